"""A map-style dataset over meshes, in a module that worker processes can import."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import fieldbake as fb


class TrainingSets:
    """Item i: points (n, 3) and signed distances (n,) of mesh i, float32."""

    def __init__(self, meshes: Sequence[fb.Mesh], n: int) -> None:
        self.meshes, self.n = list(meshes), n

    def __len__(self) -> int:
        return len(self.meshes)

    def __getitem__(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        samples = fb.sample_training(self.meshes[i], self.n, seed=i)
        return samples.points.astype(np.float32), samples.distances.astype(np.float32)
