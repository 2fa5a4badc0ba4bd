"""Shapes as implicit functions of 3MF files.

The field of a shape is a graph of arithmetic operations in the sense of the 3MF Volumetric and Implicit extensions
(3MF Consortium, *Volumetric Extension*, namespace 2022/01, and *Implicit Extension*, namespace 2023/12). Each operation
is a node with the inputs ``A`` to ``D``; the function has the input ``pos`` and the output ``shape``, negative inside.
The metadata of the model are the shape as an s-expression and the SHA-256 of the function, from which
:func:`fieldbake.load` makes the shape again.
"""

from __future__ import annotations

import hashlib
import math
import os
import xml.parsers.expat
from collections.abc import Iterator
from itertools import chain
from typing import IO, Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError, FormatError, ShapeError
from ..files import package_3mf
from ..files.container import atomic_write
from ..meshes.convert import MeshLike, as_mesh

#: Units of a 3MF model.
UNITS = ("micron", "millimeter", "centimeter", "inch", "foot", "meter")

#: Largest number of operations of a function. Slicers evaluate each of them at every point.
MOST_NODES = 20_000

_VOLUMETRIC = "http://schemas.3mf.io/3dmanufacturing/volumetric/2022/01"
_IMPLICIT = "http://schemas.3mf.io/3dmanufacturing/implicit/2023/12"
_OWN = "https://fieldbake.example.org/3mf/2026/11"

#: Bytes of a model that are parsed at once. Parsing ends after the function.
_PARSED_AT_ONCE = 1 << 16

#: Corners of the faces of a box, outward. Corner i has the upper x, y and z where i has the bits 1, 2 and 4.
_BOX_CORNERS = [0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4]
_BOX_CORNERS += [2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5]


def save_function(
    core: _core.Shape,
    path: str | os.PathLike[str],
    within: MeshLike | None,
    *,
    unit: str,
    min_feature: float | None,
    unused: list[str],
) -> None:
    """Write the field of a shape to a .3mf file; see :meth:`Shape.save`. `unused` are options that have no use."""
    target = checks.path(path)
    if unused:
        raise ArgumentError(f"{unused[0]}: an implicit file has no grid; leave this out or pass implicit=False")
    if target.suffix.lower() != ".3mf":
        raise ArgumentError(f"implicit: only .3mf files have implicit functions, got the ending '{target.suffix}'")
    checks.choice("unit", unit, UNITS)
    feature = None if min_feature is None else checks.number("min_feature", min_feature, above=0)
    if within is None:
        try:
            lower, upper = core.bounds()
        except ShapeError as error:
            raise ShapeError(f"{error}; pass within=, a mesh that clips the solid") from None
        corners = np.arange(8)[:, None] >> np.arange(3) & 1
        vertices, faces = np.where(corners, upper, lower), np.reshape(_BOX_CORNERS, (-1, 3))
    else:
        mesh = as_mesh(within)
        vertices, faces = mesh.vertices, mesh.faces
    function = function_text(core)
    own = {"sexpr": core.to_sexpr(), "sha256": hashlib.sha256(function.encode()).hexdigest()}
    head = (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<model unit="{unit}" xml:lang="en-US" xmlns="{package_3mf.CORE}" xmlns:v="{_VOLUMETRIC}" '
        f'xmlns:i="{_IMPLICIT}" xmlns:fieldbake="{_OWN}" requiredextensions="v i">'
        f'<metadata name="Application">fieldbake {_core.__version__}</metadata>'
        + "".join(f'<metadata name="fieldbake:{name}">{escape(text)}</metadata>' for name, text in own.items())
        + f'<resources>{function}<object id="2" type="other">'
    )
    detail = "" if feature is None else f' minfeaturesize="{feature!r}"'
    tail = (
        '</object><object id="3" type="model"><v:levelset functionid="1" channel="shape" meshid="2" '
        f'meshbboxonly="{"true" if within is None else "false"}"{detail}/></object></resources>'
        '<build><item objectid="3"/></build></model>'
    )
    with atomic_write(target) as stream:
        package_3mf.write(stream, chain([head], package_3mf.mesh_texts(vertices, faces), [tail]))


def check_unused(within: object, unit: str, min_feature: object) -> None:
    """Raise for an option of implicit files that a file of triangles does not have."""
    if within is not None:
        raise ShapeError("within: clips the solid of an implicit file; pass implicit=True, or intersect the shapes")
    if unit != "millimeter" or min_feature is not None:
        name = "unit" if min_feature is None else "min_feature"
        raise ArgumentError(f"{name}: only implicit files have it; pass implicit=True")


