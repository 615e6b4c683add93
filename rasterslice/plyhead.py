"""The header of a PLY file: its elements, their properties, and where the data begin."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import ModelError

Faces = NDArray[np.integer[Any]]

_HEADER = 65536  # a header is shorter
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


class Property(NamedTuple):
    """A number of type `kind`, or a list of them behind its length of type `length`."""

    name: str
    kind: str
    length: str


class Element(NamedTuple):
    """One element of a PLY file, and how many there are."""

    name: str
    number: int
    properties: list[Property]

    def smallest(self, text: bool) -> int:
        """Return the bytes that one takes at least."""
        if text:
            return 2 * len(self.properties)
        return sum(np.dtype(p.length or p.kind).itemsize for p in self.properties)

    def record(self, order: str, corners: int = 0) -> np.dtype[Any]:
        """Return the layout of one; names of its numbers are their places, and its one list, if any, is so long."""
        fields: list[Any] = []
        for i, p in enumerate(self.properties):
            lists = [("length", order + p.length), ("list", order + p.kind, corners)]
            fields += lists if p.length else [(f"{i}", order + p.kind)]
        return np.dtype(fields)

    def lists(self) -> list[int]:
        """Return which of the properties are lists."""
        return [i for i, p in enumerate(self.properties) if p.length]

    def corners(self) -> int:
        """Return which property holds the corners of a facet, or -1."""
        lists = self.lists()
        named = [i for i in lists if self.properties[i].name in ("vertex_indices", "vertex_index")]
        return (named or (lists if len(lists) == 1 else [-1]))[0]


class Header(NamedTuple):
    """What a header says; `order` is the byte order, '' for text, and `start` the first byte of the data."""

    order: str
    elements: list[Element]
    start: int

    def element(self, name: str) -> Element:
        """Return an element by name, of number 0 where there is none."""
        return next((e for e in self.elements if e.name == name), Element(name, 0, []))


def read_header(path: Path, size: int, lenient: bool) -> Header:
    """Read the header of a PLY file of `size` bytes, and check that its promises fit the file.

    Raises
    ------
    ModelError
        When it is not understood, promises no facets, or more of them than the file has room for
        (a lenient reader finds out later how many there are).
    """
    with path.open("rb") as file:
        head = file.read(_HEADER)
    bom = 3 if head.startswith(b"\xef\xbb\xbf") else 0  # some editors put it before text
    header = _parse(path, head[bom:])
    header = header._replace(start=header.start + bom)
    vertex, face = header.element("vertex"), header.element("face")
    if not face.number and vertex.number and header.element("tristrips").number:
        raise ModelError(f"{path}: holds its facets as triangle strips (element tristrips), which are not read; "
                         "export single facets")  # fmt: skip
    if not face.number or not vertex.number:
        raise ModelError(f"{path}: holds no facets ({vertex.number} vertices); nothing to slice")
    missing = {"x", "y", "z"} - {p.name for p in vertex.properties if not p.length}
    if missing:
        raise ModelError(f"{path}: vertices have no property {min(missing)}; the file is damaged")
    if face.corners() < 0 or face.properties[face.corners()].kind[0] == "f":
        raise ModelError(f"{path}: facets have no list of whole numbers vertex_indices; the file is damaged")
    for e in header.elements:
        held = (size - header.start + 1) // max(e.smallest(not header.order), 1)
        if e.number > held and not (lenient and e.name == "face"):
            raise ModelError(f"{path}: header promises {e.number} {e.name} elements but the file has room "
                             f"for {held}; export the model again{hint(e, held)}")  # fmt: skip
    return header


def hint(element: Element, held: int) -> str:
    """Return the remedy for a file that is cut short inside an element, of which it holds some."""
    return ", or use --lenient to slice what is whole" if element.name == "face" and held else ""


def _parse(path: Path, head: bytes) -> Header:
    end = re.search(rb"[\r\n]end_header[ \t]*(\r\n|\r|\n|$)", head)
    if end is None:
        raise ModelError(f"{path}: the PLY header has no end; the file is damaged")
    kind, elements = "", list[Element]()
    lines = re.split(r"\r\n|\r|\n", head[: end.start()].decode("latin-1"))
    for number, line in enumerate(lines[1:], 2):
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", "ascii" | "binary_little_endian" | "binary_big_endian" as kind, _]:
                pass
            case ["element", name, count] if re.fullmatch("[0-9]{1,18}", count):
                elements.append(Element(name, int(count), []))
            case ["property", "list", length, each, name] if elements and {length, each} <= _TYPES.keys():
                elements[-1].properties.append(Property(name, _TYPES[each], _TYPES[length]))
            case ["property", each, name] if elements and each in _TYPES:
                elements[-1].properties.append(Property(name, _TYPES[each], ""))
            case _:
                raise ModelError(f"{path}:{number}: a line of the PLY header is not understood: {line[:60]!r}")
    if not kind:
        raise ModelError(f"{path}: the PLY header names no format; the file is damaged")
    for e in elements:
        if e.number and not e.properties:
            raise ModelError(f"{path}: the PLY element {e.name[:30]!r} has no property; the file is damaged")
        if len({p.name for p in e.properties}) < len(e.properties) and e.name == "vertex":
            raise ModelError(f"{path}: the PLY element vertex has a property twice; the file is damaged")
    order = {"a": "", "l": "<", "b": ">"}[kind.removeprefix("binary_")[0]]
    return Header(order, elements, end.end())
