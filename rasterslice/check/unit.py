"""In which unit a file gives its lengths, by the size of its layers."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from .form import UNITS, Floats, TheirLayer, Theirs
from .frame import box, moved, pick, sizes, wall_rates, width_of
from .reference import Side

SHIFT = {"top": -0.5, "middle": 0.0, "bottom": 0.5}  # from a height to the middle of its layer, thicknesses
FILAMENTS = (1.75, 2.85)  # mm: the diameters on sale
THIN, THICK = 0.5, 4.0  # least and largest width of a bead, thicknesses of its layer
_ABOUT, _CLOSELY = 0.05, 0.02  # how far off a size may be that a unit explains: of the whole, and of most layers
_MOST = 10  # layers that are looked at


def unit_of(ratio: float) -> tuple[float, str] | None:
    """Return the factor that mends a ratio of lengths, and what went wrong, when it is that of two units."""
    for factor, name in UNITS.items():
        if abs(ratio / factor - 1) < _ABOUT:
            return 1 / factor, f"{factor:g} times too large: millimetres read as {name}"
        if abs(ratio * factor - 1) < _ABOUT:
            return factor, f"{factor:g} times too small: {name} read as millimetres"
    return None


def factors() -> list[float]:
    """Return the factors between millimetres and other units."""
    return [f for u in UNITS for f in (u, 1 / u)]


def ratio_of(ref: Side, boxes: Floats) -> float:
    """Return how much larger the whole of some layers is than the part."""
    whole = np.concatenate([boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)])[None]
    return float(np.exp(np.mean(np.log(sizes(whole)[0].clip(1e-9)) - np.log((ref.high - ref.low)[:2]))))


def pixel_size(ref: Side, z: Floats, thickness: float, boxes: Floats) -> Floats:
    """Return width and height of the pixels of pictures that do not say them, (2,) mm, by the size of our slices.

    Layers may lie at their heights or one higher, and may be turned by 90 degrees: whichever fits better.
    """
    size, found = np.log(sizes(boxes).clip(1e-9)), []
    for cut, worth in ((z, 1.0), (z + thickness, 2.0)):  # counted from 1 only where that clearly fits better
        ours = np.log(sizes(ref.outline(cut)[1]).clip(1e-9))
        for turned in (ours, ours[:, ::-1]):
            off = (turned - size)[np.isfinite(ours).all(axis=1)]
            if len(off):
                middle = np.median(off, axis=0)
                found.append((worth * float(np.median(np.abs(off - middle))), middle.tolist()))
    if not found:
        return np.full(2, 1.0 / ratio_of(ref, boxes))
    x, y = min(found)[1]
    return np.exp((x, y) if abs(x - y) < _CLOSELY else np.full(2, (x + y) / 2))


def in_mm(ref: Side, theirs: Theirs) -> Theirs:
    """Return a file in mm, when the size of its layers says that it is in another unit; else as it is.

    Heights stay as they are: they may be of another unit than x and y. Pictures that do not say how large a pixel is
    are left alone.
    """
    layers = [theirs.layers[i] for i in pick(theirs.layers, theirs.name)]
    if theirs.unsized:
        return theirs
    factor = _by_whole(ref, theirs, layers) or _by_slices(ref, theirs, layers)
    return theirs if factor == 1.0 else scaled(ref, theirs, factor)


def scaled(ref: Side, theirs: Theirs, factor: float) -> Theirs:
    """Return a file with x and y multiplied; widths and filament too where they are those of beads only then."""
    named = unit_of(1 / factor)
    thickness, (wide, made) = ref.params.thickness, _widths(ref, theirs)
    wider = factor if _off(factor * wide, thickness) < _off(wide, thickness) else 1.0
    fed = 1 / factor if _off(made / factor, thickness) < _off(made, thickness) else 1.0

    def mended(k: TheirLayer) -> TheirLayer:
        k = moved(k, factor * np.eye(2), np.zeros(2))
        b = k.beads
        if b is None:
            return k
        return replace(k, beads=replace(b, width=wider * b.width, fed=None if b.fed is None else fed * b.fed))

    return replace(
        theirs, layers=[mended(k) for k in theirs.layers], props=[mended(k) for k in theirs.props],
        scale=factor, unit=named[1] if named else f"{1 / factor:g} times too large",
    )  # fmt: skip


def _widths(ref: Side, theirs: Theirs) -> tuple[float, float]:
    """Return the width of most walls that the file says, and the one that their filament makes, mm; else nan."""
    rates = wall_rates(theirs.layers)
    diameter = theirs.filament if theirs.filament > 0 else FILAMENTS[0]
    made = float(np.median(rates)) * math.pi / 4 * diameter**2 / ref.params.thickness if len(rates) else math.nan
    return width_of(theirs.layers, math.nan), made


def _off(width: float, thickness: float) -> float:
    """Return how far a width is from that of any bead, as a logarithm; 0 of none."""
    if not width > 0:
        return 0.0
    return max(math.log(THIN * thickness / width), math.log(width / thickness / THICK), 0.0)


def _size_at(ref: Side, theirs: Theirs, factor: float) -> float:
    """Return what walls are wider than their centre lines when x and y are multiplied, mm."""
    if all(k.beads is None for k in theirs.layers):
        return 0.0
    thickness, (wide, made) = ref.params.thickness, _widths(ref, theirs)
    known = [w for w in (wide, factor * wide, made, made / factor) if w > 0]
    best = min(known, key=lambda w: _off(w, thickness), default=0.0)
    return best if best and not _off(best, thickness) else ref.params.part_width


def _by_whole(ref: Side, theirs: Theirs, layers: list[TheirLayer]) -> float:
    """Return the factor at which the whole is as large as the part; 0 when none is.

    What is too large must hold a line that is larger than the part: many copies do not.
    """
    boxes = np.array([box(k, 0.0) for k in layers])
    longest = max(
        float(np.ptp(p, axis=0).max())
        for k in layers
        for p in (*k.loops, *(np.split(k.beads.points, k.beads.offsets[1:-1]) if k.beads is not None else ()))
        if len(p)
    )
    part = float((ref.high - ref.low)[:2].max())
    for factor in (1.0, *factors()):
        grow = _size_at(ref, theirs, factor) / 2 * np.array([-1, -1, 1, 1])
        fits = abs(ratio_of(ref, factor * boxes + grow) - 1) < _ABOUT
        if fits and (factor >= 1.0 or longest > (1 + _ABOUT) * part):
            return factor
    return 0.0


def _by_slices(ref: Side, theirs: Theirs, layers: list[TheirLayer]) -> float:
    """Return the factor at which layers are as large as our slices: of a few layers the whole tells nothing; else 1."""
    some = [layers[i] for i in np.linspace(0, len(layers) - 1, min(_MOST, len(layers))).astype(int)]
    z, p = np.array([k.z for k in some]), ref.params
    if theirs.z_is == "number":
        z = float(ref.low[2]) + (z + p.slice_position) * (theirs.step or p.thickness)
    if not np.isfinite(z).all():
        return 1.0
    size = sizes(np.array([box(k, 0.0) for k in some]))
    tried = [(f, g) for f in (1.0, *factors()) for g in dict.fromkeys((f, 1.0))]
    moves = [base + s * p.thickness for base in dict.fromkeys((0.0, float(ref.low[2]))) for s in SHIFT.values()]
    cut = np.array([[g * z + move for move in moves] for _, g in tried])
    order = np.argsort(cut, axis=None)
    found = np.empty((cut.size, 4))
    found[order] = ref.outline(cut.ravel()[order])[1]
    ours = np.log(sizes(found).clip(1e-9)).reshape(*cut.shape, 2)
    for (factor, _), at_heights in zip(tried, ours, strict=True):
        own = np.log((factor * size + _size_at(ref, theirs, factor)).clip(1e-9))
        off = np.abs(own - at_heights).max(axis=-1)  # nan where we have no slice
        if float(np.median(np.nan_to_num(off, nan=9.0), axis=1).min()) < _CLOSELY:
            return factor
    return 1.0
