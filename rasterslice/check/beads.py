"""Measure beads: none may leave the part, and every wall must have its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .findings import Finding, Limits, Measures, judge_area, least, pieces, spans_of
from .form import FILL, OUTER, WALL, Floats, TheirLayer
from .frame import returning, width_of
from .loops import Ints, crossings, repeats
from .ours import Samples, Slices, sort_loops, spread, thinned
from .reference import Side

WALL_STEP, FILL_STEP = 2.0, 5.0  # pixels between samples
_VARIED = 0.02  # of its width: a wall that differs by less is as wide as most
_PAIRS = 1 << 18  # points and segments that are looked at together


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
        beyond = deep + np.where(role == OUTER, width / 2 - limits.shallow, width / 4 if named else 0.0)
        bad = np.flatnonzero(beyond > limits.tolerance - limits.uncertainty)
        if len(bad):  # a bead in the middle of something thinner than itself is the best that can be done
            side = found.normal[bad] * (width[bad] / 4)[:, None]
            left, right = (ours.lowest(found.points[bad] + s, found.layer[bad]) for s in (side, -side))
            thin = (left > deep[bad]) & (right > deep[bad]) & (deep[bad] < 0)
            bad = bad[~thin]
            radius = (beyond - deep)[bad]
            beyond[bad] = _sideways(ours, found, bad, radius)
        pieces(found.points[bad], found.layer[bad], found.length[bad], beyond[bad], what, out, limits)
        if found is walls[0]:
            _bead_numbers(found, role, beyond, out)
            _bead_areas(
                found, np.abs(deep + width / 2) < width / 2 if not named else role == OUTER, deep + width / 2, out
            )
    _lines(layers, out, limits)
    _bare(ref, ours, thinned(samples, WALL_STEP * limits.pitch), layers, out, limits)


def _sideways(ours: Slices, found: Samples, which: Ints, radius: Floats) -> Floats:
    """Return how far beads reach out of our solid to either side, mm: at their ends, and over a narrow gap, not."""
    points, layer, side = found.points[which], found.layer[which], radius[:, None] * found.normal[which]
    rims = [ours.lowest(points + s, layer) for s in (-side, 0.0 * side, side)]
    return np.asarray(np.max(rims, axis=0).clip(min=0.0))


def _bead_samples(
    layers: list[TheirLayer], roles: tuple[int, ...], limits: Limits, step: float
) -> tuple[Samples, Ints, Floats]:
    """Return samples of beads of some roles, with role and width of each."""
    segments, owner, bead = segments_of_beads(layers, roles)
    found = spread(segments, np.arange(len(segments)), step * limits.pitch)
    source = found.layer
    held = [k.beads for k in layers if k.beads is not None]
    role = np.concatenate([np.empty(0, np.int64), *(b.role for b in held)])[bead[source]]
    wide = np.concatenate([np.empty(0), *(b.width for b in held)])[bead[source]]
    wide = np.where(np.isfinite(wide), wide, limits.width)
    return Samples(found.points, owner[source], found.length, found.normal), role, wide


def segments_of_beads(layers: Sequence[TheirLayer], roles: tuple[int, ...]) -> tuple[Floats, Ints, Ints]:
    """Return the segments (N, 4) of beads of some roles, the layer of each, and its bead, counted over all layers."""
    held = [(i, k.beads) for i, k in enumerate(layers) if k.beads is not None]
    if not held:
        return np.empty((0, 4)), np.empty(0, np.int64), np.empty(0, np.int64)
    points = np.concatenate([b.points for _, b in held])
    owner = np.repeat([i for i, _ in held], [len(b.role) for _, b in held])  # of each bead
    bead = np.repeat(np.arange(len(owner)), np.concatenate([np.diff(b.offsets) for _, b in held]))
    chosen = np.isin(np.concatenate([b.role for _, b in held]), roles)
    at = np.flatnonzero((bead[1:] == bead[:-1]) & chosen[bead[1:]])
    return np.hstack([points[at], points[at + 1]]), owner[bead[at]], bead[at]


def _lines(layers: list[TheirLayer], out: list[Measures], limits: Limits) -> None:
    """Look at perimeters by themselves: beads that cross themselves, repeated and close points."""
    segments, owner, bead = segments_of_beads(layers, (OUTER, WALL))
    twice, close = repeats(segments, owner, len(layers), limits.spacing)
    for i, k in enumerate(layers):
        if k.beads is not None:
            out[i].repeated, out[i].close = int(twice[i]), int(close[i])
    held = [k.beads for k in layers if k.beads is not None]
    outer = np.concatenate([np.empty(0, bool), *(b.role == OUTER for b in held)])
    rings = np.concatenate([np.empty(0, bool), *(returning(b, limits.width) for b in held)])
    mine = (outer & rings if limits.unsaid else outer | rings)[bead]  # what bears no name, or is open, may fill a gap
    which, places = crossings(segments[mine], bead[mine], bead[mine])
    layer_of = np.zeros(int(bead.max(initial=0)) + 1, np.int64)
    layer_of[bead] = owner
    for i in np.unique(layer_of[which]).tolist():
        mine = places[layer_of[which] == i]
        x, y = mine[0].tolist()
        text = f"perimeters cross themselves {len(mine)} times, at ({x:.2f}, {y:.2f})"
        out[i].findings.append(Finding("crossed", True, text, (x, y)))


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


def _bead_areas(found: Samples, outer: NDArray[np.bool_], beyond: Floats, out: list[Measures]) -> None:
    """Put the areas that outer beads enclose into measures: ours, and the deviation along its boundary."""
    share = np.where(outer, beyond * found.length, 0.0)
    more, xor = (np.bincount(found.layer, v, len(out)) for v in (share, np.abs(share)))
    for i in np.unique(found.layer[outer]).tolist():
        m = out[i]
        m.area_theirs, m.area_xor = m.area_ours + float(more[i]), float(xor[i])
        judge_area(m)


def _bare(
    ref: Side, ours: Slices, samples: Samples, layers: list[TheirLayer], out: list[Measures], limits: Limits
) -> None:
    """Look for walls without a bead: half a width inside every boundary there must be one, where the part is thick."""
    plan = np.array([k.beads is not None for k in layers])[samples.layer]
    wide_of = np.array([width_of([k], limits.width, (OUTER,)) for k in layers])[samples.layer]
    due = samples.points - (wide_of / 2 + (limits.deep - limits.shallow) / 2)[:, None] * samples.normal
    wide_of = wide_of + 2 * limits.deep

    def depth(widths: float, which: Ints) -> Floats:
        inside = samples.points[which] - widths * wide_of[which, None] * samples.normal[which]
        return ours.distance(inside, samples.layer[which])

    ask = np.flatnonzero(plan)
    ask = ask[np.abs(depth(0.5, ask) + wide_of[ask] / 2) < 0.02 * wide_of[ask]]  # not beside corners
    ask = ask[depth(1.0, ask) < -0.99 * wide_of[ask]]
    # Between two and three beads of thickness programs share the room out as they like.
    shared = np.where(depth(1.5, ask) < -0.99 * 1.5 * wide_of[ask], 0.0, wide_of[ask] / 4)
    reach = limits.tolerance + limits.uncertainty
    moved = ours.wobble(samples.points[ask], samples.layer[ask])
    beside = ours.distance(samples.points[ask] + reach * samples.normal[ask], samples.layer[ask])
    wide = beside > 0.95 * reach - moved  # a narrow gap may be closed
    ask, shared = ask[wide], shared[wide] + moved[wide] + (limits.shallow + limits.deep) / 2
    segments, owner, _ = segments_of_beads(layers, (OUTER, WALL))
    beads = sort_loops(ref.device, ref.grid, segments, owner, len(layers))
    off = (beads.distance(due[ask], samples.layer[ask], signed=False) - shared).clip(min=0.0)
    doubt = np.flatnonzero(off > least(limits))
    at = ask[doubt]
    off[doubt] = np.minimum(off[doubt], _from_edge(samples.points[at], samples.layer[at], layers, wide_of[at]))
    order, spans = spans_of(samples.layer[ask], len(out))
    for i, m in enumerate(out):
        mine = off[order[spans[i] : spans[i + 1]]]
        if len(mine):
            m.to_theirs, m.to_theirs_95 = float(mine.max()), float(np.percentile(mine, 95))
    pieces(due[ask], samples.layer[ask], samples.length[ask], off, "no bead", out, limits)


def _from_edge(points: Floats, layer: Ints, layers: list[TheirLayer], wide: Floats) -> Floats:
    """Return how far places of our boundary are from the edges of walls that are wider or narrower than most, mm.

    Programs that vary the width of a wall lay it half of its own width inside the boundary.
    """
    found = np.full(len(points), np.inf)
    for i in np.unique(layer).tolist():
        mine = np.flatnonzero(layer == i)
        segments, _, bead = segments_of_beads([layers[i]], (OUTER, WALL))
        beads = layers[i].beads
        half = beads.width[bead] / 2 if beads is not None else np.empty(0)
        other = np.abs(2 * half - wide[mine[0]]) > _VARIED * wide[mine[0]]  # not where no width is said
        a, d, half = segments[other, :2], segments[other, 2:] - segments[other, :2], half[other]
        for part in np.array_split(mine, 1 + len(mine) * len(a) // _PAIRS) if len(a) else ():
            q = points[part, None] - a
            t = ((q * d).sum(axis=2) / np.maximum((d * d).sum(axis=1), 1e-18)).clip(0.0, 1.0)
            found[part] = (np.hypot(*np.moveaxis(q - t[..., None] * d, 2, 0)) - half).min(axis=1)
    return found.clip(min=0.0)
