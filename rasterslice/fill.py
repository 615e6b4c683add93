"""Parallel, unlinked lines inside closed paths."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .device import Device
from .grid import Grid
from .tiles import Contours


@dataclass(frozen=True, slots=True)
class Hatch:
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


def hatch_lines(
    device: Device, grid: Grid, contours: Contours, hatches: list[Hatch], inset: float, shortest: float
) -> list[NDArray[np.float64]]:
    """Clip one hatch to the paths of each image.

    Parameters
    ----------
    hatches : list of Hatch
        One per image.
    inset : float
        By how much both ends of each line are shortened, mm.
    shortest : float
        Lines below this length are left out, mm.

    Returns
    -------
    list of (L, 2, 2) float64
        Ends of the lines of each image, mm in the part frame; by line, then along the line.
    """
    count = len(hatches)
    spans = {h: h.span(grid) for h in set(hatches)}
    lines = max(n for _, n in spans.values())
    frame = np.zeros((count, 4), np.float32)
    for i, h in enumerate(hatches):
        c, s = h.direction()
        v0 = (spans[h][0] + 0.5) * h.spacing - (c * grid.y0 - s * grid.x0)
        frame[i] = c, s, v0 / grid.pitch, h.spacing / grid.pitch
    points, following, place, totals = contours.buffers
    counts = device.zeros("line crossings", count * lines, np.int32)
    where = (points, following, place, totals, device.put("frame", frame), lines)
    device.run("count_crossings", count, *where, counts)
    start, _, sums = device.offsets(counts, count * lines, "line start")
    total = int(sums[-1])
    crossing, fill = device.scratch("crossing", total, np.float32), device.scratch("fill", total, np.float32)
    line, made = device.scratch("line", total // 2 + 1, np.int32), device.scratch("made", count, np.int32)
    used = device.zeros("used", count * lines, np.int32)
    limits = (float(inset / grid.pitch), float(shortest / grid.pitch))
    device.run("fill_lines", count, *where, start, used, *limits, crossing, fill, line, made)

    number = device.get(made, count, np.int32)
    first = sums[np.arange(count) * lines] // 2
    ends = np.cumsum(number)
    which = np.arange(ends[-1]) + np.repeat(first - ends + number, number)
    with device.view(fill, total // 2 * 2, np.float32) as along, device.view(line, total // 2, np.int32) as across:
        u, j = along.reshape(-1, 2)[which], across[which]
    return np.split(_to_mm(u, j, np.repeat(np.arange(count), number), hatches, spans, grid), ends[:-1])


def _to_mm(
    u: NDArray[np.float32], j: NDArray[np.int32], image: NDArray[np.int64], hatches: list[Hatch],
    spans: dict[Hatch, tuple[int, int]], grid: Grid,
) -> NDArray[np.float64]:  # fmt: skip
    """Return (L, 2, 2) mm of lines from their ends along, and numbers across, the hatch of their image."""
    frames = np.array([(*h.direction(), h.spacing, spans[h][0] + 0.5) for h in hatches])
    c, s, spacing, offset = frames[image].T
    along = u * np.float64(grid.pitch) + (c * grid.x0 + s * grid.y0)[:, None]
    across = (j + offset) * spacing
    lines = np.empty((len(u), 2, 2))
    lines[..., 0] = c[:, None] * along - (s * across)[:, None]
    lines[..., 1] = s[:, None] * along + (c * across)[:, None]
    return lines
