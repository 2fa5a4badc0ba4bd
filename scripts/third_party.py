"""Write the licence texts of the crates in a wheel, and the list of these crates as an SBOM in CycloneDX.

    python scripts/third_party.py

Run it after each change of Cargo.lock, and for each release. The crates are the normal dependencies of the extension
module for every target of the released wheels, so that all wheels contain the same two files. maturin's own SBOM
contains the path of the build and is switched off.
"""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
LICENSES = ROOT / "THIRD-PARTY-LICENSES.txt"
SBOM = ROOT / "fieldbake.cyclonedx.json"

#: Targets of the released wheels; the macOS wheel has two.
TARGETS = (
    "x86_64-unknown-linux-gnu",
    "aarch64-unknown-linux-gnu",
    "x86_64-apple-darwin",
    "aarch64-apple-darwin",
    "x86_64-pc-windows-msvc",
)

#: Accepted licences in the order in which one of several is chosen: the word in the name of its file, and words of its
#: text.
LICENCES = {
    "MIT": ("MIT", "Permission is hereby granted, free of charge"),
    "BSD-2-Clause": ("BSD", "Redistribution and use in source and binary forms"),
    "BSD-3-Clause": ("BSD", "Redistribution and use in source and binary forms"),
    "ISC": ("ISC", "Permission to use, copy, modify, and/or distribute this software"),
    "Zlib": ("ZLIB", "This software is provided 'as-is'"),
    "Unicode-3.0": ("UNICODE", "UNICODE LICENSE V3"),
    "Apache-2.0": ("APACHE", "TERMS AND CONDITIONS FOR USE, REPRODUCTION, AND DISTRIBUTION"),
}

#: Holders of the copyright of the standard library and of the crates that it contains on these targets.
STANDARD_LIBRARY = """Copyright (c) The Rust Project Developers (see https://thanks.rust-lang.org)
Copyright (c) 2014 Alex Crichton
Copyright (c) 2015 The Rust Project Developers
Copyright (c) 2016 Amanieu d'Antras
Copyright (c) 2019 The Crossbeam Project Developers
Copyright (c) Microsoft Corporation"""

HEAD = """The compiled library of fieldbake contains code of the crates below, under these licences. Where a crate may
be used under one of several licences, the one that is named here was chosen. scripts/third_party.py wrote this file.
"""

Package = dict[str, Any]


def crates() -> tuple[Package, dict[str, Package], dict[str, list[str]]]:
    """The package of fieldbake, the crates in the wheels by id, and the ids that each of them depends on."""
    targets = [word for target in TARGETS for word in ("--filter-platform", target)]
    command = ["cargo", "metadata", "--locked", "--format-version", "1", "--features", "python", *targets]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, encoding="utf-8")
    if found.returncode:
        raise RuntimeError(found.stderr)
    metadata = json.loads(found.stdout)
    packages = {package["id"]: package for package in metadata["packages"]}
    needs = {
        node["id"]: sorted(d["pkg"] for d in node["deps"] if any(kind["kind"] is None for kind in d["dep_kinds"]))
        for node in metadata["resolve"]["nodes"]
    }
    root = metadata["resolve"]["root"]
    reached, waiting = set(), [root]
    while waiting:
        if (one := waiting.pop()) not in reached:
            reached.add(one)
            waiting += needs[one]
    used = sorted(reached, key=lambda one: (packages[one]["name"], packages[one]["version"]))
    return packages[root], {one: packages[one] for one in used if one != root}, needs


def chosen(package: Package) -> list[str]:
    """The licences under which a crate is used: one of each choice."""
    found = []
    for choice in re.split(r"\s+AND\s+", package["license"]):
        offered = re.split(r"\s+OR\s+|/", choice.strip("() "))
        accepted = [name for name in LICENCES if name in offered]
        if not accepted:
            raise ValueError(f"{package['name']}: no accepted licence in {package['license']!r}")
        found.append(accepted[0])
    return found


