"""The output of a run on stderr: none of other libraries, and one warning if a device is a software adapter."""

import json
import os
import subprocess
import sys

import pytest
import trimesh

BAKE = """
import json, warnings
import fieldbake as fb
mesh = fb.Mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
"""


def run(*command, **variables):
    """A process without a display server, and without what would hide the lines of Mesa's layer."""
    hidden = ("XDG_RUNTIME_DIR", "NODEVICE_SELECT", "MESA_VK_DEVICE_SELECT", "DRI_PRIME", "PYTHONWARNINGS")
    environment = {name: value for name, value in os.environ.items() if name not in hidden} | variables
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120, env=environment)


def python(script, **variables):
    return run(sys.executable, "-c", BAKE + script, **variables)


@pytest.fixture(scope="module")
def is_software():
    """Whether "gpu" is a software adapter here."""
    import fieldbake as fb

    adapters = [found for found in fb.devices() if found.type != "cpu"]
    return bool(adapters) and not any(found.hardware for found in adapters)


SCRIPTS = {
    "import": "",
    "devices": "fb.devices()",
    "auto": "fb.bake(mesh, 4)",
    "gpu": "fb.bake(mesh, 4, device='gpu').distances",
    "query": "fb.closest_point(mesh, [(0, 0, 2)])",
}


@pytest.mark.parametrize("name", SCRIPTS)
def test_nothing_foreign_is_written(name, gpu):
    result = python(SCRIPTS[name], PYTHONWARNINGS="ignore")
    assert (result.returncode, result.stderr, result.stdout) == (0, "", "")


@pytest.mark.parametrize(
    "command", [["devices"], ["bake", "{}/box.stl", "-o", "{}/box.npz", "-r", "4", "--device", "gpu"]]
)
def test_the_command_line_writes_nothing_foreign(command, gpu, tmp_path):
    trimesh.creation.box().export(tmp_path / "box.stl")
    words = [word.format(tmp_path) for word in command]
    result = run(sys.executable, "-m", "fieldbake", *words, PYTHONWARNINGS="ignore")
    assert (result.returncode, result.stderr) == (0, "")


def test_the_environment_is_as_before(gpu):
    script = """
import ctypes
fb.bake(mesh, 4, device='gpu')
read = ctypes.CDLL(None).getenv
read.restype = ctypes.c_char_p
print(read(b'NODEVICE_SELECT'))
"""
    assert python(script, PYTHONWARNINGS="ignore").stdout == "None\n"
    assert python(script, PYTHONWARNINGS="ignore", NODEVICE_SELECT="2").stdout == "b'2'\n"


def test_a_software_adapter_warns_once_a_process(gpu, is_software):
    script = """
with warnings.catch_warnings(record=True) as seen:
    warnings.simplefilter("always")
    reports = [fb.bake(mesh, 4, device=device).report for device in ("auto", "cpu", "gpu", "gpu", fb.devices()[-1])]
found = [(issubclass(w.category, fb.PerformanceWarning), str(w.message)) for w in seen]
print(json.dumps([found, [report.warnings for report in reports]]))
"""
    result = python(script)
    assert (result.returncode, result.stderr) == (0, "")
    found, reports = json.loads(result.stdout)
    said = [[line for line in report if "software adapter" in line] for report in reports]
    if not is_software:
        assert found == []
        assert said == [[]] * 5
        return
    [(is_ours, message)] = found
    assert is_ours
    assert "140 times" in message
    # Every report of a call by "gpu" says so; an adapter that was chosen by its name needs no remark.
    assert said == [[], [], [message], [message], []]


def test_the_warning_can_be_an_error(gpu, is_software):
    if not is_software:
        pytest.skip("the adapter is hardware")
    result = python("fb.bake(mesh, 4, device='gpu')", PYTHONWARNINGS="error::UserWarning")
    assert result.returncode == 1
    assert 'fieldbake.base.errors.PerformanceWarning: device="gpu" chose' in result.stderr
