"""Packed polylines and finished layers: what the stages hand to the spool and the exporters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Stat = float | int | str | None

#: Columns of ``layers.csv``, and keys of `Layer.stats`, in order.
COLUMNS = (
    "layer", "z", "part_area", "part_area_exact", "scaffold_area",
    "part_contours", "scaffold_contours", "part_points", "scaffold_points",
    "part_boundary_mm", "scaffold_boundary_mm", "part_fill_mm", "scaffold_fill_mm",
    "lost_area", "open_rows", "flags",
)  # fmt: skip

#: Names of the path sets of a layer, in the order in which the spool keeps them.
REGIONS = ("part", "scaffold")
DEPOSITION = ("part_boundary", "scaffold_boundary", "part_fill", "scaffold_fill", "part_second_fill")


@dataclass(slots=True, eq=False)
class Paths:
    """Polylines packed into one array.

    Attributes
    ----------
    points : (N, 2) float64
        x and y of all vertices, mm, in the frame of the transformed part.
    offsets : (P + 1,) uint32
        Path ``i`` is ``points[offsets[i]:offsets[i + 1]]``.
    closed : bool
        Whether the last vertex of each path joins its first (which is not repeated).
    """

    points: NDArray[np.float64]
    offsets: NDArray[np.uint32]
    closed: bool

    @classmethod
    def empty(cls, closed: bool) -> Paths:
        """Return no paths at all."""
        return cls(np.empty((0, 2)), np.zeros(1, np.uint32), closed)

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def __getitem__(self, i: int) -> NDArray[np.float64]:
        i = range(len(self))[i]
        return self.points[self.offsets[i] : self.offsets[i + 1]]

    def __iter__(self) -> Iterator[NDArray[np.float64]]:
        return (self[i] for i in range(len(self)))

    def steps(self) -> NDArray[np.complex128]:
        """Return the vector from each vertex to the next of its path (last: to the first), x + iy."""
        points = pairs_of(self.points)
        step = np.empty_like(points)
        if len(points):
            np.subtract(points[1:], points[:-1], out=step[:-1])
            held = self.offsets[1:] > self.offsets[:-1]  # a path of no points has neither a first nor a last one
            first, last = self.offsets[:-1][held], self.offsets[1:][held].astype(np.int64) - 1
            step[last] = points[first] - points[last] if self.closed else 0.0
        return step

    def lengths(self) -> NDArray[np.float64]:
        """Return the length of each path, mm; closed paths with their closing chord."""
        return self._sum(np.abs(self.steps()))

    def length(self) -> float:
        """Return the length of all paths together, mm."""
        return float(summed_lengths(self.steps(), np.array([0, len(self.points)]))[0])

    def areas(self) -> NDArray[np.float64]:
        """Return the signed area of each closed path, mm^2, counter-clockwise positive."""
        if not self.closed:
            raise ValueError("open paths have no area")
        count = np.diff(self.offsets)
        held = count > 0
        base = np.repeat(self.points[self.offsets[:-1][held]], count[held], axis=0)
        p, step = self.points - base, self.steps().view(np.float64).reshape(-1, 2)
        return self._sum(0.5 * (p[:, 0] * step[:, 1] - p[:, 1] * step[:, 0]))

    def repeated(self, offsets: NDArray[np.float64]) -> Paths:
        """Return all paths once for each of some places, copy after copy: offsets (C, 2) mm are added."""
        count, points = len(offsets), len(self.points)
        ends = np.arange(count)[:, None] * points + self.offsets[1:].astype(np.int64)
        placed = self.points + np.asarray(offsets, np.float64)[:, None, :]
        return Paths(placed.reshape(-1, 2), np.concatenate([[0], ends.ravel()]).astype(np.uint32), self.closed)

    def _sum(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        total = np.concatenate([[0.0], np.cumsum(values)])
        return np.asarray(total[self.offsets[1:]] - total[self.offsets[:-1]])


def summed_lengths(steps: NDArray[np.complex128], first: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the length of each run of steps, which are changed: x + iy, run i is ``first[i]:first[i + 1]``."""
    squares = steps.view(np.float64)
    squares *= squares
    length = squares[::2] + squares[1::2]
    np.sqrt(length, out=length)
    sums, held = np.zeros(len(first) - 1), first[1:] > first[:-1]
    if held.any():
        sums[held] = np.add.reduceat(length, first[:-1][held])
    return sums


