"""Shapes as implicit functions of 3MF files.

The field of a shape is a graph of arithmetic operations in the sense of the 3MF Volumetric and Implicit extensions
(3MF Consortium, *Volumetric Extension*, namespace 2022/01, and *Implicit Extension*, namespace 2023/12). Each operation
is a node with the inputs ``A`` to ``D``; the function has the input ``pos`` and the output ``shape``, negative inside.
The metadata of the model are the shape as an s-expression, from which :func:`fieldbake.load` makes the shape again, and
the SHA-256 of the model without this digest.
"""

from __future__ import annotations

import hashlib
import math
import os
import xml.parsers.expat
from collections.abc import Iterator
from itertools import chain
from typing import IO, Any, NamedTuple
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError, Error, FormatError, ShapeError
from ..files import package_3mf
from ..files.container import atomic_write
from ..files.png import write_grey
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
        if lower == upper:
            raise ShapeError("shape: is empty, so there is no solid to save")
        corners = np.arange(8)[:, None] >> np.arange(3) & 1
        vertices, faces = np.where(corners, upper, lower), np.reshape(_BOX_CORNERS, (-1, 3))
    else:
        try:
            mesh = as_mesh(within)
        except Error as error:
            raise type(error)(f"within: {error}") from error
        vertices, faces = mesh.vertices, mesh.faces
    graph = _graph_of(core)
    own = "" if graph.images else _metadata("sexpr", core.to_sexpr())
    head = (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<model unit="{unit}" xml:lang="en-US" xmlns="{package_3mf.CORE}" xmlns:v="{_VOLUMETRIC}" '
        f'xmlns:i="{_IMPLICIT}" xmlns:fieldbake="{_OWN}" requiredextensions="v i">'
        f'<metadata name="Application">fieldbake {_core.__version__}</metadata>{own}'
    )
    images = [_image(index, samples) for index, samples in enumerate(graph.images)]
    pictures = {path: picture for _, sheets in images for path, picture in sheets.items()}
    detail = "" if feature is None else f' minfeaturesize="{feature!r}"'
    tail = (
        '</object><object id="3" type="model"><v:levelset functionid="1" channel="shape" meshid="2" '
        f'meshbboxonly="{"true" if within is None else "false"}"{detail}/></object></resources>'
        '<build><item objectid="3"/></build></model>'
    )
    begin = ["<resources>", *(text for text, _ in images), *_function_parts(graph), '<object id="2" type="other">']

    def body() -> Iterator[str]:
        return chain(begin, package_3mf.mesh_texts(vertices, faces), [tail])

    # The digest is at the beginning of the model, and a stream cannot return there: the texts are made twice.
    digest = hashlib.sha256(head.encode())
    for text in body():
        digest.update(text.encode())
    with atomic_write(target) as stream:
        package_3mf.write(stream, chain([head, _metadata("sha256", digest.hexdigest())], body()), pictures)


def _metadata(name: str, text: str) -> str:
    return f'<metadata name="fieldbake:{name}">{escape(text)}</metadata>'


def check_unused(within: object, unit: str, min_feature: object) -> None:
    """Raise for an option of implicit files that a file of triangles does not have."""
    if within is not None:
        raise ShapeError("within: clips the solid of an implicit file; pass implicit=True, or intersect the shapes")
    if unit != "millimeter" or min_feature is not None:
        name = "unit" if min_feature is None else "min_feature"
        raise ArgumentError(f"{name}: only implicit files have it; pass implicit=True")


class _Graph(NamedTuple):
    """The operations of a field; see `_core.Shape.graph`."""

    names: list[str]
    inputs: list[tuple[int, int, int, int]]
    values: list[float]
    result: int
    images: list[NDArray[np.float32]]


def _graph_of(core: _core.Shape) -> _Graph:
    """The graph of a shape; ShapeError if it has none, too many operations, or a number that XML cannot have."""
    lists = core.graph()
    if lists is None:
        raise ShapeError("the field has no graph of operations; save the shape as a mesh, without implicit=True")
    graph = _Graph(*lists)
    if len(graph.names) > MOST_NODES:
        raise ShapeError(
            f"the implicit function of the shape would have {len(graph.names):,} nodes, and has at most "
            f"{MOST_NODES:,}; simplify the shape or save it as a mesh, without implicit=True"
        )
    if not all(map(math.isfinite, graph.values)):
        raise ShapeError("a parameter of the field is not finite; save the shape as a mesh, without implicit=True")
    return graph


