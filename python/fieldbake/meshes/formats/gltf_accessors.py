"""Checks of the arrays of glTF files before trimesh allocates and reads them."""

from __future__ import annotations

from typing import Any

#: Extension of primitives whose arrays are compressed. Their accessors state counts and types alone.
DRACO = "KHR_draco_mesh_compression"

#: Bytes of a component by its number, and components of an element.
COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def check_accessors(tree: dict[str, Any]) -> None:
    """Check that all accessors lie in their buffer views, and that the arrays of all primitives have data.

    Accessors without data are zeros in glTF. Their `count` is set to 0 in `tree`: nothing uses them, and a file of
    bytes could state gigabytes. Raises ValueError with the number of the accessor.
    """
    views, accessors = tree.get("bufferViews", []), tree.get("accessors", [])
    for number, view in enumerate(views):
        buffers = tree.get("buffers", [])
        buffer = buffers[_whole(view, "buffer", f"buffer view {number}", len(buffers) - 1)]
        length = _whole(buffer, "byteLength", f"the buffer of buffer view {number}")
        end = _whole(view, "byteOffset", f"buffer view {number}", default=0)
        end += _whole(view, "byteLength", f"buffer view {number}")
        if end > length:
            raise ValueError(f"buffer view {number} ends at byte {end} of a buffer of {length} bytes")
    for number, accessor in enumerate(accessors):
        _check_accessor(f"accessor {number}", accessor, views)
    for number, mesh in enumerate(tree.get("meshes", [])):
        for primitive in mesh["primitives"]:
            if DRACO in primitive.get("extensions", {}):
                continue
            used = {"positions": primitive["attributes"].get("POSITION"), "indices": primitive.get("indices")}
            for role, index in used.items():
                if role == "positions" or index is not None:
                    _check_use(f"mesh {number}: the accessor of its {role}", index, accessors)


def uses_draco(tree: dict[str, Any]) -> bool:
    """Whether a primitive is compressed by Draco."""
    primitives = (primitive for mesh in tree.get("meshes", []) for primitive in mesh["primitives"])
    return any(DRACO in primitive.get("extensions", {}) for primitive in primitives)


def _check_accessor(name: str, accessor: dict[str, Any], views: list[dict[str, Any]]) -> None:
    count = _whole(accessor, "count", name)
    component, kind = accessor.get("componentType"), accessor.get("type")
    if component not in COMPONENT_BYTES or kind not in COMPONENTS:
        raise ValueError(f"{name} has the unknown type {kind} of components {component}")
    if "bufferView" not in accessor:
        accessor["count"] = 0
        return
    index = _whole(accessor, "bufferView", name, len(views) - 1)
    size = COMPONENT_BYTES[component] * COMPONENTS[kind]
    stride = _whole(views[index], "byteStride", f"buffer view {index}", default=size)
    end = _whole(accessor, "byteOffset", name, default=0) + (max(count - 1, 0) * stride + size if count else 0)
    if end > views[index]["byteLength"]:
        length = views[index]["byteLength"]
        raise ValueError(f"{name} needs {end} bytes of buffer view {index}, which has {length}")


def _check_use(name: str, index: Any, accessors: list[dict[str, Any]]) -> None:
    if type(index) is not int or not 0 <= index < len(accessors):
        raise ValueError(f"{name} is {index}, the file has {len(accessors)} accessors")
    if "sparse" in accessors[index]:
        raise ValueError(f"{name}, {index}, is sparse; such arrays are not read")
    if "bufferView" not in accessors[index]:
        raise ValueError(f"{name}, {index}, has no buffer view and so no data")


def _whole(owner: dict[str, Any], key: str, name: str, most: int = 2**53, default: int | None = None) -> int:
    """Read a whole number from 0 to `most`."""
    value = owner.get(key, default)
    if type(value) is not int or not 0 <= value <= most:
        raise ValueError(f"{name} has the {key} {value}, which must be a whole number from 0 to {most}")
    return value
