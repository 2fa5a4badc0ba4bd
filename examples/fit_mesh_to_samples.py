"""Fit a mesh to samples of a distance field by gradient descent with JAX, and draw the fit.

    python examples/fit_mesh_to_samples.py [fit.png] [--steps 120] [--size 320]

The picture shows the start, the target and the result from one camera, and the loss of each step.
"""

from __future__ import annotations

import argparse
import os

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import fieldbake as fb
from fieldbake.jax import signed_distance

#: The shape whose distances are fitted.
TARGET = fb.rounded_box((1.6, 1.1, 0.8), 0.2)

#: Weight of the smoothness of the mesh beside the mean squared difference of the distances.
SMOOTHNESS = 0.3


def starting_mesh() -> fb.Mesh:
    """A sphere inside the target."""
    return fb.bake(fb.sphere(0.6), 14).to_mesh()


def fit(steps: int = 120, count: int = 3000, seed: int = 0) -> tuple[fb.Mesh, list[float]]:
    """Move the vertices of a sphere until it has the distances of a rounded box; returns the mesh and the losses."""
    jax.config.update("jax_enable_x64", True)
    start = starting_mesh()
    faces = start.faces.astype(np.int64)
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    neighbours = np.bincount(edges.ravel(), minlength=len(start.vertices))[:, None]
    random = np.random.default_rng(seed)

    def difference(vertices: jax.Array, points: np.ndarray, wanted: np.ndarray) -> jax.Array:
        return jnp.mean((signed_distance(vertices, faces, points) - wanted) ** 2)

    def loss(vertices: jax.Array, points: np.ndarray, wanted: np.ndarray) -> tuple[jax.Array, jax.Array]:
        sums = jnp.zeros_like(vertices).at[edges[:, 0]].add(vertices[edges[:, 1]])
        sums = sums.at[edges[:, 1]].add(vertices[edges[:, 0]])
        roughness = jnp.mean((vertices - sums / neighbours) ** 2)
        value = difference(vertices, points, wanted)
        return value + SMOOTHNESS * roughness, value

    step = jax.value_and_grad(loss, has_aux=True)
    vertices = np.asarray(start.vertices, np.float64)
    losses = []
    for _ in range(steps):
        # New points at every step, so that no vertex follows a single one.
        points = random.uniform(-1, 1, (count, 3))
        (_, value), slope = step(vertices, points, np.asarray(TARGET.distance(points), np.float64))
        losses.append(float(value))
        # The mean over all points spreads over the vertices; the step undoes that.
        vertices = vertices - 0.1 * len(vertices) * np.asarray(slope)
    return fb.Mesh(vertices, faces), losses


def draw(fitted: fb.Mesh, losses: list[float], path: str | os.PathLike[str], size: int = 320) -> None:
    """Draw the start, the target, the result and the losses side by side."""
    camera = fb.Camera.fit(TARGET.bounds, direction=(-0.6, -0.5, -1))
    view = {"size": (size, 3 * size // 4), "background": (1, 1, 1), "ambient": 0.35, "device": "cpu"}
    figure = Figure(figsize=(4.4 * size / 100, 0.75 * size / 100 + 0.5), dpi=100, layout="constrained")
    axes = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.3))
    objects = {"start": starting_mesh(), "target": TARGET, f"after {len(losses)} steps": fitted}
    for axis, (title, drawn) in zip(axes[:3], objects.items(), strict=True):
        axis.imshow(fb.raymarch(drawn, camera, **view).image)
        axis.set_title(title)
        axis.axis("off")
    axes[3].semilogy(range(1, len(losses) + 1), losses)
    axes[3].set_title("mean squared difference")
    axes[3].set_xlabel("step")
    axes[3].grid(alpha=0.3)
    figure.savefig(path)


def main() -> None:
    """Fit, print the losses, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture", nargs="?", default="fit.png")
    parser.add_argument("--steps", type=int, default=120)
    parser.add_argument("--size", type=int, default=320, help="side of a view, pixels")
    options = parser.parse_args()

    mesh, losses = fit(options.steps)
    print(f"mean squared difference: {losses[0]:.2e} at first, {losses[-1]:.2e} after {len(losses)} steps")
    draw(mesh, losses, options.picture, options.size)
    print(options.picture)


if __name__ == "__main__":
    main()
