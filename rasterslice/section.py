"""Triangles x planes -> oriented segments of each slice, closed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .device import Array, Device
from .grid import Grid

_AT_ONCE = 8192  # segments whose area is summed at once: what a cache holds
_WIDE = 256  # segments of which the extremes are looked for side by side
CHUNKS = 256  # triangles are counted and emitted by this many work-items, at most
_ROW = 9 * 1024  # floats that are moved at a time
_NONE = np.zeros(1, np.int32)
COUNTS = 1 << 22  # counts of segments (one per chunk and slice) that are held, at most


class Sections(NamedTuple):
    """Segments of some slices, on the device.

    Attributes
    ----------
    segments : buffer of (N, 4) float32
        x0, y0, x1, y1 in pixels, the solid on the left, sorted by slice.
    slice_of : buffer of (N,) int32
        Slice of each segment.
    first : int
        First slice.
    offsets : (K + 1,) int64
        Segments of slice ``first + i`` are ``offsets[i]:offsets[i + 1]``.
    host : (N, 4) float32
        The segments where the host reads them.
    open_rows : (K,) int64
        Rows of pixels whose winding did not return to zero before the slice was closed.
    gap : (K,) float64
        Longest bridge that was needed to close the slice, pixels; 0 where none was.
    """

    segments: Any
    slice_of: Any
    first: int
    offsets: NDArray[np.int64]
    host: NDArray[np.float32]
    open_rows: NDArray[np.int64]
    gap: NDArray[np.float64]

    def exact_areas(self, start: int, end: int) -> NDArray[np.float64]:
        """Return the area that the segments of slices start .. end - 1 enclose, px^2, summed in float64."""
        ends, areas = self.offsets[start - self.first : end - self.first + 1], np.zeros(end - start)
        step = max(1, _AT_ONCE * (end - start) // max(int(ends[-1] - ends[0]), 1))
        for i in range(0, end - start, step):
            first, counts = ends[i : i + step + 1], np.diff(ends[i : i + step + 1])
            held = counts > 0
            if held.any():
                origin = self.host[first[:-1][held]][:, [0, 1, 0, 1]].T  # of each slice: one of its own points
                points = self.host[first[0] : first[-1]].T.astype(np.float64, order="C")
                x0, y0, x1, y1 = points - np.repeat(origin, counts[held], axis=1)
                areas[i : i + step][held] = 0.5 * np.add.reduceat(x0 * y1 - x1 * y0, (first[:-1] - first[0])[held])
        return areas

    def box(self, start: int, end: int) -> tuple[float, float, float, float] | None:
        """Return left, low, right and high of the segments of slices start .. end - 1, pixels, or None."""
        first, last = (int(self.offsets[i - self.first]) for i in (start, end))
        if first == last:
            return None
        least, most = (_extremes(self.host[first:last], of) for of in (np.minimum, np.maximum))
        left, low = np.minimum(least[:2], least[2:]).tolist()
        right, high = np.maximum(most[:2], most[2:]).tolist()
        return left, low, right, high


def _extremes(numbers: NDArray[np.float32], of: np.ufunc) -> NDArray[np.float32]:
    """Return the least, or the largest, of each column of (N, 4) numbers."""
    rows = len(numbers) // _WIDE * _WIDE  # many rows as one: NumPy is slow where innermost loops are short
    wide = of.reduce(numbers[:rows].reshape(-1, 4 * _WIDE), axis=0).reshape(-1, 4) if rows else numbers[:0]
    return np.asarray(of.reduce(np.concatenate([wide, numbers[rows:]]), axis=0))


def to_pixels(vertices: NDArray[np.float32], origin: Array, grid: Grid, zmin: float) -> None:
    """Move vertices, in place, from mm to the pixels of a grid, and z to mm above the lowest point.

    The sums are made in float64, so that a part far from the origin is sliced as if it lay there.
    """
    rows = _ROW // 3  # NumPy is slow where the innermost loop is over three numbers
    zero = np.tile(np.array([grid.x0, grid.y0, zmin]) - origin, rows)
    scale = np.tile(np.array([1.0 / grid.pitch, 1.0 / grid.pitch, 1.0]), rows)
    flat, buffer = vertices.reshape(-1), np.empty(_ROW)
    for i in range(0, len(flat), _ROW):
        chunk = flat[i : i + _ROW]
        n = len(chunk)
        wide = buffer[:n]
        wide[...] = chunk
        wide -= zero[:n]
        wide *= scale[:n]
        chunk[...] = wide


class Sectioner:
    """Cuts one mesh, window by window.

    Parameters
    ----------
    device : Device
    vertices : (N, 3) float32
        x and y in pixels, z in mm above the lowest point; kept alive, not copied, on a CPU.
    faces : (T, 3) int32, or None
        The corners of each facet; None when every three vertices make one.
    planes : (K,) float64
        Cutting heights above the lowest point, mm, ascending.
    window : int
        Segments that are held at once (but always those of one slice).
    """

    def __init__(
        self, device: Device, vertices: NDArray[np.float32], faces: NDArray[np.int32] | None,
        planes: NDArray[np.float64], window: int,
    ) -> None:  # fmt: skip
        self._device = device
        self._facets = len(vertices) // 3 if faces is None else len(faces)
        self._planes = planes.astype(np.float32)
        listed = np.ascontiguousarray(_NONE if faces is None else faces)
        self._vertices, self._heights = device.hold(vertices), device.hold(self._planes)
        self._levels = self._find_levels(len(vertices))
        self._faces = (device.hold(listed), int(faces is not None), self._facets)
        self._window = window
        self._shown: Array = np.empty(0, np.float32)  # segments of the last sections, on the host
        self._chunks = max(1, min(CHUNKS, COUNTS // len(planes)))
        self._per_chunk = -(-self._facets // self._chunks)
        self._counts = self._count()
        self._per_slice = self._counts.sum(axis=0, dtype=np.int64)

    def _find_levels(self, count: int) -> Any:
        n, planes = len(self._planes), self._planes
        per_mm = (n - 1) / float(planes[-1] - planes[0]) if planes[-1] > planes[0] else 0.0
        levels = self._device.scratch("levels", count, np.int32)
        where = (self._vertices, count, self._heights, n, float(planes[0]), per_mm)
        self._device.run("find_levels", count, *where, levels, group=64)
        return levels

    def _count(self) -> NDArray[np.int32]:
        n = len(self._planes)
        counts = self._device.scratch("counts", self._chunks * n, np.int32)
        self._device.run("count_segments", self._chunks, self._levels, *self._faces, self._per_chunk, n, counts)
        return self._device.get(counts, self._chunks * n, np.int32).reshape(self._chunks, n)

    def windows(self) -> Iterator[tuple[int, int]]:
        """Yield (first, last + 1) slices, from the top down, that are held at once."""
        last = len(self._planes)
        while last > 0:
            first, total = last, 0
            while first > 0 and (first == last or total + self._per_slice[first - 1] <= self._window):
                first -= 1
                total += int(self._per_slice[first])
            yield first, last
            last = first

    def cut(self, first: int, last: int) -> Sections:
        """Return the closed segments of slices ``first .. last - 1``; those that were returned before are gone."""
        device, counts = self._device, self._counts[:, first:last]
        device.hide(self._shown)
        offsets = np.concatenate([[0], np.cumsum(self._per_slice[first:last])])
        total = int(offsets[-1])
        places = np.cumsum(counts, axis=0, dtype=np.int32)  # of a slice, those of the chunks one after the other
        places += offsets[:-1].astype(np.int32) - counts
        segments = device.scratch("segments", 4 * total, np.float32)
        slice_of = device.scratch("slice_of", total, np.int32)
        balance = device.zeros("balance", last - first, np.int32)
        device.run(
            "emit_segments", self._chunks, self._vertices, self._levels, *self._faces, self._per_chunk,
            self._heights, first, last, device.put("places", places), segments, slice_of, balance,
        )  # fmt: skip
        opened = np.flatnonzero(device.get(balance, last - first, np.int32))
        rows, gap = np.zeros(last - first, np.int64), np.zeros(last - first)
        self._shown = device.show(segments, 4 * total, np.float32).read()
        host = self._shown.reshape(-1, 4)
        if len(opened):
            host, offsets, rows, gap = _close(host, offsets, opened)
            segments = device.put("segments", host)
            slice_of = device.put("slice_of", np.repeat(np.arange(first, last, dtype=np.int32), np.diff(offsets)))
        return Sections(segments, slice_of, first, offsets, host, rows, gap)


def _close(
    segments: NDArray[np.float32], offsets: NDArray[np.int64], opened: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Add bridges to the slices that are open; return segments, offsets, open rows, longest bridges."""
    rows, gap = np.zeros(len(offsets) - 1, np.int64), np.zeros(len(offsets) - 1)
    parts = [segments[a:b] for a, b in zip(offsets[:-1], offsets[1:], strict=True)]
    for i in opened:
        extra = bridges(parts[i])
        rows[i] = _unbalanced_rows(extra)
        gap[i] = np.hypot(extra[:, 2] - extra[:, 0], extra[:, 3] - extra[:, 1]).max(initial=0.0)
        parts[i] = np.concatenate([parts[i], extra])
    sizes = [len(p) for p in parts]
    return np.concatenate(parts), np.concatenate([[0], np.cumsum(sizes)]), rows, gap


