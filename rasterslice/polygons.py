"""Polygons -> triangles: fans, and ears where a polygon is concave.

A fan of a concave polygon covers places twice and outside of it. Its winding numbers are right, but its triangles
overlap, which slices would report of a mesh that has no overlap.
Based on: G. H. Meisters, Polygons have ears (1975).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

_PART = 1 << 16  # polygons that are looked at together
_STRAIGHT = 1e-7  # sine of a turn that float32 cannot tell from none
_MOST_CORNERS = 10_000  # of a polygon whose ears are sought
_MOST_TESTS = 100_000  # corners that are tried as ears, in all polygons of a file: some seconds


def fans(corners: Ints, sizes: Ints) -> Ints:
    """Cut polygons, given one after the other, into (T, 3) fans; those of fewer than three corners are left out."""
    found: Ints = corners[fan_places(np.cumsum(sizes) - sizes, sizes)]
    return found


def fan_places(starts: Ints, sizes: Ints, stride: int = 1) -> Ints:
    """Return where the corners of the fans of polygons stand, (T, 3).

    Parameters
    ----------
    starts, sizes : (P,) int64
        Where the first corner of each polygon stands, and how many it has; of fewer than three there is no fan.
    stride : int
        From one corner to the next.
    """
    count = np.maximum(sizes - 2, 0)
    base = np.repeat(starts, count)
    step = np.arange(len(base)) - np.repeat(np.cumsum(count) - count, count)
    return np.stack([base, base + (step + 1) * stride, base + (step + 2) * stride], axis=1)


def even_fans(faces: NDArray[np.integer[Any]]) -> NDArray[np.integer[Any]]:
    """Cut polygons of one size, (P, n), into (P (n - 2), 3) fans."""
    count, n = faces.shape
    return faces if n == 3 else faces.reshape(-1)[fan_places(n * np.arange(count), np.full(count, n))]


def mend_fans(vertices: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]], sizes: Ints) -> int:
    """Put triangles that do not overlap in the place of the fans of concave polygons.

    Parameters
    ----------
    vertices : (N, 3) float
    faces : (T, 3) int
        Fans of polygons, one after the other; changed in place. Not yet checked: when a corner is no vertex,
        nothing is done.
    sizes : (P,) int64
        Corners of each polygon; those of fewer than three have no triangles.

    Returns
    -------
    int
        How many concave polygons stay fans, because they cross themselves or are too many.
    """
    large = np.flatnonzero(sizes > 3)
    if not len(large) or faces.min() < 0 or faces.max() >= len(vertices):
        return 0
    count = np.maximum(sizes - 2, 0)
    first = np.cumsum(count) - count
    budget, left = [_MOST_TESTS], 0
    for i in range(0, len(large), _PART):
        which = large[i : i + _PART]
        left += _mend_part(vertices, faces, first[which], sizes[which], budget)
    return left


def _mend_part(vertices: Any, faces: Any, first: Ints, sizes: Ints, budget: list[int]) -> int:
    """Mend some polygons of more than three corners; return how many stay fans."""
    start = np.cumsum(sizes) - sizes
    owner = np.repeat(np.arange(len(sizes)), sizes)
    step = np.arange(len(owner)) - start[owner]
    row, column = first[owner] + np.maximum(step - 2, 0), np.minimum(step, 2)
    corners = faces[row, column].astype(np.int64)
    following, before = np.arange(1, len(owner) + 1), np.arange(-1, len(owner) - 1)
    following[start + sizes - 1], before[start] = start, start + sizes - 1
    with np.errstate(all="ignore"):  # vertices may be anything; what is not finite is dropped later
        points = vertices[corners].astype(np.float64)
        points -= points[start][owner]
        normal = np.add.reduceat(np.cross(points, points[following]), start)
        normal /= np.sqrt((normal**2).sum(axis=1))[:, None]
        edge = points[following] - points
        length = np.sqrt((edge**2).sum(axis=1))
        turn = (np.cross(edge[before], edge) * normal[owner]).sum(axis=1)
        reflex = turn < -_STRAIGHT * length[before] * length
    concave = np.flatnonzero(np.logical_or.reduceat(reflex, start))
    quads = concave[sizes[concave] == 4]
    at = start[quads][:, None] + np.arange(4)
    at = start[quads][:, None] + (np.argmax(reflex[at], axis=1)[:, None] + np.arange(4)) % 4  # that corner first
    faces[first[quads]], faces[first[quads] + 1] = corners[at[:, :3]], corners[at[:, [0, 2, 3]]]
    left = 0
    for p in concave[sizes[concave] > 4].tolist():
        begin, n = int(start[p]), int(sizes[p])
        found = ears(_flat(points[begin : begin + n], normal[p]), budget) if n <= _MOST_CORNERS else None
        if found is None:
            left += 1
        else:
            faces[first[p] : first[p] + n - 2] = corners[begin + np.array(found)]
    return left


def _flat(points: Floats, normal: Floats) -> Floats:
    """Return points as seen against the normal, along the axis that it is nearest to; counter-clockwise stays so."""
    axis = int(np.abs(normal).argmax())
    u, v = (axis + 1) % 3, (axis + 2) % 3
    return points[:, [u, v] if normal[axis] > 0 else [v, u]]


def ears(xy: Floats, budget: list[int]) -> list[tuple[int, int, int]] | None:
    """Cut a counter-clockwise polygon into triangles that do not overlap.

    Parameters
    ----------
    xy : (n, 2) float64
    budget : list of one int
        How many more corners may be tried; counted down.

    Returns
    -------
    list of (i, j, k), or None
        n - 2 triangles; None when the polygon has no ears, because it crosses itself, or the budget is spent.
    """
    order, found = list(range(len(xy))), list[tuple[int, int, int]]()
    x, y = xy.T.tolist()

    def turn(a: int, b: int, c: int) -> float:
        return float((x[b] - x[a]) * (y[c] - y[b]) - (y[b] - y[a]) * (x[c] - x[b]))

    inward = np.array([turn(i - 1, i, (i + 1) % len(x)) <= 0 for i in range(len(x))])  # only these can lie in an ear
    i = tried = 0
    while len(order) > 3:
        n = len(order)
        i %= n
        a, b, c = order[i - 1], order[i], order[(i + 1) % n]
        budget[0] -= 1
        if budget[0] < 0 or tried > 2 * n:
            return None
        size = turn(a, b, c)  # corners that lie in a straight line come last
        if (size > 0 or (size == 0 and tried > n)) and not _holds(xy[[a, b, c]], xy[inward]):
            found.append((a, b, c))
            del order[i]
            n, tried, inward[b] = n - 1, 0, False
            for j in (i - 1, i):
                p, q, r = order[(j - 1) % n], order[j % n], order[(j + 1) % n]
                inward[q] = turn(p, q, r) <= 0
            i += 1  # not always the same corner: triangles stay fatter
        else:
            i, tried = i + 1, tried + 1
    return [*found, (order[0], order[1], order[2])]


def _holds(triangle: Floats, points: Floats) -> bool:
    """Whether a counter-clockwise triangle holds a point, or has it on its edge, that is none of its corners."""
    inside = np.ones(len(points), bool)
    for a, b in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        inside &= (b[0] - a[0]) * (points[:, 1] - a[1]) - (b[1] - a[1]) * (points[:, 0] - a[0]) >= 0
        inside &= (points != a).any(axis=1)
    return bool(inside.any())


def polygon_notes(left: int) -> list[str]:
    """Return what to say of concave polygons that stay fans."""
    if not left:
        return []
    what = f"{left} polygon{'s cross themselves or are' if left > 1 else ' crosses itself or is'} too large to cut well"
    return [f"{what}; layers there may be flagged overlap"]
