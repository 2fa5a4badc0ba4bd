"""Shapes beside fidget's just-in-time renderer and fogleman/sdf: the same models, threads and process, interleaved.

    python benches/csg_peers.py [--size 512] [--grid 64]

fidget (benches/fidget) draws depth and normals from +z, as many voxels deep as the picture is wide; we draw the same
box from 1000 units away, with depth, normals and colour, no shadows. Its depth is the depth of a voxel, ours is a root:
the pixels are compared that both hit. "first" is the time from the tree to the first picture: reading the text and
compiling it, or splitting the shape; "next" the time of one more picture. fogleman/sdf evaluates the model on a grid.
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
from pathlib import Path

import numpy as np

import fieldbake as fb
from csg import fresh, leaf_size, scattered, scattered_leaves
from measuring import Times, absent, interleaved, record

HERE = Path(__file__).parent

#: Distance of the camera, world units. Its rays then differ from parallel rays by less than a pixel of 512.
FAR = 1000.0

#: Half the side of the square that is drawn.
REACH = 1.8


def rotation(axis: np.ndarray, degrees: float) -> np.ndarray:
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([(0, -z, y), (z, 0, -x), (-y, x, 0)])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


class Text:
    """A tree in fidget's text format, a line for each node."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.axes = [self.node(f"var-{axis}") for axis in "xyz"]

    def node(self, *words: str) -> str:
        name = f"n{len(self.lines)}"
        self.lines.append(" ".join((name, *words)))
        return name

    def number(self, value: float) -> str:
        return self.node("const", repr(float(value)))

    def sum(self, *terms: str) -> str:
        total = terms[0]
        for term in terms[1:]:
            total = self.node("add", total, term)
        return total

    def all(self, word: str, items: list[str]) -> str:
        """A balanced tree of an operator."""
        while len(items) > 1:
            pairs = [items[i : i + 2] for i in range(0, len(items), 2)]
            items = [self.node(word, *pair) if len(pair) == 2 else pair[0] for pair in pairs]
        return items[0]

    def placed(self, axis: np.ndarray, degrees: float, place: np.ndarray) -> list[str]:
        moved = [self.node("sub", p, self.number(x)) for p, x in zip(self.axes, place, strict=True)]
        return [
            self.sum(*(self.node("mul", self.number(r), p) for r, p in zip(row, moved, strict=True)))
            for row in rotation(axis, degrees).T
        ]

    def length(self, *items: str) -> str:
        return self.node("sqrt", self.sum(*(self.node("square", item) for item in items)))

    def beyond(self, item: str, half: float) -> str:
        return self.node("sub", self.node("abs", item), self.number(half))

    def leaf(self, kind: str, size: float, at: list[str]) -> str:
        x, y, z = at
        if kind == "sphere":
            return self.node("sub", self.length(x, y, z), self.number(size / 2))
        if kind == "box":
            return self.box((size, 0.7 * size, 0.5 * size), at)
        side = self.node("sub", self.length(x, y), self.number(0.3 * size))
        return self.node("max", side, self.beyond(z, 0.75 * size))

    def box(self, size: tuple[float, ...], at: list[str]) -> str:
        return self.all("max", [self.beyond(p, side / 2) for p, side in zip(at, size, strict=True)])


def fidget_text(count: int) -> str:
    """The model of :func:`csg.scattered`; fields need not be distances for fidget."""
    text, size = Text(), leaf_size(count)
    added, removed = [text.box((1.6, 1.6, 0.4), text.axes)], []
    for kind, axis, degrees, place in scattered_leaves(count):
        leaf = text.leaf(kind, size, text.placed(axis, degrees, place))
        (removed if kind == "cylinder" else added).append(leaf)
    root = text.all("min", added)
    if removed:
        text.node("max", root, text.node("neg", text.all("min", removed)))
    return "\n".join(text.lines)


def fidget_library() -> ctypes.CDLL:
    folder = HERE / "fidget"
    subprocess.run(["cargo", "build", "--release", "--quiet"], cwd=folder, check=True)
    built = [path for path in (folder / "target/release").glob("*fieldbake_bench_fidget*") if path.suffix != ".d"]
    library = ctypes.CDLL(str(built[0]))
    library.fidget_open.restype = ctypes.c_void_p
    return library


class Fidget:
    def __init__(self, library: ctypes.CDLL, count: int) -> None:
        text = fidget_text(count).encode()
        self.fidget = library
        self.shape = ctypes.c_void_p(library.fidget_open(text, len(text)))
        if not self.shape:
            raise RuntimeError("fidget refuses the tree")

    def draw(self, side: int) -> np.ndarray:
        """Depth below the front of the box; infinite for pixels without a hit."""
        matrix = np.diag([REACH, REACH, REACH, 1.0]).astype(np.float32)
        # Column by column; half a pixel, from the corners of the pixels to their middles.
        matrix[3, :2] = REACH / side
        found = np.zeros((side, side), np.uint32)
        self.fidget.fidget_draw(self.shape, matrix.ctypes, side, found.ctypes)
        return np.where(found > 0, 2 * REACH * (1 - found / side), np.inf)


