"""Sharp corners of the part's contour, put back from the segments that made it.

Marching squares cuts a corner by up to 0.67 px, because between two pixels a distance image bends there. The source
segments know where the corner is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .tiles import Contours

SHARPEST = np.cos(np.radians(20.0))  # a corner turns by more than this
CUT = 1.1  # marching squares needs a wedge of this half width, pixels: nearer to its tip the contour is replaced
FARTHEST = 8.0  # pixels from the tip, at most
SHORTEST = 0.5  # a side that ends in the next corner is at least this long, pixels
BENT = 0.05  # how far from straight a side may be, pixels
PASSES = 0.7  # a contour that cuts the corner comes nearer to it than this part of what is replaced
PAIRS = 1 << 20  # chords that are held against each other at a time
NEAR = 1.0  # points that are replaced lie this near to the sides of the corner, pixels

Points = NDArray[np.float64]


def find_corners(segments: NDArray[np.float32]) -> tuple[Points, Points, Points, NDArray[np.float64]]:
    """Return the sharp corners of the loops that oriented segments make.

    Parameters
    ----------
    segments : (N, 4) float32
        Segments of one slice, pixels; points are the same when their bits are.

    Returns
    -------
    corner, before, after : (C, 2) float64
        The corner and the unit vectors from it back and forth along its straight sides.
    radius : (C,) float64
        How far from the corner marching squares goes wrong, pixels: farther, the sharper it is.
    """
    segments = segments[(segments[:, :2] != segments[:, 2:]).any(axis=1)]  # a vertex on the plane gives points
    starts, ends = segments[:, :2] + np.float32(0), segments[:, 2:] + np.float32(0)
    follower = _match(ends, starts)
    leader = np.full(len(segments), -1)
    leader[follower[follower >= 0]] = np.flatnonzero(follower >= 0)
    step = (ends - starts).astype(np.float64)
    length = np.hypot(*step.T)
    bend = np.flatnonzero(leader >= 0)
    cosine = np.sum(step[bend] * step[leader[bend]], axis=1) / (length[bend] * length[leader[bend]])
    bend = bend[cosine < SHARPEST]
    turns = np.zeros(len(segments), bool)
    turns[bend] = True  # the segment starts at a corner
    corner = starts[bend].astype(np.float64)
    wedge = np.arccos(np.clip(-cosine[cosine < SHARPEST], -1.0, 1.0))  # angle between the sides
    radius = np.minimum(CUT / np.maximum(np.sin(wedge / 2), 1e-9), FARTHEST)
    ends_at = np.where(follower >= 0, turns[follower], True)
    after, straight_after = _side(corner, radius, bend, follower, ends, ends_at)
    before, straight_before = _side(corner, radius, leader[bend], leader, starts, turns | (leader < 0))
    good = straight_after & straight_before & (-np.sum(before * after, axis=1) < SHARPEST)
    return corner[good], before[good], after[good], radius[good]


def _match(ends: NDArray[np.float32], starts: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return for each end the segment that starts there, or -1 when none or several do."""
    key = np.ascontiguousarray(starts).view(np.int64).ravel()
    wanted = np.ascontiguousarray(ends).view(np.int64).ravel()
    order = np.argsort(key, kind="stable")
    first = np.searchsorted(key[order], wanted, "left")
    count = np.searchsorted(key[order], wanted, "right") - first
    return np.where(count == 1, order[np.minimum(first, len(order) - 1)], -1)


