"""Pipes and devices in place of files, and files that do not fit in memory."""

import os
import subprocess
import sys

import pytest

import fieldbake as fb

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has other pipes and devices")

OBJ = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\n"
ENDINGS = (".npz", ".dds", ".ktx2", ".vf", ".vdb", ".nvdb", ".vti", ".nrrd", ".exr", ".png", ".obj", ".glb", ".stl")


def read(path):
    (fb.load_mesh if path.suffix in (".obj", ".glb", ".stl") else fb.load)(path)


@pytest.mark.parametrize("ending", ENDINGS)
def test_pipes_and_devices_are_refused_by_name(ending, tmp_path):
    pipe, link = tmp_path / f"pipe{ending}", tmp_path / f"zero{ending}"
    os.mkfifo(pipe)
    link.symlink_to("/dev/zero")
    for path in (pipe, link):
        with pytest.raises((fb.FormatError, fb.MeshError), match=rf"{path.name}: is a pipe or a device"):
            read(path)


def test_a_json_that_is_a_pipe_is_not_read(tmp_path):
    fb.bake(fb.sphere(), 8).save(tmp_path / "v.dds")
    (tmp_path / "v.dds.json").unlink()
    os.mkfifo(tmp_path / "v.dds.json")
    with pytest.raises(fb.FormatError, match=r"v\.dds\.json"):
        fb.load(tmp_path / "v.dds")


@pytest.mark.parametrize("name", ["m.mtl", "t.png"])
def test_a_pipe_that_a_mesh_refers_to_is_refused_by_name(name, tmp_path):
    (tmp_path / "m.obj").write_text(OBJ)
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd sub\\t.png\n")
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    with pytest.raises(fb.MeshError, match=rf"{name}: is a pipe or a device"):
        fb.load_mesh(tmp_path / "m.obj")
    (tmp_path / name).unlink()
    assert len(fb.load_mesh(tmp_path / "m.obj").faces) == 1


LIMITED = """
import resource, sys
import fieldbake as fb
import trimesh
resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
try:
    (fb.load_mesh if sys.argv[1].endswith((".obj", ".stl")) else fb.load)(sys.argv[1])
except fb.CapacityError as error:
    print(error)
"""


@pytest.mark.parametrize("ending", [".vf", ".nrrd", ".obj", ".stl"])
def test_a_file_beyond_memory_is_a_capacity_error(ending, tmp_path):
    path = tmp_path / f"v{ending}"
    with path.open("wb") as file:
        file.truncate(64 << 30)  # a file with a hole, which takes no space
    command = [sys.executable, "-c", LIMITED, str(path)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr
    assert f"{path}: needs more memory" in result.stdout
