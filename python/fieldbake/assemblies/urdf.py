"""URDF files: links, joints, and the geometry of links.

The ROS package urdf defines the format (https://wiki.ros.org/urdf/XML). Lengths are metres there, angles radians; a
cylinder and a capsule have their axis along z, and `length` is the length of the whole cylinder, or of the segment of a
capsule.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.errors import ArgumentError, Error, FormatError
from ..base.progress import Progress, part_of, progress_callback
from ..meshes.convert import load_mesh
from ..meshes.mesh import Mesh
from ..shapes import primitives
from ..shapes.shape import Shape
from .geometry_files import GeometryFiles
from .joint import Joint, Kind
from .kinematics import tree_of
from .xml_files import read_xml

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

#: Kinds of joints, and ours. Others have more than one value.
KINDS: dict[str, Kind] = {"fixed": "fixed", "revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}


def read_urdf(
    path: str | os.PathLike[str],
    elements: str,
    packages: Mapping[str, str | os.PathLike[str]] | None,
    progress: Progress,
) -> tuple[Any, ...]:
    """Read the parts of an assembly: bodies, joints, ignored pairs, largest deviation, default poses of roots."""
    file = checks.path(path)
    checks.choice("elements", elements, ("collision", "visual"))
    if packages is not None and not isinstance(packages, Mapping):
        raise ArgumentError(f"packages: must be a mapping of name to folder, got {checks.describe(packages)}")
    folders = {checks.text("packages", name): checks.path(folder) for name, folder in (packages or {}).items()}
    reader = _Reader(file, GeometryFiles(file, folders))
    with progress_callback(progress, "robot") as callback:
        root = read_xml(file)
        if root.tag != "robot":
            raise FormatError(f"{file}: is no URDF: its root element is <{root.tag[:40]}>, not <robot>")
        links = root.findall("link")
        bodies: dict[str, tuple[tuple[Mesh | Shape, NDArray[np.float64]], ...]] = {}
        for number, link in enumerate(links):
            name = reader.name(link)
            if name in bodies:
                raise FormatError(f"{file}: two links have the name {name!r}")
            bodies[name] = tuple(reader.placed(item, f"link {name!r}") for item in link.findall(elements))
            step = part_of(callback, number, len(links))
            if step is not None:
                step(1.0)
    if not bodies:
        raise FormatError(f"{file}: has no links")
    joints = [reader.joint(element) for element in root.findall("joint")]
    try:
        tree_of(tuple(bodies), joints)
    except ArgumentError as error:
        raise FormatError(f"{file}: {error}") from None
    above: dict[str, str] = {}
    for joint in joints:
        if joint.child in above:
            raise FormatError(
                f"{file}: joints {above[joint.child]!r} and {joint.name!r}: both have the child {joint.child!r}; "
                "a link of URDF has one joint above it"
            )
        above[joint.child] = joint.name
    return bodies, joints, (), 0.0, {}


class _Reader:
    """Reads elements of one file; errors name the file and the element."""

    def __init__(self, file: Path, files: GeometryFiles) -> None:
        self.file = file
        self.files = files
        #: Meshes by file and scale: links often share a file.
        self.meshes: dict[tuple[Path, tuple[float, ...]], Mesh] = {}

    def name(self, element: Element) -> str:
        """The name of a link or a joint."""
        name = element.get("name")
        if not name:
            raise FormatError(f"{self.file}: a <{element.tag}> has no name")
        return name

    def numbers(self, element: Element, key: str, owner: str, count: int, default: str | None = None) -> list[float]:
        """The finite numbers of an attribute."""
        text = element.get(key, default)
        where = f"{self.file}: {owner}: {key} of <{element.tag}>"
        if text is None:
            raise FormatError(f"{where} is missing")
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            values = []
        if len(values) != count or not all(abs(value) <= checks.FAR for value in values):
            what = "a finite number" if count == 1 else f"{count} finite numbers"
            raise FormatError(f"{where} must be {what}, got {text[:60]!r}")
        return values

    def positive(self, element: Element, key: str, owner: str) -> float:
        """A number above 0."""
        (value,) = self.numbers(element, key, owner, 1)
        if not value > 0:
            raise FormatError(f"{self.file}: {owner}: {key} of <{element.tag}> must be above 0, got {value:g}")
        return value

    def child(self, element: Element, tag: str, owner: str) -> Element:
        """The child of an element with this tag."""
        found = element.find(tag)
        if found is None:
            raise FormatError(f"{self.file}: {owner}: <{element.tag}> has no <{tag}>")
        return found

    def origin(self, element: Element, owner: str) -> NDArray[np.float64]:
        """The transform of <origin>: fixed-axis roll, pitch and yaw about x, y and z, then a translation."""
        origin = element.find("origin")
        transform = np.eye(4)
        if origin is None:
            return transform
        roll, pitch, yaw = self.numbers(origin, "rpy", owner, 3, "0 0 0")
        (a, b), (c, d), (e, f) = ((math.cos(angle), math.sin(angle)) for angle in (roll, pitch, yaw))
        transform[:3, :3] = (
            (e * c, e * d * b - f * a, e * d * a + f * b),
            (f * c, f * d * b + e * a, f * d * a - e * b),
            (-d, c * b, c * a),
        )
        transform[:3, 3] = self.numbers(origin, "xyz", owner, 3, "0 0 0")
        return transform

    def placed(self, element: Element, owner: str) -> tuple[Mesh | Shape, NDArray[np.float64]]:
        """The geometry of a <collision> or <visual>, and its transform to the link."""
        return self.geometry(self.child(element, "geometry", owner), owner), self.origin(element, owner)

    def geometry(self, element: Element, owner: str) -> Mesh | Shape:
        """A primitive as an exact shape, or a mesh from a file."""
        kinds = list(element)
        if len(kinds) != 1:
            raise FormatError(f"{self.file}: {owner}: <geometry> must have one element, got {len(kinds)}")
        kind = kinds[0]
        try:
            if kind.tag == "box":
                size = self.numbers(kind, "size", owner, 3)
                if not min(size) > 0:
                    raise FormatError(f"{self.file}: {owner}: size of <box> must be above 0, got {size}")
                return primitives.box(size)
            if kind.tag == "sphere":
                return primitives.sphere(self.positive(kind, "radius", owner))
            if kind.tag in ("cylinder", "capsule"):
                radius, length = self.positive(kind, "radius", owner), self.positive(kind, "length", owner)
                make = primitives.cylinder if kind.tag == "cylinder" else primitives.capsule
                return make(radius, length)
            if kind.tag == "mesh":
                return self.mesh(kind, owner)
        except FormatError:
            raise
        except Error as error:
            raise FormatError(f"{self.file}: {owner}: <{kind.tag}>: {error}") from None
        raise FormatError(f"{self.file}: {owner}: <{kind.tag[:40]}> is no geometry of URDF")

    def mesh(self, element: Element, owner: str) -> Mesh:
        """A mesh from its file, with its scale applied."""
        name = element.get("filename")
        if not name:
            raise FormatError(f"{self.file}: {owner}: filename of <mesh> is missing")
        scale = tuple(self.numbers(element, "scale", owner, 3, "1 1 1"))
        if 0 in scale:
            raise FormatError(f"{self.file}: {owner}: scale of <mesh> must not be 0, got {list(scale)}")
        key = self.files.find(name, f"{owner}: mesh", ("",)), scale
        if key not in self.meshes:
            mesh = load_mesh(key[0])
            # A reflection turns the faces over.
            faces = mesh.faces[:, ::-1] if np.prod(np.sign(scale)) < 0 else mesh.faces
            is_plain = all(factor == 1 for factor in scale)
            self.meshes[key] = mesh if is_plain else Mesh(mesh.vertices * scale, faces)
        return self.meshes[key]

    def joint(self, element: Element) -> Joint:
        """A joint with its limits and what it mimics."""
        name = self.name(element)
        owner = f"joint {name!r}"
        kind = element.get("type", "")
        if kind not in KINDS:
            several = kind in ("planar", "floating")
            advice = "has more than one value; pass the poses of a simulator to queries instead" if several else (
                f"is no type of URDF; these are {', '.join(KINDS)}"
            )  # fmt: skip
            raise FormatError(f"{self.file}: {owner}: the type {kind[:40]!r} {advice}")
        parent, child = (self.child(element, role, owner).get("link") or "" for role in ("parent", "child"))
        limits = (-math.inf, math.inf)
        axis = [1.0, 0.0, 0.0]
        mimic: tuple[str, float, float] | None = None
        if kind != "fixed":
            line = element.find("axis")
            axis = axis if line is None else self.numbers(line, "xyz", owner, 3, "1 0 0")
            limit = element.find("limit")
            if limit is not None and kind != "continuous":
                (lower,), (upper,) = (self.numbers(limit, end, owner, 1, "0") for end in ("lower", "upper"))
                limits = lower, upper
            copied = element.find("mimic")
            if copied is not None:
                (rate,), (offset,) = (
                    self.numbers(copied, key, owner, 1, default)
                    for key, default in (("multiplier", "1"), ("offset", "0"))
                )
                mimic = copied.get("joint") or "", rate, offset
        try:
            return Joint(
                name,
                KINDS[kind],
                parent,
                child,
                origin=self.origin(element, owner),
                axis=axis,
                limits=limits,
                mimic=mimic,
            )
        except ArgumentError as error:
            raise FormatError(f"{self.file}: {error}") from None