def function_text(core: _core.Shape) -> str:
    """The element of the function of a shape; ShapeError if the field has none or too many operations."""
    graph = core.graph()
    if graph is None:
        raise ShapeError(
            "the shape contains a baked volume, which is no arithmetic of the position; save it as a mesh, without "
            "implicit=True"
        )
    names, inputs, values, result = graph
    if len(names) > MOST_NODES:
        raise ShapeError(
            f"the implicit function of the shape would have {len(names):,} nodes, and has at most {MOST_NODES:,}; "
            "simplify the shape or save it as a mesh, without implicit=True"
        )
    if not all(map(math.isfinite, values)):
        raise ShapeError("a parameter of the field is not finite; save the shape as a mesh, without implicit=True")
    return "".join(_function_parts(names, inputs, values, result))


def _function_parts(
    names: list[str], inputs: list[tuple[int, int, int, int]], values: list[float], result: int
) -> Iterator[str]:
    outputs = [_output(i, name) for i, name in enumerate(names)]
    yield '<i:implicitfunction id="1" displayname="shape"><i:in><i:vector identifier="pos" displayname="pos"/></i:in>'
    yield '<i:decomposevector identifier="point" displayname="point">'
    yield '<i:in><i:vectorref identifier="A" ref="inputs.pos"/></i:in><i:out>'
    yield "".join(f'<i:scalar identifier="{axis}" displayname="{axis}"/>' for axis in "xyz")
    yield "</i:out></i:decomposevector>"
    for i, (name, value) in enumerate(zip(names, values, strict=True)):
        if name in ("x", "y", "z"):
            continue
        attributes = f'identifier="n{i}" displayname="n{i}"'
        if name == "constant":
            yield f'<i:constant {attributes} value="{value!r}">{_out("value")}</i:constant>'
            continue
        letters = "ABCD"[: _INPUTS.get(name, 2)]
        references = (
            f'<i:scalarref identifier="{letter}" ref="{outputs[source]}"/>'
            for letter, source in zip(letters, inputs[i], strict=False)
        )
        yield f"<i:{name} {attributes}><i:in>{''.join(references)}</i:in>{_out('result')}</i:{name}>"
    yield f'<i:out><i:scalarref identifier="shape" displayname="shape" ref="{outputs[result]}"/></i:out>'
    yield "</i:implicitfunction>"


#: Number of inputs of the operations that do not have two.
_INPUTS = {**dict.fromkeys(("sqrt", "abs", "sin", "cos", "floor"), 1), "select": 4}


def _output(i: int, name: str) -> str:
    if name in ("x", "y", "z"):
        return f"point.{name}"
    return f"n{i}.value" if name == "constant" else f"n{i}.result"


def _out(name: str) -> str:
    return f"<i:out><i:scalar identifier={quoteattr(name)} displayname={quoteattr(name)}/></i:out>"


def read_function(stream: IO[bytes]) -> str:
    """Read the s-expression of a function that :func:`save_function` wrote.

    Raises FormatError for a file without a function, for a function of another program or a changed one, and for a file
    that is not safe to read.
    """
    model = package_3mf.read_model(stream)
    metadata: dict[str, str] = {}
    name: list[str] = []
    text: list[str] = []
    start: list[int] = []
    ends: list[int] = []
    parser = xml.parsers.expat.ParserCreate(namespace_separator=" ")

    def begin(element: str, attributes: dict[str, str]) -> None:
        if element == f"{package_3mf.CORE} metadata":
            name[:] = [attributes.get("name", "")]
            text.clear()
        elif element == f"{_IMPLICIT} implicitfunction" and not start:
            start.append(parser.CurrentByteIndex)

    def end(element: str) -> None:
        if element == f"{package_3mf.CORE} metadata" and name:
            metadata[name.pop()] = "".join(text)
        elif element == f"{_IMPLICIT} implicitfunction":
            ends.append(parser.CurrentByteIndex)

    def refuse(*_: Any) -> None:
        raise FormatError("the model declares a document type, which is not safe to read")

    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    parser.CharacterDataHandler = text.append
    parser.StartDoctypeDeclHandler = refuse
    try:
        for first in range(0, len(model), _PARSED_AT_ONCE):
            parser.Parse(model[first : first + _PARSED_AT_ONCE], False)
            if ends:
                break
    except xml.parsers.expat.ExpatError as error:
        raise FormatError(f"the model is not valid XML ({error})") from None
    if not ends:
        raise FormatError("has no implicit function; meshes are read by load_mesh or bake")
    if "fieldbake:sexpr" not in metadata:
        program = metadata.get("Application", "another program")[:60]
        raise FormatError(f"written by {program}; only fieldbake's own functions become shapes")
    function = model[start[0] : model.index(b">", ends[0]) + 1]
    if hashlib.sha256(function).hexdigest() != metadata.get("fieldbake:sha256"):
        raise FormatError("the function was changed after fieldbake wrote it, so the shape is unknown")
    return metadata["fieldbake:sexpr"]
