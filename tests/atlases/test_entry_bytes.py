"""The bytes of the entries against the layout that the reference compiler of GLSL gives to the article's buffer."""

import re
import shutil
import struct
import subprocess

import numpy as np
import pytest

import fieldbake as fb
from browser import missing

ARTICLE_BUFFER = """#version 450
struct PackedSdfOffsetDetail {
    mat4 modelMat;
    mat4 invModelMat;
    vec4 innerBBMin;
    vec4 innerBBMax;
    vec4 outerBBMin;
    vec4 outerBBMax;
    int atlasIndex;
    int atlasOffset;
};
layout (std430, binding = 0) buffer PackedSdfOffsetDetailBuffer {
    int offsetSize;
    PackedSdfOffsetDetail offsets[];
};
layout (local_size_x = 1) in;
void main() {
    PackedSdfOffsetDetail one = offsets[0];
    offsets[offsetSize] = one;
}
"""


def test_the_header_and_the_entries_lie_where_the_articles_shader_reads_them(tmp_path):
    moved = np.eye(4)
    moved[:3, 3] = 5, 6, 7
    ball = fb.bake(fb.sphere(1), (4, 4, 4))
    atlas = fb.pack([ball, (ball, moved), ball], layout="strips", page_size=16)
    compiler = shutil.which("glslangValidator")
    if compiler is None:
        missing("there is no glslangValidator: install the package glslang-tools")
    path = tmp_path / "article.comp"
    path.write_text(ARTICLE_BUFFER)
    told = subprocess.run([compiler, "-q", "-l", str(path)], capture_output=True, text=True, timeout=60, check=True)
    offsets = {name: int(at) for name, at in re.findall(r"^(?:offsets\.)?(\w+): offset (\d+)", told.stdout, re.M)}
    strides = set(map(int, re.findall(r"topLevelArrayStride (\d+)", told.stdout)))

    content = atlas.entry_bytes(header=True)

    (stride,) = strides
    assert len(content) == offsets["modelMat"] + 3 * stride
    assert struct.unpack_from("<i", content, offsets["offsetSize"]) == (3,)
    for i, model in enumerate((np.eye(4), moved, np.eye(4))):
        start = i * stride
        columns = np.frombuffer(content, "<f4", 16, start + offsets["modelMat"]).reshape(4, 4)
        assert np.array_equal(columns.T, model)
        outer = np.frombuffer(content, "<f4", 3, start + offsets["outerBBMax"])
        assert np.array_equal(outer, ball.bounds[1].astype(np.float32))
        assert struct.unpack_from("<ii", content, start + offsets["atlasIndex"]) == (
            atlas.entries["atlas_index"][i],
            atlas.entries["atlas_offset"][i],
        )


def test_without_a_header_the_bytes_are_the_entries():
    atlas = fb.pack([fb.bake(fb.sphere(1), 6)], page_size=64)
    assert atlas.entry_bytes() == atlas.entries.tobytes()
    assert len(atlas.entry_bytes(header=True)) == 16 + 240
    with pytest.raises(fb.ArgumentError, match="header"):
        atlas.entry_bytes(header=1)
