"""`fieldbake doctor` describes the installation and tests it, even if parts are missing."""

import importlib.metadata
import json
import os
import signal
import subprocess
import sys

import pytest
from typer.testing import CliRunner

import assets
import fieldbake as fb
import meshes
from fieldbake.cli import diagnosis, selftests
from fieldbake.cli.application import app
from fieldbake.cli.doctor import rows_of


def doctor(*arguments):
    result = CliRunner().invoke(app, ["doctor", *arguments], prog_name="fieldbake")
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


@pytest.fixture
def no_driver(monkeypatch, tmp_path):
    """A machine without a graphics driver. The devices are listed in a child process, which sees the variable."""
    monkeypatch.setenv("VK_DRIVER_FILES", str(tmp_path / "missing.json"))


@pytest.fixture
def no_devices(monkeypatch):
    """No child process is started for the devices."""
    monkeypatch.setattr(diagnosis, "_devices", lambda _: [])


@pytest.mark.usefixtures("no_driver")
def test_json_and_text_have_versions_the_cpu_and_its_tests():
    result = doctor("--json")
    found = json.loads(result.stdout)

    assert result.exit_code == 0, result.stdout
    assert found["problems"] == []
    assert found["fieldbake"]["version"] == fb.__version__
    assert found["python"]["version"] == ".".join(map(str, sys.version_info[:3]))
    assert found["cpu"]["cores"] == os.cpu_count()
    (cpu,) = found["devices"]
    assert (cpu["name"], cpu["backend"]) == ("cpu", "cpu")
    assert cpu["limits"]["threads"] >= 1
    distance, depth = selftests.DISTANCE_TOLERANCE, selftests.DEPTH_TOLERANCE
    for path, limit in {"bake": distance, "query": distance, "draw": depth, "render": depth}.items():
        assert cpu["tests"][path]["ok"]
        assert 0 <= cpu["tests"][path]["error"] <= limit
        assert cpu["tests"][path]["seconds"] > 0
        assert cpu["tests"][path]["first_seconds"] > 0
    rows = " ".join(text for _, text in rows_of(found))
    assert "no graphics adapter was found" in rows
    assert "missing.json (missing)" in rows
    assert "every test passed" in rows


@pytest.mark.usefixtures("gpu")
def test_each_adapter_is_tested():
    found = diagnosis.diagnose()

    assert found["problems"] == []
    assert [device["name"] for device in found["devices"]] == [device.name for device in fb.devices()]
    assert all(device["tests"][path]["ok"] for device in found["devices"] for path in selftests.PATHS)


@pytest.mark.usefixtures("no_driver")
def test_a_crash_of_a_driver_is_a_failed_test(monkeypatch):
    monkeypatch.setattr(selftests, "check_bake", assets.kill_on)

    result = doctor("--json")
    found = json.loads(result.stdout)

    tests = found["devices"][0]["tests"]
    assert result.exit_code == 1
    assert [tests[path]["ok"] for path in selftests.PATHS] == [False, True, True, True]
    assert signal.Signals.SIGKILL.name in " ".join(found["problems"])


@pytest.mark.parametrize("path", selftests.PATHS)
def test_a_wrong_result_fails_a_self_test(monkeypatch, path):
    vertices, faces = meshes.box()
    mesh = fb.Mesh(0.51 * vertices, faces)  # its half side is 0.51
    monkeypatch.setattr(selftests, "_cube", lambda: mesh)

    with pytest.raises(fb.Error, match=r"largest error is 0\.01"):
        getattr(selftests, f"check_{path}")("cpu")


def test_a_missing_shadow_fails_the_test_of_scenes(monkeypatch):
    scene, ahead = fb.Scene, fb.DirectionalLight((0, 0, -1))
    monkeypatch.setattr(selftests.fb, "Scene", lambda instances, **_: scene(instances, lights=[ahead]))

    with pytest.raises(fb.Error, match="largest error is 1"):
        selftests.check_render("cpu")


def test_a_result_that_is_not_a_number_fails_a_self_test():
    errors = iter((0.0, float("nan")))

    with pytest.raises(fb.Error, match="largest error is nan"):
        selftests._checked(lambda: None, lambda _: next(errors), 1.0)


@pytest.mark.usefixtures("no_devices")
def test_packages_that_are_missing_or_too_old_are_problems_but_optional_ones_are_not(monkeypatch):
    requirements = ["numpy>=99.0", "no-such-package>=1.2", 'other-package>=3; extra == "zarr"', "pillow>=1.1,<99"]
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: requirements)

    found = diagnosis.diagnose(self_tests=False)

    assert [row["name"] for row in found["packages"]] == ["numpy", "no-such-package", "other-package", "pillow"]
    assert [row["extra"] for row in found["packages"]] == [None, None, "zarr", None]
    assert [row["least"] for row in found["packages"]] == ["99.0", "1.2", "3", "1.1"]
    assert [bool(row["error"]) for row in found["packages"]] == [True, True, False, False]
    assert len(found["problems"]) == 2
    assert "older than 99.0" in found["problems"][0]


@pytest.mark.usefixtures("no_devices")
@pytest.mark.parametrize(("other", "problems"), [("pillow>=1.1", 1), ("no-such-package>=1.2", 0)])
def test_a_package_is_too_old_for_an_extra_only_if_the_extra_is_installed(monkeypatch, other, problems):
    requirements = ['numpy>=99.0; extra == "zarr"', f'{other}; extra == "zarr"']
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: requirements)

    assert len(diagnosis.diagnose(self_tests=False)["problems"]) == problems


@pytest.mark.usefixtures("no_devices")
def test_without_metadata_the_diagnosis_has_no_packages(monkeypatch):
    def missing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "requires", missing)

    assert diagnosis.diagnose(self_tests=False)["packages"] == []


@pytest.mark.usefixtures("no_devices")
def test_the_cache_has_its_size(monkeypatch, tmp_path):
    (tmp_path / "one.npz").write_bytes(b"1234")
    (tmp_path / "two.npz").write_bytes(b"123")
    monkeypatch.setenv("FIELDBAKE_CACHE", str(tmp_path))

    cache = diagnosis.diagnose(self_tests=False)["cache"]

    assert (cache["folder"], cache["used"], cache["files"], cache["nbytes"]) == (str(tmp_path), True, 2, 7)


@pytest.mark.parametrize("module", ["fieldbake._core", "numpy"])
def test_an_installation_that_cannot_be_imported_is_a_problem_not_a_crash(module):
    script = f"import sys; sys.modules[{module!r}] = None; from fieldbake.cli import main; main()"

    result = subprocess.run(
        [sys.executable, "-c", script, "doctor"], capture_output=True, text=True, check=False, timeout=120
    )

    assert result.returncode == 1
    assert result.stderr == ""
    assert "import of" in result.stdout
    assert "no graphics adapter" not in result.stdout
