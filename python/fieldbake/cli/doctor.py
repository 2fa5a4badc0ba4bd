"""The command ``doctor``: versions, devices and self-tests, as a table or as JSON."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from .application import app, show_rows
from .diagnosis import diagnose


@app.command()
def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Print versions, devices and packages, and test what works here. Exit status 1 means that a test failed."""
    found = diagnose()
    if as_json:
        typer.echo(json.dumps(found, indent=2))
    else:
        show_rows("fieldbake doctor", rows_of(found))
    if found["problems"]:
        raise typer.Exit(1)


def rows_of(found: dict[str, Any]) -> list[tuple[str, str]]:
    """Convert a diagnosis to labels and texts."""
    own, python, cpu, cache = found["fieldbake"], found["python"], found["cpu"], found["cache"]
    rows = [
        ("fieldbake", f"{own['version'] or 'unknown version'} in {own['location']}"),
        ("Python", f"{python['implementation']} {python['version']}, {python['executable']}"),
        ("system", ", ".join(filter(None, found["system"].values()))),
        ("CPU", f"{cpu['name']}, {cpu['usable_cores']} of {cpu['cores']} cores usable"),
        ("CPU features", ", ".join(cpu["features"]) or "unknown"),
    ]
    for device in found["devices"]:
        rows.append(("device", _device_text(device)))
        rows += [("", f"{path}: {_test_text(test)}") for path, test in device.get("tests", {}).items()]
    if [device.get("backend") for device in found["devices"]] == ["cpu"]:
        rows.append(("device", "no graphics adapter was found; everything runs on the CPU"))
    rows += [("Vulkan driver", path) for path in found["vulkan_drivers"]]
    rows.append(("cache", _cache_text(cache)))
    rows += [("package", _package_text(package)) for package in found["packages"]]
    rows += [("variable", f"{name}={value}") for name, value in found["environment"].items()]
    rows += [("warning", problem) for problem in found["problems"]]
    return rows if found["problems"] else [*rows, ("result", "every test passed")]


def _device_text(device: dict[str, Any]) -> str:
    if "backend" not in device:
        return f"{device['name']}: {device['error']}"
    if device["backend"] == "cpu":
        return f"cpu, {device['limits'].get('threads', 'unknown number of')} worker threads"
    kind = "hardware" if device["hardware"] else 'runs on the CPU, used only if named or with device="gpu"'
    return f"{device['name']}, {device['backend']}, {device['type']}, {kind}"


def _test_text(test: dict[str, Any]) -> str:
    if not test["ok"]:
        return f"FAILED, {test['message']}"
    first, second = (1e3 * test[name] for name in ("first_seconds", "seconds"))
    return f"works, {second:.1f} ms (first call {first:.0f} ms), largest error {test['error']:.1e}"


def _cache_text(cache: dict[str, Any]) -> str:
    size = f"{cache['files']} fields, {cache['nbytes'] / 1e6:.1f} MB"
    state = "" if cache["used"] else "; used only after fieldbake.cache.use_disk() or with FIELDBAKE_CACHE"
    return f"{cache['folder'] or cache['error']}: {size}{state}"


def _package_text(package: dict[str, Any]) -> str:
    state = package["error"] or package["version"] or "not installed"
    needed = f" (at least {package['least']})" if package["least"] else ""
    return f"{package['name']} {state}{needed}" + (f", extra {package['extra']}" if package["extra"] else "")
