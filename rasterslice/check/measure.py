"""Measure the layers of another program against ours: areas here, beads in `beads`."""

from __future__ import annotations

import numpy as np

from .align import Alignment
from .beads import measure_beads
from .findings import Finding, Limits, Measures, compare, judge_area, least
from .form import Floats, TheirLayer
from .loops import Ints, crossings, depths, repeats, segments_of, solid_area
from .loops import area as signed_area
from .middles import at_middles, rounded_off
from .ours import Samples, Slices, sort_loops, spread
from .outlines import Strung, string
from .pixels import knotted, unproven
from .reference import Side

#: Slices may change by leaps where a face lies flat: what goes away at a height this far off, mm, is not held against
#: anyone. Heights are written with three decimals, and float32 holds no more of 300 mm.
HEIGHT_SLACK = 0.002


def measure(ref: Side, found: Alignment, limits: Limits) -> list[Measures]:
    """Measure every layer of an alignment; findings name places in the frame of the part."""
    results = [Measures() for _ in found.layers]
    for ours in ref.boundaries(found.heights):
        batch = slice(ours.first, ours.last)
        strung = _measure(ref, ours, found.layers[batch], results[batch], limits)
        ref.outlines.keep(found.heights[batch], strung)
    return results


def measure_softly(ref: Side, layers: list[TheirLayer], heights: Floats, limits: Limits) -> list[Measures]:
    """Measure layers at ascending heights, and forgive what a slice HEIGHT_SLACK mm higher or lower explains."""
    results = [Measures() for _ in layers]
    for first, ours in ref.wobbly(heights, HEIGHT_SLACK):
        last = first + len(ours.tangled)
        _measure(ref, ours, layers[first:last], results[first:last], limits)
    return results


def _measure(ref: Side, ours: Slices, layers: list[TheirLayer], out: list[Measures], limits: Limits) -> Strung:
    """Measure the layers of one batch; return our outlines."""
    areas = [i for i, k in enumerate(layers) if k.beads is None]
    strung = string(*ours.pieces())
    samples = ours.samples(strung.pieces, strung.layer_of())
    islands, holes = strung.counts(len(layers))
    reach = np.einsum("nd,nd->n", samples.points, samples.normal)
    area = np.bincount(samples.layer, reach * samples.length / 2, minlength=len(layers))
    for i, m in enumerate(out):
        m.area_ours = float(area[i])
        if not ours.tangled[i]:
            m.islands, m.holes = int(islands[i]), int(holes[i])
    if areas:
        _measure_areas(ref, ours, samples, layers, out, limits)
    if len(areas) < len(layers):
        measure_beads(ref, ours, samples, layers, out, limits)
    for m, is_open in zip(out, ours.is_open, strict=True):
        if is_open:
            for finding in m.findings:
                finding.sure = False
            m.findings.append(Finding("open", False, "our own slice is open here"))
    return strung


def _measure_areas(
    ref: Side, ours: Slices, samples: Samples, layers: list[TheirLayer], out: list[Measures], limits: Limits
) -> None:
    """Measure the layers that are areas."""
    loops = [k.loops for k in layers]
    segments, layer, loop = segments_of(loops)
    plan = np.array([k.beads is None for k in layers])
    check = plan[samples.layer]
    mine = Samples(*(a[check] for a in (samples.points, samples.layer, samples.length, samples.normal)))
    other = sort_loops(ref.device, ref.grid, segments, layer, len(layers))
    if limits.pixel:
        theirs, outward = at_middles(ours, other, layers, segments, layer, limits)
    else:
        theirs = spread(segments, layer, 2.0 * limits.pitch)
        outward = ours.distance(theirs.points, theirs.layer)  # positive: theirs lies outside ours
    inward = zone(ours, other, mine, ours.wobble(mine.points, mine.layer), limits)
    inward = rounded_off(inward, limits) if limits.pixel else inward
    compare_both(ours, other, theirs, outward, mine, inward, out, limits)
    shape(ours, layers, segments, layer, loop, out, limits)
    for i in np.flatnonzero(plan):
        judge_area(out[i])


