"""The folders of `src/` are layers: each imports only those below it. No two files import each other."""

import re
from pathlib import Path

SOURCE = Path(__file__).parents[2] / "src"
SHADERS = SOURCE.parent / "shaders"

#: From the bottom to the top. A folder has the name of the file beside it.
LAYERS = [
    "error simd",
    "memory progress geometry encoding",
    "shader_text",
    "grid openexr",
    "gpu",
    "mesh",
    "bvh",
    "cloud",
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
    "assembly",
    "sweep",
    "quadric",
    "merge",
    "scene",
    "viewer",
    "python",
]

#: The order of the files and folders inside some folders, written as above.
INNER = {
    "bvh": ["binary boxes build lanes moments pack refit stack", "nearest rays"],
    "csg": ["tree", "model", "evaluation", "parts", "between_samples", "level_set text", "device"],
    "scene": ["fields", "content", "visibility", "light", "device", "lighting", "last_picture uneven", "renderer"],
}

#: Largest number of files directly in a folder.
LARGEST_FOLDER = 16

#: The binding layer has a file for each file of the core.
LARGE_FOLDERS = {"src/python"}

#: Files that import each other: the context of a device owns caches whose methods take the context.
KNOTS = {"gpu::buffer gpu::context gpu::device gpu::pipeline gpu::raster gpu::timer"}


def levels(layers):
    return {name: level for level, names in enumerate(layers) for name in names.split()}


def code(path):
    """The text of a file without comments and tests."""
    text = path.read_text(encoding="utf-8").partition("#[cfg(test)]\nmod tests")[0]
    # Imports of one name for tests alone.
    return re.sub(r"//.*|#\[cfg\(test\)\]\n\S[^;{]*;", "", text)


def module(path):
    """The names on the way to a file. `mod.rs` is the index of its folder, and so is a file beside a folder."""
    names = path.relative_to(SOURCE).with_suffix("").parts
    return names[:-1] if names[-1] in ("mod", "lib") else names


def sources():
    paths = [path for path in sorted(SOURCE.rglob("*.rs")) if "tests" not in path.stem and path.name != "lib.rs"]
    return {module(path): path for path in paths}


def leaves(tree):
    """The paths of a `use` tree, as tuples of names: `a::{b, c::d}` is `a::b` and `a::c::d`."""
    head, brace, rest = tree.partition("{")
    prefix = tuple(name.strip() for name in head.split("::") if name.strip())
    if not brace:
        return [(*prefix[:-1], prefix[-1].split(" as ")[0])]
    inner, depth, parts = rest.rpartition("}")[0], 0, [""]
    for char in inner:
        depth += {"{": 1, "}": -1}.get(char, 0)
        if char == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += char
    found = [(*prefix, *leaf) for part in parts if part.strip() for leaf in leaves(part)]
    return [leaf[:-1] if leaf[-1] == "self" else leaf for leaf in found]


def absolute(names, here, files):
    """A path from the root of the crate; None for a path into another crate. `here` is the module that has it."""
    if names[0] == "crate":
        return names[1:]
    if names[0] in ("self", "super"):
        while names and names[0] in ("self", "super"):
            here = here if names[0] == "self" else here[:-1]
            names = names[1:]
        return here + names
    return here + names if here + names[:1] in files else None


def exports(files):
    """The names that indices re-export, each with the path of its definition."""
    found = {}
    for name, path in files.items():
        for tree in re.findall(r"^\s*pub(?:\([^)]*\))? use ([^;]+);", code(path), re.MULTILINE):
            for leaf in leaves(tree):
                if target := absolute(leaf, name, files):
                    found[(*name, leaf[-1])] = target
    return found


def resolve(names, files, exported):
    """The file that defines what a path names."""
    for length in range(len(names), 0, -1):
        if names[:length] in exported and names[:length] not in files:
            return resolve(exported[names[:length]] + names[length:], files, exported)
    return next((names[:length] for length in range(len(names), 0, -1) if names[:length] in files), None)


