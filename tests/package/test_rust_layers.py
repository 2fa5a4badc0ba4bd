"""The folders and files of `src/` are layers: each imports only those below it, and no files import each other."""

import re
from pathlib import Path

SOURCE = Path(__file__).parents[2] / "src"

#: From the bottom to the top. A folder has the name of the file beside it.
LAYERS = [
    "error",
    "memory progress geometry encoding shader_text",
    "shader_library",
    "grid openexr",
    "gpu",
    "mesh",
    "bvh",
    "sign",
    "volume",
    "surface",
    "render",
    "atlas",
    "bake",
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