def compare_both(
    ours: Slices, other: Slices, theirs: Samples, outward: Floats, mine: Samples, inward: Floats, out: list[Measures],
    limits: Limits, name: str = "",
) -> None:  # fmt: skip
    """Compare two boundaries; of two runs both have pixels, so that neither is the true one."""
    doubts = None
    if limits.thin:
        outward = zone(other, ours, theirs, np.zeros(len(outward)), limits)
    if limits.thin or limits.lost:
        doubts = unproven(other, ours, theirs, outward, limits), unproven(ours, other, mine, inward, limits)
    compare(theirs, outward, mine, inward, out, limits, name, doubts)


def zone(ours: Slices, other: Slices, mine: Samples, moved: Floats, limits: Limits) -> Floats:
    """Return the signed distance of our samples from theirs, small where they keep to the zone about our boundary.

    Theirs may do what it likes within the tolerance of our boundary, for instance close a gap that is narrower than
    twice that: a sample counts only if a point just outside the zone, beside it, lies on the wrong side of theirs.
    """
    inward = other.distance(mine.points, mine.layer)
    inward = np.sign(inward) * (np.abs(inward) - moved).clip(min=0.0)
    reach = limits.tolerance + limits.uncertainty
    bad = np.flatnonzero(np.abs(inward) > limits.tolerance / 2)
    points, layer, step = mine.points[bad], mine.layer[bad], reach * mine.normal[bad]
    beside = 0.95 * reach - moved[bad]
    out = (ours.distance(points + step, layer) > beside) & (other.distance(points + step, layer) < 0)
    deep = (ours.distance(points - step, layer) < -beside) & (other.distance(points - step, layer) > 0)
    inward[bad] = np.where(out | deep, inward[bad], np.sign(inward[bad]) * np.abs(inward[bad]).clip(max=least(limits)))
    return np.asarray(inward, np.float64)


def shape(
    ours: Slices, layers: list[TheirLayer], segments: Floats, layer: Ints, loop: Ints, out: list[Measures],
    limits: Limits,
) -> None:  # fmt: skip
    """Look at their contours by themselves: nesting, counts, crossings, repeated and close points."""
    twice, close = repeats(segments, layer, len(layers), limits.spacing)
    for i, (k, m) in enumerate(zip(layers, out, strict=True)):
        if k.beads is None:
            depth = depths(k.loops)
            m.area_theirs = solid_area(k.loops, depth)
            m.islands_theirs = sum(d % 2 == 0 for d in depth)
            m.holes_theirs = sum(d % 2 for d in depth)
            m.repeated, m.close = int(twice[i]), int(close[i])
    where, places = crossings(segments, layer, loop)
    tied = knotted(ours, places, where, limits)
    for i in np.unique(where).tolist():
        x, y = places[where == i][np.argmin(tied[where == i])].tolist()
        text = f"contours cross {(where == i).sum()} times, at ({x:.2f}, {y:.2f})"
        out[i].findings.append(Finding("crossed", not tied[where == i].all(), text, (x, y)))


def winding(layers: list[TheirLayer], out: list[Measures]) -> str:
    """Add loops that turn against the custom of their file; return a note when it has no custom."""
    votes = np.zeros(2, np.int64)
    seen = []
    for i, k in enumerate(layers):
        for p, d, said in zip(k.loops, depths(k.loops), k.declared or [0] * len(k.loops), strict=True):
            due = -1 if d % 2 else 1
            turn = due * (1 if signed_area(p) > 0 else -1)
            votes[int(turn > 0)] += 1
            seen.append((i, turn, said * due, p))
    custom = 1 if votes[1] >= votes[0] else -1
    if not seen or votes.max() < 0.9 * votes.sum():
        return "the contours follow no rule of winding" if seen else ""
    for i, turn, said, p in seen:
        x, y = p.mean(axis=0).tolist()
        if turn != custom or said < 0:
            what = (
                "is wound the wrong way" if turn != custom else "is called a hole and is none, or the other way round"
            )
            out[i].findings.append(Finding("wound", True, f"the contour about ({x:.2f}, {y:.2f}) {what}", (x, y)))
    return ""
