"""The examples of quadrics, of merging and of the still life run unchanged."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize(
    ("name", "options", "shape"),
    [
        ("quadrics.py", ["--size", "96x54", "--device", "cpu"], (54, 96)),
        ("still_life.py", ["--size", "64x36", "--samples", "1", "--device", "cpu"], (36, 64)),
        ("merged_forest.py", ["--trees", "5", "--size", "48"], (48, 192)),
    ],
)
def test_an_example_makes_its_picture(name, options, shape, tmp_path):
    picture = tmp_path / "out.png"
    command = [sys.executable, str(EXAMPLES / name), str(picture), *options]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stderr
    pixels = np.asarray(Image.open(picture))
    assert pixels.shape[:2] == shape
    assert len(np.unique(pixels.reshape(-1, pixels.shape[2]), axis=0)) > 50
