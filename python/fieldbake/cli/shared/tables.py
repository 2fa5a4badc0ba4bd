"""Descriptions of objects: labels and texts for tables, plain values for JSON."""

from __future__ import annotations

from typing import Any

import fieldbake as fb

from ...base.encodings import texel_rule
from ...base.report import bytes_text


def box_text(bounds: Any) -> str:
    """Two corners as text."""
    lower, upper = ("(" + ", ".join(f"{x:.5g}" for x in corner) + ")" for corner in bounds)
    return f"{lower} to {upper}"


def volume_rows(volume: fb.Volume | fb.SparseVolume) -> list[tuple[str, str]]:
    """Labels and texts of a dense or sparse volume."""
    nx, ny, nz = volume.resolution
    size = bytes_text(volume.nbytes)
    if isinstance(volume, fb.Volume):
        stored = f"{size} as {volume.encoding}" if isinstance(volume, fb.QuantizedVolume) else size
        low, high = float(volume.distances.min()), float(volume.distances.max())
        contents = [("distances", f"{low:.5g} to {high:.5g}")]
    else:
        stored = f"{size} as {volume.encoding}, {volume.nbytes / (4 * nx * ny * nz):.1%} of a dense volume"
        counts = volume.brick_counts.items()
        contents = [
            ("bricks", ", ".join(f"{count:,} with cells of {side}" for side, count in counts if count) or "none"),
            ("band", f"{volume.band:.5g}"),
        ]
    rows = [
        ("voxels", f"{nx} x {ny} x {nz}, {stored}"),
        ("voxel size", " x ".join(f"{side:.5g}" for side in volume.spacing)),
        ("box", box_text(volume.bounds)),
        ("surface box", box_text(volume.inner_bounds)),
        *contents,
    ]
    return rows + (volume.report.rows() if volume.report.sign_method else [])


def atlas_rows(atlas: fb.Atlas, ending: str) -> list[tuple[str, str]]:
    """Labels and texts of an atlas in a file with this ending."""
    count, size = len(atlas.pages), atlas.page_size
    rule = texel_rule(ending, atlas.encoding)
    rows = [
        ("pages", f"{count} of {size} x {size} {atlas.encoding}, {bytes_text(atlas.nbytes)}, {atlas.fill:.0%} full"),
        ("texels", f"{rule['texel']}, {rule['decode']}"),
        ("layout", atlas.layout if atlas.layout == "strips" else f"{atlas.layout}, gutter {atlas.gutter}"),
    ]
    for i in atlas.indices:
        entry = atlas.entries[i]
        shape = " x ".join(map(str, atlas.resolution(i)))
        place = f"page {entry['atlas_index']}, offset {entry['atlas_offset']}"
        name = f"{atlas.names[i]}: " if atlas.names[i] else ""
        rows.append((f"volume {i}", f"{name}{shape} voxels, {place}"))
    return rows


def mesh_rows(mesh: fb.Mesh) -> list[tuple[str, str]]:
    """Labels and texts of a mesh."""
    rows = [
        ("vertices", f"{len(mesh.vertices):,}"),
        ("faces", f"{len(mesh.faces):,}"),
        ("box", box_text(mesh.bounds)),
        ("memory", bytes_text(mesh.nbytes)),
    ]
    facts = mesh.topology()
    rows.append(("closed", "yes" if facts.pop("closed") else "no"))
    rows += [(name.replace("_", " "), f"{count:,}") for name, count in facts.items()]
    rows += [("part", f"{part.name or '-'}: {len(part.faces):,} faces, {part.alpha_mode}") for part in mesh.parts]
    return rows


def bounds_of(shape: fb.Shape) -> Any:
    """Bounds of a shape, (2, 3); None for a shape without a finite box."""
    try:
        return shape.bounds
    except fb.ShapeError:
        return None


def rows_of(found: Any, ending: str) -> list[tuple[str, str]]:
    """Labels and texts of any object that a file can store."""
    if isinstance(found, fb.Atlas):
        return atlas_rows(found, ending)
    if isinstance(found, fb.Mesh):
        return mesh_rows(found)
    if isinstance(found, (fb.Volume, fb.SparseVolume)):
        return volume_rows(found)
    if isinstance(found, fb.PointCloud):
        return [("box", box_text(found.bounds)), *found.report.rows()]
    if isinstance(found, fb.Shape):
        bounds = bounds_of(found)
        return [("shape", repr(found)), ("box", "unbounded or empty" if bounds is None else box_text(bounds))]
    return [("holds", repr(found))]


def facts_of(found: Any) -> dict[str, Any]:
    """Describe any object that a file can store by plain values, for JSON."""
    facts: dict[str, Any] = {"kind": type(found).__name__}
    if isinstance(found, fb.Mesh):
        facts |= {"vertices": len(found.vertices), "faces": len(found.faces), "bounds": found.bounds.tolist()}
        return facts | found.topology()
    if isinstance(found, fb.Shape):
        bounds = bounds_of(found)
        return facts | {"expression": found.to_sexpr(), "bounds": None if bounds is None else bounds.tolist()}
    if isinstance(found, fb.PointCloud):
        names = ("points", "duplicates", "spacing", "spacing_95", "normals", "inside_out", "area", "outliers")
        facts |= {name: getattr(found.report, name) for name in (*names, "low_opacity", "round_splats")}
        return facts | {"bounds": found.bounds.tolist()}
    if isinstance(found, fb.Atlas):
        facts |= {"pages": len(found.pages), "page_size": found.page_size, "layout": found.layout}
        facts |= {"encoding": found.encoding, "gutter": found.gutter, "nbytes": found.nbytes, "fill": float(found.fill)}
        facts["names"] = [found.names[i] for i in found.indices]
        return facts | {"volumes": [list(found.resolution(i)) for i in found.indices]}
    facts |= {
        "resolution": list(found.resolution),
        "spacing": found.spacing.tolist(),
        "bounds": found.bounds.tolist(),
        "inner_bounds": found.inner_bounds.tolist(),
        "nbytes": found.nbytes,
    }
    if isinstance(found, (fb.QuantizedVolume, fb.SparseVolume)):
        facts["encoding"] = found.encoding
    if isinstance(found, fb.Volume):
        facts |= {"lowest": float(found.distances.min()), "highest": float(found.distances.max())}
    if isinstance(found, fb.SparseVolume):
        facts |= {"bricks": {str(side): count for side, count in found.brick_counts.items()}, "band": found.band}
    if isinstance(found, (fb.Volume, fb.SparseVolume)):
        facts["report"] = found.report.to_dict()
    return facts
