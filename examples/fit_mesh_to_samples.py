"""Fit a mesh to samples of a distance field by gradient descent with JAX, and draw the result.

python examples/fit_mesh_to_samples.py [picture.png]
"""

from __future__ import annotations

import sys

import jax
import jax.numpy as jnp
import numpy as np

import fieldbake as fb
from fieldbake.jax import signed_distance

#: Weight of the smoothness of the mesh beside the mean squared difference of the distances.
SMOOTHNESS = 0.02


def fit(steps: int = 120, count: int = 3000, seed: int = 0) -> tuple[fb.Mesh, list[float]]:
    """Move the vertices of a sphere until its distances are those of a rounded box; returns the mesh and the losses."""
    jax.config.update("jax_enable_x64", True)
    target = fb.rounded_box((1.6, 1.1, 0.8), 0.2)
    start = fb.bake(fb.sphere(0.6), 14).to_mesh()
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
        (_, value), slope = step(vertices, points, np.asarray(target.distance(points), np.float64))
        losses.append(float(value))
        # The mean over all points spreads over the vertices; the step undoes that.
        vertices = vertices - 0.1 * len(vertices) * np.asarray(slope)
    return fb.Mesh(vertices, faces), losses


def main() -> None:
    """Fit, print the losses, draw."""
    mesh, losses = fit()
    print(f"mean squared difference: {losses[0]:.2e} at first, {losses[-1]:.2e} after {len(losses)} steps")
    if len(sys.argv) > 1:
        fb.raymarch(fb.bake(mesh, 96, device="cpu"), size=(640, 480), device="cpu").save(sys.argv[1])


if __name__ == "__main__":
    main()
