"""Distances to the placed meshes and shapes of a scene."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..assemblies.geometry import RIGID, core_element, searchable
from ..base import checks
from ..base.errors import ArgumentError, SceneError
from ..base.notices import warn_surface
from ..base.progress import Progress, progress_callback
from ..base.report import MIXED_SIGN_REASON, Report
from ..meshes.mesh import Mesh
from ..queries.nearest import Query
from ..shapes.field import MESH_RESOLUTION
from ..shapes.shape import Shape
from .instance import Instance


class SceneGeometry:
    """The search trees of the instances of a scene.

    Parameters
    ----------
    instances : sequence of Instance
        Instances with meshes and shapes.

    Raises
    ------
    SceneError
        For an instance with another object, or with a transform that is not a similarity.
    """

    def __init__(self, instances: Sequence[Instance]) -> None:
        converted: dict[int, Mesh | Shape] = {}
        elements = []
        self.sources: list[Mesh | Shape] = []
        for i, instance in enumerate(instances):
            source = _geometry_of(instance)
            if not isinstance(source, (Mesh, Shape)):
                # A tuple holds the quadrics of an instance.
                got, advice = source, "pass the to_mesh() of a field"
                if isinstance(source, tuple):
                    got, advice = source[0], "a quadric is a sheet without an inside"
                raise SceneError(
                    f"instances[{i}]: queries of a scene take meshes and shapes, got {checks.describe(got)}; {advice}"
                )
            if id(source) not in converted:
                converted[id(source)] = searchable(source, MESH_RESOLUTION)[0]
            self.sources.append(converted[id(source)])
            transform = np.asarray(instance.transform)
            scale = _scale(f"instances[{i}].transform", transform)
            elements.append(core_element(0, self.sources[-1], transform, scale))
        self._bodies = _core.Bodies(1, elements)

    def query(self, points: Any, sign: str, device: str, progress: Progress) -> Query:
        """Evaluate :func:`fieldbake.query`."""
        sign, device = checks.text("sign", sign), checks.text("device", device)
        if sign not in ("auto", "winding"):
            raise ArgumentError(f'sign: the sign of a scene is "auto" or "winding", got {sign!r}')
        if device not in ("auto", "cpu"):
            raise ArgumentError(f'device: queries of a scene run on the CPU; use "auto" or "cpu", got {device!r}')
        flat, shape = checks.points(points)
        start = time.perf_counter()
        with progress_callback(progress, "query") as callback:
            distances, gradients, nearest, instances, faces, weights = self._bodies.query(
                np.eye(4)[None], flat, paired=False, searched=[True] * len(self.sources), progress=callback
            )
        meshes = {id(source): source for source in self.sources if isinstance(source, Mesh)}
        warnings = [text for mesh in meshes.values() for text in mesh._core.sign_warnings("auto")]
        warn_surface(warnings)
        report = Report(
            sign_method="winding",
            sign_reason=MIXED_SIGN_REASON,
            closed=all(mesh.topology()["closed"] for mesh in meshes.values()),
            faces=sum(len(mesh.faces) for mesh in meshes.values()),
            vertices=sum(len(mesh.vertices) for mesh in meshes.values()),
            points=len(flat),
            inside_points=int((distances < 0).sum()),
            device="cpu",
            seconds={"query": time.perf_counter() - start},
            warnings=tuple(dict.fromkeys(warnings)),
        )
        return Query(
            distances.reshape(shape),
            gradients.reshape(*shape, 3),
            nearest.reshape(*shape, 3),
            faces.reshape(shape),
            weights.reshape(*shape, 3),
            report,
            instances.reshape(shape),
        )


def _geometry_of(instance: Instance) -> Any:
    """The object of an instance."""
    return instance.geometry


def _scale(name: str, transform: NDArray[np.float64]) -> float:
    """The factor of all lengths under a similarity; SceneError for another transform."""
    linear = transform[:3, :3]
    scale = float(np.cbrt(abs(np.linalg.det(linear))))
    turn = linear / scale
    if not np.abs(turn.T @ turn - np.eye(3)).max() <= RIGID:
        raise SceneError(
            f"{name}: must scale all axes alike, got {linear.tolist()}; other transforms change distances by a factor "
            "that depends on the direction. Apply it to the mesh instead: fieldbake.as_mesh([(mesh, transform)])"
        )
    return scale
