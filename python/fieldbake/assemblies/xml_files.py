"""Robot files as trees of XML elements, with limits that hold for files of unknown origin."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base import checks
from ..base.errors import FormatError

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

#: Largest size of a robot file, bytes. The largest public ones have a few megabytes.
MAX_BYTES = 64 << 20

#: Largest depth of nested elements. Elements of bodies are nested in MJCF, one for each link of a chain.
MAX_DEPTH = 1000


def read_xml(path: Path) -> Element:
    """Read the root element of an XML file.

    Raises FormatError for a folder, and for a file that is no XML, has a DOCTYPE, or exceeds `MAX_BYTES` or
    `MAX_DEPTH`. Entities can only be defined in a DOCTYPE, so the tree is never larger than the file.
    """
    from xml.etree.ElementTree import TreeBuilder
    from xml.parsers import expat

    if path.is_dir():
        raise FormatError(f"{path}: is a folder, not a robot file; name the file in it")
    checks.finite_file(path, FormatError)
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise FormatError(f"{path}: has {size:,} bytes; robot files have at most {MAX_BYTES:,}")
    builder = TreeBuilder()
    depth = 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise FormatError(f"{path}: elements are nested more than {MAX_DEPTH} deep")
        builder.start(name, attributes)

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(name)

    def doctype(*_: Any) -> None:
        raise FormatError(f"{path}: has a DOCTYPE, which robot files do not need; remove it")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(path.read_bytes(), True)
        return builder.close()
    except (expat.ExpatError, ValueError, LookupError) as error:
        # An unknown encoding is a LookupError, and a null byte in a name a ValueError.
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"{path}: is no XML ({error})") from None