def bridges(segments: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return segments that join every loose end of a slice to a loose start, the nearest pairs first.

    Parameters
    ----------
    segments : (N, 4) float32
        Oriented segments; points are the same when their bits are.

    Returns
    -------
    (M, 4) float32
        After they are added, every point is left as often as it is reached, so that every winding number
        that a row or a column counts returns to zero. A facet turned the wrong way is mended by two bridges
        over its segment.
    """
    points = np.ascontiguousarray(segments.reshape(-1, 2)) + np.float32(0.0)  # -0 is 0
    unique, where = np.unique(points, axis=0, return_inverse=True)
    where = where.reshape(-1, 2)
    excess = np.bincount(where[:, 1], minlength=len(unique)) - np.bincount(where[:, 0], minlength=len(unique))
    ends = unique[np.repeat(np.arange(len(unique)), np.maximum(excess, 0))]
    starts = unique[np.repeat(np.arange(len(unique)), np.maximum(-excess, 0))]
    made = []
    while len(ends):
        to, reach = _nearest(ends, starts)
        back, _ = _nearest(starts, ends)
        mine = np.arange(len(ends))
        mutual = back[to] == mine
        if not mutual.any():  # ties that go round in a ring: take the shortest
            mutual = mine == np.argmin(reach)
        made.append(np.hstack([ends[mutual], starts[to[mutual]]]))
        free = np.ones(len(starts), bool)
        free[to[mutual]] = False
        ends, starts = ends[~mutual], starts[free]
    return np.concatenate(made).astype(np.float32) if made else np.empty((0, 4), np.float32)


def _nearest(a: NDArray[np.float32], b: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return for each point of a the index of the nearest of b (the first of equals) and its distance."""
    index, reach = np.empty(len(a), np.int64), np.empty(len(a))
    rows = max(1, 4_000_000 // len(b))
    for i in range(0, len(a), rows):
        d = a[i : i + rows, None].astype(np.float64) - b[None]
        square = d[..., 0] ** 2 + d[..., 1] ** 2
        index[i : i + rows] = square.argmin(axis=1)
        reach[i : i + rows] = np.sqrt(square.min(axis=1))
    return index, reach


def _unbalanced_rows(extra: NDArray[np.float32]) -> int:
    """Count the rows of pixels whose winding the bridges change."""
    low = np.ceil(np.minimum(extra[:, 1], extra[:, 3])).astype(np.int64)
    high = np.ceil(np.maximum(extra[:, 1], extra[:, 3])).astype(np.int64)
    turns = np.where(extra[:, 3] < extra[:, 1], 1, -1)
    change = np.zeros(int(high.max(initial=0)) + 2, np.int64)
    np.add.at(change, low, turns)
    np.add.at(change, high, -turns)
    return int(np.count_nonzero(np.cumsum(change)))
