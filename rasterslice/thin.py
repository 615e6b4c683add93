"""Fewer points on paths, so that a controller can follow: no two successive ones closer than a spacing.

Whole batches of paths are thinned together, in rounds: of the points at segments that are too short, those go whose
going bends the path least among their neighbours. Ends of open paths stay.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .paths import Paths


def thin(paths: Paths, spacing: float) -> tuple[Paths, NDArray[np.float64], NDArray[np.int64], int]:
    """Return paths whose segments are no shorter than a spacing, and how far they lie from the old points.

    Parameters
    ----------
    paths : Paths
    spacing : float
        mm; a little below it counts as equal.

    Returns
    -------
    thinned : Paths
        As many paths; closed ones that cannot hold three points, and open ones whose ends are nearer than the spacing
        and that cannot hold a point between, are empty.
    deviation : (D,) float64
        Distance of each point that went from the chord that replaces it, mm.
    gone : (D,) int64
        The path of each.
    lost : int
        How many paths became empty.
    """
    spacing *= 1 - 1e-9
    keep = np.ones(len(paths.points), bool)
    owner = np.repeat(np.arange(len(paths)), np.diff(paths.offsets))
    while True:
        index = np.flatnonzero(keep)
        going = _round(paths.points[index], owner[index], paths.closed, spacing)
        if not going.any():
            break
        keep[index[going]] = False
    count = np.bincount(owner[keep], minlength=len(paths))
    left = Paths(paths.points[keep], np.concatenate([[0], np.cumsum(count)]).astype(np.uint32), paths.closed)
    whole = count >= 3 if paths.closed else (count >= 3) | ((count == 2) & (left.lengths() >= spacing))
    lost = int(np.count_nonzero(~whole & (np.diff(paths.offsets) > 0)))
    deviation, gone = _deviation(paths, keep, owner, whole)
    keep &= whole[owner]
    offsets = np.concatenate([[0], np.cumsum(np.bincount(owner[keep], minlength=len(paths)))]).astype(np.uint32)
    return Paths(paths.points[keep], offsets, paths.closed), deviation, gone, lost


def neighbours(owner: NDArray[np.int64], closed: bool) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the index of the point before and after each; the ends of open paths are their own neighbours."""
    n = len(owner)
    at = np.arange(n)
    if not n:
        return at, at
    is_first = np.r_[True, owner[1:] != owner[:-1]]
    first, last = at[is_first], np.r_[at[is_first][1:], n] - 1
    before, after = at - 1, at + 1
    before[first], after[last] = (last, first) if closed else (first, last)
    return before, after


def chord_distance(
    p: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distance of points from the segments a to b, mm."""
    step = b - a
    square = np.maximum((step * step).sum(axis=1), 1e-30)
    along = np.clip(((p - a) * step).sum(axis=1) / square, 0.0, 1.0)
    off = p - a - along[:, None] * step
    return np.asarray(np.hypot(off[:, 0], off[:, 1]))


def _round(p: NDArray[np.float64], owner: NDArray[np.int64], closed: bool, spacing: float) -> NDArray[np.bool_]:
    """Return which points go in one round: never two neighbours."""
    before, after = neighbours(owner, closed)
    step = p[after] - p
    short = (np.hypot(step[:, 0], step[:, 1]) < spacing) & (after != np.arange(len(p)))
    free = (short | short[before]) & (before != after)
    if not closed:
        free &= (before != np.arange(len(p))) & (after != np.arange(len(p)))
    cost = np.full(len(p), np.inf)
    at = np.flatnonzero(free)
    cost[at] = chord_distance(p[at], p[before[at]], p[after[at]])
    lower = (cost < cost[before]) | ((cost == cost[before]) & (before > np.arange(len(p))))
    lower &= (cost < cost[after]) | ((cost == cost[after]) & (after > np.arange(len(p))))
    return np.asarray(free & lower)


def _deviation(
    paths: Paths, keep: NDArray[np.bool_], owner: NDArray[np.int64], whole: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return how far the points that went lie from the chords between those that stayed, and their paths."""
    gone = np.flatnonzero(~keep & whole[owner])
    kept = np.flatnonzero(keep & whole[owner])
    if not len(gone):
        return np.empty(0), np.empty(0, np.int64)
    after = np.searchsorted(kept, gone)
    ends = np.concatenate([[0], np.cumsum(np.bincount(owner[kept], minlength=len(paths)))])
    first, last = ends[owner[gone]], ends[owner[gone] + 1] - 1
    a = np.where(after > first, after - 1, last)
    b = np.where(after <= last, after, first)
    return chord_distance(paths.points[gone], paths.points[kept[a]], paths.points[kept[b]]), owner[gone]
