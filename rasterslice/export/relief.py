"""The stack as a surface: outlines of some of the layers, with a normal at each point.

Normals come from a coarse volume of occupancy, smoothed: the gradient points out of the material, also where a slope
shows in the outlines as steps only.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..grid import TILE, Grid
from ..paths import Layer, Paths
from .coverage import coverage
from .format import Context
from .viewdata import thinned

LEVELS = 256  # layers that are taken, at most
CELLS = 256  # cells of the volume along its longest side, at most


class Relief(NamedTuple):
    """Outlines of one material.

    Attributes
    ----------
    outlines : list of Paths
        Closed, mm, one entry per level, bottom-up.
    normals : list of (N, 3) float64
        Unit vectors out of the material, one per point.
    """

    outlines: list[Paths]
    normals: list[NDArray[np.float64]]


def levels(n: int) -> list[int]:
    """Return the indices of up to `LEVELS` evenly spread layers of n."""
    count = min(n, LEVELS)
    return [(2 * i + 1) * n // (2 * count) for i in range(count)]


def relief(layers: Sequence[Layer], name: str, context: Context, outline: str = "") -> Relief:
    """Return outlines and normals of ``part`` or ``scaffold``.

    Parameters
    ----------
    layers : sequence of Layer
        All of them; those of `levels` are taken.
    outline : str
        The set whose paths are the outlines, where that is not the region.
    """
    picked = levels(len(layers))
    if not picked:
        return Relief([], [])
    grid, pitch = context.grid, context.grid.pitch
    size = max(grid.width * pitch, grid.height * pitch, len(layers) * context.thickness)
    cell = max(size / CELLS, pitch)
    coarse = Grid(grid.x0, grid.y0, cell, *(-(-int(n * pitch / cell + 2) // TILE) for n in (grid.width, grid.height)))
    tolerance = size / (1000 if name == "part" else 500)
    outlines = [thinned(getattr(layers[k], outline or name) or Paths.empty(True), tolerance) for k in picked]
    volume = np.zeros((len(picked) + 4, coarse.height, coarse.width), np.float32)
    for level, paths in enumerate(outlines):
        volume[level + 2] = coverage(paths, coarse)
    step = len(layers) * context.thickness / max(len(picked), 1)
    gradient = _gradient(_smooth(volume), (step, cell, cell))
    normals = [_at(gradient, coarse, level + 2, paths.points) for level, paths in enumerate(outlines)]
    return Relief(outlines, normals)


def _smooth(volume: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the volume blurred by (1 2 1) / 4 along each axis."""
    for axis in range(3):
        v = np.moveaxis(volume, axis, 0)
        blurred = v * np.float32(0.5)
        blurred[1:] += v[:-1] / 4
        blurred[:-1] += v[1:] / 4
        volume = np.moveaxis(blurred, 0, axis)
    return volume


def _gradient(volume: NDArray[np.float32], spacing: tuple[float, float, float]) -> list[NDArray[np.float32]]:
    """Return the slopes along z, y, x."""
    found = []
    for axis, h in enumerate(spacing):
        v = np.moveaxis(volume, axis, 0)
        slope = np.zeros_like(v)
        slope[1:-1] = (v[2:] - v[:-2]) / (2 * h)
        found.append(np.moveaxis(slope, 0, axis))
    return found


def _at(
    gradient: list[NDArray[np.float32]], grid: Grid, level: int, points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return unit normals at points, the slopes interpolated between cells."""
    p = np.clip(grid.to_pixels(points), 0, (grid.width - 1.001, grid.height - 1.001))
    i, f = p.astype(np.int64), p % 1
    normal = np.zeros((len(points), 3))
    for axis, slope in enumerate(gradient):
        image = slope[level]
        for dy in (0, 1):
            for dx in (0, 1):
                weight = np.abs(1 - dx - f[:, 0]) * np.abs(1 - dy - f[:, 1])
                normal[:, 2 - axis] -= weight * image[i[:, 1] + dy, i[:, 0] + dx]
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray(normal / np.maximum(length, 1e-12))
