"""The part as the beads build it, seen from the side and shaded: one depth per layer and column of pixels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..paths import Paths

LIGHT = (-0.42, -0.66, 0.62)  # towards the light: left, front, up

Depths = NDArray[np.float64]


def depths(outlines: Sequence[Paths], turn: float, columns: int, low: float, pitch: float, radius: float) -> Depths:
    """Return how near the beads come in each column, seen along +y after a turn about z.

    Parameters
    ----------
    outlines : sequence of Paths
        Middle lines of the outer beads of each layer, closed, mm.
    turn : float
        Angle by which the part is turned about z, radians.
    columns : int
    low, pitch : float
        Position of the first column, and from column to column, mm, after the turn.
    radius : float
        Half the width of a bead, mm.

    Returns
    -------
    (layers, columns) float64
        y of the nearest point, mm; infinite where there is none.
    """
    found = np.full((len(outlines), columns), np.inf)
    c, s = np.cos(turn), np.sin(turn)
    for row, paths in zip(found, outlines, strict=True):
        if len(paths.points):
            x = ((paths.points @ (c, -s)) - low) / pitch
            y = paths.points @ (s, c)
            following = np.arange(1, len(x) + 1)
            ends = paths.offsets.astype(np.int64)
            filled = ends[1:] > ends[:-1]
            following[ends[1:][filled] - 1] = ends[:-1][filled]
            _lower(row, x, y, x[following], y[following])
    return _grown(found, radius, pitch)


def _lower(row: Depths, x0: Depths, y0: Depths, x1: Depths, y1: Depths) -> None:
    """Take the nearest of all segments, at every column that each of them passes."""
    first = np.ceil(np.minimum(x0, x1)).astype(np.int64)
    count = np.maximum(np.floor(np.maximum(x0, x1)).astype(np.int64) - first + 1, 0)
    source = np.repeat(np.arange(len(x0)), count)
    column = np.repeat(first - np.cumsum(count) + count, count) + np.arange(len(source))
    run = x1 - x0
    t = (column - x0[source]) / np.where(run == 0, 1.0, run)[source]
    y = y0[source] + t * (y1 - y0)[source]
    inside = (column >= 0) & (column < len(row))
    np.minimum.at(row, column[inside], y[inside])


def _grown(found: Depths, radius: float, pitch: float) -> Depths:
    """Return the depths of round beads about the middle lines."""
    grown = found - radius
    for shift in range(1, int(radius / pitch) + 1):
        nearer = np.sqrt(radius**2 - (shift * pitch) ** 2)
        grown[:, shift:] = np.minimum(grown[:, shift:], found[:, :-shift] - nearer)
        grown[:, :-shift] = np.minimum(grown[:, :-shift], found[:, shift:] - nearer)
    return grown


def shade(found: Depths, pitch: tuple[float, float]) -> Depths:
    """Return how bright each pixel is, 0 to 1; `pitch` is from row to row (up) and from column to column, mm."""
    slope_z, slope_x = (_slope(found, axis) / pitch[axis] for axis in (0, 1))
    length = np.sqrt(slope_x**2 + slope_z**2 + 1)
    lit = (slope_x * LIGHT[0] - LIGHT[1] + slope_z * LIGHT[2]) / length
    rim = 1 - 1 / length
    bright = 0.30 + 0.72 * np.clip(lit, 0, 1) + 0.10 * rim - 0.22 * _hollow(found, pitch)
    return np.asarray(np.where(np.isfinite(found), np.clip(bright, 0.05, 1), 0))


def _slope(found: Depths, axis: int) -> Depths:
    """Return the smaller of the differences to both neighbours: an edge of the part is no slope."""
    with np.errstate(invalid="ignore"):
        step = np.diff(found, axis=axis)
    step[~np.isfinite(step)] = 0
    none = np.zeros_like(np.take(found, [0], axis=axis))
    before, after = np.concatenate([none, step], axis=axis), np.concatenate([step, none], axis=axis)
    same = before * after > 0
    smaller = np.where(np.abs(before) < np.abs(after), before, after)
    return np.asarray(np.where(same, smaller, (before + after) * 0.15))


def _hollow(found: Depths, pitch: tuple[float, float]) -> Depths:
    """Return how far each pixel lies behind the mean of its surroundings, 0 to 1."""
    import cv2

    there = np.isfinite(found)
    size = max((found.shape[0] * pitch[0]) / 40, 1e-6)
    sigma = {"sigmaX": size / pitch[1], "sigmaY": size / pitch[0]}
    filled = np.where(there, found, 0)
    weight = cv2.GaussianBlur(there.astype(np.float64), (0, 0), **sigma)
    mean = cv2.GaussianBlur(filled, (0, 0), **sigma) / np.maximum(weight, 1e-9)
    return np.asarray(np.clip((filled - mean) / (1.2 * size), 0, 1))
