"""What a layer should be: the exact slice of the mesh, on the device, and signed distances from it.

Distances are exact to the pieces of boundary that the distance images are made of, at the place that is asked for:
no pixel stands between the two sides, so the uncertainty is that of float32 coordinates.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..bins import sort_pieces
from ..device import Device
from ..grid import TILE, Grid, cover, slice_heights
from ..mesh import read_mesh, transform
from ..overlap import boundary_pieces
from ..params import Params
from ..section import Sectioner, Sections, to_pixels
from ..tiles import RULES, Pieces, read_pieces

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

REACH = 3  # tiles: distances are exact to 44 pixels, and end there
STEP = 2.0  # longest distance between samples of a boundary, pixels
BATCH, BATCH_TILES = 64, 1 << 18


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

    def distance(self, points: Floats, layer: Ints) -> Floats:
        """Return the signed distance of points from their layer, mm, negative inside; at most 44 pixels.

        Parameters
        ----------
        points : (N, 2) float64
            mm, in the part frame.
        layer : (N,) int64
            Layer of each point, counted in the batch.
        """
        if not len(points):
            return np.zeros(0)
        device, grid, count = self._device, self._grid, len(points)
        pixels = device.put("check points", grid.to_pixels(points).astype(np.float32))
        layers = device.put("check layers", np.asarray(layer, np.int32))
        out = device.scratch("check distance", count, np.float32)
        device.run(
            "nearest", "nearest", count, pixels, layers, count, self._near.pieces, self._near.start, self._all.pieces,
            self._all.start, self._wind, grid.tiles_x, grid.tiles_y, REACH, RULES[self._rule], out, group=64,
        )  # fmt: skip
        far = REACH * TILE - 4.0  # beyond, some see farther than others
        return device.get(out, count, np.float32).astype(np.float64).clip(-far, far) * grid.pitch

    def lowest(self, points: Floats, layer: Ints) -> Floats:
        """Return the signed distance, as `Wobbly.lowest` does; here of the one slice."""
        return self.distance(points, layer)

    def wobble(self, points: Floats, layer: Ints) -> Floats:
        """Return how far the boundary may move, as `Wobbly.wobble` does; here nothing."""
        return np.zeros(len(points))

    def pieces(self) -> tuple[NDArray[np.float32], Ints]:
        """Return the pieces of boundary, (N, 4) px, and the layer of each."""
        layers = self.last - self.first
        pieces, start = read_pieces(self._device, self._near, layers * self._grid.tiles)
        return pieces, np.repeat(np.arange(layers), np.diff(start[:: self._grid.tiles]))

    def samples(self) -> Samples:
        """Return points along the boundary; to be asked for before anything else is sorted."""
        pieces, layer = self.pieces()
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

    def lowest(self, points: Floats, layer: Ints) -> Floats:
        """Return the signed distance from the slice that the points lie deepest in."""
        return np.asarray(self._three(points, layer).min(axis=0))

    def wobble(self, points: Floats, layer: Ints) -> Floats:
        """Return how far the boundary moves at points of the slice in the middle, mm."""
        return np.asarray(np.abs(self._three(points, layer)).max(axis=0))

    def pieces(self) -> tuple[NDArray[np.float32], Ints]:
        """Return the pieces of the slices in the middle, and the layer of each."""
        pieces, layer = self.below.pieces()
        return pieces[layer % 3 == 1], layer[layer % 3 == 1] // 3

    def samples(self) -> Samples:
        """Return points along the boundaries of the slices in the middle."""
        s = self.below.samples()
        keep = s.layer % 3 == 1
        return Samples(s.points[keep], s.layer[keep] // 3, s.length[keep], s.normal[keep])


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


class Reference:
    """The mesh of a parameter file, ready to be cut at any heights.

    Parameters
    ----------
    params : Params
    device : str, optional
        As in `device.Device`.

    Attributes
    ----------
    low, high : (3,) float64
        Bounds of the transformed part, mm.
    heights : (K,) float64
        Cutting heights that the parameters ask for.
    grid : Grid
    device : Device
    """

    def __init__(self, params: Params, device: str | None = None) -> None:
        self.params, self.device = params, Device(device)
        mesh = transform(read_mesh(params.files[0]), params.scaling, params.rotation, params.translation)
        self.low, self.high = mesh.low, mesh.high
        self.heights = slice_heights(float(self.low[2]), float(self.high[2]), params.thickness, params.slice_position)
        margin = max(5.0, 0.1 * float((self.high - self.low)[:2].max()))
        self.grid = cover(self.low[:2], self.high[:2], params.pitch, margin)
        self._triangles = mesh.triangles
        to_pixels(self._triangles, mesh.origin, self.grid, float(self.low[2]))

    def _cuts(self, heights: Floats) -> Iterator[tuple[Sections, int, int]]:
        if not len(heights):
            return
        sectioner = Sectioner(self.device, self._triangles, heights - self.low[2])
        for first, last in sectioner.windows():
            yield sectioner.cut(first, last), first, last

    def outline(self, heights: Floats) -> tuple[Floats, Floats]:
        """Return area, mm^2, and box (x0, y0, x1, y1), mm, of the slices at ascending heights; nan where empty."""
        area, box = np.zeros(len(heights)), np.full((len(heights), 4), np.nan)
        for cut, first, last in self._cuts(heights):
            area[first:last] = np.abs(cut.exact_area) * self.grid.pitch**2
            ends = self.device.get(cut.segments, 4 * int(cut.offsets[-1]), np.float32).reshape(-1, 2)
            for k in range(first, last):
                a, b = (2 * int(o) for o in cut.offsets[k - first : k - first + 2])
                if b > a:
                    corners = np.stack([ends[a:b].min(axis=0), ends[a:b].max(axis=0)])
                    box[k] = self.grid.to_mm(corners).ravel()
        return area, box

    def wobbly(self, heights: Floats, slack: float) -> Iterator[tuple[int, Wobbly]]:
        """Yield first layers and slices at ascending heights, each also ``slack`` mm lower and higher."""
        most = max(1, min(BATCH, BATCH_TILES // self.grid.tiles) // 3)
        for first in range(0, len(heights), most):
            three = (heights[first : first + most, None] + slack * np.array([-1, 0, 1])).ravel()
            order = np.argsort(three, kind="stable")
            if np.any(order != np.arange(len(order))):  # heights that come twice
                raise ValueError("heights must ascend by more than the slack")
            for boundary in self.boundaries(three):
                yield first, Wobbly(boundary)

    def boundaries(self, heights: Floats) -> Iterator[Boundary]:
        """Yield the slices at ascending heights, some at a time, from the top down; each replaces the one before."""
        device, grid, batch = self.device, self.grid, max(1, min(BATCH, BATCH_TILES // self.grid.tiles))
        for cut, first, last in self._cuts(heights):
            for end in range(last, first, -batch):
                start = max(first, end - batch)
                # Layer i of what is sorted is slice end - 1 - i; turned round, so that layers ascend as elsewhere.
                span = (int(cut.offsets[start - first]), int(cut.offsets[end - first]))
                held = device.get(cut.slice_of, span[1] - span[0], np.int32, span[0])
                order = device.put("check slices", np.concatenate([np.zeros(span[0], np.int32), end - 1 - held]))
                pieces, wind = sort_pieces(device, grid, cut.segments, order, span, end - 1 - start, end - start)
                # order holds end - 1 - slice and layer = (end - 1 - start) - order = slice - start
                near, tangled = boundary_pieces(device, grid, pieces, wind, end - start, self.params.winding)
                opened = cut.gap[start - first : end - first] * grid.pitch > self.params.tolerance
                yield Boundary(start, end, tangled, opened, device, grid, near, pieces, wind, self.params.winding)


class _Second:
    """A device whose scratch memory bears other names, so that two boundaries can be held at once."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self.run = device.run

    def scratch(self, name: str, shape: int, dtype: DTypeLike) -> Any:
        return self._device.scratch(f"second {name}", shape, dtype)

    def zeros(self, name: str, shape: int, dtype: DTypeLike) -> Any:
        return self._device.zeros(f"second {name}", shape, dtype)

    def put(self, name: str, array: NDArray[Any]) -> Any:
        return self._device.put(f"second {name}", array)

    def offsets(self, counts: Any, n: int, name: str) -> tuple[Any, Any, NDArray[Any]]:
        return self._device.offsets(counts, n, f"second {name}")


def sort_loops(device: Device, grid: Grid, segments: Floats, layer: Ints, layers: int) -> Boundary:
    """Return other boundaries sorted in the same way, held beside ours; beyond the grid they are drawn to its border.

    Parameters
    ----------
    segments : (N, 4) float64
        x0, y0, x1, y1, mm; closed loops in either direction, if the sign of the distance is asked for.
    layer : (N,) int64
        Layer of each, 0 .. layers - 1.
    """
    pixels = grid.to_pixels(segments.reshape(-1, 2))
    pixels = pixels.clip(0.25, (grid.width - 1.25, grid.height - 1.25)).astype(np.float32)
    second = cast(Device, _Second(device))
    buffer = second.put("segments", pixels)
    order = second.put("layers", np.asarray(layers - 1 - layer, np.int32))
    pieces, wind = sort_pieces(second, grid, buffer, order, (0, len(segments)), layers - 1, layers)
    none = np.zeros(layers, bool)
    return Boundary(0, layers, none, none, device, grid, pieces, pieces, wind, "evenodd")