def texts(package: Package) -> list[str]:
    """The texts of the chosen licences of a crate, and its notices."""
    folder = Path(package["manifest_path"]).parent
    files = sorted(path for path in folder.iterdir() if path.is_file())
    named = [path for path in files if re.match("LICEN[CS]E|COPYING", path.name.upper())]
    found = [path.read_text(encoding="utf-8") for path in files if re.match("NOTICE|COPYRIGHT", path.name.upper())]
    for name in chosen(package):
        word, phrase = LICENCES[name]
        own = [path for path in named if word in path.name.upper()] or [p for p in named if len(named) == 1]
        all_texts = [path.read_text(encoding="utf-8") for path in own] or [standard_text(name, package)]
        if not any(phrase in " ".join(text.split()) for text in all_texts):
            raise ValueError(f"{package['name']}: the text of {name} was not found in {folder}")
        found += all_texts
    return found


def standard_text(name: str, package: Package) -> str:
    """The text of a licence for a crate that has no file of it."""
    if name == "Apache-2.0":
        return (ROOT / "LICENSE-APACHE").read_text(encoding="utf-8")
    if name != "MIT":
        raise ValueError(f"{package['name']}: it has no text of its licence, {name}")
    holders = [author.partition(" <")[0] for author in package["authors"]] or [f"the authors of {package['name']}"]
    return mit_text(f"Copyright (c) {', '.join(holders)}")


def mit_text(holders: str) -> str:
    return re.sub(r"(?m)^Copyright .*$", holders, (ROOT / "LICENSE-MIT").read_text(encoding="utf-8"))


def licence_file(used: dict[str, Package]) -> str:
    """The text of the file of licences: the list of the crates, then each different text with its crates."""
    title = {one: f"{package['name']} {package['version']}" for one, package in used.items()}
    parts: dict[str, tuple[str, list[str]]] = {}

    def add(text: str, crate: str) -> None:
        lines = "\n".join(line.rstrip() for line in text.splitlines()).strip("\n")
        owners = parts.setdefault(" ".join(text.split()), (lines, []))[1]
        if crate not in owners:
            owners.append(crate)

    for one, package in used.items():
        for text in texts(package):
            add(text, title[one])
    standard = "Rust standard library"
    add(mit_text(STANDARD_LIBRARY), standard)
    unicode = next(package for package in used.values() if package["name"] == "unicode-ident")
    add(texts(unicode)[-1], standard)

    rows = [f"{title[one]}: {' and '.join(chosen(package))}" for one, package in used.items()]
    rows.append(f"{standard}: MIT and Unicode-3.0")
    rule = "=" * 80
    blocks = [f"{rule}\n{', '.join(owners)}\n{rule}\n\n{text}\n" for text, owners in parts.values()]
    return "\n".join([HEAD, *rows, "", *blocks])


def sbom(root: Package, used: dict[str, Package], needs: dict[str, list[str]]) -> str:
    """The SBOM in CycloneDX 1.5, without a date or a path: the same input gives the same bytes."""

    def reference(package: Package) -> str:
        return f"pkg:cargo/{package['name']}@{package['version']}"

    def component(package: Package) -> dict[str, Any]:
        return {
            "type": "library",
            "bom-ref": reference(package),
            "name": package["name"],
            "version": package["version"],
            "licenses": [{"expression": package["license"].replace("/", " OR ")}],
            "purl": reference(package),
        }

    everything = {root["id"]: root} | used
    content = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {"component": component(root)},
        "components": [component(package) for package in used.values()],
        "dependencies": [
            {"ref": reference(package), "dependsOn": [reference(everything[need]) for need in needs[one]]}
            for one, package in everything.items()
        ],
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def files() -> dict[Path, str]:
    """The files that belong to the present Cargo.lock."""
    root, used, needs = crates()
    return {LICENSES: licence_file(used), SBOM: sbom(root, used, needs)}


if __name__ == "__main__":
    for path, content in files().items():
        path.write_text(content, encoding="utf-8", newline="\n")
        print(f"{path.name}: {len(content):,} characters")
