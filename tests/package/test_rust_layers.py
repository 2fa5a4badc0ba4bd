"""The folders and files of `src/` are layers: each imports only those below it, and no files import each other."""

import re
from pathlib import Path

SOURCE = Path(__file__).parents[2] / "src"

#: From the bottom to the top. A folder has the name of the file beside it.
LAYERS = [
    "error simd",
    "memory progress geometry encoding",
    "shader_text",
    "grid openexr",
    "gpu",
    "mesh",
    "bvh",
    "sign",
    "volume",
    "surface",
    "picture",
    "march",
    "render",
    "atlas",
    "bake",
    "solid",
    "query",
    "csg",
    "quadric",
    "merge",
    "scene",
    "viewer",
    "python",
]

LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names.split()}


def code(path):
    """The text of a file without comments and tests."""
    text = path.read_text(encoding="utf-8").partition("#[cfg(test)]\nmod tests")[0]
    # Imports of one name for tests alone.
    return re.sub(r"//.*|#\[cfg\(test\)\]\n\S[^;{]*;", "", text)


def sources():
    return [path for path in sorted(SOURCE.rglob("*.rs")) if "tests" not in path.stem and path.name != "lib.rs"]


def layer(path):
    return path.relative_to(SOURCE).parts[0].removesuffix(".rs")


def test_every_file_belongs_to_a_layer():
    assert {layer(path) for path in sources()} == set(LEVEL)


def test_folders_import_only_what_lies_below_them():
    wrong = [
        f"{path.relative_to(SOURCE)} imports {name}"
        for path in sources()
        for name in sorted(set(re.findall(r"\bcrate::(\w+)", code(path))) - {layer(path)})
        if LEVEL[name] >= LEVEL[layer(path)]
    ]
    assert wrong == []


#: Files that import each other. The context of a device owns caches whose methods take the context.
KNOTS = {
    "gpu": {"buffer context device pipeline raster timer"},
    "quadric": {"draw gpu"},
}


def imports(folder):
    """The files of a folder and the files beside them that they import; `mod.rs` is an index."""
    files = {path.stem: path for path in sources() if path.parent == SOURCE / folder and path.stem != "mod"}
    graph = {}
    for name, path in files.items():
        text = code(path)
        found = set(re.findall(r"super::(\w+)", text)) | set(re.findall(rf"crate::{folder}::(\w+)", text))
        for group in re.findall(r"use super::\{([^;]*)\};", text):
            found |= set(re.findall(r"\w+", group))
        graph[name] = {other for other in found if other in files and other != name}
    return graph


def knots(graph):
    """Sets of files that reach each other."""

    def reach(start):
        seen, waiting = set(), [start]
        while waiting:
            for other in graph[waiting.pop()] - seen:
                seen.add(other)
                waiting.append(other)
        return seen

    ways = {name: reach(name) for name in graph}
    circles = {name: {other for other in ways[name] if name in ways[other]} for name in graph if name in ways[name]}
    return {" ".join(sorted(circle)) for circle in circles.values()}


def test_files_of_a_folder_import_each_other_in_one_direction():
    folders = sorted({path.parent.name for path in sources() if path.parent.parent == SOURCE})
    found = {folder: circles for folder in folders if (circles := knots(imports(folder)))}

    assert found == KNOTS


def test_a_knot_is_found():
    assert knots({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == {"b c"}
