"""Outlines of our slices: loops strung from unordered pieces of boundary, counted, and kept by height."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..grid import Grid
from .form import Floats
from .loops import Ints

Shape = list[Floats]


@dataclass(frozen=True, slots=True)
class Strung:
    """Loops of some layers; those of one layer follow each other.

    Attributes
    ----------
    pieces : (N, 4) float32
        Along each loop, pixels.
    starts : (L + 1,) int64
        Loop ``i`` is ``pieces[starts[i]:starts[i + 1]]``.
    layer : (L,) int64
    area : (L,) float64
        Signed, counter-clockwise positive, px^2.
    """

    pieces: NDArray[np.float32]
    starts: Ints
    layer: Ints
    area: Floats

    def layer_of(self) -> Ints:
        """Return the layer of each piece."""
        return np.repeat(self.layer, np.diff(self.starts))

    def counts(self, layers: int) -> tuple[Ints, Ints]:
        """Return islands and holes of each layer."""
        islands = np.bincount(self.layer[self.area > 0], minlength=layers)
        return islands, np.bincount(self.layer[self.area < 0], minlength=layers)


class Outlines:
    """Loops of slices that were looked at before, by height.

    Parameters
    ----------
    grid : Grid
    """

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._held: dict[float, tuple[NDArray[np.float32], list[int]]] = {}

    def __contains__(self, z: float) -> bool:
        return z in self._held

    def __getitem__(self, z: float) -> Shape:
        points, starts = self._held[z]
        placed = self._grid.to_mm(points)
        return [placed[a:b] for a, b in zip(starts[:-1], starts[1:], strict=True)]

    def keep(self, heights: Floats, strung: Strung) -> None:
        """Keep the loops of slices at some heights."""
        edges = np.searchsorted(strung.layer, np.arange(len(heights) + 1))
        for z, a, b in zip(heights.tolist(), edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            starts = strung.starts[a : b + 1]
            self._held[z] = (strung.pieces[starts[0] : starts[-1], :2], (starts - starts[0]).tolist())


def string(pieces: NDArray[np.float32], layer: Ints) -> Strung:
    """Return the loops of unordered pieces; ends that meet are equal bit by bit, but where slivers are lost.

    The order of the pieces does not matter: they come from the device in any.

    Parameters
    ----------
    pieces : (N, 4) float32
        Solid on the left, pixels.
    layer : (N,) int64
        Ascending.
    """
    order, starts = _walk(_following(pieces, layer).tolist())
    if not len(order):
        return Strung(pieces, np.zeros(1, np.int64), np.empty(0, np.int64), np.empty(0))
    order, starts = _settled(pieces, layer, order, starts)
    pieces, layer = pieces[order], layer[order]
    x0, y0, x1, y1 = pieces.astype(np.float64).T
    area = np.add.reduceat(x0 * y1 - x1 * y0, starts[:-1]) / 2
    return Strung(pieces, starts, layer[starts[:-1]], area)


def _walk(following: list[int]) -> tuple[Ints, Ints]:
    """Return pieces in the order in which they follow each other, and where each loop begins and the last ends."""
    seen = bytearray(len(following))
    order: list[int] = []
    starts = []
    for here in range(len(following)):
        if seen[here]:
            continue
        starts.append(len(order))
        while not seen[here]:
            seen[here] = 1
            order.append(here)
            here = following[here]
    return np.array(order, np.int64), np.array([*starts, len(order)], np.int64)


def _settled(pieces: NDArray[np.float32], layer: Ints, order: Ints, starts: Ints) -> tuple[Ints, Ints]:
    """Return the same loops in an order that does not depend on that of the pieces: each from its leftmost point."""
    first, size = starts[:-1], np.diff(starts)
    loop = np.repeat(np.arange(len(size)), size)
    bits = np.ascontiguousarray(pieces[order, :2] + np.float32(0)).view(np.uint32).astype(np.uint64)
    key = (bits[:, 0] << np.uint64(32)) | bits[:, 1]  # ascends with x, then y, as pixels are not negative
    least = np.minimum.reduceat(key, first)
    begin = np.full(len(size), len(order))
    hits = np.flatnonzero(key == least[loop])[::-1]
    begin[loop[hits]] = hits
    rank = np.lexsort((size, least, layer[order[first]]))
    size, begin, first = size[rank], begin[rank], first[rank]
    ends = np.cumsum(size)
    place = np.arange(len(order)) - np.repeat(ends - size, size)
    turned = np.repeat(first, size) + (place + np.repeat(begin - first, size)) % np.repeat(size, size)
    return order[turned], np.append(ends - size, len(order))


def _following(pieces: NDArray[np.float32], layer: Ints) -> Ints:
    """Return which piece begins where each one ends; every piece follows one other.

    Where slivers of overlapping shells were cut away, ends fall short of each other: the nearest are joined.
    """
    n = len(pieces)
    if not n:
        return np.empty(0, np.int64)
    keys = [np.ascontiguousarray(pieces[:, c]).view(np.uint64).ravel() for c in (slice(0, 2), slice(2, 4))]
    mixed = [k ^ (layer.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)) for k in keys]
    starts, ends = (np.argsort(k, kind="stable") for k in mixed)
    first, last = mixed[0][starts], mixed[1][ends]
    place = np.searchsorted(first, last) + np.arange(n) - np.searchsorted(last, last)
    met = (place < n) & (first[place.clip(max=n - 1)] == last)
    following = np.full(n, -1)
    following[ends[met]] = starts[place[met]]
    if met.all():
        return following
    begun = np.ones(n, bool)
    begun[starts[place[met]]] = False
    loose, free = np.flatnonzero(following < 0), np.flatnonzero(begun)
    for k in np.unique(layer[loose]).tolist():
        rest = free[layer[free] == k].tolist()
        for i in loose[layer[loose] == k].tolist():
            near = int(np.argmin(((pieces[rest, :2] - pieces[i, 2:]) ** 2).sum(axis=1)))
            following[i] = rest.pop(near)
    return following
