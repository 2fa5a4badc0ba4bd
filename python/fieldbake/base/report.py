"""The report of a bake or a query: properties of the surface, the method, time and memory."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from html import escape
from types import MappingProxyType
from typing import Any


def bytes_text(count: float) -> str:
    """Format a number of bytes in the largest fitting unit."""
    for unit in ("bytes", "KiB", "MiB"):
        if count < 1024:
            return f"{count:.0f} {unit}" if unit == "bytes" else f"{count:.1f} {unit}"
        count /= 1024
    return f"{count:.1f} GiB"


def count_text(count: int, geometry: str, geometries: str | None = None) -> str:
    """Format a number with its noun in the singular or plural."""
    return f"{count:,} {geometry if count == 1 else geometries or geometry + 's'}"


def seconds_text(seconds: float) -> str:
    """Format a duration in seconds or milliseconds."""
    return f"{seconds:.2f} s" if seconds >= 1 else f"{seconds * 1e3:.{2 if seconds < 0.01 else 0}f} ms"


class Rows(ABC):
    """A report of labelled rows: `print` shows it as text, and notebooks as a table."""

    @abstractmethod
    def rows(self) -> list[tuple[str, str]]:
        """List the label and the text of each line of the report."""

    def __str__(self) -> str:
        return "\n".join(f"{label:<8}  {text}" for label, text in self.rows())

    def _repr_html_(self) -> str:
        """The rows as a table, for notebooks."""
        rows = "".join(f"<tr><th>{escape(label)}</th><td>{escape(text)}</td></tr>" for label, text in self.rows())
        return f'<table style="text-align:left">{rows}</table>'


#: Reason of the sign where meshes and shapes are searched together.
MIXED_SIGN_REASON = "the winding number of meshes, and the sign of exact shapes"


@dataclass(frozen=True)
class Report(Rows):
    """Properties of the surface and cost of the work. `print` shows all of them as text.

    Attributes
    ----------
    sign_method : str
        ``"winding"``, ``"parity"``, ``"pseudonormal"``, ``"normal"`` or ``"unsigned"``; ``"shape"`` for the field of a
        shape; empty for a field of unknown origin.
    sign_reason : str
        Reason for the choice of the method, in one sentence.
    closed : bool
        Whether the surface has no opening: after the repairs counted here, faces traverse every edge equally often
        in both directions.
    faces, vertices : int
        Number of faces with an area, and of vertices that were used.
    boundary_edges, nonmanifold_edges, flipped_faces, duplicate_faces, components : int
        Counts for the surface after equal positions were welded.
    degenerate_faces, dropped_vertices : int
        Number of faces without area, and of unused vertices that are not finite. Vertices and faces with a repeated
        position are left out; faces whose corners lie on a line are line segments.
    undecided_voxels, inside_voxels : int
        Number of voxels where the sign method was close to undecided, for instance by a winding number near 1/2, and
        of voxels with a negative distance. Both are 0 for a Zarr store, whose report is written before its shards. In
        the ledger of training samples the first is the number of such points.
    chord_error : float
        Largest distance between the mesh and the solid that it was tessellated from, world units; 0 for other meshes.
    points, inside_points, undecided_points : int
        Number of points of a query, of those with a negative distance, and of those whose side is a guess across a hole
        of a cloud of points. All are 0 for a bake, and the last one for a mesh.
    device : str
        Device that evaluated the distances.
    seconds : mapping of str to float
        Duration of each stage, seconds.
    peak_bytes : int
        Peak memory of the bake, bytes.
    band : float
        Distances up to this magnitude are exact, world units; larger magnitudes are lower bounds. 0 if all are exact.
    thickness : float
        Thickness of a two-sided sheet, world units; 0 for other fields.
    warnings : tuple of str
        Warnings; each names a remedy.

    Examples
    --------
    >>> import fieldbake as fb
    >>> report = fb.bake(fb.models.gear(), 16).report
    >>> report.closed, report.sign_method, report.boundary_edges
    (True, 'winding', 0)
    """

    sign_method: str = ""
    sign_reason: str = ""
    closed: bool = False
    faces: int = 0
    vertices: int = 0
    boundary_edges: int = 0
    nonmanifold_edges: int = 0
    flipped_faces: int = 0
    duplicate_faces: int = 0
    degenerate_faces: int = 0
    dropped_vertices: int = 0
    components: int = 0
    undecided_voxels: int = 0
    inside_voxels: int = 0
    chord_error: float = 0.0
    points: int = 0
    inside_points: int = 0
    undecided_points: int = 0
    device: str = ""
    seconds: Mapping[str, float] = field(default_factory=dict)
    peak_bytes: int = 0
    band: float = 0.0
    thickness: float = 0.0
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "seconds", MappingProxyType(dict(self.seconds)))
        object.__setattr__(self, "warnings", tuple(self.warnings))

    @classmethod
    def from_dict(cls, facts: Mapping[str, Any]) -> Report:
        """Make a report from a mapping of attributes, as :meth:`to_dict` returns; unknown keys are ignored."""
        attributes = cls.__dataclass_fields__
        return cls(**{name: value for name, value in facts.items() if name in attributes})

    @classmethod
    def of_mesh(cls, mesh: Any, facts: Mapping[str, Any]) -> Report:
        """Combine the facts of the core with the facts of the mesh they describe."""
        sizes = {"vertices": len(mesh.vertices), "chord_error": mesh.chord_error}
        return cls.from_dict({**facts, **sizes})

    def to_dict(self) -> dict[str, Any]:
        """Convert the report to plain values that JSON can store."""
        return {item.name: _plain(getattr(self, item.name)) for item in fields(self)}

    def rows(self) -> list[tuple[str, str]]:
        """List the label and the text of each line of the report."""
        surface = [count_text(self.faces, "face"), count_text(self.components, "component")]
        surface.append("closed" if self.closed else "not closed")
        faults = (
            (self.boundary_edges, "boundary edge"),
            (self.nonmanifold_edges, "non-manifold edge"),
            (self.flipped_faces, "flipped face"),
            (self.duplicate_faces, "duplicate face"),
        )
        surface.extend(count_text(count, fault) for count, fault in faults if count)
        # Closed forms have no faces.
        rows = [("surface", ", ".join(surface))] if self.faces else []
        if self.degenerate_faces or self.dropped_vertices:
            dropped = [
                count_text(self.degenerate_faces, "degenerate face"),
                count_text(self.dropped_vertices, "unused vertex", "unused vertices"),
            ]
            rows.append(("left out", ", ".join(text for text in dropped if not text.startswith("0 "))))
        rows.append(("sign", f"{self.sign_method}: {self.sign_reason}" if self.sign_reason else self.sign_method))
        inside = count_text(self.inside_voxels, "voxel")
        if self.undecided_voxels:
            inside += f"; the sign of {count_text(self.undecided_voxels, 'voxel')} is uncertain"
        if self.points:
            inside = f"{self.inside_points:,} of {count_text(self.points, 'point')}"
            if self.undecided_points:
                inside += f"; the sign of {count_text(self.undecided_points, 'point')} is uncertain"
        # The report of a Zarr store is written before its shards are baked: it has no stages, and nothing is counted.
        stages = ", ".join(f"{stage} {seconds_text(seconds)}" for stage, seconds in self.seconds.items())
        if stages:
            rows.append(("inside", inside))
        rows.append(("time", f"{stages} on {self.device}") if stages else ("device", self.device))
        rows.append(("memory", f"{bytes_text(self.peak_bytes)} at most"))
        rows.extend(("warning", warning) for warning in self.warnings)
        return rows

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self).from_dict, (self.to_dict(),)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    return list(value) if isinstance(value, tuple) else value


@dataclass(frozen=True)
class SurfaceReport:
    """Properties of a mesh that was extracted from a field.

    Attributes
    ----------
    clamped_vertices : int
        Number of vertices that are not at the nearest point to their tangent planes: it lies outside their cell, and a
        face would fold there, or a sample would change its side.
    warnings : tuple of str
        Reasons why the surface may not be the expected one. Each is also issued as a :class:`SurfaceWarning`.
    """

    clamped_vertices: int = 0
    warnings: tuple[str, ...] = field(default=(), kw_only=True)
