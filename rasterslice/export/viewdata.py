"""Layers as the viewer takes them: loops thinned for the screen, whole quanta, differences, variable-length integers.

::

    layer    the sets, in the order of `SETS`, then the places of lost features
    set      number of paths, then each path: number of points, then x and y of each as the difference
             from the point before (the first of a set: from 0), zigzag
    places   number, then x, y (from 0, zigzag), radius of each, in quanta
    integer  7 bits a byte, low bits first, the high bit set in all but the last byte
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..paths import DEPOSITION, REGIONS, Layer, Paths

SETS = REGIONS + DEPOSITION

Ints = NDArray[np.int64]


def thinned(paths: Paths, tolerance: float) -> Paths:
    """Return closed paths without the points that lie within `tolerance`, mm, of what remains (Douglas-Peucker)."""
    import cv2

    loops = [p for p in paths if len(p)]
    if not loops:
        return Paths.empty(True)
    base = loops[0][0]  # float32 near 0 is fine enough
    kept = [cv2.approxPolyDP((p - base).astype(np.float32), tolerance, True).reshape(-1, 2) for p in loops]
    ends = np.cumsum([0, *(len(p) for p in kept)])
    return Paths(np.concatenate(kept).astype(np.float64) + base, ends.astype(np.uint32), True)


def packed(layer: Layer, quantum: float, corner: tuple[float, float]) -> bytes:
    """Return one layer; `corner` is the origin of the quanta, mm."""
    parts = []
    for name in SETS:
        paths: Paths | None = getattr(layer, name)
        if paths is None:
            paths = Paths.empty(True)
        elif paths.closed:
            paths = thinned(paths, quantum * (3 if name in REGIONS else 2))
        parts.append(_set_values(paths, quantum, corner))
    parts.append(_places(layer, quantum, corner))
    return varints(np.concatenate(parts))


def _set_values(paths: Paths, quantum: float, corner: tuple[float, float]) -> Ints:
    ends = paths.offsets.astype(np.int64)
    count = ends[1:] - ends[:-1]
    count, first = count[count > 0], ends[:-1][count > 0]
    xy = np.rint((paths.points - corner) / quantum).astype(np.int64)
    step = zigzag(np.diff(xy, axis=0, prepend=np.zeros((1, 2), np.int64)))
    values = np.empty(1 + len(count) + 2 * len(xy), np.int64)
    values[0] = len(count)
    heads = 1 + 2 * first + np.arange(len(count))
    values[heads] = count
    rest = np.ones(len(values), np.bool_)
    rest[0] = rest[heads] = False
    values[rest] = step.ravel()
    return values


def _places(layer: Layer, quantum: float, corner: tuple[float, float]) -> Ints:
    values = [0]
    for u, v, radius in lost_places(layer):
        x, y = np.rint((np.array([u, v]) - corner) / quantum).astype(np.int64)
        values += [*zigzag(np.array([x, y])).tolist(), round(radius / quantum)]
        values[0] += 1
    return np.array(values, np.int64)


def lost_places(layer: Layer) -> list[tuple[float, float, float]]:
    """Return circles, x, y and radius, mm, about the loops of the part that no bead reaches; none without regions."""
    found: list[tuple[float, float, float]] = []
    if layer.part is not None and len(layer.part.points):
        beads = layer.part_boundary.points[layer.part_boundary.offsets[:-1][np.diff(layer.part_boundary.offsets) > 0]]
        for loop, area in zip(layer.part, layer.part.areas().tolist(), strict=True):
            if area > 0 and not _inside(loop, beads).any():
                low, high = loop.min(axis=0), loop.max(axis=0)
                x, y = ((low + high) / 2).tolist()
                found.append((x, y, float(np.hypot(*(high - low))) / 2))
    return found


def _inside(loop: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which points lie inside a loop (even-odd), within its box first."""
    found: NDArray[np.bool_] = ((points >= loop.min(axis=0)) & (points <= loop.max(axis=0))).all(axis=1)
    a, b = loop, np.roll(loop, -1, axis=0)
    for i in np.flatnonzero(found):
        x, y = points[i]
        crosses = (a[:, 1] > y) != (b[:, 1] > y)
        p, q = a[crosses], b[crosses]
        found[i] = (p[:, 0] + (y - p[:, 1]) / (q[:, 1] - p[:, 1]) * (q[:, 0] - p[:, 0]) > x).sum() % 2
    return found


def zigzag(values: Ints) -> Ints:
    """Return integers as integers >= 0, small ones small: 0, -1, 1, -2 become 0, 1, 2, 3."""
    return np.where(values < 0, -2 * values - 1, 2 * values)


def varints(values: Ints) -> bytes:
    """Return integers of 0 to 2^35 - 1 with 7 bits a byte."""
    size = np.ones(len(values), np.int64)
    for bits in (7, 14, 21, 28):
        size += values >= 1 << bits
    place = np.arange(int(size.sum())) - np.repeat(np.cumsum(size) - size, size)
    data = np.repeat(values, size) >> 7 * place & 127
    data[place + 1 < np.repeat(size, size)] |= 128
    return data.astype(np.uint8).tobytes()
