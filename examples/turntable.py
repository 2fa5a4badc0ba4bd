"""A model on a turntable, as an animated GIF or, with imageio's ffmpeg plugin, an MP4.

python examples/turntable.py [model.glb] [-o turntable.gif] [--frames 36]
"""

import argparse
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from rich.progress import track

import fieldbake as fb


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", nargs="?", help="a mesh file; a gear made in code if not given")
    parser.add_argument("-o", "--output", type=Path, default=Path("turntable.gif"))
    parser.add_argument("--frames", type=int, default=36)
    parser.add_argument("--size", type=int, default=240)
    parser.add_argument("--device", default="auto")
    arguments = parser.parse_args()

    model = fb.load_mesh(arguments.model) if arguments.model else fb.models.gear()
    center, extent = model.bounds.mean(axis=0), np.ptp(model.bounds, axis=0)
    radius = np.linalg.norm(extent) / 2
    y = model.bounds[0, 1] - 0.02 * extent[1]
    disc = fb.Mesh(
        [
            (0, 0, 0),
            *((1.4 * radius * np.cos(a), 0, -1.4 * radius * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 65)[:-1]),
        ],
        [(0, 1 + i, 1 + (i + 1) % 64) for i in range(64)],
    )
    camera = fb.Camera(center + radius * np.array([0.0, 1.5, 3.2]), center - (0, 0.2 * radius, 0), fov_deg=42)
    lights = [fb.DirectionalLight((-0.6, -1.0, -0.5), angle_deg=6)]
    table = np.eye(4)
    table[:3, 3] = center[0], y, center[2]
    pictures = []
    for number in track(range(arguments.frames), "turning"):
        angle = 2 * np.pi * number / arguments.frames
        turn = np.eye(4)
        turn[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        turn[:3, 3] = center - turn[:3, :3] @ center
        # The field is baked for the first picture and kept for the others.
        scene = fb.Scene([fb.Instance(model, turn), fb.Instance(disc, table)], lights=lights, ambient=0.3)
        frame = fb.render(
            scene,
            camera,
            size=(arguments.size, arguments.size),
            samples=4,
            ambient_occlusion=True,
            device=arguments.device,
        )
        pictures.append(frame.image[..., :3])
    options = {"duration": 1000 // 24, "loop": 0} if arguments.output.suffix.lower() == ".gif" else {"fps": 24}
    imageio.imwrite(arguments.output, np.stack(pictures), **options)
    print(f"{arguments.output}: {arguments.frames} pictures")


if __name__ == "__main__":
    main()
