"""A scene's light: 200 instances under soft shadow, and shadow rays against Embree.

    python benches/scene.py [--size 640x480] [--instances 200] [--repeat 3]

Steps count evaluations of fields, and tests of instances.

Embree is Open3D's `test_occlusions` on the triangles of all instances as one soup, with rays from the same points. Its
time covers the rays alone; the time of fieldbake covers the whole light pass, shading included. The cost of a field
does not depend on the number of triangles, and a field also returns the clearance. The rays are therefore also traced
through the same trees with each triangle divided into 64.
"""

from __future__ import annotations

import argparse
import datetime
from pathlib import Path

import numpy as np

import fieldbake as fb
from measuring import absent, interleaved, machine, record, timed

SUN = fb.DirectionalLight((-1.0, -0.8, -0.35), angle_deg=1.5)


def spruce(sides: int) -> fb.Mesh:
    """A tree turned on a lathe."""
    rings = [(0.06, 0.0), (0.06, 0.3), (0.5, 0.3), (0.22, 0.8), (0.38, 0.8), (0.15, 1.3), (0.26, 1.3), (0.02, 2.0)]
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    vertices = [(r * np.cos(a), y, -r * np.sin(a)) for r, y in rings for a in angle]
    bottom, top = len(vertices), len(vertices) + 1
    vertices += [(0.0, 0.0, 0.0), (0.0, 2.0, 0.0)]
    faces = []
    for i in range(sides):
        j = (i + 1) % sides
        for low in range(0, (len(rings) - 1) * sides, sides):
            faces += [(low + i, low + j, low + sides + j), (low + i, low + sides + j, low + sides + i)]
        faces += [(bottom, j, i), (top, (len(rings) - 1) * sides + i, (len(rings) - 1) * sides + j)]
    return fb.Mesh(vertices, faces)


