"""Properties of this installation and this machine, for `doctor`.

A property that cannot be read is None or has an error as text. Such an error never ends the diagnosis.
"""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import importlib.util
import os
import platform
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

#: Time limit of each self-test, seconds. The first call on a device compiles its kernels.
LIMIT_S = 60.0

#: Instruction sets that decide speed, as NumPy names them.
FEATURES = ("SSE42", "AVX", "FMA3", "AVX2", "AVX512F", "NEON", "ASIMD", "SVE")

#: Environment variables that change results or speed: names, or prefixes of names.
VARIABLES = ("FIELDBAKE_", "RAYON_", "VK_", "WGPU_", "MESA_", "LIBGL_", "XDG_CACHE_HOME", "PYTHONPATH")

#: Folders in which the Vulkan loader of Linux finds its drivers.
DRIVER_FOLDERS = ("/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d", "/usr/share/vulkan/icd.d")

#: A requirement in the metadata of a package: name, lower bound of the version, extra.
REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)[^>;]*(?:>=\s*(?P<least>[\w.]+))?[^;]*(?:;.*extra == ['\"](?P<extra>\w+))?")

#: The module of a package whose name differs by more than hyphens, which are underscores in modules.
MODULES = {"pillow": "PIL"}


def diagnose(*, self_tests: bool = True) -> dict[str, Any]:
    """Collect all properties. The entry ``problems`` lists all faults as sentences."""
    found: dict[str, Any] = {
        "fieldbake": _own_facts(),
        "python": {"version": platform.python_version(), "implementation": platform.python_implementation()},
        "system": {"platform": platform.platform(), "libc": " ".join(platform.libc_ver()).strip()},
        "cpu": _cpu_facts(),
        "packages": _packages(),
        "cache": _cache_facts(),
        "environment": {name: value for name, value in sorted(os.environ.items()) if name.startswith(VARIABLES)},
        "vulkan_drivers": _vulkan_drivers(),
    }
    found["python"]["executable"] = sys.executable
    found["devices"] = _devices(self_tests) if not found["fieldbake"]["error"] else []
    found["problems"] = _problems(found)
    return found


def attempt(function: Callable[..., Any], *arguments: Any) -> tuple[Any, str | None]:
    """Call a function. Returns its result and None, or None and the error as one line."""
    try:
        return function(*arguments), None
    except Exception as error:  # the diagnosis goes on without this property
        lines = str(error).strip().splitlines()
        return None, f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


def _own_facts() -> dict[str, Any]:
    version, error = attempt(lambda: importlib.import_module("fieldbake._core").__version__)
    return {"version": version, "location": str(Path(__file__).parents[1]), "error": error}


def _cpu_facts() -> dict[str, Any]:
    affinity, _ = attempt(lambda: len(os.sched_getaffinity(0)))
    features, _ = attempt(_cpu_features)
    return {
        "name": _cpu_name(),
        "architecture": platform.machine(),
        "cores": os.cpu_count(),
        "usable_cores": affinity or os.cpu_count(),
        "features": features or [],
    }


def _cpu_features() -> list[str]:
    # The name of NumPy's private package has an underscore since NumPy 2.
    name = "numpy._core" if importlib.util.find_spec("numpy._core") else "numpy.core"
    offered = importlib.import_module(f"{name}._multiarray_umath").__cpu_features__
    return [feature for feature in FEATURES if offered.get(feature)]


def _cpu_name() -> str:
    text, _ = attempt(lambda: Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace"))
    match = re.search(r"^model name\s*:\s*(.+)$", text or "", re.MULTILINE)
    return match.group(1) if match else platform.processor()


def _packages() -> list[dict[str, Any]]:
    """List the packages that fieldbake requires or can use, by the metadata of the installation."""
    requirements, _ = attempt(importlib.metadata.requires, "fieldbake")
    rows = []
    for requirement in requirements or []:
        match = REQUIREMENT.match(requirement)
        if match is None:
            continue
        name, least, extra = match["name"], match["least"], match["extra"]
        version, _ = attempt(importlib.metadata.version, name)
        row = {"name": name, "version": version, "least": least, "extra": extra, "error": None}
        if version is not None and least is not None and _numbers(version) < _numbers(least):
            row["error"] = f"version {version} is older than {least}"
        elif extra is None and version is None:
            row["error"] = "not installed"
        elif extra is None:
            _, row["error"] = attempt(importlib.import_module, MODULES.get(name, name.replace("-", "_")))
        rows.append(row)
    # A package may be too old for an extra that is not installed.
    incomplete = {row["extra"] for row in rows if row["version"] is None}
    for row in rows:
        if row["extra"] is not None and row["extra"] in incomplete:
            row["error"] = None
    return rows


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version)[:3])


def _cache_facts() -> dict[str, Any]:
    """Find the folder of cached fields, its size and whether fields are stored there."""
    named = os.environ.get("FIELDBAKE_CACHE")
    folder, error = (named, None) if named else attempt(_default_cache)
    facts: dict[str, Any] = {"folder": folder, "used": bool(named), "files": 0, "nbytes": 0, "error": error}
    if folder is not None:
        sizes, facts["error"] = attempt(_sizes, Path(folder))
        facts["files"], facts["nbytes"] = len(sizes or []), sum(sizes or [])
        nearest = next(path for path in (Path(folder), *Path(folder).absolute().parents) if path.exists())
        facts["writable"] = os.access(nearest, os.W_OK)
    return facts


def _sizes(folder: Path) -> list[int]:
    return [path.stat().st_size for path in folder.glob("*.npz")] if folder.is_dir() else []


def _default_cache() -> str:
    return str(importlib.import_module("platformdirs").user_cache_dir("fieldbake"))


def _vulkan_drivers() -> list[str]:
    """List the manifests of Vulkan drivers. Only Linux has them as files."""
    named = os.environ.get("VK_DRIVER_FILES") or os.environ.get("VK_ICD_FILENAMES")
    if named:
        return [f"{path}{'' if Path(path).is_file() else ' (missing)'}" for path in named.split(os.pathsep)]
    found, _ = attempt(lambda: [str(path) for folder in DRIVER_FOLDERS for path in sorted(Path(folder).glob("*.json"))])
    return found or []


def _devices(self_tests: bool) -> list[dict[str, Any]]:
    """List the devices and test each in a child process, so that a crash of a driver does not end this process."""
    child_module, error = attempt(importlib.import_module, "fieldbake.scaling.process")
    tests, other_error = attempt(importlib.import_module, "fieldbake.cli.selftests")
    if error or other_error:
        return [{"name": "cpu", "error": error or other_error}]
    child = child_module.Child()
    call = functools.partial(child.call, limit_s=LIMIT_S)
    try:
        listed, error = attempt(call, tests.list_devices)
        if error:
            # The drivers cannot be loaded. The CPU needs none.
            listed = [{"name": "cpu", "backend": "cpu", "type": "cpu", "hardware": False, "limits": {}}]
        if self_tests:
            for device in listed:
                device["tests"] = {}
                for path in tests.PATHS:
                    result, failure = attempt(call, getattr(tests, f"check_{path}"), device["name"])
                    device["tests"][path] = {**(result or {}), "ok": failure is None, "message": failure}
    finally:
        child.close()
    if error:
        listed.append({"name": "adapters", "error": error})
    return list(listed)


def _problems(found: dict[str, Any]) -> list[str]:
    problems = []
    if found["fieldbake"]["error"]:
        problems.append(f"The compiled core cannot be imported: {found['fieldbake']['error']}")
    problems += [f"The package {row['name']}: {row['error']}" for row in found["packages"] if row["error"]]
    for device in found["devices"]:
        if device.get("error"):
            problems.append(f"The devices cannot be listed: {device['error']}")
        problems += [
            f"The self-test {path!r} on {device['name']} failed: {test['message']}"
            for path, test in device.get("tests", {}).items()
            if not test["ok"]
        ]
    if found["cache"]["error"]:
        problems.append(f"The cache folder cannot be read: {found['cache']['error']}")
    return problems
