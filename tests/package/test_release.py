"""The files of a release agree: one version, one date, and requirements that the workflows test."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def version():
    return re.search(r'^version = "([\d.]+)"$', text("Cargo.toml"), re.MULTILINE)[1]


def test_the_changelog_and_the_citation_have_the_version_and_its_date():
    released = re.search(r"^## (\d+\.\d+\.\d+) - (\d{4}-\d{2}-\d{2})$", text("CHANGELOG.md"), re.MULTILINE)

    assert released[1] == version()
    assert f"version: {released[1]}\n" in text("CITATION.cff")
    assert f"date-released: {released[2]}\n" in text("CITATION.cff")
    assert f'name = "fieldbake"\nversion = "{released[1]}"' in text("Cargo.lock")


def test_the_workflows_and_the_classifiers_have_the_same_pythons():
    project = text("pyproject.toml")
    classified = re.findall(r'"Programming Language :: Python :: (3\.\d+)"', project)

    assert classified[0] == re.search(r'requires-python = ">=([\d.]+)"', project)[1]
    for name in ("test", "release"):
        listed = re.search(r"python: \[(.*)\]", text(f".github/workflows/{name}.yml"))[1]
        assert re.findall(r"3\.\d+", listed) == classified


def test_the_wheel_is_for_the_oldest_python():
    oldest = re.search(r'requires-python = ">=3\.(\d+)"', text("pyproject.toml"))[1]

    assert f"abi3-py3{oldest}" in text("Cargo.toml")


def test_the_citation_has_the_addresses_of_the_package():
    addresses = text("pyproject.toml").partition("[project.urls]")[2].partition("\n[")[0]
    urls = dict(re.findall(r'^(\w+) = "(.*)"$', addresses, re.MULTILINE))

    assert {"Homepage", "Documentation", "Source", "Issues", "Changelog"} <= set(urls)
    assert f"\nurl: {urls['Homepage']}\n" in text("CITATION.cff")
    assert f"\nrepository-code: {urls['Source']}\n" in text("CITATION.cff")
