"""What the stages made of a batch, in pixels -> finished layers, in mm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .grid import Grid
from .paths import Layer, Paths, Stat
from .tiles import Contours

#: How far the two areas of a slice may differ: relative, px^2 for each loop, and px^2 for corners (docs/accuracy.md).
AREA_RELATIVE, AREA_LOOP, AREA_CORNERS = 2e-4, 0.75, 4.0
#: Share of a part that no path reaches from which on the layer is flagged.
MUCH_LOST = 0.1


@dataclass(frozen=True, slots=True)
class Batch:
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
    fills: list[NDArray[np.float64]] | None
    second_fills: list[NDArray[np.float64]] | None  # of the parts


def contour_paths(contours: Contours, grid: Grid) -> list[Paths]:
    """Return the loops of each image, mm."""
    points = grid.to_mm(contours.points)
    first = contours.first
    return [
        Paths(points[first[i] : first[i + 1]], np.concatenate([[0], ends]).astype(np.uint32), True)
        for i, ends in enumerate(contours.ends)
    ]


def _line_paths(lines: NDArray[np.float64]) -> Paths:
    return Paths(lines.reshape(-1, 2), np.arange(0, 2 * len(lines) + 1, 2, dtype=np.uint32), False)


def assemble(batch: Batch) -> list[Layer]:
    """Return the layers of a batch, top first."""
    layers = len(batch.open_rows)
    boundary = contour_paths(batch.boundary, batch.grid)
    fills = [_line_paths(f) for f in batch.fills] if batch.fills is not None else []
    second = [_line_paths(f) for f in batch.second_fills or ()]
    none = [Paths.empty(True)] * layers, [Paths.empty(False)] * layers
    part, scaffold = boundary[:layers], boundary[layers:] or none[0]
    part_fill, scaffold_fill = fills[:layers] or none[1], fills[layers:] or none[1]
    out = []
    for i in range(layers):
        regions: list[Paths | None] = [None, None]
        if batch.regions is not None:
            regions = [batch.regions[i], (batch.regions[layers:] or none[0])[i]]
        paths = part[i], scaffold[i], part_fill[i], scaffold_fill[i]
        stats = _stats(batch, i, *paths)
        k = batch.top - i
        out.append(Layer(k, float(batch.heights[k]), regions[0], regions[1], *paths, stats, (second or none[1])[i]))
    return out


def _stats(
    batch: Batch, i: int, part: Paths, scaffold: Paths, part_fill: Paths, scaffold_fill: Paths
) -> dict[str, Stat]:
    layers, pixel = len(batch.open_rows), batch.grid.pitch**2
    exact = float(batch.exact[i])
    return {
        "layer": batch.top - i,
        "z": float(batch.heights[batch.top - i]),
        "part_area": float(batch.areas[i]) * pixel,
        "part_area_exact": None if np.isnan(exact) else exact * pixel,
        "scaffold_area": float(batch.areas[layers + i]) * pixel if len(batch.areas) > layers else 0.0,
        "part_contours": len(part),
        "scaffold_contours": len(scaffold),
        "part_points": len(part.points),
        "scaffold_points": len(scaffold.points),
        "part_boundary_mm": part.length(),
        "scaffold_boundary_mm": scaffold.length(),
        "part_fill_mm": part_fill.length(),
        "scaffold_fill_mm": scaffold_fill.length(),
        "lost_area": _lost(batch, i) * pixel,
        "open_rows": int(batch.open_rows[i]),
        "flags": ";".join(_flags(batch, i, len(part))),
    }


def _lost(batch: Batch, i: int) -> float:
    """Return the area of the part that no path reaches, px^2: at most all of it."""
    return float(min(batch.lost[i], batch.areas[i]))


def _flags(batch: Batch, i: int, loops: int) -> list[str]:
    """Return the words that docs/flags.md explains."""
    layers, words = len(batch.open_rows), []
    images = [j for j in (i, layers + i) if j < len(batch.boundary.dropped)]
    if batch.is_open[i]:
        words.append("open")
    if batch.tangled[i]:
        words.append("overlap")
    limit = AREA_RELATIVE * abs(batch.exact[i]) + AREA_LOOP * max(loops, 1) + AREA_CORNERS
    if abs(batch.areas[i] - batch.exact[i]) > limit:
        words.append("area")
    if _lost(batch, i) > MUCH_LOST * batch.areas[i]:
        words.append("lost")
    if any(batch.boundary.dropped[j] for j in images):
        words.append("dropped")
    if any(batch.boundary.dense[j] for j in images):
        words.append("dense")
    return words
