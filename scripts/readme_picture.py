"""Make the README's picture from the demo's: run `make demo`, then `.venv/bin/python scripts/readme_picture.py`."""

from pathlib import Path

from PIL import Image

WIDTH_PX, HEIGHT_PX = 480, 360
NAMES = ("knot", "gear")

picture = Image.new("RGB", (WIDTH_PX * len(NAMES), HEIGHT_PX), "white")
for column, name in enumerate(NAMES):
    drawn = Image.open(Path("out") / f"{name}.png").convert("RGB")
    picture.paste(drawn.resize((WIDTH_PX, HEIGHT_PX), Image.Resampling.LANCZOS), (column * WIDTH_PX, 0))
# A palette keeps it small.
picture.quantize(128).save("docs/demo.png", optimize=True)
