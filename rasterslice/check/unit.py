"""In which unit a file gives its lengths, by the size of its layers."""

from __future__ import annotations

import numpy as np

from .form import Floats
from .frame import sizes
from .reference import Side

SHIFT = {"top": -0.5, "middle": 0.0, "bottom": 0.5}  # from a height to the middle of its layer, thicknesses
UNITS = {25.4: "inches", 10.0: "centimetres", 1000.0: "metres"}
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


def unit_by_slices(ref: Side, z: Floats, thickness: float, boxes: Floats) -> float:
    """Return the factor at which layers are as large as our slices: of a few layers the whole tells nothing.

    Parameters
    ----------
    ref : Reference or Run
    z, boxes : (P,) float64, (P, 4) float64
        Of some layers, as the file gives them.
    thickness : float
        mm, of the layers that are asked for.
    """
    some = np.linspace(0, len(z) - 1, min(_MOST, len(z))).astype(int)
    size, low = np.log(sizes(boxes[some]).clip(1e-9)), float(ref.low[2])
    tried = [(f, g) for f in (1.0, *factors()) for g in dict.fromkeys((f, 1.0))]
    moves = [base + s * thickness for base in dict.fromkeys((0.0, low)) for s in SHIFT.values()]
    cut = np.array([[g * z[some] + move for move in moves] for _, g in tried])
    order = np.argsort(cut, axis=None)
    box = np.empty((cut.size, 4))
    box[order] = ref.outline(cut.ravel()[order])[1]
    ours = np.log(sizes(box).clip(1e-9)).reshape(*cut.shape, 2)
    for (factor, _), at_heights in zip(tried, ours, strict=True):
        off = np.abs(size + np.log(factor) - at_heights).max(axis=-1)  # nan where we have no slice
        if float(np.median(np.nan_to_num(off, nan=9.0), axis=1).min()) < _CLOSELY:
            return factor
    return 1.0
