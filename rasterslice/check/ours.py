"""What a layer should be: the exact slice of the mesh, on the device, and signed distances from it.

Distances are exact to the pieces of boundary that the distance images are made of, at the place that is asked for:
no pixel stands between the two sides, so the uncertainty is that of float32 coordinates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..bins import sort_pieces
from ..device import Device
from ..grid import TILE, Grid
from ..tiles import RULES, Pieces, read_pieces

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

REACH = 3  # tiles: distances are exact to 44 pixels, and end there
_UNSIGNED = -1  # as in nearest.cl
STEP = 2.0  # longest distance between samples of a boundary, pixels


@dataclass(frozen=True, slots=True)
class Samples:
    """Points spread along boundaries.

    Attributes
    ----------
    points : (N, 2) float64
        mm, in the part frame.
    layer : (N,) int64
        Layer of each, counted in its batch.
    length : (N,) float64
        Length of boundary that each stands for, mm.
    normal : (N, 2) float64
        Unit vector to the right of the boundary: out of a solid that lies left.
    """

    points: Floats
    layer: Ints
    length: Floats
    normal: Floats


@dataclass(frozen=True, slots=True)
class Boundary:
    """Sorted pieces of some layers on the device, until the next are sorted.

    Attributes
    ----------
    first, last : int
        Layers ``first .. last - 1`` are 0 .. last - first - 1 of the batch.
    tangled, is_open : (layers,) bool
        Layers of overlapping shells, and layers that had to be closed.
    """

    first: int
    last: int
    tangled: NDArray[np.bool_]
    is_open: NDArray[np.bool_]
    _device: Device
    _grid: Grid
    _near: Pieces
    _all: Pieces
    _wind: Any
    _rule: str

    def distance(self, points: Floats, layer: Ints, reach: int = REACH, signed: bool = True) -> Floats:
        """Return the signed distance of points from their layer, mm, negative inside; at most 44 pixels.

        Parameters
        ----------
        points : (N, 2) float64
            mm, in the part frame.
        layer : (N,) int64
            Layer of each point, counted in the batch.
        reach : int
            Tiles to look in; distances end at 16 pixels for each, less 4.
        signed : bool
            Whether inside and outside are to be told.
        """
        if not len(points):
            return np.zeros(0)
        device, grid, count = self._device, self._grid, len(points)
        pixels = device.put("check points", grid.to_pixels(points).astype(np.float32))
        layers = device.put("check layers", np.asarray(layer, np.int32))
        out = device.scratch("check distance", count, np.float32)
        device.run(
            "nearest", count, pixels, layers, count, self._near.pieces, self._near.start, self._all.pieces,
            self._all.start, self._wind, grid.tiles_x, grid.tiles_y, reach, RULES[self._rule] if signed else _UNSIGNED,
            out, group=64,
        )  # fmt: skip
        far = reach * TILE - 4.0  # beyond, some see farther than others
        return device.get(out, count, np.float32).astype(np.float64).clip(-far, far) * grid.pitch

    def lowest(self, points: Floats, layer: Ints, reach: int = REACH) -> Floats:
        """Return the signed distance, as `Wobbly.lowest` does; here of the one slice."""
        return self.distance(points, layer, reach)

    def wobble(self, points: Floats, layer: Ints) -> Floats:
        """Return how far the boundary may move, as `Wobbly.wobble` does; here nothing."""
        return np.zeros(len(points))

    def pieces(self) -> tuple[NDArray[np.float32], Ints]:
        """Return the pieces of boundary, (N, 4) px, and the layer of each."""
        layers = self.last - self.first
        pieces, start = read_pieces(self._device, self._near, layers)
        return pieces, np.repeat(np.arange(layers), np.diff(start[:: self._near.window.tiles]))

    def samples(self, pieces: NDArray[np.float32], layer: Ints) -> Samples:
        """Return points along pieces of boundary."""
        return spread(self._grid.to_mm(pieces.reshape(-1, 2)).reshape(-1, 4), layer, STEP * self._grid.pitch)


@dataclass(frozen=True, slots=True)
class Wobbly:
    """Slices each taken at three heights, a little apart: what a face that lies flat may do.

    Layer i is layer ``3 i + 1`` of the boundary below it, between its lower and its higher neighbour.
    """

    below: Boundary

    @property
    def tangled(self) -> NDArray[np.bool_]:
        """Layers of overlapping shells."""
        return self.below.tangled[1::3]

    @property
    def is_open(self) -> NDArray[np.bool_]:
        """Layers that had to be closed."""
        return self.below.is_open[1::3]

    def _three(self, points: Floats, layer: Ints) -> Floats:
        asked = np.concatenate([3 * layer + i for i in range(3)])
        return self.below.distance(np.concatenate([points] * 3), asked).reshape(3, -1)

    def distance(self, points: Floats, layer: Ints) -> Floats:
        """Return the least of the three distances, and 0 between two slices."""
        d = self._three(points, layer)
        least = np.take_along_axis(d, np.abs(d).argmin(axis=0)[None], 0)[0]
        return np.where((d.min(axis=0) <= 0) & (d.max(axis=0) >= 0), 0.0, least)

    def lowest(self, points: Floats, layer: Ints, reach: int = REACH) -> Floats:
        """Return the signed distance from the slice that the points lie deepest in."""
        return np.asarray(self._three(points, layer).min(axis=0))

    def wobble(self, points: Floats, layer: Ints) -> Floats:
        """Return how far the boundary moves at points of the slice in the middle, mm."""
        return np.asarray(np.abs(self._three(points, layer)).max(axis=0))

    def pieces(self) -> tuple[NDArray[np.float32], Ints]:
        """Return the pieces of the slices in the middle, and the layer of each."""
        pieces, layer = self.below.pieces()
        return pieces[layer % 3 == 1], layer[layer % 3 == 1] // 3

    def samples(self, pieces: NDArray[np.float32], layer: Ints) -> Samples:
        """Return points along pieces of boundary."""
        return self.below.samples(pieces, layer)


Slices = Boundary | Wobbly


def thinned(samples: Samples, step: float) -> Samples:
    """Return fewer samples where they lie closer than a step: the last within each step along their order."""
    reached = np.floor(np.cumsum(samples.length) / step).astype(np.int64)
    keep = np.flatnonzero(np.diff(reached, append=-1))
    length = np.diff(np.cumsum(samples.length)[keep], prepend=0.0)
    return Samples(samples.points[keep], samples.layer[keep], length, samples.normal[keep])


def spread(segments: Floats, layer: Ints, step: float) -> Samples:
    """Return the middles of equal shares, no longer than ``step``, of segments (N, 4): x0, y0, x1, y1."""
    vector = segments[:, 2:] - segments[:, :2]
    length = np.hypot(vector[:, 0], vector[:, 1])
    keep = length > 0
    segments, vector, length, layer = segments[keep], vector[keep], length[keep], np.asarray(layer)[keep]
    count = np.ceil(length / step - 1e-9).astype(np.int64).clip(1)
    which = np.repeat(np.arange(len(count)), count)
    place = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    share = (place + 0.5) / count[which]
    normal = np.stack([vector[:, 1], -vector[:, 0]], axis=1) / length[:, None]
    points = segments[which, :2] + share[:, None] * vector[which]
    return Samples(points, layer[which].astype(np.int64), (length / count)[which], normal[which])


class _Second:
    """A device whose scratch memory bears other names, so that two boundaries can be held at once."""

    def __init__(self, device: Device, name: str) -> None:
        self._device, self._name = device, name
        self.run = device.run

    def scratch(self, name: str, shape: int, dtype: DTypeLike) -> Any:
        return self._device.scratch(f"{self._name} {name}", shape, dtype)

    def zeros(self, name: str, shape: int, dtype: DTypeLike) -> Any:
        return self._device.zeros(f"{self._name} {name}", shape, dtype)

    def put(self, name: str, array: NDArray[Any]) -> Any:
        return self._device.put(f"{self._name} {name}", array)

    def places(self, counts: Any, n: int, name: str) -> tuple[Any, Callable[[], int]]:
        return self._device.places(counts, n, f"{self._name} {name}")


def sort_loops(
    device: Device, grid: Grid, segments: Floats, layer: Ints, layers: int, name: str = "second"
) -> Boundary:
    """Return other boundaries sorted in the same way, held beside ours; beyond the grid they are drawn to its border.

    Parameters
    ----------
    segments : (N, 4) float64
        x0, y0, x1, y1, mm; closed loops in either direction, if the sign of the distance is asked for.
    layer : (N,) int64
        Layer of each, 0 .. layers - 1.
    name : str
        What is sorted under one name replaces what was sorted under it before.
    """
    pixels = grid.to_pixels(segments.reshape(-1, 2))
    pixels = pixels.clip(0.25, (grid.width - 1.25, grid.height - 1.25)).astype(np.float32)
    second = cast(Device, _Second(device, name))
    buffer = second.put("segments", pixels)
    order = second.put("layers", np.asarray(layers - 1 - layer, np.int32))
    pieces, wind = sort_pieces(second, grid, buffer, order, (0, len(segments)), layers - 1, layers)
    none = np.zeros(layers, bool)
    return Boundary(0, layers, none, none, device, grid, pieces, pieces, wind, "evenodd")
