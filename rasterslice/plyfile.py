"""PLY, binary and ASCII: vertices, and facets cut into triangles; everything else is skipped."""

from __future__ import annotations

import struct
from array import array
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import ModelError, counted
from .interrupts import unbroken
from .plyhead import Element, Faces, Header, hint, read_header
from .plyplain import read_plain
from .polygons import Ints, even_fans, fan_places, mend_fans, polygon_notes

Vertices = NDArray[np.float32] | NDArray[np.float64]
Bytes = NDArray[np.uint8]

_POLYGONS = 1 << 16  # that are cut into fans at a time
_CHECKED = 1 << 20  # facets after which it is looked whether they are facets


class Found(NamedTuple):
    """Elements that are read: rows, or triangles; how many are whole; where the next begins; corners of each."""

    rows: Any
    whole: int
    next: int
    sizes: Ints | None = None  # None when all are triangles


def read_ply(path: Path, size: int, lenient: bool) -> tuple[Vertices, Faces, list[str]]:
    """Read a PLY file of `size` bytes.

    Returns
    -------
    vertices : (N, 3) float32 or float64
        As precise as the file has them; may hold values that are not finite.
    faces : (T, 3) int
        Corners of the triangles, not checked; polygons are cut into fans, concave ones into ears.
    notes : list of str
        What a user should know.

    Raises
    ------
    ModelError
        When the file is damaged, or cut short and `lenient` does not help.
    """
    header = read_header(path, size, lenient)
    plain = read_plain(path, size, header)
    if plain is not None:
        return *plain, []
    vertices, faces, whole, left, small, crossed = (_read_binary if header.order else _read_ascii)(path, header)
    vertex, face, notes = header.element("vertex"), header.element("face"), list[str]()
    for e, held in ((vertex, len(vertices)), (face, whole)):
        if held < e.number and not (lenient and e is face and held):
            raise ModelError(f"{path}: header promises {e.number} {e.name} elements but the file holds {held}; "
                             f"export the model again{hint(e, held)}")  # fmt: skip
    if whole < face.number:
        notes.append(f"the file is cut short; {whole} of {face.number} facets are whole, and are sliced")
    if small:
        notes.append(f"{small} of {counted(whole, 'facet')} with fewer than 3 corners: left out")
    notes += polygon_notes(crossed)
    if left:
        notes.append(f"{counted(left, 'byte')} after the last element: ignored")
    return vertices, faces, notes


def _read_ascii(path: Path, header: Header) -> tuple[Vertices, Faces, int, int, int, int]:
    with unbroken():
        from .plytext import read_text
    return read_text(path, header)


