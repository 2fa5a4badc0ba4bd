"""The code of the README runs as pasted, and the links of the documents at the root lead to files."""

import re
from pathlib import Path

import pytest

from fences import fences, run_fences

ROOT = Path(__file__).parents[2]
README, DESCRIPTION = ROOT / "README.md", ROOT / "python" / "DESCRIPTION.md"

LINK = re.compile(r"\]\((?P<target>[^)\s]+)\)")


def test_the_code_runs_in_an_empty_folder(tmp_path, capsys):
    run_fences(README, tmp_path)

    written = {"knot.vdb", "knot.html", "knot.png", "scene.png", "knot.glb", "knot.npz"}
    assert {path.name for path in tmp_path.iterdir()} == written
    assert "exact winding number" in capsys.readouterr().out


def test_the_readme_is_short_and_starts_with_eight_lines():
    first = fences(README)[0]

    assert first.language == "python"
    assert len(first.text.splitlines()) == 8
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 100


@pytest.mark.parametrize("path", sorted(ROOT.glob("*.md")), ids=lambda path: path.stem)
def test_the_links_of_the_documents_lead_to_files(path):
    targets = [match["target"] for match in LINK.finditer(path.read_text(encoding="utf-8"))]
    missing = [target for target in targets if "://" not in target and not (ROOT / target.partition("#")[0]).exists()]

    assert len(targets) > 10 or path != README
    assert missing == []


def test_the_description_for_package_indexes_has_the_same_code_and_no_relative_link():
    targets = [match["target"] for match in LINK.finditer(DESCRIPTION.read_text(encoding="utf-8"))]

    assert [target for target in targets if not target.startswith("https://")] == []
    assert fences(DESCRIPTION)[0].text == fences(README)[0].text


def test_the_figures_are_those_of_their_source():
    """Each figure of the table is a rounded figure of the results that the text above it links."""
    text = README.read_text(encoding="utf-8")
    (target,) = {m["target"] for m in LINK.finditer(text) if m["target"].endswith("-peers.md")}
    source = (ROOT / target).read_text(encoding="utf-8")
    bunny = source.partition("### stanford-bunny, 69,451 faces, 128^3")[2].partition("###")[0]
    rows = {cells[1]: cells for line in bunny.splitlines() if len(cells := [c.strip() for c in line.split("|")]) > 8}

    def seconds(tool):
        return float(rows[tool][2].split()[0])

    for tool in ("libigl", "Open3D", "parry3d"):
        assert f"{tool} {seconds(tool):.1f} s" in text
        assert f"{tool} {rows[tool][8].split()[0]}" in text.partition("wrong signs")[2]
    assert f"| {seconds('fieldbake'):.2f} s |" in text
    assert f"{seconds('fieldbake, band=3'):.2f} s; {rows['fieldbake, band=3'][7].replace('e-0', 'e-')}" in text
    assert f"OpenVDB {seconds('OpenVDB, band=3'):.2f} s; {rows['OpenVDB, band=3'][7].replace('e-0', 'e-')}" in text
