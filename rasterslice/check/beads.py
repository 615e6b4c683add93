"""Measure beads: none may leave the part, and every wall must have its own."""

from __future__ import annotations

import numpy as np

from .findings import Limits, Measures, pieces, spans_of
from .form import FILL, OUTER, WALL, Beads, Floats, TheirLayer
from .loops import Ints
from .ours import Samples, Slices, sort_loops, spread, thinned
from .reference import Side

WALL_STEP, FILL_STEP = 2.0, 5.0  # pixels between samples


def measure_beads(
    ref: Side, ours: Slices, samples: Samples, layers: list[TheirLayer], out: list[Measures], limits: Limits
) -> None:
    """Measure the layers that are beads: none may leave the part, and every wall must have its own."""
    walls = _bead_samples(layers, (OUTER, WALL), limits, WALL_STEP)
    fills = _bead_samples(layers, (FILL,), limits, FILL_STEP)
    named = any(k.beads is not None and (k.beads.role == OUTER).any() for k in layers)
    for (found, role, width), what in ((walls, "bead leaves the part"), (fills, "fill leaves the part")):
        deep = ours.lowest(found.points, found.layer, 1)
        # Walls that are no outer ones may fill gaps, as wide as the gap; where fill ends, programs differ.
        beyond = deep + np.where(role == OUTER, width / 2, width / 4 if named else 0.0)
        bad = np.flatnonzero(beyond > limits.tolerance - limits.uncertainty)
        if len(bad):  # a bead in the middle of something thinner than itself is the best that can be done
            side = found.normal[bad] * (width[bad] / 4)[:, None]
            left, right = (ours.lowest(found.points[bad] + s, found.layer[bad]) for s in (side, -side))
            thin = (left > deep[bad]) & (right > deep[bad]) & (deep[bad] < 0)
            bad = bad[~thin]
            radius = (beyond - deep)[bad]
            beyond[bad] = _farthest(ours, found.points[bad], found.layer[bad], radius)
        pieces(found.points[bad], found.layer[bad], found.length[bad], beyond[bad], what, out, limits)
        if found is walls[0]:
            _bead_numbers(found, role, beyond, out)
    _bare(ref, ours, thinned(samples, WALL_STEP * limits.pitch), layers, out, limits)


def _farthest(ours: Slices, points: Floats, layer: Ints, radius: Floats) -> Floats:
    """Return how far circles reach out of our solid, mm: over a narrow gap they do not."""
    found = np.full(len(points), -np.inf)
    for turn in np.arange(24) * (2 * np.pi / 24):
        rim = points + radius[:, None] * (np.cos(turn), np.sin(turn))
        found = np.maximum(found, ours.lowest(rim, layer))
    return found


def _bead_samples(
    layers: list[TheirLayer], roles: tuple[int, ...], limits: Limits, step: float
) -> tuple[Samples, Ints, Floats]:
    """Return samples of beads of some roles, with role and width of each."""
    parts, owner, role, width = [], [], [], []
    for i, k in enumerate(layers):
        if k.beads is None:
            continue
        segments, which = _bead_segments(k.beads, roles)
        parts.append(segments)
        owner.append(np.full(len(segments), i))
        role.append(k.beads.role[which])
        width.append(k.beads.width[which])
    if not parts:
        none = np.empty((0, 2))
        return Samples(none, np.empty(0, np.int64), np.empty(0), none), np.empty(0, np.int64), np.empty(0)
    segments, index = np.concatenate(parts), np.arange(sum(map(len, parts)))
    found = spread(segments, index, step * limits.pitch)
    source = found.layer
    wide = np.concatenate(width)[source]
    wide = np.where(np.isfinite(wide), wide, limits.width)
    return (
        Samples(found.points, np.concatenate(owner)[source], found.length, found.normal),
        np.concatenate(role)[source],
        wide,
    )


def _bead_segments(beads: Beads, roles: tuple[int, ...]) -> tuple[Floats, Ints]:
    """Return the segments of beads of some roles, and the bead of each."""
    bead = np.repeat(np.arange(len(beads.role)), np.diff(beads.offsets))
    joined = (bead[1:] == bead[:-1]) & np.isin(beads.role, roles)[bead[1:]]
    return np.hstack([beads.points[:-1], beads.points[1:]])[joined], bead[1:][joined]


def _bead_numbers(found: Samples, role: Ints, beyond: Floats, out: list[Measures]) -> None:
    """Put the signed deviation of outer beads from where they should be into measures."""
    outer = role == OUTER if (role == OUTER).any() else np.zeros(len(role), bool)
    order, spans = spans_of(found.layer[outer], len(out))
    values, length = beyond[outer][order], found.length[outer][order]
    for i, m in enumerate(out):
        mine = values[spans[i] : spans[i + 1]]
        if len(mine):
            m.to_ours, m.to_ours_95 = float(np.abs(mine).max()), float(np.percentile(np.abs(mine), 95))
            m.mean = float(np.average(mine, weights=length[spans[i] : spans[i + 1]]))


def _bare(
    ref: Side, ours: Slices, samples: Samples, layers: list[TheirLayer], out: list[Measures], limits: Limits
) -> None:
    """Look for walls without a bead: half a width inside every boundary there must be one, where the part is thick."""
    half = limits.width / 2
    plan = np.array([k.beads is not None for k in layers])[samples.layer]
    due = samples.points - half * samples.normal

    def depth(widths: float, which: Ints) -> Floats:
        inside = samples.points[which] - widths * limits.width * samples.normal[which]
        return ours.distance(inside, samples.layer[which])

    ask = np.flatnonzero(plan)
    ask = ask[np.abs(depth(0.5, ask) + half) < 0.02 * limits.width]  # not beside corners
    ask = ask[depth(1.0, ask) < -0.99 * limits.width]
    # Between two and three beads of thickness programs share the room out as they like.
    shared = np.where(depth(1.5, ask) < -0.99 * 3 * half, 0.0, limits.width / 4)
    reach = limits.tolerance + limits.uncertainty
    moved = ours.wobble(samples.points[ask], samples.layer[ask])
    beside = ours.distance(samples.points[ask] + reach * samples.normal[ask], samples.layer[ask])
    wide = beside > 0.95 * reach - moved  # a narrow gap may be closed
    ask, shared = ask[wide], shared[wide] + moved[wide]
    parts, owner = [], []
    for i, k in enumerate(layers):
        if k.beads is not None:
            segments, _ = _bead_segments(k.beads, (OUTER, WALL))
            parts.append(segments)
            owner.append(np.full(len(segments), i))
    segments = np.concatenate(parts)
    beads = sort_loops(ref.device, ref.grid, segments, np.concatenate(owner), len(layers))
    off = (np.abs(beads.distance(due[ask], samples.layer[ask])) - shared).clip(min=0.0)
    order, spans = spans_of(samples.layer[ask], len(out))
    for i, m in enumerate(out):
        mine = off[order[spans[i] : spans[i + 1]]]
        if len(mine):
            m.to_theirs, m.to_theirs_95 = float(mine.max()), float(np.percentile(mine, 95))
    pieces(due[ask], samples.layer[ask], samples.length[ask], off, "no bead", out, limits)