def draw_ours(shape: fb.Shape, side: int) -> np.ndarray:
    camera = fb.Camera((0, 0, FAR), (0, 0, 0), fov_deg=float(np.degrees(2 * np.arctan(REACH / FAR))))
    frame = fb.raymarch(shape, camera, size=(side, side), shadows="none", device="cpu")
    return frame.depth - (FAR - REACH)


def fogleman(count: int):
    """The model in fogleman/sdf."""
    import sdf

    size = leaf_size(count)
    makers = {
        "sphere": lambda: sdf.sphere(size / 2),
        "box": lambda: sdf.box((size, 0.7 * size, 0.5 * size)),
        "cylinder": lambda: sdf.capped_cylinder(-0.75 * size * sdf.Z, 0.75 * size * sdf.Z, 0.3 * size),
    }
    added, removed = [sdf.box((1.6, 1.6, 0.4))], []
    for kind, axis, degrees, place in scattered_leaves(count):
        leaf = makers[kind]().rotate(np.radians(degrees), axis / np.linalg.norm(axis)).translate(place)
        (removed if kind == "cylinder" else added).append(leaf)
    whole = sdf.union(*added)
    return sdf.difference(whole, *removed) if removed else whole


def compare_pictures(library: ctypes.CDLL, count: int, side: int) -> None:
    times = {name: Times() for name in ("ours first", "ours next", "fidget first", "fidget next")}
    shape = scattered(count)
    for _ in range(7):
        ours = fresh(shape)
        times["ours first"].run(lambda ours=ours: draw_ours(ours, side))
        times["fidget first"].run(lambda: (peer := Fidget(library, count), peer.draw(side))[0])
        other = times["fidget first"].result
        times["ours next"].run(lambda ours=ours: draw_ours(ours, side))
        times["fidget next"].run(lambda other=other: other.draw(side))
        library.fidget_free(other.shape)
    depth, voxels = times["ours next"].result, times["fidget next"].result
    best = {name: took.least for name, took in times.items()}
    for which in ("first", "next"):
        question = f"{which} picture of a shape, {count:,} leaves, {side} px"
        record(question, "fidget", best[f"ours {which}"], best[f"fidget {which}"])
    both = np.isfinite(depth) & np.isfinite(voxels)
    # A voxel, and the slant of its pixel: all but outlines agree.
    agree = np.abs(depth[both] - voxels[both]) < 4 * 2 * REACH / side
    row = "".join(f"  {name} {seconds * 1e3:8.1f} ms" for name, seconds in best.items())
    first, later = (best[f"fidget {which}"] / best[f"ours {which}"] for which in ("first", "next"))
    alone = (np.isfinite(depth) ^ np.isfinite(voxels)).mean()
    print(f"{count:6} leaves{row}  first {first:5.2f}x next {later:5.2f}x  same {agree.mean():.4f}, alone {alone:.4f}")


def compare_grids(count: int, grid: int) -> None:
    other, shape = fogleman(count), scattered(count)
    middle = (np.arange(grid) + 0.5) / grid * 2 * REACH - REACH
    points = np.stack(np.meshgrid(middle, middle, middle, indexing="ij"), axis=-1).reshape(-1, 3)
    bounds = [(-REACH,) * 3, (REACH,) * 3]
    jobs = {
        "ours": lambda: fb.bake(fresh(shape), grid, bounds=bounds, margin=0, device="cpu"),
        "theirs": lambda: other(points).reshape((grid,) * 3),
    }
    baked, evaluated = interleaved(jobs, 2).values()
    record(f"grid of a shape, {count} leaves, {grid}^3", "sdf-fork", baked.least, evaluated.least)
    apart = np.abs(baked.result.distances - evaluated.result).max()
    print(
        f"{count:6} leaves  ours {baked.least * 1e3:8.1f} ms  fogleman/sdf {evaluated.least * 1e3:8.1f} ms"
        f"  {evaluated.least / baked.least:6.1f}x  largest difference {apart:.1e}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=512, help="pixels along a side")
    parser.add_argument("--grid", type=int, default=64, help="samples along a side")
    options = parser.parse_args()
    try:
        library = fidget_library()
    except (OSError, subprocess.CalledProcessError) as error:
        absent("fidget", error)
    else:
        print(f"pictures of {options.size} x {options.size} pixels beside fidget 0.5.1 (JIT, CPU)")
        for count in (3, 10, 100, 1000):
            compare_pictures(library, count, options.size)
    print(f"grids of {options.grid} cubed beside fogleman/sdf (NumPy)")
    try:
        for count in (3, 10, 100):
            compare_grids(count, options.grid)
    except ImportError as error:
        absent("sdf-fork", error)


if __name__ == "__main__":
    main()
