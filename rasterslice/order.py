"""The order of runs: nearest next with reversal, and lead-ins that keep off fresh walls.

Greedy and sequential, one run after the other; each step is a few operations on all ends that are left. A layer has
some hundreds of runs, for which that is faster than building and updating a search tree.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

_FAR = 1e18
_STARTS = 48  # starts of a closed run that are tried when the nearest runs through a wall


def nearest_next(entry: Points, leave: Points, at: Points) -> tuple[list[int], list[int], Points]:
    """Order open runs that may be laid in both directions.

    Parameters
    ----------
    entry, leave : (R, 2, 2) float64
        Where the dry lead-in of run r begins and its lead-out ends, laid forwards ([r, 0]) and backwards ([r, 1]).
    at : (2,) float64
        Where the tip is.

    Returns
    -------
    runs, backwards : list of int
        Numbers of the runs, and 0 or 1.
    at : (2,) float64
        Where the tip is at the end.
    """
    x, y = entry[..., 0].ravel().copy(), entry[..., 1].ravel().copy()
    leave_x, leave_y = leave[..., 0].ravel().tolist(), leave[..., 1].ravel().tolist()
    px, py = float(at[0]), float(at[1])
    dx, dy = np.empty_like(x), np.empty_like(y)
    runs, backwards = [], []
    for _ in range(len(entry)):
        np.subtract(x, px, out=dx)
        np.subtract(y, py, out=dy)
        dx *= dx
        dy *= dy
        dx += dy
        k = int(dx.argmin())
        x[k] = x[k ^ 1] = _FAR
        runs.append(k >> 1)
        backwards.append(k & 1)
        px, py = leave_x[k], leave_y[k]
    return runs, backwards, np.array([px, py])


def crosses(a: Points, b: Points, walls: Points, boxes: Points) -> NDArray[np.bool_]:
    """Return which of the segments a to b, (K, 2) each, cross any wall, (S, 2, 2), given `boxes_of` the walls."""
    (x0, y0), (x1, y1) = np.minimum(a, b).min(axis=0).tolist(), np.maximum(a, b).max(axis=0).tolist()
    near = np.flatnonzero((boxes[2] >= x0) & (boxes[0] <= x1) & (boxes[3] >= y0) & (boxes[1] <= y1))
    c, d = walls[near, 0], walls[near, 1]
    if not len(c):
        return np.zeros(len(a), bool)
    a, b = a[:, None], b[:, None]

    def side(p: Points, q: Points, r: Points) -> Points:
        return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])

    hit = (side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0)
    return np.asarray(hit.any(axis=1))


def boxes_of(walls: Points) -> Points:
    """Return x0, y0, x1, y1 of walls (S, 2, 2) as (4, S)."""
    return np.concatenate([np.minimum(walls[:, 0], walls[:, 1]).T, np.maximum(walls[:, 0], walls[:, 1]).T])


def walls_next(
    entry: Points, start: Points, leave: Points, owner: NDArray[np.int64], walls: list[Points], at: Points
) -> tuple[list[int], int, Points]:
    """Order runs that have several possible starts, and choose a start whose lead-in crosses no wall laid before.

    Parameters
    ----------
    entry, start, leave : (C, 2) float64
        Of each possible start: where the lead-in begins, where it meets the run, where the lead-out ends.
    owner : (C,) int64
        The run of each start, ascending.
    walls : list of (S, 2, 2) float64
        Segments of each run.
    at : (2,) float64
        Where the tip is.

    Returns
    -------
    chosen : list of int
        The start of each run, in the order of laying.
    through : int
        How many lead-ins cross a wall because every start would.
    at : (2,) float64
        Where the tip is at the end.
    """
    x, y = entry[:, 0].copy(), entry[:, 1].copy()
    first = np.searchsorted(owner, np.arange(len(walls) + 1))
    sizes = np.array([len(w) for w in walls], np.int64)
    fresh, boxes = np.empty((int(sizes.sum()), 2, 2)), np.empty((4, int(sizes.sum())))
    laid, through, chosen = 0, 0, []
    for _ in range(len(walls)):
        k = int(((x - at[0]) ** 2 + (y - at[1]) ** 2).argmin())
        mine = slice(first[owner[k]], first[owner[k] + 1])
        if laid and crosses(entry[k : k + 1], start[k : k + 1], fresh[:laid], boxes[:, :laid])[0]:
            near = mine.start + np.argsort((x[mine] - at[0]) ** 2 + (y[mine] - at[1]) ** 2, kind="stable")
            near = near[:: -(-len(near) // _STARTS)]
            free = near[~crosses(entry[near], start[near], fresh[:laid], boxes[:, :laid])]
            through += not len(free)
            k = int(free[0]) if len(free) else k
        chosen.append(k)
        wall = walls[owner[k]]
        fresh[laid : laid + len(wall)] = wall
        boxes[:, laid : laid + len(wall)] = boxes_of(wall)
        laid += len(wall)
        x[mine] = _FAR
        at = leave[k]
    return chosen, through, at
