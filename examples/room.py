"""Light that goes from wall to wall: a room with a luminous panel, beside the picture of a path tracer.

    python examples/room.py [-o room.png] [--size 256] [--bounces 2] [--samples 4] [--paths 1024] [--device auto]

The left half is a picture of `fieldbake.render` with bounces. The right half is the reference: random paths through the
same triangles in float64, without distance fields. Its noise falls with the square root of the number of paths. The
script prints the mean difference between the two halves.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from PIL import Image

import fieldbake as fb

WHITE, RED, GREEN = (0.75, 0.75, 0.75), (0.75, 0.1, 0.1), (0.1, 0.6, 0.15)
CAMERA = fb.Camera((0.04, 0.02, 3.4), (0, 0, 0), fov_deg=41)

#: Index of the front wall, through which the camera looks.
FRONT = 5

#: Distance by which reference rays start off a surface, world units.
LIFT = 1e-6


@dataclass(frozen=True)
class Surface:
    """A mesh with one diffuse colour. Both sides of its faces reflect; `emission` leaves the front only."""

    mesh: fb.Mesh
    albedo: tuple[float, ...] = (0.0, 0.0, 0.0)
    emission: tuple[float, ...] = (0.0, 0.0, 0.0)


def wall(axis: int, side: int) -> fb.Mesh:
    """A square side of the room, 2 units long; its front is inside."""
    u, v, out = side * np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3], side * np.eye(3)[axis]
    return fb.Mesh([out - u - v, out - u + v, out + u + v, out + u - v], [(0, 1, 2), (0, 2, 3)])


def room() -> list[Surface]:
    """A closed room from -1 to 1 with red and green walls, a block and a ball."""
    turn = 0.35
    block = fb.box((0.56, 1.2, 0.56)).rotate("y", np.degrees(turn)).translate((-0.38, -0.4, -0.35)).to_mesh(32)
    ball = fb.sphere(0.35).translate((0.42, -0.65, 0.15)).to_mesh(32)
    walls = [wall(axis, side) for axis in range(3) for side in (-1, 1)]
    colors = [RED, GREEN, WHITE, WHITE, WHITE, WHITE, WHITE, WHITE]
    return [Surface(mesh, color) for mesh, color in zip([*walls, block, ball], colors, strict=True)]


def panel(half: float, emission: tuple[float, ...]) -> Surface:
    """A square light below the ceiling that shines down."""
    corners = [(-half, 0.98, -half), (half, 0.98, -half), (half, 0.98, half), (-half, 0.98, half)]
    return Surface(fb.Mesh(corners, [(0, 1, 2), (0, 2, 3)]), emission=emission)


def scene_of(surfaces: list[Surface], lights=(), ambient: float = 0.0, hidden=(FRONT,)) -> fb.Scene:
    """The surfaces as a scene without highlights. The camera does not see `hidden` ones, but light does."""
    instances = []
    for number, surface in enumerate(surfaces):
        emits = any(surface.emission)
        material = fb.Material(
            color=surface.albedo, emission=surface.emission, specular=0, two_sided=False if emits else None
        )
        instances.append(fb.Instance(surface.mesh, material=material, visible=number not in hidden))
    return fb.Scene(instances, list(lights), ambient=ambient)


class PathTracer:
    """Surfaces, point lights with the falloff of the inverse square, and a constant ambient light."""

    def __init__(self, surfaces: list[Surface], lights=(), ambient: float = 0.0) -> None:
        meshes = [surface.mesh for surface in surfaces]
        first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        faces = [mesh.faces + start for mesh, start in zip(meshes, first[:-1], strict=True)]
        self.mesh = fb.Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))
        owner = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])
        self.albedo = np.array([surface.albedo for surface in surfaces])[owner]
        self.emission = np.array([surface.emission for surface in surfaces])[owner]
        self.lights = [(np.array(light.position), light.intensity * np.array(light.color)) for light in lights]
        self.ambient = ambient

    def direct(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """The light of the point lights that white surfaces reflect, (n, 3)."""
        total = np.zeros((len(points), 3))
        for position, color in self.lights:
            way = position - points
            distance = np.linalg.norm(way, axis=1)
            cosine = (way * normals).sum(axis=1) / distance
            seen = cosine > 0
            seen[seen] = ~fb.occluded(self.mesh, points[seen] + LIFT * normals[seen], way[seen], t_max=1)
            total[seen] += (cosine / distance**2)[seen, None] * color
        return total

    def indirect(self, points: np.ndarray, normals: np.ndarray, bounces: int, paths: int, seed: int) -> np.ndarray:
        """All other light that white surfaces reflect, (n, 3), by random paths with at most `bounces` reflections.

        The directions have a density proportional to the cosine. A path collects the emission of the surfaces that it
        hits, the light of the point lights on them, and the ambient light where it leaves the scene.
        """
        random = np.random.default_rng(seed)
        points, normals = (np.repeat(values, paths, axis=0) for values in (points, normals))
        total, weight, alive = np.zeros((len(points), 3)), np.ones((len(points), 3)), np.arange(len(points))
        for bounce in range(bounces + 1):
            ways = cosine_directions(normals, random)
            hits = fb.cast_rays(self.mesh, points + LIFT * normals, ways)
            total[alive[~hits.hit]] += weight[~hits.hit] * self.ambient
            alive, weight, face, ways = alive[hits.hit], weight[hits.hit], hits.faces[hits.hit], ways[hits.hit]
            points = points[hits.hit] + hits.t[hits.hit, None] * ways
            is_front = ((hits.normals[hits.hit] * ways).sum(axis=1) < 0)[:, None]
            normals = np.where(is_front, 1, -1) * hits.normals[hits.hit]
            total[alive] += weight * self.emission[face] * is_front
            if bounce < bounces:
                weight = weight * self.albedo[face]
                total[alive] += weight * self.direct(points, normals)
        return total.reshape(-1, paths, 3).mean(axis=1)


def cosine_directions(normals: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """One random unit direction above each normal, with a density proportional to the cosine."""
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    right = np.cross(helper, normals)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    squared, angle = random.random(len(normals)), 2 * np.pi * random.random(len(normals))
    x, y = np.sqrt(squared) * np.cos(angle), np.sqrt(squared) * np.sin(angle)
    return x[:, None] * right + y[:, None] * np.cross(normals, right) + np.sqrt(1 - squared)[:, None] * normals


def surface_points(frame: fb.Frame, camera: fb.Camera) -> tuple[np.ndarray, np.ndarray]:
    """World positions and unit normals of the pixels that show a surface, (n, 3) float64, in row order."""
    width, height = frame.size
    side = 2 * np.tan(np.radians(camera.fov_deg) / 2) / height
    x, y = (np.arange(width) + 0.5 - width / 2) * side, (height / 2 - np.arange(height) - 0.5) * side
    rays = np.stack(np.broadcast_arrays(x[None], y[:, None], -1.0), axis=-1) @ camera.pose[:3, :3].T
    seen = frame.object_id >= 0
    normals = frame.normal[seen].astype(np.float64)
    return camera.eye + frame.depth[seen, None] * rays[seen], normals / np.linalg.norm(normals, axis=1, keepdims=True)


def reference(surfaces: list[Surface], frame: fb.Frame, bounces: int, paths: int) -> np.ndarray:
    """The picture of the path tracer for the surfaces of a frame, linear RGB."""
    tracer = PathTracer(surfaces)
    points, normals = surface_points(frame, CAMERA)
    batches = range(0, len(points), 1024)
    light = [tracer.indirect(points[i : i + 1024], normals[i : i + 1024], bounces, paths, seed=i) for i in batches]
    seen = frame.object_id[frame.object_id >= 0]
    albedo = np.array([surface.albedo for surface in surfaces])[seen]
    emission = np.array([surface.emission for surface in surfaces])[seen]
    image = np.zeros((*frame.object_id.shape, 3))
    image[frame.object_id >= 0] = np.concatenate(light) * albedo + emission
    return image


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", default="room.png")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--size", type=int, default=256, help="side of each half, pixels")
    parser.add_argument("--bounces", type=int, default=2)
    parser.add_argument("--samples", type=int, default=4, help="colour samples per pixel of the left half")
    parser.add_argument("--paths", type=int, default=1024, help="paths per pixel of the right half")
    arguments = parser.parse_args()
    surfaces = [*room(), panel(0.5, (4.0, 3.4, 2.6))]
    scene = scene_of(surfaces)
    options = {"size": (arguments.size, arguments.size), "bounces": arguments.bounces, "device": arguments.device}
    frame = fb.render(scene, CAMERA, samples=arguments.samples, **options)
    truth = reference(surfaces, frame, arguments.bounces, arguments.paths)
    centres = fb.render(scene, CAMERA, **options).color[..., :3]
    print(f"mean difference {np.abs(centres - truth).mean() / truth.mean():.1%} of the mean light")
    linear = np.clip(truth, 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    right = np.round(255 * srgb).astype(np.uint8)
    Image.fromarray(np.concatenate([frame.image[..., :3], right], axis=1)).save(arguments.output)


if __name__ == "__main__":
    main()