def forest(count: int, random: np.random.Generator) -> tuple[fb.Scene, fb.Camera]:
    tree = spruce(24)
    side = 0.55 * np.sqrt(count)
    instances = []
    for _ in range(count):
        turn, height, width = random.uniform(0, 2 * np.pi), random.uniform(0.7, 1.5), random.uniform(0.8, 1.2)
        c, s = np.cos(turn), np.sin(turn)
        place = np.eye(4)
        place[:3, :3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.diag([width, height, width])
        place[[0, 2], 3] = random.uniform(-side, side, 2)
        instances.append(fb.Instance(tree, place, resolution=32))
    half = 3 * side
    ground = fb.Mesh([(-half, 0, -half), (half, 0, -half), (half, 0, half), (-half, 0, half)], [(0, 2, 1), (0, 3, 2)])
    instances.append(fb.Instance(ground))
    return fb.Scene(instances, lights=[SUN]), fb.Camera((0.4 * side, 0.45 * side, 1.25 * side), (0, 0, 0), fov_deg=40)


def light_of(scene: fb.Scene, camera: fb.Camera, size: tuple[int, int], repeat: int, **options) -> tuple[float, float]:
    """Shortest time of the light pass, milliseconds, and its steps per pixel. Fields are baked before."""
    plain = fb.render(scene, camera, size=size, **{**options, "shadows": "none"})
    frames = [fb.render(scene, camera, size=size, **options) for _ in range(repeat)]
    time_ms = min(frame.report["milliseconds"]["light"] for frame in frames)
    return time_ms, float(frames[0].steps.mean() - plain.steps.mean())


def occlusion_against_soft(count: int, size: tuple[int, int], repeat: int) -> tuple[float, float]:
    """Processor seconds of a picture with soft shadows, and of one with occlusion alone; the shortest, interleaved."""
    scene, camera = forest(count, np.random.default_rng(7))
    fb.render(scene, camera, size=(16, 16), device="cpu")
    jobs = {
        "soft": lambda: fb.render(scene, camera, size=size, device="cpu", shadows="soft"),
        "open": lambda: fb.render(scene, camera, size=size, device="cpu", shadows="none", ambient_occlusion=True),
    }
    soft, opened = interleaved(jobs, repeat).values()
    return soft.least_cpu, opened.least_cpu


def embree_rays(scene: fb.Scene, frame: fb.Frame, camera: fb.Camera, cut: int, repeat: int) -> tuple[float, int, float]:
    """Rays per second, number of triangles, and the fraction of rays with the result of hard shadows."""
    import open3d

    soup = []
    for instance in scene.instances:
        matrix = np.asarray(instance.transform)
        corners = (
            instance.geometry.vertices[instance.geometry.faces].astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        )
        for _ in range(cut):
            a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
            ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
            quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
            corners = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
        soup.append(corners)
    triangles = np.concatenate(soup).astype(np.float32)
    caster = open3d.t.geometry.RaycastingScene()
    caster.add_triangles(triangles.reshape(-1, 3), np.arange(3 * len(triangles), dtype=np.uint32).reshape(-1, 3))
    hit = np.isfinite(frame.depth)
    to_light = -np.array(SUN.direction)
    faces_light = hit & (frame.normal @ to_light > 0)
    width, height = frame.size
    side = 2 * np.tan(np.radians(camera.fov_deg) / 2) / height
    x, y = (np.arange(width) + 0.5 - width / 2) * side, (height / 2 - np.arange(height) - 0.5) * side
    ways = np.stack(np.broadcast_arrays(x[None], y[:, None], -1.0), axis=-1) @ camera.pose[:3, :3].T
    points = camera.eye + (frame.depth[..., None] * ways)[faces_light] + 1e-3 * frame.normal[faces_light]
    rays = np.concatenate([points, np.broadcast_to(to_light, points.shape)], axis=1).astype(np.float32)
    caster.test_occlusions(rays[:100])
    cast = timed(lambda: caster.test_occlusions(rays).numpy(), repeat)
    agree = float((cast.result == (frame.shadow[faces_light] == 0)).mean())
    return len(rays) / cast.least, len(triangles), agree


def report(options: argparse.Namespace) -> list[str]:
    size = tuple(int(n) for n in options.size.split("x"))
    small = (size[0] // 4, size[1] // 4)
    scene, camera = forest(options.instances, np.random.default_rng(7))
    lines = [
        f"# Scenes, {datetime.date.today()}",
        "",
        f"{machine()}. {len(scene.instances)} instances, {size[0]} x {size[1]}, shortest of {options.repeat}.",
        "",
        "| light pass | device | ms | steps a pixel |",
        "|---|---|---|---|",
    ]

    def row(name: str, device: str, result: tuple[float, float]) -> tuple[float, float]:
        lines.append(f"| {name} | {device} | {result[0]:.0f} | {result[1]:.0f} |")
        return result

    hard = row("hard", "cpu", light_of(scene, camera, size, options.repeat, shadows="hard", device="cpu"))
    row("soft", "cpu", light_of(scene, camera, size, options.repeat, shadows="soft", device="cpu"))
    row("soft, light_scale=2", "cpu", light_of(scene, camera, size, options.repeat, light_scale=2, device="cpu"))
    row("soft, samples=4", "cpu", light_of(scene, camera, size, 1, samples=4, device="cpu"))
    rays = {"shadows": "none", "ambient_occlusion": True}
    row("occlusion, no shadows", "cpu", light_of(scene, camera, size, options.repeat, device="cpu", **rays))
    for device in fb.devices():
        if device.type != "cpu":
            row("soft", device.name, light_of(scene, camera, size, options.repeat, device=device.name))
    lines.append("")
    lines += ["| instances | soft shadows, processor s | occlusion, processor s | ratio |", "|---|---|---|---|"]
    for count in (10, 60, 200):
        soft_s, open_s = occlusion_against_soft(count, small, options.repeat)
        lines.append(f"| {count} | {soft_s:.2f} | {open_s:.2f} | {open_s / soft_s:.1f} |")
    lines.append("")
    frame = fb.render(scene, camera, size=size, shadows="hard", device="cpu")
    lit = (frame.depth < np.inf) & (frame.normal @ -np.array(SUN.direction) > 0)
    lines += [
        "| shadow rays | a second | same answer |",
        "|---|---|---|",
        f"| fieldbake, fields of 32 voxels, with shading | {lit.sum() / hard[0] * 1e3:,.0f} | |",
    ]
    try:
        for cut in (0, 3):
            rate, count, agree = embree_rays(scene, frame, camera, cut, options.repeat)
            record(f"hard shadow rays of {count:,} triangles", "Embree", hard[0] / 1e3, lit.sum() / rate)
            lines.append(f"| Embree by Open3D, {count:,} triangles | {rate:,.0f} | {agree:.1%} |")
    except ImportError as error:
        absent("Embree", error)
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--instances", type=int, default=200)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("-o", "--output", type=Path, help="write the table there too")
    options = parser.parse_args()
    text = "\n".join(report(options)) + "\n"
    print(text)
    if options.output:
        options.output.write_text(text)


if __name__ == "__main__":
    main()
