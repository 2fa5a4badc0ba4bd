"""What a bake found and did."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any


def bytes_text(count: float) -> str:
    """A size in the unit that reads best."""
    for unit in ("bytes", "KiB", "MiB"):
        if count < 1024:
            return f"{count:.0f} {unit}" if unit == "bytes" else f"{count:.1f} {unit}"
        count /= 1024
    return f"{count:.1f} GiB"


def count_text(count: int, thing: str, things: str | None = None) -> str:
    """A number with its noun."""
    return f"{count:,} {thing if count == 1 else things or thing + 's'}"


def seconds_text(seconds: float) -> str:
    """A time in the unit that reads best."""
    return f"{seconds:.2f} s" if seconds >= 1 else f"{seconds * 1e3:.{2 if seconds < 0.01 else 0}f} ms"


@dataclass(frozen=True)
class Report:
    """Facts of the surface and of the work; `print` it, or read the attributes.

    Attributes
    ----------
    sign_method : str
        ``"winding"``, ``"parity"``, ``"pseudonormal"``, ``"normal"`` or ``"unsigned"``.
    sign_reason : str
        Why, in one sentence.
    closed : bool
        No opening: after the repairs counted here every edge is walked equally often in both directions.
    faces, vertices : int
        Kept.
    boundary_edges, nonmanifold_edges, flipped_faces, duplicate_faces, components : int
        Of the surface after welding equal positions.
    degenerate_faces, dropped_vertices : int
        Left out: faces without area; vertices that are not finite and unused.
    undecided_voxels, inside_voxels : int
        Voxels where the sign method could not decide by itself; voxels with negative distance.
    device : str
        Where it ran.
    seconds : mapping of str to float
        Time of each stage.
    peak_bytes : int
        Most memory held by the bake.
    warnings : tuple of str
        What deserves a look, each naming what to try.
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
    device: str = ""
    seconds: Mapping[str, float] = field(default_factory=dict)
    peak_bytes: int = 0
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "seconds", MappingProxyType(dict(self.seconds)))
        object.__setattr__(self, "warnings", tuple(self.warnings))

    @classmethod
    def from_dict(cls, facts: Mapping[str, Any]) -> Report:
        """Take what is known of a mapping; facts this version does not know are left out."""
        known = {item.name for item in fields(cls)}
        return cls(**{name: value for name, value in facts.items() if name in known})

    def to_dict(self) -> dict[str, Any]:
        """Plain values, fit for JSON."""
        return {item.name: _plain(getattr(self, item.name)) for item in fields(self)}

    def rows(self) -> list[tuple[str, str]]:
        """Label and text of each line, for tables."""
        surface = [count_text(self.faces, "face"), count_text(self.components, "component")]
        surface.append("closed" if self.closed else "not closed")
        faults = (
            (self.boundary_edges, "boundary edge"),
            (self.nonmanifold_edges, "non-manifold edge"),
            (self.flipped_faces, "flipped face"),
            (self.duplicate_faces, "duplicate face"),
        )
        surface.extend(count_text(count, fault) for count, fault in faults if count)
        rows = [("surface", ", ".join(surface))]
        if self.degenerate_faces or self.dropped_vertices:
            dropped = [
                count_text(self.degenerate_faces, "degenerate face"),
                count_text(self.dropped_vertices, "unused vertex", "unused vertices"),
            ]
            rows.append(("left out", ", ".join(text for text in dropped if not text.startswith("0 "))))
        rows.append(("sign", f"{self.sign_method}: {self.sign_reason}" if self.sign_reason else self.sign_method))
        inside = count_text(self.inside_voxels, "voxel")
        if self.undecided_voxels:
            inside += f" ({self.undecided_voxels:,} undecided)"
        rows.append(("inside", inside))
        stages = ", ".join(f"{stage} {seconds_text(seconds)}" for stage, seconds in self.seconds.items())
        rows.append(("time", f"{stages} on {self.device}" if stages else f"on {self.device}"))
        rows.append(("memory", f"{bytes_text(self.peak_bytes)} at most"))
        rows.extend(("warning", warning) for warning in self.warnings)
        return rows

    def __str__(self) -> str:
        return "\n".join(f"{label:<8}  {text}" for label, text in self.rows())

    def __reduce__(self) -> tuple[Any, ...]:
        return Report.from_dict, (self.to_dict(),)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    return list(value) if isinstance(value, tuple) else value
