"""Five hundred trees of two kinds with one field each: instances share meshes and fields.

python examples/forest.py [-o forest.png] [--trees 500]
"""

import argparse
from pathlib import Path

import numpy as np

import fieldbake as fb


def cone(rings: list[tuple[float, float]], sides: int = 12) -> fb.Mesh:
    """A solid of revolution around y; rings of (radius, height) from the bottom, closed at both ends."""
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    vertices = [(r * np.cos(a), y, -r * np.sin(a)) for r, y in rings for a in angle]
    vertices += [(0.0, rings[0][1], 0.0), (0.0, rings[-1][1], 0.0)]
    bottom, top = len(vertices) - 2, len(vertices) - 1
    faces = []
    for i in range(sides):
        j = (i + 1) % sides
        for ring in range(len(rings) - 1):
            a, b = ring * sides + i, ring * sides + j
            faces += [(a, b, b + sides), (a, b + sides, a + sides)]
        last = (len(rings) - 1) * sides
        faces += [(bottom, j, i), (top, last + i, last + j)]
    return fb.Mesh(vertices, faces)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("forest.png"))
    parser.add_argument("--trees", type=int, default=500)
    parser.add_argument("--size", type=int, nargs=2, default=(640, 360), metavar=("W", "H"))
    parser.add_argument("--samples", type=int, default=4)
    parser.add_argument("--device", default="auto")
    arguments = parser.parse_args()

    spruce = cone(
        [(0.06, 0.0), (0.06, 0.3), (0.5, 0.3), (0.22, 0.8), (0.38, 0.8), (0.15, 1.3), (0.26, 1.3), (0.02, 2.0)]
    )
    bush = cone([(0.05, 0.0), (0.4, 0.2), (0.5, 0.5), (0.35, 0.8), (0.05, 0.95)])
    green = [fb.Material(color=(0.05, 0.25, 0.09), specular=0.02), fb.Material(color=(0.2, 0.35, 0.06), specular=0.02)]
    random = np.random.default_rng(7)
    side = 0.55 * np.sqrt(arguments.trees)
    instances = []
    for _ in range(arguments.trees):
        kind = int(random.random() < 0.3)
        turn, height, width = random.uniform(0, 2 * np.pi), random.uniform(0.7, 1.5), random.uniform(0.8, 1.2)
        c, s = np.cos(turn), np.sin(turn)
        place = np.eye(4)
        place[:3, :3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.diag([width, height, width])
        place[[0, 2], 3] = random.uniform(-side, side, 2)
        instances.append(fb.Instance((spruce, bush)[kind], place, green[kind], resolution=32))
    ground = fb.Mesh(
        [(-3 * side, 0, -3 * side), (3 * side, 0, -3 * side), (3 * side, 0, 3 * side), (-3 * side, 0, 3 * side)],
        [(0, 2, 1), (0, 3, 2)],
    )
    instances.append(fb.Instance(ground, material=fb.Material(color=(0.42, 0.36, 0.24), specular=0.0)))
    sun = fb.DirectionalLight((-1.0, -0.8, -0.35), color=(1.0, 0.93, 0.8), angle_deg=1.5)
    scene = fb.Scene(instances, lights=[sun], ambient=0.35, background=(0.55, 0.72, 0.92))
    camera = fb.Camera((0.4 * side, 0.45 * side, 1.25 * side), (0, 0, -0.1 * side), fov_deg=40)
    frame = fb.render(
        scene,
        camera,
        size=tuple(arguments.size),
        samples=arguments.samples,
        ambient_occlusion=0.5,
        device=arguments.device,
        progress=True,
    )
    frame.save(arguments.output)
    print(frame, {stage: f"{time:.0f} ms" for stage, time in frame.report["milliseconds"].items()})


if __name__ == "__main__":
    main()
