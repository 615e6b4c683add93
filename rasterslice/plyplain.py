"""PLY as most programs write it, vertices and then triangles, read to where it will stay.

`plyfile` reads every file, from a copy of all its bytes in memory; of a million facets, that copy and what is made of
it take three times as long as reading does here.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from .plyhead import Faces, Header

_ROWS = 1 << 18  # that are read at a time


def read_plain(path: Path, size: int, header: Header) -> tuple[NDArray[np.float32], Faces] | None:
    """Read a binary file of single precision and triangles; None where it is something else, or of another size.

    Returns
    -------
    vertices : (N, 3) float32
    faces : (T, 3) int
    """
    order = header.order
    if [e.name for e in header.elements] != ["vertex", "face"] or not order or not np.dtype(f"{order}i4").isnative:
        return None
    vertex, face = header.elements
    if vertex.lists() or face.lists() != [face.corners()]:
        return None
    points, facets = vertex.record(order), face.record(order, 3)
    places = [[p.name for p in vertex.properties].index(axis) for axis in "xyz"]
    if any(points[f"{i}"] != np.float32 for i in places):
        return None
    if header.start + vertex.number * points.itemsize + face.number * facets.itemsize != size:
        return None  # before memory is taken for what a header promises
    vertices, faces = np.empty((vertex.number, 3), np.float32), np.empty((face.number, 3), facets["list"].base)
    packed = places == [0, 1, 2] and points.itemsize == 12
    with path.open("rb", buffering=0) as file:
        file.seek(header.start)
        if packed and not _fill(file, vertices):
            return None
        at = 0
        for rows in () if packed else _rows(file, points, vertex.number):
            for axis, i in enumerate(places):
                vertices[at : at + len(rows), axis] = rows[f"{i}"]
            at += len(rows)
        at = 0
        for rows in _rows(file, facets, face.number):
            if (rows["length"] != 3).any():
                return None
            faces[at : at + len(rows)] = rows["list"]
            at += len(rows)
    return (vertices, faces) if at == face.number else None


def _rows(file: IO[bytes], record: np.dtype[Any], number: int) -> Iterator[NDArray[np.void]]:
    """Yield records, some at a time, in memory that is used again; fewer where the file is short."""
    buffer = np.empty(min(number, _ROWS), record)
    for start in range(0, number, _ROWS):
        part = buffer[: number - start]
        if not _fill(file, part):
            break
        yield part


def _fill(file: IO[bytes], array: NDArray[Any]) -> bool:
    """Read an array; return whether the file has enough."""
    left = array.reshape(-1).view(np.uint8).data
    while left:
        count = file.readinto(left)  # type: ignore[attr-defined]
        if not count:
            return False
        left = left[count:]
    return True
