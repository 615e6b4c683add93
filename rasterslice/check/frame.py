"""Bounds of what was read: boxes, samples, widths, and layers in another frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError
from .form import OUTER, WALL, Beads, Floats, TheirLayer
from .loops import Ints, segments_of
from .ours import spread

SAMPLED = 40  # layers that alignment looks at


def says_width(layers: Sequence[TheirLayer]) -> bool:
    """Whether a file tells how wide its walls are, or has no beads."""
    beads = [k.beads for k in layers if k.beads is not None]
    return not beads or any(np.isfinite(b.width[b.role <= WALL]).any() for b in beads)


def width_of(layers: Sequence[TheirLayer], default: float, roles: tuple[int, ...] = (OUTER, WALL)) -> float:
    """Return the width of most outer beads, mm."""
    for role in roles:
        beads = [k.beads for k in layers if k.beads is not None]
        width = np.concatenate([*(b.width[b.role == role] for b in beads), np.empty(0)])
        length = np.concatenate([*(lengths(b)[b.role == role] for b in beads), np.empty(0)])
        width, length = width[np.isfinite(width)], length[np.isfinite(width)]
        if len(width):
            order = np.argsort(width)
            reached = np.cumsum(length[order])
            return float(width[order[np.searchsorted(reached, reached[-1] / 2)]])
    return default


def wall_rates(layers: Sequence[TheirLayer]) -> Floats:
    """Return the filament for one mm of each wall of which that is known."""
    held = [k.beads for k in layers if k.beads is not None and k.beads.fed is not None]
    chosen = [(b.fed, walls(b)) for b in held]  # a layer may be fill alone
    rates = np.concatenate([np.empty(0), *(fed[own] for fed, own in chosen if fed is not None and own is not None)])
    return np.asarray(rates[np.isfinite(rates)])


def lengths(beads: Beads) -> Floats:
    """Return the length of each bead, mm."""
    step = np.diff(beads.points, axis=0)
    total = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))])
    whole = total[beads.offsets[1:] - 1] - total[beads.offsets[:-1]]
    return np.asarray(whole)


def pick(layers: list[TheirLayer], name: str = "") -> list[int]:
    """Return some layers that hold something, spread over the height."""
    held = [i for i, k in enumerate(layers) if len(k.loops) or walls(k.beads) is not None]
    if not held:
        raise ModelError(f"{name or 'the file'} holds no contour and no perimeter; name one that does")
    count = min(SAMPLED, len(held))
    return [held[(2 * i + 1) * len(held) // (2 * count)] for i in range(count)]


def walls(beads: Beads | None) -> NDArray[np.bool_] | None:
    """Return which beads bound the part: outer perimeters, else all perimeters."""
    for role in (OUTER, WALL) if beads is not None else ():
        chosen = np.asarray(beads.role == role) if beads is not None else np.zeros(0, bool)
        if chosen.any():
            return chosen
    return None


def returning(beads: Beads, width: float) -> NDArray[np.bool_]:
    """Return which beads come back to where they began, but for a seam of half a width."""
    gap = beads.points[beads.offsets[1:] - 1] - beads.points[beads.offsets[:-1]]
    wide = np.where(np.isfinite(beads.width), beads.width, width)
    return np.asarray((np.hypot(gap[:, 0], gap[:, 1]) < wide / 2) & (np.diff(beads.offsets) > 3))


def closed_walls(beads: Beads, width: float) -> list[Floats]:
    """Return the walls that bound the part and come back to where they began, but for a seam."""
    chosen = walls(beads)
    rings = [] if chosen is None else np.flatnonzero(chosen).tolist()
    lines = [beads.points[beads.offsets[i] : beads.offsets[i + 1]] for i in rings]
    return [p for p in lines if len(p) > 3 and float(np.hypot(*(p[0] - p[-1]))) < width]


def wall_points(layer: TheirLayer) -> Floats:
    """Return the points of contours, or of outer perimeters."""
    if layer.loops:
        return np.concatenate(layer.loops)
    chosen = walls(layer.beads)
    if layer.beads is None or chosen is None:
        return np.empty((0, 2))
    return layer.beads.points[np.repeat(chosen, np.diff(layer.beads.offsets))]


def wall_segments(beads: Beads | None) -> Floats:
    """Return the segments (N, 4) of outer perimeters."""
    chosen = walls(beads)
    if beads is None or chosen is None:
        return np.empty((0, 4))
    line = np.repeat(np.arange(len(beads.role)), np.diff(beads.offsets))
    joined = (line[1:] == line[:-1]) & chosen[line[1:]]
    return np.asarray(np.hstack([beads.points[:-1], beads.points[1:]])[joined])


def box(layer: TheirLayer, width: float) -> Floats:
    """Return x0, y0, x1, y1 of a layer, half a width around beads."""
    points, grow = wall_points(layer), 0.0 if layer.loops else width / 2
    return np.concatenate([points.min(axis=0) - grow, points.max(axis=0) + grow])


def sizes(boxes: Floats) -> Floats:
    """Return width and height of boxes."""
    return np.asarray(boxes[:, 2:] - boxes[:, :2])


def samples(layers: list[TheirLayer]) -> tuple[Floats, Ints]:
    """Return some hundred points of each layer."""
    found, which = [], []
    for i, k in enumerate(layers):
        segments = segments_of([k.loops])[0] if k.loops else wall_segments(k.beads)
        points = spread(segments, np.zeros(len(segments), np.int64), 1.0).points
        points = points[:: max(1, len(points) // 300)]
        found.append(points)
        which.append(np.full(len(points), i))
    return np.concatenate(found), np.concatenate(which)


def moved(layer: TheirLayer, turn: Floats, offset: Floats) -> TheirLayer:
    """Return a layer in another frame; a mirror reverses what it turns over, so that solids stay left."""
    flip = -1 if np.linalg.det(turn) < 0 else 1
    beads = layer.beads
    if beads is not None:
        beads = replace(beads, points=beads.points @ turn.T + offset)
    return replace(
        layer,
        middle=None if layer.middle is None else layer.middle @ turn.T + offset,
        loops=[(p @ turn.T + offset)[::flip] for p in layer.loops],
        scaffold=[(p @ turn.T + offset)[::flip] for p in layer.scaffold],
        supports=[(p @ turn.T + offset)[::flip] for p in layer.supports],
        beads=beads,
    )
