"""The data of an ASCII PLY file: parsed block by block, shared out among the elements."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import ModelError
from .numbertext import NotANumber, parse, words_of
from .plyhead import Element, Faces, Header
from .polygons import even_fans, fan_places, mend_fans
from .streams import Block, blocks, in_order, line_of

Values = NDArray[np.float64]

_MOST = 2.0**31  # vertices that a facet can name
_LONGEST = 1_000_000  # numbers of a list


def read_text(path: Path, header: Header) -> tuple[Values, Faces, int, int, int, int]:
    """Return vertices, triangles; how many facets are whole, numbers left over, facets too small, and still fans."""
    taker = _Taker(path, header)
    with path.open("rb") as file:
        file.seek(header.start)
        found = in_order(_numbers, blocks(file))
        with closing(found):
            for block, (values, bad) in found:
                if bad is not None:
                    line = line_of(path, block.start + bad[0])
                    raise ModelError(f"{path}:{line}: expected a number, got {bad[1]!r}; export the model again")
                taker.take(values)
    return taker.result()


def _numbers(block: Block) -> tuple[Values, tuple[int, str] | None]:
    text = np.frombuffer(block.text, np.uint8)
    starts, ends = words_of(text)
    try:
        return parse(text, starts, ends), None
    except NotANumber as bad:
        return np.empty(0), (int(starts[bad.index]), bad.word)


class _Taker:
    """Shares out the numbers of an ASCII file, as they come, among its elements."""

    def __init__(self, path: Path, header: Header) -> None:
        self._path, self._elements = path, [e for e in header.elements if e.number]
        self._left = self._elements[0].number if self._elements else 0
        self._rest = np.empty(0)
        self._vertices: list[Values] = []
        self._faces: list[Faces] = []
        self._sizes: list[NDArray[np.int64]] = []  # corners of the facets
        self._whole = self._extra = self._small = 0

    def take(self, values: Values) -> None:
        """Take the numbers of the next block."""
        values = np.concatenate([self._rest, values]) if len(self._rest) else values
        while len(values) and self._elements:
            e = self._elements[0]
            rows, used = self._lists(e, values) if e.lists() else self._plain(e, values)
            values = values[used:]
            self._left -= rows
            if self._left:
                break  # the rest of a row comes with the next block
            self._elements.pop(0)
            self._left = self._elements[0].number if self._elements else 0
        self._rest = values
        if not self._elements:
            self._extra, self._rest = self._extra + len(values), np.empty(0)

    def _plain(self, e: Element, values: Values) -> tuple[int, int]:
        width = len(e.properties)
        rows = min(self._left, len(values) // width)
        if e.name == "vertex":
            places = [[p.name for p in e.properties].index(c) for c in "xyz"]
            self._vertices.append(values[: rows * width].reshape(-1, width)[:, places])
        return rows, rows * width

    def _lists(self, e: Element, values: Values) -> tuple[int, int]:
        corners, count = e.corners(), 0
        if e.lists() == [corners]:
            count = int(values[corners]) if len(values) > corners and 3 <= values[corners] <= 64 else 0
        width = len(e.properties) + count
        if count:
            rows = min(self._left, len(values) // width)
            table = values[: rows * width].reshape(-1, width)
            if (table[:, corners] == count).all():
                self._add(e, table[:, corners + 1 : corners + 1 + count], np.full(rows, count))
                return rows, rows * width
        return self._one_by_one(e, values)

    def _one_by_one(self, e: Element, values: Values) -> tuple[int, int]:
        """Walk over elements whose lists differ in length."""
        corners, numbers, end = e.corners(), values.tolist(), len(values)
        starts, sizes = list[int](), list[int]()  # of the lists of corners
        rows, at = 0, 0
        while rows < self._left:
            here = at
            for i, p in enumerate(e.properties):
                number = 0
                if p.length and here < end:
                    if not 0 <= numbers[here] <= _LONGEST or numbers[here] % 1:
                        raise self._damaged(f"a list of {numbers[here]:g} numbers")
                    number = int(numbers[here])
                    if i == corners:
                        starts.append(here + 1)
                        sizes.append(number)
                here += number + 1
            if here > end:
                break
            at, rows = here, rows + 1
        if e.name == "face":
            size = np.array(sizes[:rows], np.int64)
            self._add(e, values[fan_places(np.array(starts[:rows], np.int64), size)], size)
            self._small += int((size < 3).sum())
        return rows, at

    def _add(self, e: Element, polygons: Values, sizes: NDArray[np.int64]) -> None:
        if e.name != "face":
            return
        if not ((polygons > -_MOST) & (polygons < _MOST)).all() or (polygons % 1).any():
            raise self._damaged("a corner that is no whole number")
        self._faces.append(even_fans(polygons.astype(np.int32)))
        self._sizes.append(sizes)
        self._whole += len(sizes)

    def _damaged(self, what: str) -> ModelError:
        return ModelError(f"{self._path}: {what} in element {self._elements[0].name[:30]}; export the model again")

    def result(self) -> tuple[Values, Faces, int, int, int, int]:
        """Return what `read_text` does."""
        vertices = np.concatenate([np.empty((0, 3)), *self._vertices])
        faces = np.concatenate([np.empty((0, 3), np.int32), *self._faces])
        crossed = mend_fans(vertices, faces, np.concatenate([np.empty(0, np.int64), *self._sizes]))
        return vertices, faces, self._whole, self._extra, self._small, crossed