def _function_parts(graph: _Graph) -> Iterator[str]:
    outputs = [_output(i, name) for i, name in enumerate(graph.names)]
    yield '<i:implicitfunction id="1" displayname="shape"><i:in><i:vector identifier="pos" displayname="pos"/></i:in>'
    yield '<i:decomposevector identifier="point" displayname="point">'
    yield '<i:in><i:vectorref identifier="A" ref="inputs.pos"/></i:in>'
    yield _out(*"xyz") + "</i:decomposevector>"
    for index in range(len(graph.images)):
        attributes = f'identifier="image{index}" displayname="image{index}" value="{_image_id(index) + 1}"'
        out = '<i:out><i:resourceid identifier="value" displayname="value"/></i:out>'
        yield f"<i:constresourceid {attributes}>{out}</i:constresourceid>"
    for i, (name, value) in enumerate(zip(graph.names, graph.values, strict=True)):
        if name in ("x", "y", "z"):
            continue
        attributes = f'identifier="n{i}" displayname="n{i}"'
        if name == "constant":
            yield f'<i:constant {attributes} value="{value!r}">{_out("value")}</i:constant>'
            continue
        if name == "image":
            at = f'identifier="n{i}_at" displayname="n{i}_at"'
            scalars = _references("xyz", graph.inputs[i], outputs)
            vector = '<i:out><i:vector identifier="result" displayname="result"/></i:out>'
            yield f"<i:composevector {at}><i:in>{scalars}</i:in>{vector}</i:composevector>"
            yield f'<i:functioncall {attributes}><i:in><i:resourceref identifier="functionID" '
            yield f'ref="image{value:.0f}.value"/><i:vectorref identifier="pos" ref="n{i}_at.result"/></i:in>'
            yield f"{_out('red')}</i:functioncall>"
            continue
        letters = "ABCD"[: _INPUTS.get(name, 2)]
        yield f"<i:{name} {attributes}><i:in>{_references(letters, graph.inputs[i], outputs)}</i:in>"
        yield f"{_out('result')}</i:{name}>"
    yield f'<i:out><i:scalarref identifier="shape" displayname="shape" ref="{outputs[graph.result]}"/></i:out>'
    yield "</i:implicitfunction>"


def _references(letters: str, sources: tuple[int, ...], outputs: list[str]) -> str:
    """The inputs of a node."""
    pairs = zip(letters, sources, strict=False)
    return "".join(f'<i:scalarref identifier="{letter}" ref="{outputs[source]}"/>' for letter, source in pairs)


#: Number of inputs of the operations that do not have two.
_INPUTS = {**dict.fromkeys(("sqrt", "abs", "sin", "cos", "floor"), 1), "select": 4}


def _output(i: int, name: str) -> str:
    if name in ("x", "y", "z"):
        return f"point.{name}"
    return f"n{i}." + {"constant": "value", "image": "red"}.get(name, "result")


def _out(*names: str) -> str:
    return "<i:out>" + "".join(f'<i:scalar identifier="{name}" displayname="{name}"/>' for name in names) + "</i:out>"


def _image_id(index: int) -> int:
    """Identifier of an image; its function has the next one."""
    return 10 + 2 * index


def _image(index: int, samples: NDArray[np.float32]) -> tuple[str, dict[str, bytes]]:
    """The elements of an image and of its function, and the sheets along z, from samples (nx, ny, nz).

    A texel has 16 bits of the range from -r to r, where r is the largest magnitude of the samples. Row 0 of a sheet is
    the largest y.
    """
    width, height, count = samples.shape
    reach = float(np.abs(samples).max()) or 1.0
    folder, own = f"3D/volume{index}", _image_id(index)
    sheets = {}
    for z in range(count):
        texels = np.rint((samples[:, ::-1, z].T.astype(np.float64) / reach + 1) * 32767.5).astype(np.uint16)
        sheets[f"{folder}/sheet{z:05}.png"] = write_grey(texels)
    text = (
        f'<v:image3d id="{own}" name="volume{index}">'
        f'<v:imagestack rowcount="{height}" columncount="{width}" sheetcount="{count}">'
        + "".join(f'<v:imagesheet path="/{path}"/>' for path in sheets)
        + f'</v:imagestack></v:image3d><v:functionfromimage3d id="{own + 1}" displayname="volume{index}" '
        f'image3did="{own}" valueoffset="{-reach!r}" valuescale="{2 * reach!r}" tilestyleu="clamp" '
        'tilestylev="clamp" tilestylew="clamp" filter="linear"/>'
    )
    return text, sheets


def read_function(stream: IO[bytes]) -> str:
    """Read the s-expression of a function that :func:`save_function` wrote.

    Raises FormatError for a file without a function, for a function of another program, for a model that was changed,
    and for a file that is not safe to read.
    """
    parts = package_3mf.model_parts(stream)
    model = next(parts)
    metadata: dict[str, str] = {}
    name: list[str] = []
    text: list[str] = []
    ends: list[str] = []
    parser = xml.parsers.expat.ParserCreate(namespace_separator=" ")

    def begin(element: str, attributes: dict[str, str]) -> None:
        if element == f"{package_3mf.CORE} metadata":
            name[:] = [attributes.get("name", "")]
            text.clear()

    def end(element: str) -> None:
        if element == f"{package_3mf.CORE} metadata" and name:
            metadata[name.pop()] = "".join(text)
        elif element == f"{_IMPLICIT} implicitfunction":
            ends.append(element)

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
        if not ends and len(model) < package_3mf.MOST_READ:
            parser.Parse(b"", True)
    except xml.parsers.expat.ExpatError as error:
        raise FormatError(f"the model is not valid XML ({error})") from None
    if not ends:
        raise FormatError("has no implicit function; meshes are read by load_mesh or bake")
    if "fieldbake:sha256" not in metadata:
        program = metadata.get("Application", "another program")[:60]
        raise FormatError(f"written by {program}; only fieldbake's own functions become shapes")
    found = metadata["fieldbake:sha256"]
    digest = hashlib.sha256(model.replace(_metadata("sha256", found).encode(), b"", 1))
    for part in parts:
        digest.update(part)
    if digest.hexdigest() != found:
        raise FormatError("the model was changed after fieldbake wrote it, so the shape is unknown")
    if "fieldbake:sexpr" not in metadata:
        raise FormatError("the shape contains a baked volume, which the file has as pictures of 16 bits only")
    return metadata["fieldbake:sexpr"]
