"""Sharp corners of the part's contour, put back from the segments that made it.

Marching squares cuts a corner by up to 0.67 px, because between two pixels a distance image bends there. The source
segments know where the corner is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .tiles import Contours

SHARPEST = np.cos(np.radians(20.0))  # a corner turns by more than this
STRAIGHT = 1.5  # pixels of contour on both sides of a corner that must be straight, and that it replaces
BENT = 0.05  # how far from straight, pixels
PASSES = 0.75  # a contour that cuts the corner comes at least this near to it, pixels
NEAR = 1.0  # points that are replaced lie this near to the sides of the corner, pixels

Points = NDArray[np.float64]


def find_corners(segments: NDArray[np.float32]) -> tuple[Points, Points, Points]:
    """Return the sharp corners of the loops that oriented segments make.

    Parameters
    ----------
    segments : (N, 4) float32
        Segments of one slice, pixels; points are the same when their bits are.

    Returns
    -------
    corner, before, after : (C, 2) float64
        The corner and the unit vectors from it back and forth along its straight sides.
    """
    starts, ends = segments[:, :2] + np.float32(0), segments[:, 2:] + np.float32(0)
    follower = _match(ends, starts)
    leader = np.full(len(segments), -1)
    leader[follower[follower >= 0]] = np.flatnonzero(follower >= 0)
    step = (ends - starts).astype(np.float64)
    length = np.hypot(*step.T)
    seen = np.flatnonzero((leader >= 0) & (length > 0))
    seen = seen[length[leader[seen]] > 0]
    cosine = np.sum(step[seen] * step[leader[seen]], axis=1) / (length[seen] * length[leader[seen]])
    seen = seen[cosine < SHARPEST]
    corner = starts[seen].astype(np.float64)
    after, straight_after = _side(corner, seen, follower, ends)
    before, straight_before = _side(corner, leader[seen], leader, starts)
    good = straight_after & straight_before & (-np.sum(before * after, axis=1) < SHARPEST)
    return corner[good], before[good], after[good]


def _match(ends: NDArray[np.float32], starts: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return for each end the segment that starts there, or -1 when none or several do."""
    key = np.ascontiguousarray(starts).view(np.int64).ravel()
    wanted = np.ascontiguousarray(ends).view(np.int64).ravel()
    order = np.argsort(key, kind="stable")
    first = np.searchsorted(key[order], wanted, "left")
    count = np.searchsorted(key[order], wanted, "right") - first
    return np.where(count == 1, order[np.minimum(first, len(order) - 1)], -1)


def _side(
    corner: Points, segment: NDArray[np.int64], onward: NDArray[np.int64], points: NDArray[np.float32]
) -> tuple[Points, NDArray[np.bool_]]:
    """Return the direction of the side of each corner that starts with a segment, and whether it is straight."""
    walked: list[Points] = []
    direction = np.zeros_like(corner)
    far = np.zeros(len(corner))
    at = segment.copy()
    for _ in range(64):
        walking = (far < STRAIGHT) & (at >= 0)
        if not walking.any():
            break
        out = np.full_like(corner, np.nan)
        out[walking] = points[at[walking]] - corner[walking]
        walked.append(out)
        reach = np.hypot(*out.T)
        farther = walking & (reach > far)
        direction[farther] = out[farther] / reach[farther, None]
        far[farther] = reach[farther]
        at = np.where(walking, onward[at], at)
    offside = [np.abs(w[:, 0] * direction[:, 1] - w[:, 1] * direction[:, 0]) for w in walked]
    most = np.nanmax(np.stack(offside), axis=0) if len(corner) else np.zeros(0)
    return direction, (far >= STRAIGHT) & (most <= BENT)


def restore_corners(contours: Contours, layer: int, segments: NDArray[np.float32]) -> tuple[Points, NDArray[np.int64]]:
    """Return the loops of one image with the corners that the segments have.

    Parameters
    ----------
    contours : Contours
        Undecimated, at level 0 of the part.
    layer : int
        Image of the slice.
    segments : (N, 4) float32
        As in `find_corners`.

    Returns
    -------
    points : (N, 2) float64
    ends : (L,) int64
        End of each loop.
    """
    first = int(contours.first[layer])
    points = contours.points[first : int(contours.first[layer + 1])].astype(np.float64)
    ends = contours.ends[layer]
    if not len(points) or not len(segments):
        return points, ends
    corner, before, after = find_corners(segments)
    owner, squares = _nearest_corner(points, corner, before, after)
    loop = np.repeat(np.arange(len(ends)), np.diff(ends, prepend=0))
    return _replace(points, loop, len(ends), owner, squares, corner)


def _nearest_corner(points: Points, corner: Points, before: Points, after: Points) -> tuple[NDArray[np.int64], Points]:
    """Return for each point the corner that may replace it, or -1, and the squared distance to it."""
    owner, best = np.full(len(points), -1), np.full(len(points), STRAIGHT**2)
    order = np.argsort(points[:, 0], kind="stable")
    x = points[order, 0]
    low, high = np.searchsorted(x, corner[:, 0] - STRAIGHT), np.searchsorted(x, corner[:, 0] + STRAIGHT)
    for c in range(len(corner)):
        near = order[low[c] : high[c]]
        d = points[near] - corner[c]
        square = np.sum(d * d, axis=1)
        off = np.minimum(_off(d, before[c]), _off(d, after[c]))
        mine = (square < best[near]) & (off < NEAR)
        owner[near[mine]] = c
        best[near[mine]] = square[mine]
    return owner, best


def _off(d: Points, side: Points) -> NDArray[np.float64]:
    """Return the distance of offsets from the corner to one of its sides."""
    along = np.maximum(d @ side, 0.0)
    return np.asarray(np.hypot(d[:, 0] - along * side[0], d[:, 1] - along * side[1]))


def _replace(
    points: Points, loop: NDArray[np.int64], loops: int, owner: NDArray[np.int64], squares: Points, corner: Points
) -> tuple[Points, NDArray[np.int64]]:
    """Put each corner in the place of the run of points that it owns, where that is one run that comes near it."""
    keep = np.ones(len(points), bool)
    moved = points.copy()
    which = np.argsort(owner, kind="stable")
    which = which[owner[which] >= 0]
    for run in np.split(which, np.flatnonzero(np.diff(owner[which])) + 1):
        if not len(run) or squares[run].min() > PASSES**2 or len(np.unique(loop[run])) != 1:
            continue
        mine = np.flatnonzero(loop == loop[run[0]])
        gaps = np.flatnonzero(np.diff(run) > 1)
        wraps = len(gaps) == 1 and run[0] == mine[0] and run[-1] == mine[-1]
        if (len(gaps) and not wraps) or len(mine) - len(run) < 2:
            continue
        keep[run] = False
        stay = run[0]  # on a loop that wraps, the corner becomes its first point
        keep[stay], moved[stay] = True, corner[owner[stay]]
    counts = np.bincount(loop[keep], minlength=loops)
    return moved[keep], np.cumsum(counts)
