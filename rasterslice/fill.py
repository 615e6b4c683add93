"""Parallel, unlinked lines inside closed paths."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .device import Device
from .grid import Grid
from .paths import Paths, pairs_of, summed_lengths
from .tiles import Traced


class Hatch(NamedTuple):
    """Lines at (j + 1/2) spacing in the part frame, j any whole number.

    Attributes
    ----------
    angle : float
        Direction of the lines, degrees counter-clockwise from x.
    spacing : float
        Distance between lines, mm.
    """

    angle: float
    spacing: float

    def direction(self) -> tuple[float, float]:
        """Return cosine and sine, exact for multiples of 90 degrees."""
        turns, rest = divmod(self.angle, 90.0)
        if rest == 0:
            return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(turns) % 4]
        return math.cos(math.radians(self.angle)), math.sin(math.radians(self.angle))

    def span(self, grid: Grid) -> tuple[int, int]:
        """Return the first line number that may cross a grid, and how many there are."""
        c, s = self.direction()
        corners = grid.to_mm([(x, y) for x in (0, grid.width) for y in (0, grid.height)])
        v = (corners @ (-s, c)) / self.spacing - 0.5
        first = math.floor(v.min())
        return first, math.ceil(v.max()) - first + 1


@cache
def _frames(hatches: tuple[Hatch, ...], grid: Grid) -> tuple[int, NDArray[np.float64], NDArray[np.float32]]:
    """Return the most lines that a hatch has on a grid; (c, s, spacing, first + 1/2) of each, mm; and in pixels."""
    spans = [h.span(grid) for h in hatches]
    frames = np.array([(*h.direction(), h.spacing, j + 0.5) for h, (j, _) in zip(hatches, spans, strict=True)])
    c, s, spacing, j = frames.T
    v0 = j * spacing - (c * grid.y0 - s * grid.x0)
    frame = np.stack([c, s, v0 / grid.pitch, spacing / grid.pitch], axis=1).astype(np.float32)
    return max(n for _, n in spans), frames, frame


def hatch_lines(
    device: Device, grid: Grid, boundary: Traced, hatches: tuple[Hatch, ...], which: NDArray[np.int64],
    image: NDArray[np.int64], inset: float, shortest: float,
) -> Callable[[], Callable[[], tuple[list[Paths], NDArray[np.float64]]]]:  # fmt: skip
    """Begin to lay the lines of one hatch within the paths of one image, several times; by line, then along the line.

    Parameters
    ----------
    hatches : tuple of Hatch
    which, image : (F,) int64
        Number of the hatch and of the image of each filling.
    inset : float
        By how much both ends of each line are shortened, mm.
    shortest : float
        Lines below this length are left out, mm.

    Returns
    -------
    callable
        Call it when the crossings may be counted, to go on; what it returns gives the lines of each filling, and their
        lengths together, mm.
    """
    count = len(which)
    lines, frames, frame = _frames(hatches, grid)
    counts, used = (device.scratch(name, count * lines, np.int32) for name in ("line crossings", "used"))
    images, turned = device.put("filled", image.astype(np.int32)), device.put("frame", frame[which])
    where = (*boundary, images, turned, lines)
    device.run("count_crossings", count, *where, counts, used)
    counted = device.offsets(counts, count * lines, "line start")
    limits = (float(inset / grid.pitch), float(shortest / grid.pitch))

    def lay() -> Callable[[], tuple[list[Paths], NDArray[np.float64]]]:
        start, sums = counted()
        total = int(sums[-1])
        crossing, fill = device.scratch("crossing", total, np.float32), device.scratch("fill", total, np.float32)
        line, made = device.scratch("line", total // 2 + 1, np.int32), device.scratch("made", count, np.int32)
        device.run("fill_lines", count, *where, start, used, *limits, crossing, fill, line, made)
        along, across = device.ask(fill, total // 2 * 2, np.float32), device.ask(line, total // 2, np.int32)
        numbers, begin = device.ask(made, count, np.int32), sums[np.arange(count) * lines] // 2
        return lambda: _paths(numbers.read(), along.read().reshape(-1, 2), across.read(), begin, frames[which], grid)

    return lay


def _paths(
    number: NDArray[np.int32], pairs: NDArray[np.float32], rows: NDArray[np.int32], begin: NDArray[np.int32],
    frames: NDArray[np.float64], grid: Grid,
) -> tuple[list[Paths], NDArray[np.float64]]:  # fmt: skip
    """Return the lines of each filling, which has ``number`` of them from number ``begin`` on, and their length."""
    first = np.concatenate([[0], np.cumsum(number, dtype=np.int64)])
    held = [np.s_[a:b] for a, b in zip(begin.tolist(), (begin + number).tolist(), strict=True)]
    u, v = np.concatenate([pairs[part] for part in held]), np.concatenate([rows[part] for part in held])
    ends = _to_mm(u, v, frames, number, grid)
    offsets = np.arange(0, len(ends) + 1, 2, dtype=np.uint32)
    paths = [Paths(ends[2 * a : 2 * b], offsets[: b - a + 1], False) for a, b in itertools.pairwise(first.tolist())]
    points = pairs_of(ends)
    return paths, summed_lengths(points[1::2] - points[::2], first)


def _to_mm(
    u: NDArray[np.float32], row: NDArray[np.int32], frames: NDArray[np.float64], number: NDArray[np.int32], grid: Grid
) -> NDArray[np.float64]:
    """Return (2 L, 2) mm of lines from their ends along the hatch and the numbers of their rows.

    ``frames`` are (c, s, spacing, first + 1/2) of each filling, which has ``number`` lines.
    """
    c, s, spacing, offset = (np.repeat(column, number) for column in frames.T)
    start, across = c * grid.x0 + s * grid.y0, (row + offset) * spacing
    right, up = s * across, c * across
    lines = np.empty((len(u), 2, 2))
    for end in (0, 1):
        along = u[:, end] * np.float64(grid.pitch) + start
        lines[:, end, 0] = c * along - right
        lines[:, end, 1] = s * along + up
    return lines.reshape(-1, 2)
