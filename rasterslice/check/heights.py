"""Which heights their layers lie at: what their z means, in which unit, and which layers are not there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..errors import ModelError
from .fit import Fit
from .form import Floats, TheirLayer, Theirs
from .frame import says_width
from .gaps import GAP, spacing
from .reference import Side
from .unit import SHIFT, factors, unit_of

_CLEARLY = 0.5  # another meaning of heights must fit twice as well
_MISFIT = 0.02  # mm: outlines off by less on the average tell nothing of a wrong height


@dataclass(slots=True)
class Heights:
    """Where the layers of a file are to be cut.

    Attributes
    ----------
    middle : (N,) float64
        In our frame, ascending, mm.
    thickness : float
        Of most layers, mm.
    z_is : str
        "top", "middle" or "bottom".
    told : bool
        Whether the shape told this.
    shift, scale : float
        Added to their heights, after they were multiplied.
    faults : list of str
    """

    middle: Floats
    thickness: float
    z_is: str
    told: bool = False
    shift: float = 0.0
    scale: float = 1.0
    faults: list[str] = field(default_factory=list)


def find_heights(
    ref: Side, theirs: Theirs, layers: list[TheirLayer], picked: list[int], boxes: Floats, areas: Floats, scale: float
) -> Heights:
    """Find what heights mean, by the shape where it tells.

    Parameters
    ----------
    ref : Reference or Run
    theirs : Theirs
    layers : list of TheirLayer
        By ascending height.
    picked : list of int
        The layers that are looked at.
    boxes, areas : (P, 4), (P,) float64
        Of those, in mm; an area of 0 is not known.
    scale : float
        Factor of their x and y, which z may need too.
    """
    z, thickness = _steps(layers, ref)
    fit = Fit(ref, boxes, areas)
    misfit = fit.misfit
    if theirs.z_is == "number":  # counted from 0 or from 1: a first one may be missing
        up = z + thickness
        first, second = misfit([z[picked], up[picked]])
        later = up[-1] < ref.high[2] and second < _CLEARLY * first
        return Heights(up if later else z, thickness, "middle", later, thickness if later else 0.0)
    low, habit, due = float(ref.low[2]), theirs.z_is or "middle", ref.params.thickness
    thickness = _without_gaps(ref, z, picked, thickness, habit, misfit)

    def scaled(factor: float) -> tuple[float, Heights]:
        step = factor * thickness if len(z) > 1 else thickness  # of one layer nothing says how thick it is
        name, said, base, misses = _meaning(factor * z[picked], step, low, habit, misfit)
        faults = [_scaled(factor)] if factor != 1.0 else []
        return misses, Heights(_middles(factor * z, step, name, base, low, due), step, name, said, base, factor, faults)

    score, best = scaled(1.0)
    if scale != 1.0 and _as_due(ref, scale * z, scale * thickness) and not _as_due(ref, z, thickness):
        other, whole = scaled(scale)  # all lengths of a file are of one unit, when the shape has nothing against it
        if other <= max(score, _MISFIT):
            score, best = other, whole
    least = max(_MISFIT, 2 * theirs.precision)
    if score < least or not (areas.any() or says_width(layers)):  # beads of no known width: the size tells nothing
        return best
    for factor in _scales(ref, z, thickness, scale):
        other, found = scaled(factor)
        if other < _CLEARLY * score:
            score, best = other, found
    off = fit.shift(best.middle[picked], best.thickness) if score > least else 0.0
    if off:
        if best.told and best.scale == 1.0:  # a shift of its own, not in part another meaning
            plain = _middles(z, thickness, habit, best.shift, low, due)
            off = round(off + float(np.median(best.middle - plain)), 3)
            best = Heights(plain, thickness, habit, False, best.shift)
        text = f"all layers lie {abs(off):.3f} mm too {'low' if off > 0 else 'high'}"
        best.faults.append(text)
        best.middle, best.shift = best.middle + off, best.shift + off
    return best


def _scaled(factor: float) -> str:
    named = unit_of(1 / factor)
    return f"the heights are {named[1]}" if named else f"the heights are {1 / factor:.4f} times what they should be"


def _as_due(ref: Side, z: Floats, thickness: float) -> bool:
    """Whether layers lie as far apart as asked for; a single one, whether it lies at a height that we would cut."""
    due = ref.params.thickness
    if len(z) > 1:
        return abs(thickness / due - 1) < 0.01
    halves = 2 * np.array([z[0], z[0] - float(ref.low[2])]) / due  # its bottom, middle or top
    return bool(np.any((np.abs(halves - np.round(halves)) < 0.02) & (np.round(halves) >= 1)))


def _scales(ref: Side, z: Floats, thickness: float, scale: float) -> list[float]:
    """Return by which factors heights may be wrong: that of x and y, units, and what the thickness says."""
    span = float(ref.high[2] - ref.low[2])
    tall = float(z.max() - z.min()) + thickness
    found = [scale] if scale != 1.0 else []
    found += [f for f in factors() if abs(f * tall / span - 1) < 0.5]
    found += [ref.params.thickness / thickness] if abs(ref.params.thickness / thickness - 1) > 1e-4 else []
    return list(dict.fromkeys(found))


Misfit = Callable[[list[Floats]], list[float]]


def _meaning(z: Floats, thickness: float, low: float, habit: str, misfit: Misfit) -> tuple[str, bool, float, float]:
    """Return what heights mean, whether the shape told, what to add to them, and how they fit then."""
    bases = {0.0: None, low: None}
    keys = [(name, base) for base in bases for name in SHIFT]
    scores = dict(zip(keys, misfit([z + base + SHIFT[name] * thickness for name, base in keys]), strict=True))
    best = min(scores, key=lambda key: scores[key])
    usual = min(((habit, base) for base in bases), key=lambda key: scores[key])
    told = scores[best] < _CLEARLY * scores[usual] and scores[usual] > 0.003
    name, base = best if told else usual
    return name, told, base, scores[name, base]


def _without_gaps(ref: Side, z: Floats, picked: list[int], thickness: float, habit: str, misfit: Misfit) -> float:
    """Return the thickness of layers that lie far apart: what was asked for, when they are every second one of ours."""
    due, low = ref.params.thickness, float(ref.low[2])
    ratio = thickness / due
    if ratio < 1.5 or abs(ratio - round(ratio)) > 0.01:
        return thickness
    thick, thin = (_middles(z, t, habit, 0.0, low, due) for t in (thickness, due))
    on_each_other = abs((thick[0] - low) / thickness - 0.5) < 0.05
    off = np.abs(ref.heights[None, :] - thin[:, None]).min(axis=1)
    factor = _CLEARLY if on_each_other else 1.0
    if float(np.median(off)) >= due / 8:
        return thickness
    first, second = misfit([thin[picked], thick[picked]])
    return due if first <= factor * second else thickness


def _steps(layers: list[TheirLayer], ref: Side) -> tuple[Floats, float]:
    """Return their heights and the distance between most layers."""
    z = np.array([k.z for k in layers])
    if not np.isfinite(z).all():
        raise ModelError(f"{layers[int(np.argmin(np.isfinite(z)))].where}: the layer has no height; write it anew")
    steps = np.diff(z)
    steps = steps[steps > 1e-6]
    return z, float(np.median(steps)) if len(steps) else ref.params.thickness


def _middles(z: Floats, thickness: float, z_is: str, base: float, low: float, due: float) -> Floats:
    """Return the middle of each layer: each is as thick as its own step, unless layers are missing beside it."""
    found, steps = spacing(z, thickness), np.diff(z)
    near = float(found.local[0]) if len(steps) else thickness
    if found.regular:
        each = np.full(len(z), thickness)
        most = 1.6 * thickness  # of a first layer
        if z_is == "bottom" and len(steps) and 1e-6 < steps[0] < most:
            each[0] = steps[0]
    else:
        own = np.where((steps < 1e-6) | (steps > GAP * found.local), found.local, steps)
        each = np.append(own, found.local[-1]) if z_is == "bottom" else np.insert(own, 0, near)
        most = max(1.6 * near, 1.05 * due)
    if z_is == "top" and 0.02 * thickness < z[0] + base - low < most:
        each[0] = z[0] + base - low
    return np.asarray(z + base + SHIFT[z_is] * each)