def _read_binary(path: Path, header: Header) -> tuple[Vertices, Faces, int, int, int, int]:
    """Return what `plytext.read_text` does; bytes are left over."""
    data = np.fromfile(path, np.uint8)
    at = header.start
    vertices: Vertices = np.empty((0, 3), np.float32)
    faces: Faces = np.empty((0, 3), np.int32)
    whole, sizes, left = 0, None, 0
    for e in header.elements:
        if e.lists():
            found = _with_lists(data, at, e, header.order)
        else:
            record = e.record(header.order)
            held = min(e.number, (len(data) - at) // max(record.itemsize, 1))
            end = at + held * record.itemsize
            found = Found(data[at:end].view(record) if e.properties else None, held, end)
        if e.name == "vertex" and not e.lists():
            vertices = _columns(found.rows, [[p.name for p in e.properties].index(c) for c in "xyz"])
        elif e.name == "vertex":
            raise ModelError(f"{path}: vertices with lists are not understood; export the model again")
        elif e.name == "face":
            faces, whole, sizes = found.rows, found.whole, found.sizes
        at = found.next
        if found.whole < e.number:
            break
    else:
        left = len(data) - at
    if sizes is None:
        return vertices, faces, whole, left, 0, 0
    return vertices, faces, whole, left, int((sizes < 3).sum()), mend_fans(vertices, faces, sizes)


def _with_lists(data: Bytes, start: int, e: Element, order: str) -> Found:
    """Read an element with lists, as records when the lists are of one length, else one after the other."""
    corners = e.corners()
    if e.lists() == [corners] and e.number:
        widths = [np.dtype(p.length or p.kind).itemsize for p in e.properties]
        at = start + sum(widths[:corners])
        kind = e.properties[corners]
        first = data[at : at + widths[corners]]
        count = int(first.view(order + kind.length)[0]) if len(first) == widths[corners] else 0
        if 3 <= count <= 64:
            record = e.record(order, count)
            held = min(e.number, (len(data) - start) // record.itemsize)
            rows = data[start : start + held * record.itemsize].view(record)
            if (rows["length"] == count).all():
                faces = _native(np.ascontiguousarray(rows["list"]))
                sizes = None if count == 3 else np.full(held, count)
                return Found(even_fans(faces), held, start + held * record.itemsize, sizes)
    return _one_by_one(data, start, e, order)


def _one_by_one(data: Bytes, start: int, e: Element, order: str) -> Found:
    """Walk over elements whose lists differ in length."""
    steps = [
        (i == e.corners(), np.dtype(p.kind).itemsize, struct.Struct(order + _CODES[p.length]) if p.length else None)
        for i, p in enumerate(e.properties)
    ]
    view, end, at, whole = data.data, len(data), start, 0
    starts, sizes = array("q"), array("q")  # of the lists of corners
    while whole < e.number:
        here = at
        for is_corners, item, counter in steps:
            number = 1
            if counter is not None:
                here += counter.size
                if here > end:
                    break
                number = int(counter.unpack_from(view, here - counter.size)[0])
                if number < 0:
                    here = end + 1
                    break
                if is_corners:
                    starts.append(here)
                    sizes.append(number)
            here += item * number
        if here > end:
            break
        at, whole = here, whole + 1
        if not whole & (_CHECKED - 1) and e.name == "face" and 2 * sum(n < 3 for n in sizes) > whole:
            raise ValueError(f"more than half of its first {whole} facets have fewer than 3 corners; it is damaged")
    if e.name != "face":
        return Found(None, whole, at)
    lengths = np.array(sizes[:whole], np.int64)
    kind = np.dtype(order + e.properties[e.corners()].kind)
    faces = _cut_polygons(data, np.array(starts[:whole], np.int64), lengths, kind)
    return Found(faces, whole, at, lengths)


_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}


def _cut_polygons(data: Bytes, starts: NDArray[np.int64], sizes: NDArray[np.int64], kind: np.dtype[Any]) -> Faces:
    """Cut polygons into fans, in their order; those of fewer than three corners are no facets."""
    parts: list[Faces] = [np.empty((0, 3), np.int64)]
    for i in range(0, len(starts), _POLYGONS):
        places = fan_places(starts[i : i + _POLYGONS], sizes[i : i + _POLYGONS], kind.itemsize)
        corners = data[places[..., None] + np.arange(kind.itemsize)]
        parts.append(np.ascontiguousarray(corners).view(kind)[..., 0].astype(np.int64))
    return np.concatenate(parts)


def _columns(rows: NDArray[np.void], numbers: list[int]) -> Vertices:
    """Return three columns of records as (N, 3) float32 where that loses nothing, else float64."""
    kinds = [rows.dtype[f"{i}"] for i in numbers]
    exact = all((k.kind == "f" and k.itemsize == 4) or k.itemsize <= 2 for k in kinds)
    out = np.empty((len(rows), 3), np.float32 if exact else np.float64)
    for axis, i in enumerate(numbers):
        out[:, axis] = rows[f"{i}"]
    return out


def _native(array: Any) -> Any:
    """Return an array in the byte order of the machine."""
    return array.astype(array.dtype.newbyteorder("="), copy=False)
