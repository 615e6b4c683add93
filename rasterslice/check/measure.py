"""How far two boundaries lie apart, layer by layer: what is missing, what is extra, where, how far."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .align import Alignment
from .form import FILL, OUTER, WALL, Beads, Floats, TheirLayer
from .loops import Ints, count_loops, crossings, depths, repeats, segments_of, solid_area
from .loops import area as signed_area
from .ours import Boundary, Reference, Samples, Wobbly, sort_loops, spread

CELL = 8  # pixels: deviations are summed in squares of this side
#: Slices may change by leaps where a face lies flat: what goes away at a height this far off, mm, is not held against
#: anyone. Heights are written with three decimals, and float32 holds no more of 300 mm.
HEIGHT_SLACK = 0.002
FILL_STEP = 5.0  # pixels between samples of fill lines

Slices = Boundary | Wobbly


@dataclass(slots=True)
class Limits:
    """When a deviation counts.

    Attributes
    ----------
    tolerance : float
        Largest deviation that is forgiven, mm.
    uncertainty : float
        How far our own boundary, and what the format rounds, may be off, mm.
    area : float
        Least area of a square of CELL pixels that a deviation must enclose, mm^2.
    spacing : float
        Least distance between successive points, mm.
    pitch : float
        mm.
    width : float
        Width of their outer beads, mm.
    """

    tolerance: float
    uncertainty: float
    area: float
    spacing: float
    pitch: float
    width: float


@dataclass(slots=True)
class Finding:
    """Something of one layer that is not as it should be.

    Attributes
    ----------
    what : str
        "missing", "extra", "leaves", "bare", "crossed", "wound", ...
    sure : bool
        Whether it exceeds tolerance and uncertainty; if not, nobody is accused.
    text : str
        What to print.
    place : tuple of float
        Where, mm.
    """

    what: str
    sure: bool
    text: str
    place: tuple[float, float] = (np.nan, np.nan)


@dataclass(slots=True)
class Measures:
    """Numbers of one layer; nan where they do not apply. Lengths mm, areas mm^2."""

    area_ours: float = np.nan
    area_theirs: float = np.nan
    area_xor: float = np.nan
    iou: float = np.nan
    to_ours: float = np.nan  # largest distance of their boundary from ours
    to_theirs: float = np.nan
    to_ours_95: float = np.nan
    to_theirs_95: float = np.nan
    mean: float = np.nan  # signed, of their boundary or bead, outward positive
    islands: float = np.nan
    holes: float = np.nan
    islands_theirs: float = np.nan
    holes_theirs: float = np.nan
    repeated: int = 0
    close: int = 0
    findings: list[Finding] = field(default_factory=list)


def measure(ref: Reference, found: Alignment, limits: Limits) -> list[Measures]:
    """Measure every layer of an alignment; findings name places in the frame of the part."""
    results = [Measures() for _ in found.layers]
    for ours in ref.boundaries(found.heights):
        _measure(ref, ours, found.layers[ours.first : ours.last], results[ours.first : ours.last], limits)
    return results


def measure_softly(ref: Reference, layers: list[TheirLayer], heights: Floats, limits: Limits) -> list[Measures]:
    """Measure layers at ascending heights, and forgive what a slice HEIGHT_SLACK mm higher or lower explains."""
    results = [Measures() for _ in layers]
    for first, ours in ref.wobbly(heights, HEIGHT_SLACK):
        last = first + len(ours.tangled)
        _measure(ref, ours, layers[first:last], results[first:last], limits)
    return results


def _measure(ref: Reference, ours: Slices, layers: list[TheirLayer], out: list[Measures], limits: Limits) -> None:
    """Measure the layers of one batch."""
    areas = [i for i, k in enumerate(layers) if k.beads is None]
    samples = ours.samples()
    parts, which = ours.pieces()
    islands, holes = count_loops(parts, which, len(layers))
    reach = np.einsum("nd,nd->n", samples.points, samples.normal)
    area = np.bincount(samples.layer, reach * samples.length / 2, minlength=len(layers))
    for i, m in enumerate(out):
        m.area_ours = float(area[i])
        if not ours.tangled[i]:
            m.islands, m.holes = int(islands[i]), int(holes[i])
    if areas:
        _measure_areas(ref, ours, samples, layers, out, limits)
    if len(areas) < len(layers):
        _measure_beads(ref, ours, samples, layers, out, limits)
    for m, is_open in zip(out, ours.is_open, strict=True):
        if is_open:
            for finding in m.findings:
                finding.sure = False
            m.findings.append(Finding("open", False, "our own slice is open here"))


def _measure_areas(
    ref: Reference, ours: Slices, samples: Samples, layers: list[TheirLayer], out: list[Measures], limits: Limits
) -> None:
    """Measure the layers that are areas."""
    loops = [k.loops for k in layers]
    segments, layer, _ = segments_of(loops)
    step = 2.0 * limits.pitch
    theirs = spread(segments, layer, step)
    outward = ours.distance(theirs.points, theirs.layer)  # positive: theirs lies outside ours
    plan = np.array([k.beads is None for k in layers])
    check = plan[samples.layer]
    mine = Samples(*(a[check] for a in (samples.points, samples.layer, samples.length, samples.normal)))
    other = sort_loops(ref.device, ref.grid, segments, layer, len(layers))
    inward = _zone(ours, other, mine, ours.wobble(mine.points, mine.layer), limits)
    compare(theirs, outward, mine, inward, out, limits)
    shape(layers, segments, layer, out, limits)
    for i in np.flatnonzero(plan):
        judge_area(out[i])


def _zone(ours: Slices, other: Boundary, mine: Samples, moved: Floats, limits: Limits) -> Floats:
    """Return the signed distance of our samples from theirs, small where they keep to the zone about our boundary.

    Theirs may do what it likes within the tolerance of our boundary, for instance close a gap that is narrower than
    twice that: a sample counts only if a point just outside the zone, beside it, lies on the wrong side of theirs.
    """
    inward = other.distance(mine.points, mine.layer)
    inward = np.sign(inward) * (np.abs(inward) - moved).clip(min=0.0)
    reach = limits.tolerance + limits.uncertainty
    bad = np.flatnonzero(np.abs(inward) > limits.tolerance / 2)
    points, layer, step = mine.points[bad], mine.layer[bad], reach * mine.normal[bad]
    out = (ours.distance(points + step, layer) > 0.95 * reach) & (other.distance(points + step, layer) < 0)
    deep = (ours.distance(points - step, layer) < -0.95 * reach) & (other.distance(points - step, layer) > 0)
    inward[bad] = np.where(out | deep, inward[bad], np.sign(inward[bad]) * np.abs(inward[bad]).clip(max=least(limits)))
    return inward


def least(limits: Limits) -> float:
    """Return the deviation at which doubts begin, mm."""
    return max(limits.tolerance - limits.uncertainty, limits.tolerance / 2)


def compare(
    theirs: Samples, outward: Floats, mine: Samples, inward: Floats, out: list[Measures], limits: Limits, name: str = ""
) -> None:
    """Put the deviations of two boundaries, each from the other, into measures.

    Parameters
    ----------
    theirs, mine : Samples
    outward, inward : (N,) float64
        Signed distance of their samples from our solid, and of ours from theirs, mm.
    """
    a, b = np.abs(outward), np.abs(inward)
    spans = [_spans(theirs.layer, len(out)), _spans(mine.layer, len(out))]
    xor = (
        np.bincount(theirs.layer, a * theirs.length, len(out)) + np.bincount(mine.layer, b * mine.length, len(out))
    ) / 2
    sums = np.bincount(theirs.layer, outward * theirs.length, len(out))
    lengths = np.bincount(theirs.layer, theirs.length, len(out))
    for i, m in enumerate(out):
        one, two = (v[o[s[i] : s[i + 1]]] for v, (o, s) in zip((a, b), spans, strict=True))
        if len(one):
            m.to_ours, m.to_ours_95, m.mean = float(one.max()), float(np.percentile(one, 95)), sums[i] / lengths[i]
        if len(two):
            m.to_theirs, m.to_theirs_95 = float(two.max()), float(np.percentile(two, 95))
        m.area_xor = float(xor[i])
    extra = (np.concatenate([theirs.points[outward > 0], mine.points[inward < 0]]),
             np.concatenate([theirs.layer[outward > 0], mine.layer[inward < 0]]),
             np.concatenate([theirs.length[outward > 0], mine.length[inward < 0]]),
             np.concatenate([a[outward > 0], b[inward < 0]]))  # fmt: skip
    lacking = (np.concatenate([theirs.points[outward <= 0], mine.points[inward >= 0]]),
               np.concatenate([theirs.layer[outward <= 0], mine.layer[inward >= 0]]),
               np.concatenate([theirs.length[outward <= 0], mine.length[inward >= 0]]),
               np.concatenate([a[outward <= 0], b[inward >= 0]]))  # fmt: skip
    pieces(*extra, f"{name}extra", out, limits)
    pieces(*lacking, f"{name}missing", out, limits)


def _spans(layer: Ints, layers: int) -> tuple[Ints, Ints]:
    order = np.argsort(layer, kind="stable")
    return order, np.searchsorted(layer[order], np.arange(layers + 1))


def pieces(
    points: Floats, layer: Ints, length: Floats, deviation: Floats, what: str, out: list[Measures], limits: Limits
) -> None:
    """Add the worst place of each layer where deviations exceed the tolerance and enclose enough area."""
    bad = np.flatnonzero(deviation > least(limits))
    if not len(bad):
        return
    cell = np.floor(points[bad] / (CELL * limits.pitch)).astype(np.int64) % (1 << 24)
    key = (layer[bad] << 48) | (cell[:, 0] << 24) | cell[:, 1]
    keys, which = np.unique(key, return_inverse=True)
    # The share of a boundary that one sample can stand for is bounded by how far it is off, seen from both sides.
    area = np.bincount(which, deviation[bad].clip(max=CELL * limits.pitch) * length[bad])
    sure = deviation[bad] > limits.tolerance + limits.uncertainty
    proven = np.bincount(which, np.where(sure, deviation[bad].clip(max=CELL * limits.pitch) * length[bad], 0.0))
    farthest = np.zeros(len(keys))
    np.maximum.at(farthest, which, deviation[bad])
    owner = keys >> 48
    total = np.bincount(owner, area, minlength=len(out))
    for i in np.unique(owner).tolist():
        mine = np.flatnonzero(owner == i)
        top = mine[np.lexsort((area[mine], proven[mine]))[-1]]
        if area[top] < limits.area / 2:
            continue
        here = bad[which == top]
        x, y = points[here[np.argmax(deviation[here])]].tolist()
        text = f"{what} at ({x:.2f}, {y:.2f}) by {farthest[top]:.3f} mm, about {total[i]:.3f} mm2 in all"
        out[i].findings.append(Finding(what, bool(proven[top] > limits.area), text, (x, y)))


def shape(layers: list[TheirLayer], segments: Floats, layer: Ints, out: list[Measures], limits: Limits) -> None:
    """Look at their contours by themselves: nesting, counts, crossings, repeated and close points."""
    twice, close = repeats(segments, layer, len(layers), limits.spacing)
    for i, (k, m) in enumerate(zip(layers, out, strict=True)):
        if k.beads is None:
            depth = depths(k.loops)
            m.area_theirs = solid_area(k.loops, depth)
            m.islands_theirs = sum(d % 2 == 0 for d in depth)
            m.holes_theirs = sum(d % 2 for d in depth)
        m.repeated, m.close = int(twice[i]), int(close[i])
    where, places = crossings(segments, layer)
    for i in np.unique(where).tolist():
        x, y = places[where == i][0].tolist()
        text = f"contours cross {(where == i).sum()} times, at ({x:.2f}, {y:.2f})"
        out[i].findings.append(Finding("crossed", True, text, (x, y)))


def judge_area(m: Measures) -> None:
    """Fill in the overlap of areas."""
    both = m.area_ours + (m.area_theirs if np.isfinite(m.area_theirs) else 0.0)
    xor = min(m.area_xor, both) if np.isfinite(m.area_xor) else both
    m.area_xor = xor
    m.iou = (both - xor) / (both + xor) if both > 0 else 1.0


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


def _measure_beads(
    ref: Reference, ours: Slices, samples: Samples, layers: list[TheirLayer], out: list[Measures], limits: Limits
) -> None:
    """Measure the layers that are beads: none may leave the part, and every wall must have its own."""
    walls = _bead_samples(layers, (OUTER, WALL), limits, 2.0)
    fills = _bead_samples(layers, (FILL,), limits, FILL_STEP)
    for (found, role, width), what in ((walls, "bead leaves the part"), (fills, "fill leaves the part")):
        deep = ours.lowest(found.points, found.layer)
        # Walls of unknown kind may be fill of gaps, which is as wide as the gap; where fill ends, programs differ.
        beyond = deep + np.where(role == OUTER, width / 2, width / 4)
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
    _bare(ref, ours, samples, layers, out, limits)


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
    order, spans = _spans(found.layer[outer], len(out))
    values, length = beyond[outer][order], found.length[outer][order]
    for i, m in enumerate(out):
        mine = values[spans[i] : spans[i + 1]]
        if len(mine):
            m.to_ours, m.to_ours_95 = float(np.abs(mine).max()), float(np.percentile(np.abs(mine), 95))
            m.mean = float(np.average(mine, weights=length[spans[i] : spans[i + 1]]))


def _bare(
    ref: Reference, ours: Slices, samples: Samples, layers: list[TheirLayer], out: list[Measures], limits: Limits
) -> None:
    """Look for walls without a bead: half a width inside every boundary there must be one, where the part is thick."""
    half = limits.width / 2
    plan = np.array([k.beads is not None for k in layers])[samples.layer]
    depth = [ours.distance(samples.points - n * half * samples.normal, samples.layer) for n in (1, 2, 3)]
    due = samples.points - half * samples.normal
    there = np.abs(depth[0] + half) < 0.02 * limits.width  # not beside corners
    ask = np.flatnonzero(plan & there & (depth[1] < -0.97 * 2 * half))
    # Between two and three beads of thickness programs share the room out as they like.
    shared = np.where(depth[2][ask] < -0.97 * 3 * half, 0.0, limits.width / 4)
    reach = limits.tolerance + limits.uncertainty
    out = ours.distance(samples.points[ask] + reach * samples.normal[ask], samples.layer[ask]) > 0.95 * reach
    ask, shared = ask[out], shared[out]  # a narrow gap may be closed
    shared += ours.wobble(samples.points[ask], samples.layer[ask])
    parts, owner = [], []
    for i, k in enumerate(layers):
        if k.beads is not None:
            segments, _ = _bead_segments(k.beads, (OUTER, WALL))
            parts.append(segments)
            owner.append(np.full(len(segments), i))
    segments = np.concatenate(parts)
    beads = sort_loops(ref.device, ref.grid, segments, np.concatenate(owner), len(layers))
    off = (np.abs(beads.distance(due[ask], samples.layer[ask])) - shared).clip(min=0.0)
    order, spans = _spans(samples.layer[ask], len(out))
    for i, m in enumerate(out):
        mine = off[order[spans[i] : spans[i + 1]]]
        if len(mine):
            m.to_theirs, m.to_theirs_95 = float(mine.max()), float(np.percentile(mine, 95))
    pieces(due[ask], samples.layer[ask], samples.length[ask], off, "no bead", out, limits)
