"""Volumes of random distances, for tests that hold for any samples."""

import numpy as np

import fieldbake as fb


def noise(shape, seed=0, bounds=((-1, -0.5, -2), (1, 0.75, 1.5))):
    """A volume of random distances from -1 to 1."""
    values = np.random.default_rng(seed).uniform(-1, 1, shape)
    return fb.Volume(values, bounds, inner_bounds=[(-0.2, -0.1, -0.3), (0.3, 0.2, 0.1)])


def cubes(count, side):
    """So many of them, each its own."""
    return [noise((side,) * 3, seed) for seed in range(count)]