def imports():
    """The files of the crate and those that each of them imports."""
    files = sources()
    exported = exports(files)
    graph = {}
    for name, path in files.items():
        text = code(path)
        uses = re.findall(r"^\s*use ([^;]+);", text, re.MULTILINE)
        paths = [leaf for tree in uses for leaf in leaves(tree)]
        rest = re.sub(r"^\s*(?:pub(?:\([^)]*\))? )?use [^;]+;", "", text, flags=re.MULTILINE)
        paths += [tuple(found.split("::")) for found in re.findall(r"\b(?:crate|super|self)(?:::\w+)+", rest)]
        targets = {absolute(leaf, name, files) for leaf in paths} - {None}
        graph[name] = {resolve(target, files, exported) for target in targets} - {None, name}
    return graph


def knots(graph):
    """Sets of files that reach each other."""

    def reach(start):
        reached, waiting = set(), [start]
        while waiting:
            for other in graph[waiting.pop()] - reached:
                reached.add(other)
                waiting.append(other)
        return reached

    targets = {name: reach(name) for name in graph}
    circles = {name: {other for other in targets[name] if name in targets[other]} for name in graph}
    return {" ".join(sorted(circle)) for circle in circles.values() if circle}


def test_every_file_belongs_to_a_layer():
    assert {name[0] for name in sources()} == set(levels(LAYERS))
    for folder, layers in INNER.items():
        assert {name[1] for name in sources() if name[0] == folder and len(name) > 1} == set(levels(layers)), folder


def test_folders_import_only_what_lies_below_them():
    level = levels(LAYERS)
    wrong = [
        f"{'::'.join(name)} imports {other[0]}"
        for name, others in imports().items()
        for other in sorted(others)
        if name[0] != other[0] and level[other[0]] >= level[name[0]]
    ]
    assert wrong == []


def is_above(name, other, level):
    """Whether `name` imports `other` of the same folder against the order. Files on one level may import each other."""
    if name[1] == other[1]:
        return False
    is_beside = level[other[1]] == level[name[1]] and (len(name) > 2 or len(other) > 2)
    return is_beside or level[other[1]] > level[name[1]]


def test_inner_folders_import_only_what_lies_below_them():
    graph = imports()
    for folder, layers in INNER.items():
        level = levels(layers)
        wrong = [
            f"{'::'.join(name)} imports {'::'.join(other)}"
            for name, others in graph.items()
            for other in sorted(others)
            if name[0] == other[0] == folder and len(name) > 1 and len(other) > 1 and is_above(name, other, level)
        ]
        assert wrong == []


def test_an_import_against_the_order_is_found():
    level = levels(["a b", "c"])
    assert is_above(("x", "a"), ("x", "c", "f"), level)
    assert is_above(("x", "a", "f"), ("x", "b"), level)
    assert not is_above(("x", "a"), ("x", "b"), level)
    assert not is_above(("x", "c", "f"), ("x", "a"), level)


def test_files_import_each_other_in_one_direction():
    graph = imports()
    # An index declares its files, and they import the types that it defines.
    indices = {name for name in graph if any(other[:-1] == name for other in graph)}
    files = {
        "::".join(name): {"::".join(other) for other in others - indices}
        for name, others in graph.items()
        if name not in indices
    }
    assert knots(files) == KNOTS


def test_no_folder_is_crowded():
    folders = [folder for root in (SOURCE, SHADERS) for folder in (root, *root.rglob("*")) if folder.is_dir()]
    counts = {
        folder.relative_to(SOURCE.parent).as_posix(): sum(path.is_file() for path in folder.iterdir())
        for folder in folders
    }
    assert {name for name, count in counts.items() if count > LARGEST_FOLDER} <= LARGE_FOLDERS


def test_a_knot_is_found():
    assert knots({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == {"b c"}


def test_paths_are_read():
    files = {("a",): None, ("a", "b"): None, ("a", "c"): None}
    assert leaves("crate::a::{self, b::{X, Y as Z}}") == [("crate", "a"), *(("crate", "a", "b", x) for x in "XY")]
    assert absolute(("super", "c", "f"), ("a", "b"), files) == ("a", "c", "f")
    assert absolute(("std", "fmt"), ("a",), files) is None
    assert resolve(("a", "X"), files, {("a", "X"): ("a", "b", "X")}) == ("a", "b")
