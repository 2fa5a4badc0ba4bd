"""The examples of scenes run unchanged, at small sizes."""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize(
    ("name", "options", "shape", "said"),
    [
        ("monkey_over_floor.py", ["--size", "48"], (48, 144), "soft"),
        ("room.py", ["--size", "24", "--samples", "1", "--paths", "16"], (24, 48), "mean difference"),
        ("forest.py", ["--trees", "9", "--size", "64", "36"], (36, 64), "light"),
    ],
)
def test_an_example_makes_its_picture(name, options, shape, said, tmp_path):
    picture = tmp_path / "out.png"
    result = run(name, *options, "-o", str(picture))
    assert said in result.stdout
    pixels = np.asarray(Image.open(picture))
    assert pixels.shape[:2] == shape
    assert len(np.unique(pixels.reshape(-1, pixels.shape[2]), axis=0)) > 50


def test_the_turntable_turns(tmp_path):
    film = tmp_path / "out.gif"
    run("turntable.py", "--frames", "3", "--size", "40", "-o", str(film))
    with Image.open(film) as image:
        assert image.n_frames == 3
        frames = []
        for number in range(3):
            image.seek(number)
            frames.append(np.asarray(image.convert("RGB"), dtype=int))
    assert all(np.abs(a - b).max() > 30 for a, b in pairwise(frames))


def run(name: str, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(EXAMPLES / name), "--device", "cpu", *options]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stderr
    return result
