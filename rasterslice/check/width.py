"""How wide beads are, and which of them are outer ones, where the file does not say it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .align import Alignment, align
from .form import OUTER, SUPPORT, Floats, TheirLayer, Theirs
from .frame import lengths, pick, returning, says_width, wall_rates, wall_segments, walls, width_of
from .ours import sort_loops
from .reference import Side
from .unit import FILAMENTS, THICK, THIN

_ABOUT = 0.1  # how far off a width from filament or parameter file may be
_PEAK = 0.02  # mm: the depths of outer beads are counted within
_ROUNDS = 6
_LEAST = 0.03  # mm: what a width that was seen may be off, at least


@dataclass(frozen=True, slots=True)
class Width:
    """Width of outer beads.

    Attributes
    ----------
    value : float
        mm.
    low, high : float
        Between which it lies, mm.
    doubt : str
        Why walls that are all too deep could not be told; empty when they could.
    """

    value: float
    low: float
    high: float
    doubt: str = ""


def align_and_width(
    side: Side, theirs: Theirs, width: float | None, shift: tuple[float, float] | str
) -> tuple[Alignment, Width]:
    """Return the alignment, and the width of outer beads: as asked, as the file says, or as seen.

    What is seen, twice the depth at which our boundary sees most outer beads, says nothing about that depth. It is
    believed when the filament that is fed, or the parameter file, bears it out; what a single bead was fed then tells
    how much wider than most it is.
    """
    wide = width or width_of(theirs.layers, _guess(side, theirs))
    found = align(side, theirs, wide, shift)
    if says_width(theirs.layers) or "rasterslice" in theirs.format:
        return found, Width(wide, wide, wide)
    if width is not None:
        return _with_widths(side, theirs, found, Width(wide, wide, wide))
    seen, least = seen_width(side, found)
    low, high = THIN * found.thickness, THICK * found.thickness
    for _ in range(_ROUNDS):  # the shift is found for a width, and the width for a shift
        last, found = seen, align(side, theirs, float(np.clip(seen, low, high)), shift)
        seen, least = seen_width(side, found)
        if abs(seen - last) < _PEAK / 2:
            break
    text = f"the file says no width: most outer beads lie {seen / 2:.3f} mm deep, half of {seen:.3f} mm"
    fed = _from_filament(theirs, side, found, seen) if low <= seen <= high else ""
    borne_out = fed or _from_parameters(side, seen)
    if not borne_out:
        note = f"{text}, and nothing bears that out: whether all are too deep cannot be told without --width"
        found.notes.append(note)
        doubt = "how deep its walls should lie is not known: the file says no width; give --width"
        return found, Width((low + high) / 2, low, high, doubt)
    found.notes.append(f"{text}, which {borne_out} bears out; taken for {least:.3f} mm more or less")
    return _with_widths(side, theirs, found, Width(seen, seen - least, seen + least))


def _guess(side: Side, theirs: Theirs) -> float:
    """Return a width to begin with: what the filament of most walls makes, when it is that of a bead."""
    rates = wall_rates(theirs.layers)
    step = np.diff(np.unique([k.z for k in theirs.layers]))
    due = side.params.thickness
    thickness = float(np.median(step)) if len(step) else due
    if theirs.scale != 1.0 and not 0.5 < thickness / due < 2.0:  # heights are of the unit of x and y
        thickness *= theirs.scale
    diameter = theirs.filament if theirs.filament > 0 else FILAMENTS[0]
    made = float(np.median(rates)) * math.pi / 4 * diameter**2 / thickness if len(rates) else 0.0
    return made if THIN * thickness <= made <= THICK * thickness else side.params.part_width


def seen_width(side: Side, found: Alignment) -> tuple[float, float]:
    """Return twice the depth at which most of our boundary sees the nearest wall, and how far off that may be, mm."""
    picked = pick(found.layers)
    order = sorted(picked, key=lambda i: found.heights[i])
    parts = [np.empty(0)]
    for boundary in side.boundaries(found.heights[order]):
        layers = [found.layers[i] for i in order[boundary.first : boundary.last]]
        ours = boundary.samples(*boundary.pieces())
        segments = [wall_segments(k.beads) for k in layers]
        owner = np.repeat(np.arange(len(layers)), [len(s) for s in segments])
        beads = sort_loops(side.device, side.grid, np.concatenate(segments), owner, len(layers))
        parts.append(np.abs(beads.distance(ours.points, ours.layer)))
    depth = np.sort(np.concatenate(parts))
    if not len(depth):
        return 1e-3, 0.0
    count = np.searchsorted(depth, depth + _PEAK, "right") - np.arange(len(depth))
    top = int(np.argmax(count))
    peak = depth[top : top + count[top]]
    value = 2 * float(np.median(peak))
    near = depth[np.abs(2 * depth - value) < _ABOUT * value]
    spread = 2 * float(np.subtract(*np.percentile(near, [75, 25])))
    return float(np.clip(np.round(value, 3), 1e-3, None)), max(_LEAST, spread)


def _outer_fed(side: Side, found: Alignment, seen: float) -> float:
    """Return the filament for one mm of most beads that are as deep as outer ones; nan where none is known."""
    picked = pick(found.layers)
    rates, long = [np.empty(0)], [np.empty(0)]
    for i, depth in zip(picked, _depths(side, found, picked), strict=True):
        beads, chosen = found.layers[i].beads, walls(found.layers[i].beads)
        if beads is not None and chosen is not None and beads.fed is not None:
            mine = np.flatnonzero(chosen & (np.abs(2 * depth / seen + 1) < _ABOUT) & np.isfinite(beads.fed))
            rates.append(beads.fed[mine])
            long.append(lengths(beads)[mine])
    fed, length = np.concatenate(rates), np.concatenate(long)
    if not len(fed):
        return math.nan
    order = np.argsort(fed)
    reached = np.cumsum(length[order])
    return float(fed[order[np.searchsorted(reached, reached[-1] / 2)]])


def _depths(side: Side, found: Alignment, which: list[int]) -> list[Floats]:
    """Return the signed distance from our solid at which most of each bead lies, for ascending layers."""
    result = [np.empty(0)] * len(which)
    for boundary in side.boundaries(found.heights[which]):
        for j in range(boundary.last - boundary.first):
            i = boundary.first + j
            beads = found.layers[which[i]].beads
            if beads is None or not len(beads.role):
                continue
            middles = (beads.points[1:] + beads.points[:-1]) / 2
            depth = boundary.distance(middles, np.full(len(middles), j))
            pairs = zip(beads.offsets[:-1].tolist(), (beads.offsets[1:] - 1).tolist(), strict=True)
            step = np.hypot(*np.diff(beads.points, axis=0).T)
            result[i] = np.array([_median(depth[a:b], step[a:b]) for a, b in pairs])
    return result


def _median(values: Floats, weight: Floats) -> float:
    order = np.argsort(values)
    reached = np.cumsum(weight[order])
    return float(values[order[np.searchsorted(reached, reached[-1] / 2)]]) if len(values) else math.nan


def _with_widths(side: Side, theirs: Theirs, found: Alignment, wide: Width) -> tuple[Alignment, Width]:
    """Give beads the width that their filament tells beside that of most, and name outer ones where the file does not.

    The width of a bead grows with its cross-section over its height, whether its edges are square or round.
    """
    usual = _outer_fed(side, found, wide.value)
    step = np.diff(found.heights, prepend=2 * float(side.low[2]) - found.heights[0])
    step = np.where((step > 0.25 * found.thickness) & (step < 1.5 * found.thickness), step, found.thickness)
    section = math.pi / 4 * _diameter(theirs, found, wide.value, usual) ** 2
    layers = []
    for k, height in zip(found.layers, step.tolist(), strict=True):
        if k.beads is not None and k.beads.fed is not None:
            more = section * (k.beads.fed / height - usual / found.thickness)
            guess = wide.value + np.where(np.isfinite(more), more, 0.0)
            guess = guess.clip(THIN * height, THICK * height)
            k = replace(k, beads=replace(k.beads, width=np.where(np.isfinite(k.beads.width), k.beads.width, guess)))
        layers.append(k)
    found = replace(found, layers=layers)
    if not theirs.unsaid:
        return found, wide
    # Over nothing a bead is a round thread of the same section, thinner than it is wide elsewhere.
    flat = wide.value * found.thickness - (1 - math.pi / 4) * found.thickness**2
    thread = 2 * math.sqrt(max(flat, 0.0) / math.pi)
    return _named(side, found, wide.value), replace(wide, low=min(wide.low, thread))


def _named(side: Side, found: Alignment, usual: float) -> Alignment:
    """Call those beads outer ones that lie half of their width deep."""
    layers: list[TheirLayer] = []
    for k, depth in zip(found.layers, _depths(side, found, list(range(len(found.layers)))), strict=True):
        beads = k.beads
        if beads is not None and len(beads.role):
            outer = (np.abs(2 * depth / beads.width + 1) < _ABOUT) & (beads.role != SUPPORT)
            alike = (np.abs(beads.width / usual - 1) < _ABOUT / 2) & (lengths(beads) > 2 * beads.width)
            outer &= returning(beads, usual) | alike  # gaps are filled in any width
            k = replace(k, beads=replace(beads, role=np.where(outer, OUTER, beads.role)))
        layers.append(k)
    return replace(found, layers=layers)


def _diameter(theirs: Theirs, found: Alignment, seen: float, fed: float) -> float:
    """Return the diameter of filament with which what is fed makes beads of a width; 0 when none does."""
    thickness = found.thickness
    for diameter in ((theirs.filament,) if theirs.filament > 0 else FILAMENTS) if fed > 0 else ():
        square = fed * math.pi / 4 * diameter**2 / thickness  # a bead with square edges
        rounded = square + (1 - math.pi / 4) * thickness
        if (1 - _ABOUT) * square < seen < (1 + _ABOUT) * rounded:
            return diameter
    return 0.0


def _from_filament(theirs: Theirs, side: Side, found: Alignment, seen: float) -> str:
    """Return what bears a width out, when the filament that is fed for a length of bead does."""
    diameter = _diameter(theirs, found, seen, _outer_fed(side, found, seen))
    return f"its filament of {diameter:g} mm" if diameter else ""


def _from_parameters(side: Side, seen: float) -> str:
    wanted = side.params.part_width
    return "the parameter file" if abs(seen / wanted - 1) < _ABOUT / 2 else ""
