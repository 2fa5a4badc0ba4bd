"""Time of one field for a whole scene: the culled merge, updates, and a far field in a picture.

    python benches/merge.py [--resolution 128] [--instances 500] [--repeat 3]

All on the CPU. The loop is timed on a grid of a quarter of the side, 1/64 of the samples: its time is proportional to
them.
"""

from __future__ import annotations

import argparse

import numpy as np

import fieldbake as fb
from measuring import timed


def scattered(count: int, random: np.random.Generator) -> list[tuple[fb.Volume, np.ndarray]]:
    """Gears and knots, turned at random, in a layer whose area grows with their number."""
    volumes = [fb.bake(fb.models.gear(teeth=8), 32), fb.bake(fb.models.torus_knot(segments=160, sides=16), 32)]
    side = 3.0 * np.sqrt(count)
    instances = []
    for i in range(count):
        turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
        transform = np.eye(4)
        transform[:3, :3] = turn
        transform[:3, 3] = random.uniform((0, 0, 0), (side, side / 4, side))
        instances.append((volumes[i % 2], transform))
    return instances


def shortest(repeat, call):
    """The result and the shortest time."""
    times = timed(call, repeat)
    return times.result, times.least


def far_rays(count: int, resolution: int, repeat: int) -> None:
    """Shortest times of a grove of posts under a sun, with and without a far field, in interleaved runs."""
    random = np.random.default_rng(2)
    post = fb.bake(fb.cylinder(radius=0.25, height=2).rotate("x", 90).translate((0, 1, 0)), 48)
    side = 0.6 * np.sqrt(count)
    posts = []
    for _ in range(count):
        place = np.eye(4)
        place[[0, 2], 3] = random.uniform(-side, side, 2)
        posts.append(fb.Instance(post, place))
    w = 2 * side
    floor = fb.Mesh([(-w, 0, -w), (w, 0, -w), (w, 0, w), (-w, 0, w)], [(0, 2, 1), (0, 3, 2)])
    scene = fb.Scene([*posts, fb.Instance(floor)], lights=[fb.DirectionalLight((-1, -0.5, -0.35), angle_deg=1.5)])
    camera = fb.Camera((0.4 * side, 0.6 * side, 1.25 * side), (0, 0, -0.1 * side), fov_deg=40)
    far = fb.merge(posts, resolution, device="cpu")
    print(f"{count} posts, a far field of {far.resolution} voxels of {far.spacing[0]:.3f}:")
    for name, options in (
        ("hard shadows", {"shadows": "hard"}),
        ("soft shadows", {"shadows": "soft"}),
        ("soft shadows and occlusion", {"shadows": "soft", "ambient_occlusion": 4.0}),
    ):
        seconds, frames = {}, {}
        for _ in range(repeat):
            for field in (None, far):
                frame = fb.render(scene, camera, size=(192, 128), far=field, device="cpu", **options)
                key = field is not None
                seconds[key] = min(seconds.get(key, np.inf), frame.report["milliseconds"]["light"] / 1e3)
                frames[key] = frame
        seen = np.isfinite(frames[False].depth)
        off = np.abs(frames[True].shadow - frames[False].shadow)[seen].mean()
        steps = [float(frames[key].steps[seen].mean()) for key in (False, True)]
        share = frames[True].report["far_rays"] / frames[True].report["rays"]
        print(
            f"  {name}: {seconds[False]:.2f} s without, {seconds[True]:.2f} s with "
            f"({seconds[True] / seconds[False]:.2f}); {steps[0]:.0f} and {steps[1]:.0f} steps a pixel; "
            f"{share:.0%} of the rays went on in it; shadow off by {off:.4f} on average"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resolution", type=int, default=128)
    parser.add_argument("--instances", type=int, default=500)
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    random = np.random.default_rng(1)
    sizes = (options.resolution,) * 3
    instances = scattered(options.instances, random)
    field, full = shortest(options.repeat, lambda: fb.merge(instances, sizes, device="cpu"))
    print(f"{options.instances} instances at {options.resolution}^3: {full:.3f} s")

    twice = scattered(2 * options.instances, random)
    _, double = shortest(options.repeat, lambda: fb.merge(twice, sizes, device="cpu"))
    print(f"{2 * options.instances} instances: {double:.3f} s, {double / full:.2f} times as long")

    moved = instances[7][1].copy()
    moved[:3, 3] += 1.0
    after, update = shortest(options.repeat, lambda: field.update([(7, moved)]))
    instances[7] = (instances[7][0], moved)
    whole = fb.merge(instances, sizes, bounds=field.bounds, device="cpu")
    same = np.array_equal(after.distances, whole.distances)
    print(f"one moved: {1e3 * update:.1f} ms, {full / update:.0f} times faster than a full merge, same bits: {same}")
    far_rays(200, options.resolution, options.repeat)


if __name__ == "__main__":
    main()
