"""The sides that a file is held against: a mesh, cut where it is asked for, or an earlier run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..bins import sort_pieces
from ..device import Device
from ..grid import cover, slice_heights
from ..overlap import boundary_pieces
from ..params import Params
from ..part import load_part
from ..section import Sectioner, Sections, to_pixels
from .form import Floats, TheirLayer
from .loops import depths, segments_of, solid_area
from .ours import Boundary, Slices, Wobbly, sort_loops
from .outlines import Outlines, string

BATCH, BATCH_TILES = 64, 1 << 18
WINDOW = 2_000_000  # segments that are held at once


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
    outlines : Outlines
        Of slices that were measured.
    """

    def __init__(self, params: Params, device: str | None = None) -> None:
        self.params, self.device = params, Device(device)
        self._sorted: tuple[Floats, Boundary] | None = None  # what was sorted last, if it was sorted in one batch
        mesh, self.notes = load_part(params)
        self.low, self.high = mesh.low, mesh.high
        self.heights = slice_heights(float(self.low[2]), float(self.high[2]), params.thickness, params.slice_position)
        margin = max(5.0, params.scaffold_buffer + 2.0, 0.1 * float((self.high - self.low)[:2].max()))
        self.grid = cover(self.low[:2], self.high[:2], params.pitch, margin)
        self.outlines = Outlines(self.grid)
        self._mesh = mesh
        to_pixels(mesh.vertices, mesh.origin, self.grid, float(self.low[2]))

    def _cuts(self, heights: Floats) -> Iterator[tuple[Sections, int, int]]:
        if not len(heights):
            return
        sectioner = Sectioner(self.device, self._mesh.vertices, self._mesh.faces, heights - self.low[2], WINDOW)
        for first, last in sectioner.windows():
            yield sectioner.cut(first, last), first, last

    def outline(self, heights: Floats) -> tuple[Floats, Floats]:
        """Return area, mm^2, and box (x0, y0, x1, y1), mm, of the slices at ascending heights; nan where empty."""
        area, box = np.zeros(len(heights)), np.full((len(heights), 4), np.nan)
        for cut, first, last in self._cuts(heights):
            area[first:last] = np.abs(cut.exact_areas(first, last)) * self.grid.pitch**2
            ends = cut.host.reshape(-1, 2)
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
        if self._sorted and np.array_equal(self._sorted[0], heights):
            yield self._sorted[1]
            return
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
                all_layers = device.put("check suspects", np.ones(end - start, np.int32))
                near, tangled = boundary_pieces(device, pieces, wind, all_layers, end - start, self.params.winding)
                opened = cut.gap[start - first : end - first] * grid.pitch > self.params.tolerance
                found = Boundary(start, end, tangled, opened, device, grid, near, pieces, wind, self.params.winding)
                self._sorted = (heights, found) if end - start == len(heights) else None
                yield found


class Run:
    """An earlier run as the side that another is held against; the same face as `Reference`.

    Parameters
    ----------
    layers : sequence of TheirLayer
        Its areas, by ascending height.
    params : Params
        Of the run; only lengths are used.
    device : str, optional
    """

    def __init__(self, layers: Sequence[TheirLayer], params: Params, device: str | None = None) -> None:
        self.params, self.device = params, Device(device)
        self._layers = list(layers)
        self.heights = np.array([k.z for k in layers])
        points = np.concatenate([np.empty((0, 2)), *(p for k in layers for p in (*k.loops, *k.scaffold))])
        half = params.thickness / 2
        low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(2), np.ones(2))
        self.low = np.array([*low, self.heights.min(initial=0.0) - half])
        self.high = np.array([*high, self.heights.max(initial=0.0) + half])
        self.grid = cover(low, high, params.pitch, 5.0)
        self.outlines = Outlines(self.grid)

    def at(self, heights: Floats) -> list[TheirLayer]:
        """Return the layer at each height, an empty one where there is none."""
        place = np.searchsorted(self.heights, heights - self.params.thickness / 4).clip(max=len(self.heights) - 1)
        close = np.abs(self.heights[place] - heights) < self.params.thickness / 4
        empty = TheirLayer(np.nan, "nothing")
        return [self._layers[i] if ok else empty for i, ok in zip(place, close, strict=True)]

    def outline(self, heights: Floats) -> tuple[Floats, Floats]:
        """Return area and box of the layers at some heights, as `Reference.outline`."""
        area, box = np.zeros(len(heights)), np.full((len(heights), 4), np.nan)
        for i, k in enumerate(self.at(heights)):
            if k.loops:
                points = np.concatenate(k.loops)
                area[i] = solid_area(k.loops, depths(k.loops))
                box[i] = [*points.min(axis=0), *points.max(axis=0)]
        return area, box

    def boundaries(self, heights: Floats) -> Iterator[Boundary]:
        """Yield the layers at ascending heights, some at a time."""
        batch = max(1, min(BATCH, BATCH_TILES // self.grid.tiles))
        for first in range(0, len(heights), batch):
            layers = self.at(heights[first : first + batch])
            segments, layer, _ = segments_of([k.loops for k in layers])
            held = sort_loops(self.device, self.grid, segments, layer, len(layers), "first")
            yield replace(held, first=first, last=first + len(layers))

    def wobbly(self, heights: Floats, slack: float) -> Iterator[tuple[int, Slices]]:
        """Yield the same: a run has no slices in between."""
        for boundary in self.boundaries(heights):
            yield boundary.first, boundary


Side = Reference | Run


def outlines(side: Side, heights: Floats) -> Outlines:
    """Return outlines that hold those of our slices at some ascending heights."""
    lacking = np.array([z for z in heights.tolist() if z not in side.outlines])
    for boundary in side.boundaries(lacking):
        side.outlines.keep(lacking[boundary.first : boundary.last], string(*boundary.pieces()))
    return side.outlines
