"""The licences and the SBOM in the wheel match the crates that it contains."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).parents[2]
LICENSES = ROOT / "THIRD-PARTY-LICENSES.txt"
SBOM = ROOT / "fieldbake.cyclonedx.json"

#: Words of standard licence texts, one for each licence that deny.toml accepts and a crate is used under.
WORDS = {
    "MIT": 'THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND',
    "BSD-2-Clause": "Redistributions in binary form must reproduce the above copyright",
    "BSD-3-Clause": "Neither the name",
    "ISC": "provided that the above copyright notice and this permission notice appear in all copies",
    "Zlib": "This notice may not be removed or altered from any source distribution",
    "Apache-2.0": "Grant of Patent License",
    "Unicode-3.0": "UNICODE LICENSE V3",
}


def script(name: str) -> Any:
    spec = importlib.util.spec_from_file_location(name, ROOT / "scripts" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def listed() -> dict[tuple[str, str], str]:
    """The licence of each crate in the file, by its name and version."""
    head = LICENSES.read_text(encoding="utf-8").partition("=====")[0]
    return {(name, version): licence for name, version, licence in re.findall(r"(?m)^(\S+) (\d\S*): (.*)$", head)}


def blocks() -> list[tuple[str, str]]:
    """The crates and the text of each licence."""
    parts = re.split(r"={80}\n(.*)\n={80}\n", LICENSES.read_text(encoding="utf-8"))[1:]
    return list(zip(parts[::2], parts[1::2], strict=True))


def test_the_files_are_those_of_the_locked_crates() -> None:
    if shutil.which("cargo") is None:
        pytest.skip("cargo is missing")
    for path, content in script("third_party").files().items():
        assert path.read_text(encoding="utf-8") == content, f"{path.name} is out of date: run scripts/third_party.py"


def test_every_crate_has_the_text_of_its_licence() -> None:
    found = listed()
    assert len(found) > 100
    for (name, version), licences in found.items():
        own = [text for owners, text in blocks() if f"{name} {version}" in owners.split(", ")]
        words = " ".join(" ".join(own).lower().split())
        for licence in licences.split(" and "):
            assert WORDS[licence].lower() in words, (name, version, licence)


def test_the_sbom_lists_the_same_crates_and_no_path() -> None:
    text = SBOM.read_text(encoding="utf-8")
    sbom = json.loads(text)

    assert {(crate["name"], crate["version"]) for crate in sbom["components"]} == set(listed())
    assert all(crate["purl"].startswith("pkg:cargo/") for crate in sbom["components"])
    references = {crate["bom-ref"] for crate in [sbom["metadata"]["component"], *sbom["components"]]}
    assert {row["ref"] for row in sbom["dependencies"]} == references
    assert {need for row in sbom["dependencies"] for need in row["dependsOn"]} <= references
    assert "file://" not in text
    assert str(Path.home()) not in text


def test_the_targets_are_those_of_deny_and_of_the_release() -> None:
    targets = re.search(
        r"TARGETS = \((.*?)\)", (ROOT / "scripts/third_party.py").read_text(encoding="utf-8"), re.DOTALL
    )
    assert targets is not None
    written = re.findall(r'"(.*?)"', targets[1])
    checked = re.search(r"targets = \[(.*?)\]", (ROOT / "deny.toml").read_text(encoding="utf-8"), re.DOTALL)
    assert checked is not None
    assert re.findall(r'"(.*?)"', checked[1]) == written
    released = re.findall(r"target: ([\w-]+)", (ROOT / ".github/workflows/release.yml").read_text(encoding="utf-8"))
    universal = {"universal2-apple-darwin": ["x86_64-apple-darwin", "aarch64-apple-darwin"]}
    assert sorted(target for one in released for target in universal.get(one, [one])) == sorted(written)


REMAPPED = b"/cargo/registry/src/index/exr-1/src/lib.rs\0/rustc/1a2b/library/core/src/mod.rs"


@pytest.mark.parametrize(
    ("library", "fault"),
    [
        (REMAPPED, None),
        (
            REMAPPED + b"\0/opt/rust/registry/src/index/exr-1/src/lib.rs",
            "/opt/rust/registry/src/index/exr-1/src/lib.rs",
        ),
        (REMAPPED + b"\0C:\\Users\\ann\\x.rs", "C:\\Users\\ann\\x.rs"),
        (REMAPPED + b"\0/Users/ann/x.rs", "/Users/ann/x.rs"),
    ],
)
def test_a_path_of_the_machine_in_a_wheel_is_found(library: bytes, fault: str | None, tmp_path: Path) -> None:
    wheel, info = tmp_path / "fieldbake.whl", "fieldbake-1.dist-info"
    with ZipFile(wheel, "w") as archive:
        archive.writestr("fieldbake/_core.abi3.so", library)
        for name in ("LICENSE-MIT", "LICENSE-APACHE", LICENSES.name):
            archive.write(ROOT / name, f"{info}/licenses/{name}")
        archive.write(SBOM, f"{info}/sboms/{SBOM.name}")

    faults = script("check_wheel").faults(wheel)

    assert faults == ([] if fault is None else [f"fieldbake/_core.abi3.so contains {fault}"])


def test_a_wheel_without_licences_is_found(tmp_path: Path) -> None:
    with ZipFile(tmp_path / "fieldbake.whl", "w") as archive:
        archive.writestr("fieldbake/_core.abi3.so", REMAPPED)

    assert len(script("check_wheel").faults(tmp_path / "fieldbake.whl")) == 4


@pytest.mark.parametrize(("ending", "count"), [("/x.py", 1), ("", 1), ("s.py", 0)])
def test_the_folder_of_the_build_is_found_and_a_longer_name_is_not(
    ending: str, count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("HOME", "USERPROFILE"):  # a folder that does not contain the repository
        monkeypatch.setenv(name, str(tmp_path / "home"))
    with ZipFile(tmp_path / "fieldbake.whl", "w") as archive:
        archive.writestr("fieldbake-1.dist-info/RECORD", f"{ROOT}{ending}\n")

    faults = script("check_wheel").faults(tmp_path / "fieldbake.whl")

    assert len([fault for fault in faults if "RECORD" in fault]) == count