def _side(
    corner: Points, radius: NDArray[np.float64], segment: NDArray[np.int64], onward: NDArray[np.int64],
    points: NDArray[np.float32], stops: NDArray[np.bool_],
) -> tuple[Points, NDArray[np.bool_]]:  # fmt: skip
    """Return the direction of the side of each corner that starts with a segment, and whether it is straight.

    It is walked until it is a radius long, or ends (``stops``) in another corner.
    """
    walked: list[Points] = []
    direction = np.zeros_like(corner)
    far = np.zeros(len(corner))
    at = segment.copy()
    ended = np.zeros(len(corner), bool)
    for _ in range(256):
        walking = (far < radius) & ~ended
        if not walking.any():
            break
        out = np.full_like(corner, np.nan)
        out[walking] = points[at[walking]] - corner[walking]
        walked.append(out)
        reach = np.hypot(*out.T)
        farther = walking & (reach > far)
        direction[farther] = out[farther] / reach[farther, None]
        far[farther] = reach[farther]
        ended |= walking & stops[at]
        at = np.where(walking & ~ended, onward[at], at)
    offside = [np.abs(w[:, 0] * direction[:, 1] - w[:, 1] * direction[:, 0]) for w in walked]
    most = np.nanmax(np.stack(offside), axis=0) if len(corner) else np.zeros(0)
    return direction, ((far >= radius) | (ended & (far >= SHORTEST))) & (most <= BENT)


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

    Notes
    -----
    A corner is not put back where its sides would cross the contour: in a tongue thinner than a pixel, the corners of
    both sides lie beyond each other.
    """
    first = int(contours.first[layer])
    points = contours.points[first : int(contours.first[layer + 1])].astype(np.float64)
    ends = contours.ends[layer]
    if not len(points) or not len(segments):
        return points, ends
    corner, before, after, radius = find_corners(segments)
    owner, squares = _nearest_corner(points, corner, before, after, radius)
    loop = np.repeat(np.arange(len(ends)), np.diff(ends, prepend=0))
    while True:
        made, made_ends, tips = _replace(points, loop, len(ends), owner, squares, corner, radius)
        crossing = _crossing(made, made_ends, tips)
        if not len(crossing):
            return made, made_ends
        owner[np.isin(owner, crossing)] = -1


def _crossing(points: Points, ends: NDArray[np.int64], tips: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the corners of which a side crosses another chord; ``tips`` is the corner of each point, or -1."""
    following = np.arange(1, len(points) + 1)
    following[ends - 1] = np.concatenate([[0], ends[:-1]])
    leading = np.empty(len(points), np.int64)
    leading[following] = np.arange(len(points))
    a, b = points, points[following]
    low, high = np.minimum(a, b), np.maximum(a, b)
    order = np.argsort(low[:, 0], kind="stable")
    x, widest = low[order, 0], float((high - low)[:, 0].max(initial=0.0))
    at = np.flatnonzero(tips >= 0)
    side = np.concatenate([leading[at], at])
    begin, end = np.searchsorted(x, (low[side, 0] - widest, high[side, 0]))
    found = []
    for some in np.array_split(np.arange(len(side)), 1 + int((end - begin).sum()) // PAIRS):
        count = (end - begin)[some]
        mine = np.repeat(side[some], count)
        first = np.repeat(begin[some] - np.cumsum(count) + count, count)
        near = order[first + np.arange(len(mine))]
        meet = (low[near] <= high[mine]) & (high[near] >= low[mine])
        apart = meet[:, 0] & meet[:, 1] & (near != mine) & (near != following[mine]) & (near != leading[mine])
        mine, near = mine[apart], near[apart]
        p, q, r, s = a[mine], b[mine], a[near], b[near]
        cut = (_turn(p, q, r) * _turn(p, q, s) < 0) & (_turn(r, s, p) * _turn(r, s, q) < 0)
        found += [tips[mine[cut]], tips[following[mine[cut]]]]
    corners = np.unique(np.concatenate(found))
    return corners[corners >= 0]


def _turn(a: Points, b: Points, c: Points) -> Points:
    """Return twice the area of triangles: positive where c lies left of a - b."""
    d, e = b - a, c - a
    return np.asarray(d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0])


def _nearest_corner(
    points: Points, corner: Points, before: Points, after: Points, radius: NDArray[np.float64]
) -> tuple[NDArray[np.int64], Points]:
    """Return for each point the corner that may replace it, or -1, and the squared distance to it."""
    owner, best = np.full(len(points), -1), np.full(len(points), FARTHEST**2)
    order = np.argsort(points[:, 0], kind="stable")
    x = points[order, 0]
    low, high = np.searchsorted(x, corner[:, 0] - radius), np.searchsorted(x, corner[:, 0] + radius)
    for c in range(len(corner)):
        near = order[low[c] : high[c]]
        d = points[near] - corner[c]
        square = np.sum(d * d, axis=1)
        off = np.minimum(_off(d, before[c]), _off(d, after[c]))
        mine = (square < np.minimum(best[near], radius[c] ** 2)) & (off < NEAR)
        owner[near[mine]] = c
        best[near[mine]] = square[mine]
    return owner, best


def _off(d: Points, side: Points) -> NDArray[np.float64]:
    """Return the distance of offsets from the corner to one of its sides."""
    along = np.maximum(d @ side, 0.0)
    return np.asarray(np.hypot(d[:, 0] - along * side[0], d[:, 1] - along * side[1]))


def _replace(
    points: Points, loop: NDArray[np.int64], loops: int,
    owner: NDArray[np.int64], squares: Points, corner: Points,
    radius: NDArray[np.float64],
) -> tuple[Points, NDArray[np.int64], NDArray[np.int64]]:  # fmt: skip
    """Put each corner in the place of the run of points that it owns, where that is one run that comes near it.

    Returns points, ends of loops, and the corner that each point is, or -1.
    """
    keep = np.ones(len(points), bool)
    moved, tip = points.copy(), np.full(len(points), -1)
    which = np.argsort(owner, kind="stable")
    which = which[owner[which] >= 0]
    size = np.bincount(loop, minlength=loops)
    left = size.copy()  # several corners may take points of one loop
    for run in np.split(which, np.flatnonzero(np.diff(owner[which])) + 1):
        if not len(run) or squares[run].min() > (PASSES * radius[owner[run[0]]]) ** 2:
            continue
        mine = np.bincount(loop[run], minlength=loops)
        tips = (mine == size) & (mine > 0)  # a sharp tip may have come off as an island
        body = run[~tips[loop[run]]]
        if not len(body) or len(np.unique(loop[body])) != 1 or left[loop[body[0]]] - len(body) < 2:
            continue
        ring = np.flatnonzero(loop == loop[body[0]])
        gaps = np.flatnonzero(np.diff(body) > 1)
        if len(gaps) and not (len(gaps) == 1 and body[0] == ring[0] and body[-1] == ring[-1]):
            continue
        keep[run] = False
        left[loop[body[0]]] -= len(body) - 1
        stay = body[0]  # on a loop that wraps, the corner becomes its first point
        keep[stay], moved[stay], tip[stay] = True, corner[owner[stay]], owner[stay]
    counts = np.bincount(loop[keep], minlength=loops)
    return moved[keep], np.cumsum(counts[counts > 0]), tip[keep]
