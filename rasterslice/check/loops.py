"""Contours as segments: nesting, winding, crossings, repeated points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .form import Floats

Ints = NDArray[np.int64]
_MOST_STEPS = 4000  # neighbours along x that are tried for a crossing; beyond, the layer is too tangled to say


def segments_of(layers: Sequence[Sequence[Floats]]) -> tuple[Floats, Ints, Ints]:
    """Return closed loops as segments.

    Parameters
    ----------
    layers : sequence of lists of (N, 2) float64
        The loops of each layer.

    Returns
    -------
    segments : (N, 4) float64
        x0, y0, x1, y1, in order along each loop.
    layer, loop : (N,) int64
        Layer of each, and loop, counted over all layers.
    """
    loops = [p for loops in layers for p in loops]
    if not loops:
        return np.empty((0, 4)), np.empty(0, np.int64), np.empty(0, np.int64)
    sizes = np.array([len(p) for p in loops])
    points, ends = np.concatenate(loops), np.cumsum(sizes)
    following = np.arange(1, len(points) + 1)
    following[ends - 1] = ends - sizes
    owner = np.repeat(np.arange(len(layers)), [len(k) for k in layers])
    loop = np.repeat(np.arange(len(loops)), sizes)
    return np.hstack([points, points[following]]), owner[loop], loop


def area(loop: Floats) -> float:
    """Return the signed area of a loop, counter-clockwise positive."""
    p = loop - loop[0]
    return 0.5 * float(np.dot(p[:-1, 0], p[1:, 1]) - np.dot(p[1:, 0], p[:-1, 1]))


def depths(loops: Sequence[Floats]) -> list[int]:
    """Return in how many other loops each loop of a layer lies."""
    if len(loops) < 2:
        return [0] * len(loops)
    segments, _, loop = segments_of([loops])
    x0, y0, x1, y1 = segments.T
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (x1 - x0) / (y1 - y0)
    found = []
    for i, points in enumerate(loops):
        x, y = points[0] + (0.0, 1.9e-7)  # off the vertices of others, which like to lie on the same height
        crossed = ((y0 <= y) != (y1 <= y)) & (loop != i)
        crossed[crossed] = x0[crossed] + (y - y0[crossed]) * slope[crossed] > x
        inside = np.bincount(loop[crossed], minlength=len(loops)) % 2
        found.append(int(inside.sum()))
    return found


def solid_area(loops: Sequence[Floats], depth: Sequence[int]) -> float:
    """Return the area that is inside an odd number of loops, when none cross."""
    return sum(abs(area(p)) * (-1 if d % 2 else 1) for p, d in zip(loops, depth, strict=True))


def crossings(segments: Floats, layer: Ints, loop: Ints) -> tuple[Ints, Floats]:
    """Return the layers and places where segments of one layer properly cross, or a loop runs back over itself.

    Parameters
    ----------
    segments : (N, 4) float64
    layer, loop : (N,) int64

    Returns
    -------
    layer : (M,) int64
    place : (M, 2) float64
    """
    low = np.minimum(segments[:, 0], segments[:, 2])
    high = np.maximum(segments[:, 0], segments[:, 2])
    span = float(high.max(initial=0.0) - low.min(initial=0.0)) + 1.0
    low, high = low + layer * span, high + layer * span  # layers side by side
    order = np.argsort(low, kind="stable")
    low, high, s = low[order], high[order], segments[order]
    bottom, top = np.minimum(s[:, 1], s[:, 3]), np.maximum(s[:, 1], s[:, 3])
    first = np.arange(len(s))
    where, places = [], []
    for step in range(1, _MOST_STEPS):
        first = first[first + step < len(s)]
        first = first[low[first + step] <= high[first]]
        if not len(first):
            break
        second = first + step
        near = (bottom[first] <= top[second]) & (bottom[second] <= top[first])
        a, b = first[near], second[near]
        hit = _cross(s[a], s[b])
        same = np.flatnonzero(~hit & (loop[order[a]] == loop[order[b]]))
        hit[same] = _overlap(s[a[same]], s[b[same]])
        where.append(layer[order[a[hit]]])
        places.append((s[a[hit], :2] + s[a[hit], 2:] + s[b[hit], :2] + s[b[hit], 2:]) / 4)
    if not where:
        return np.empty(0, np.int64), np.empty((0, 2))
    return np.concatenate(where), np.concatenate(places)


def _cross(a: Floats, b: Floats) -> NDArray[np.bool_]:
    """Whether each segment of a crosses its partner of b, touching not counted."""
    through = _side(a, b[:, :2]) * _side(a, b[:, 2:]) < 0
    return np.asarray(through & (_side(b, a[:, :2]) * _side(b, a[:, 2:]) < 0))


def _overlap(a: Floats, b: Floats) -> NDArray[np.bool_]:
    """Whether each segment of a lies on one line with its partner of b, and they share more than 0.001 mm of it."""
    u = a[:, 2:] - a[:, :2]
    u = u / np.maximum(np.hypot(*u.T), 1e-12)[:, None]
    p, q = (np.sort(np.stack([(s[:, c] * u).sum(axis=1) for c in (slice(0, 2), slice(2, 4))]), axis=0) for s in (a, b))
    shared = np.minimum(p[1], q[1]) - np.maximum(p[0], q[0]) > 1e-3
    return np.asarray(shared & (_side(a, b[:, :2], 2e-5) == 0) & (_side(a, b[:, 2:], 2e-5) == 0))


def _side(s: Floats, p: Floats, slack: float = 1e-6) -> Floats:
    """Return on which side of segments points lie: 1 left, -1 right, 0 within ``slack`` mm of their line."""
    dx, dy = s[:, 2] - s[:, 0], s[:, 3] - s[:, 1]
    d = (dx * (p[:, 1] - s[:, 1]) - dy * (p[:, 0] - s[:, 0])) / np.maximum(np.hypot(dx, dy), 1e-12)
    return np.where(np.abs(d) < slack, 0.0, np.sign(d))


def repeats(segments: Floats, layer: Ints, layers: int, spacing: float) -> tuple[Ints, Ints]:
    """Return, for each layer, how many points come twice in a row, and how many steps are shorter than a spacing."""
    length = np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1])
    twice = np.bincount(layer[length < 1e-9], minlength=layers)
    return twice, np.bincount(layer[(length < spacing - 1e-6) & (length >= 1e-9)], minlength=layers)
