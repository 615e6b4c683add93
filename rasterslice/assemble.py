"""What the stages made of a batch, in pixels -> finished layers, in mm."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .grid import Grid
from .paths import Layer, Paths, Stat, summed_lengths
from .tiles import Contours

#: How far the two areas of a slice may differ: relative, px^2 for each loop, and px^2 for corners (docs/accuracy.md).
AREA_RELATIVE, AREA_LOOP, AREA_CORNERS = 2e-4, 0.75, 4.0
#: Share of a part that no path reaches from which on the layer is flagged.
MUCH_LOST = 0.1


class Batch(NamedTuple):
    """Results of a batch of layers; entry i is slice ``top - i``, image i its part, image layers + i its scaffold.

    Areas are px^2; ``exact`` is NaN where the segments have no exact area. Without scaffold there are no
    scaffold images; without fill there are no hatches.
    """

    top: int
    heights: NDArray[np.float64]
    grid: Grid
    areas: NDArray[np.float64]
    exact: NDArray[np.float64]
    lost: NDArray[np.float64]
    open_rows: NDArray[np.int64]
    is_open: NDArray[np.bool_]
    tangled: NDArray[np.bool_]
    boundary: Contours
    regions: list[Paths] | None
    fills: list[Paths] | None
    second_fills: list[Paths] | None  # of the parts
    fill_mm: NDArray[np.float64] | None  # lengths of ``fills``


def contour_paths(contours: Contours, points: NDArray[np.float64]) -> list[Paths]:
    """Return the loops of each image; ``points`` are all of them, mm."""
    first = contours.first.tolist()
    start = np.zeros(1, np.int64)
    offsets = np.concatenate([part for ends in contours.ends for part in (start, ends)]).astype(np.uint32)
    paths, at = [], 0
    for i, ends in enumerate(contours.ends):
        paths.append(Paths(points[first[i] : first[i + 1]], offsets[at : at + len(ends) + 1], True))
        at += len(ends) + 1
    return paths


def contour_lengths(contours: Contours, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the length of all loops of each image, mm, as `contour_paths`."""
    counts = [len(ends) for ends in contours.ends]
    ends = np.concatenate(contours.ends) + np.repeat(contours.first[:-1], counts)
    loops = Paths(points, np.concatenate([[0], ends]).astype(np.uint32), True)
    return summed_lengths(loops.steps(), contours.first)


def assemble(batch: Batch) -> list[Layer]:
    """Return the layers of a batch, top first."""
    layers = len(batch.open_rows)
    none = [Paths.empty(True)] * layers, [Paths.empty(False)] * layers
    points = batch.grid.to_mm(batch.boundary.points)
    boundary = contour_paths(batch.boundary, points)
    fills, second = batch.fills or [], batch.second_fills or none[1]
    regions = [None] * 2 * layers if batch.regions is None else [*batch.regions, *none[0]]
    part, scaffold = boundary[:layers], boundary[layers:] or none[0]
    part_fill, scaffold_fill = fills[:layers] or none[1], fills[layers:] or none[1]
    stats = _stats(batch, part, scaffold, contour_lengths(batch.boundary, points))
    columns = (regions[:layers], regions[layers : 2 * layers], part, scaffold, part_fill, scaffold_fill, stats, second)
    rows = zip(*columns, strict=True)
    return [Layer(batch.top - i, float(batch.heights[batch.top - i]), *row) for i, row in enumerate(rows)]


def _stats(
    batch: Batch, part: list[Paths], scaffold: list[Paths], boundary_mm: NDArray[np.float64]
) -> list[dict[str, Stat]]:
    """Return the statistics of each layer."""
    layers, pixel = len(part), batch.grid.pitch**2
    numbers = batch.top - np.arange(layers)
    exact = (batch.exact * pixel).tolist()
    lost = np.minimum(batch.lost, batch.areas[:layers])  # what no path reaches is at most all of it
    fill_mm = np.zeros(2 * layers) if batch.fill_mm is None else batch.fill_mm
    columns = {
        "layer": numbers.tolist(),
        "z": batch.heights[numbers].tolist(),
        "part_area": (batch.areas[:layers] * pixel).tolist(),
        "part_area_exact": [None if math.isnan(value) else value for value in exact],
        "scaffold_area": (batch.areas[layers:] * pixel).tolist() or [0.0] * layers,
        "part_contours": [len(p) for p in part],
        "scaffold_contours": [len(p) for p in scaffold],
        "part_points": [len(p.points) for p in part],
        "scaffold_points": [len(p.points) for p in scaffold],
        "part_boundary_mm": boundary_mm[:layers].tolist(),
        "scaffold_boundary_mm": boundary_mm[layers:].tolist() or [0.0] * layers,
        "part_fill_mm": fill_mm[:layers].tolist(),
        "scaffold_fill_mm": fill_mm[layers:].tolist() or [0.0] * layers,
        "lost_area": (lost * pixel).tolist(),
        "open_rows": batch.open_rows.tolist(),
        "flags": _flags(batch, lost, np.array([len(p) for p in part])),
    }
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _flags(batch: Batch, lost: NDArray[np.float64], loops: NDArray[np.int64]) -> list[str]:
    """Return for each layer the words that docs/flags.md explains."""
    layers = len(loops)
    area = batch.areas[:layers]
    limit = AREA_RELATIVE * np.abs(batch.exact) + AREA_LOOP * np.maximum(loops, 1) + AREA_CORNERS
    found = {
        "open": batch.is_open,
        "overlap": batch.tangled,
        "area": np.abs(area - batch.exact) > limit,
        "lost": lost > MUCH_LOST * area,
        "dropped": batch.boundary.dropped.reshape(-1, layers).any(axis=0),
        "dense": batch.boundary.dense.reshape(-1, layers).any(axis=0),
    }
    return [";".join(itertools.compress(found, row)) for row in zip(*found.values(), strict=True)]