def pairs_of(points: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return x + iy, (N,): NumPy is slow where innermost loops are of two."""
    return np.ascontiguousarray(points, np.float64).reshape(-1).view(np.complex128)


@dataclass(slots=True, eq=False)
class Layer:
    """One finished slice.

    Attributes
    ----------
    index : int
        Number of the slice, 0 at the bottom.
    z : float
        Cutting height, mm, in the frame of the transformed part.
    part, scaffold : Paths or None
        Regions: closed contours at level 0, outer ones counter-clockwise, holes clockwise.
        None unless regions were asked for.
    part_boundary, scaffold_boundary : Paths
        Deposition paths, closed, half a path width inside the region.
    part_fill, scaffold_fill : Paths
        Fill lines, open, two points each.
    stats : dict
        One value per name in `COLUMNS`; None is a blank.
    part_second_fill : Paths
        Fill lines of the second ice layer that is deposited in the slice, and of the fourth, ...: `part_boundary`
        serves all of them, the direction of the fill turns. The lengths in `stats` are those of `part_fill`.
    """

    index: int
    z: float
    part: Paths | None
    scaffold: Paths | None
    part_boundary: Paths
    scaffold_boundary: Paths
    part_fill: Paths
    scaffold_fill: Paths
    stats: dict[str, Stat]
    part_second_fill: Paths = field(default_factory=lambda: Paths.empty(False))

    def ice_fill(self, number: int) -> Paths:
        """Return the fill lines of an ice layer of the slice, 0 the lowest."""
        return self.part_second_fill if number % 2 else self.part_fill


#: What happens on the way to a point of a `Toolpath`. A valve signal is given where the motion to its point begins.
TRAVEL, MOVE, OPEN, CLOSE = range(4)
#: Materials, and kinds of a run.
ICE, SCAFFOLD = range(2)
BOUNDARY, FILL = 1, 2


@dataclass(slots=True, eq=False)
class Toolpath:
    """How one material is laid in one layer: runs at constant speed, each from its lead-in to its lead-out.

    A run is ``TRAVEL a0, MOVE a1, OPEN ..., MOVE c, CLOSE b``: the signal to open is given at a1, `open_distance`
    before the wet start; the signal to shut at c, `close_distance` before the wet end; the lead-out ends at b.

    Attributes
    ----------
    layer, pass_ : int
        Number of the slice, and of the layer of this material within it.
    material : int
        `ICE` or `SCAFFOLD`.
    top : float
        Height of the top of the deposit, mm, in the frame of the part.
    speed : float
        While the valve is open, mm/s.
    open_distance, close_distance : float
        How far the tip goes between a signal and the drop, mm.
    hold : bool
        Whether the machine stops for measuring before it.
    points : (N, 2) float64
        Where the tip goes, mm, in the frame of the part.
    ops : (N,) uint8
        `TRAVEL`, `MOVE`, `OPEN` or `CLOSE`, of the motion to each point.
    offsets : (P + 1,) uint32
        Run ``i`` is ``points[offsets[i]:offsets[i + 1]]``.
    kinds : (P,) uint8
        `BOUNDARY` or `FILL`.
    """

    layer: int
    pass_: int
    material: int
    top: float
    speed: float
    open_distance: float
    close_distance: float
    hold: bool
    points: NDArray[np.float64]
    ops: NDArray[np.uint8]
    offsets: NDArray[np.uint32]
    kinds: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def wet(self) -> Paths:
        """Return the polylines between wet start and wet end, in order: open, from a run's second point to its last."""
        if not len(self):
            return Paths.empty(False)
        first, last = self.offsets[:-1].astype(np.int64), self.offsets[1:].astype(np.int64) - 1
        keep = np.ones(len(self.points), bool)
        keep[first] = False
        points = self.points.copy()
        points[first + 1] = self._ahead(first + 1, self.open_distance)
        points[last] = self._ahead(last - 1, self.close_distance)
        return Paths(points[keep], (self.offsets - np.arange(len(self.offsets))).astype(np.uint32), False)

    def _ahead(self, at: NDArray[np.int64], distance: float) -> NDArray[np.float64]:
        """Return the positions a distance after some points, towards the next ones."""
        step = self.points[at + 1] - self.points[at]
        length = np.hypot(step[:, 0], step[:, 1])
        return np.asarray(self.points[at] + step * (distance / length)[:, None])
