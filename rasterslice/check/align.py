"""Which of our slices each of their layers is, and how their frame lies in ours."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import ModelError
from .form import OUTER, Floats, TheirLayer, Theirs
from .frame import box, moved, pick, samples
from .gaps import counted
from .heights import find_heights
from .loops import Ints, depths, solid_area
from .reference import Side
from .unit import SHIFT, pixel_size

#: What may have happened to x and y on the way, the likeliest first.
TURNS: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {
    "": ((1, 0), (0, 1)),
    "mirrored in y": ((1, 0), (0, -1)), "mirrored in x": ((-1, 0), (0, 1)),
    "turned by 180 degrees": ((-1, 0), (0, -1)),
    "turned by 90 degrees": ((0, -1), (1, 0)), "turned by 270 degrees": ((0, 1), (-1, 0)),
    "mirrored at the diagonal": ((0, 1), (1, 0)), "mirrored at the other diagonal": ((0, -1), (-1, 0)),
}  # fmt: skip
MOST_SPAN = 30
FAR = 6.0  # of the median distance from the middle layer; all layers of a whole part lie within two
_CLEARLY = 0.5  # another turn must fit twice as well
_FITS = 0.05  # mm: what misses by less nearly everywhere lies as it is
_VOTES, _LAYERS = 3, 5  # how many times as many places must be for another turn as against it; least layers
_NOTHING = 0.003  # mm: turns that differ by less do not differ


@dataclass(frozen=True, slots=True)
class Alignment:
    """Their layers in our frame.

    Attributes
    ----------
    layers : list of TheirLayer
        In our frame, by ascending height.
    heights : (N,) float64
        Where each would be cut, mm.
    thickness : float
        mm, of most of their layers.
    z_is : str
        "top", "middle" or "bottom": what their heights mean.
    told : bool
        Whether the shape told this, and not the habit of the format.
    z_shift, dx, dy : float
        Added to their heights and places, mm.
    turned : str
        A word of `TURNS`, empty when they lie as we do.
    scale : float
        Factor of their lengths.
    faults, notes : list of str
    props : list of TheirLayer
        Layers of support alone, in our frame.
    tops : (P,) float64
        Where the top of each of them lies, mm.
    z_scale : float
        Factor of their heights.
    """

    layers: list[TheirLayer]
    heights: Floats
    thickness: float
    z_is: str
    told: bool
    z_shift: float
    dx: float
    dy: float
    turned: str
    scale: float
    faults: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    props: list[TheirLayer] = field(default_factory=list)
    tops: Floats = field(default_factory=lambda: np.empty(0))
    z_scale: float = 1.0


def align(ref: Side, theirs: Theirs, width: float, shift: tuple[float, float] | str = "auto") -> Alignment:
    """Find heights, shift, turn and unit.

    Parameters
    ----------
    ref : Reference or Run
    theirs : Theirs
    width : float
        Width of their outer beads, mm; not used for areas.
    shift : "auto", "none" or (dx, dy)

    Raises
    ------
    ModelError
        When nothing in the file could be laid over the part.
    """
    order = np.argsort([k.z for k in theirs.layers], kind="stable")
    layers = [theirs.layers[i] for i in order]
    notes = list(theirs.notes)
    if theirs.z_is == "number":
        p = ref.params
        notes += [] if theirs.step else counted(ref, np.array([k.z for k in layers]))
        step = theirs.step or p.thickness
        layers = [replace(k, z=float(ref.low[2]) + (k.z + p.slice_position) * step) for k in layers]
    faults = [] if np.all(np.diff(order) > 0) else ["layers do not come in the order of their heights"]
    layers = _without_far(ref, layers, faults)
    picked = pick(layers)
    boxes = np.array([box(layers[i], width) for i in picked])
    z = np.array([layers[i].z for i in picked])
    scales = pixel_size(ref, z, ref.params.thickness, boxes) if theirs.unsized else np.ones(2)
    applied = float(np.sqrt(scales.prod()))
    scale = applied * theirs.scale
    if theirs.scale != 1.0:
        faults.append(f"the file is {theirs.unit}")
    if np.any(scales != 1.0):
        layers = [moved(k, np.diag(scales), np.zeros(2)) for k in layers]
        boxes = boxes * np.tile(scales, 2)
    _not_too_large(ref, layers, theirs.name)
    areas = np.array([solid_area(layers[i].loops, depths(layers[i].loops)) for i in picked])
    tall = find_heights(ref, theirs, layers, picked, boxes, areas, scale)
    heights, faults = tall.middle, [*faults, *tall.faults]
    turned, offset = _place(ref, layers, picked, heights, width, theirs, shift)
    if turned != theirs.turned and not (theirs.any_mirror and turned == "mirrored in y"):
        what = f"the file is {turned}" if turned else f"the file is not {theirs.turned}, as it should be"
        (notes if theirs.any_turn else faults).append(what)
    elif turned:
        notes.append("y points down in the file")
    layers = [moved(k, np.array(TURNS[turned], float), offset) for k in layers]
    dx, dy = offset.tolist()
    props = [moved(k, applied * np.array(TURNS[turned], float), offset) for k in theirs.props]
    tops = np.array([k.z for k in props]) * tall.scale + tall.shift + (SHIFT[tall.z_is] + 0.5) * tall.thickness
    return Alignment(
        layers, heights, tall.thickness, tall.z_is, tall.told, tall.shift, dx, dy, turned, scale, faults, notes, props,
        tops, tall.scale,
    )  # fmt: skip


def _without_far(ref: Side, layers: list[TheirLayer], faults: list[str]) -> list[TheirLayer]:
    """Leave out layers that lie far from most and from the part: their height would spoil what heights tell."""
    z = np.array([k.z for k in layers])
    if len(z) < 3 or not np.isfinite(z).all():
        return layers
    off, steps = np.abs(z - np.median(z)), np.diff(z)
    step = float(np.median(steps[steps > 1e-6])) if (steps > 1e-6).any() else ref.params.thickness
    low, high = float(ref.low[2]), float(ref.high[2])
    tall = high - low
    far = (off > FAR * (float(np.median(off)) + step)) & ((z < low - tall) | (z > high + tall))
    for i in np.flatnonzero(far).tolist():
        side = "below" if z[i] < low else "above"
        what = f"a layer lies at z {z[i]:g} mm, far {side} the part and all others"
        faults.append(f"{layers[i].where}: {what}; it is not compared")
    return [k for k, lost in zip(layers, far.tolist(), strict=True) if not lost]


def _not_too_large(ref: Side, layers: list[TheirLayer], name: str) -> None:
    """Refuse layers so large that sampling them would take all memory."""
    most = MOST_SPAN * float((ref.high - ref.low)[:2].max())
    for k in layers:
        lines = [*k.loops, *k.scaffold, *k.supports, *([k.beads.points] if k.beads is not None else [])]
        span = max((float(np.ptp(p, axis=0).max()) for p in lines if len(p)), default=0.0)
        if span > most:
            what = f"a layer spans {span:g} mm; at most {MOST_SPAN} times the part, {most:g} mm, are compared"
            number = k.where.removeprefix("line ")
            place = f"{name}:{number}" if number.isdigit() else f"{name}, {k.where}"
            raise ModelError(f"{place}: {what}. Check the file, and the units")


def _place(
    ref: Side, layers: list[TheirLayer], picked: list[int], heights: Floats, width: float,
    theirs: Theirs, shift: tuple[float, float] | str,
) -> tuple[str, Floats]:  # fmt: skip
    """Return turn and offset."""
    order = sorted(picked, key=lambda i: heights[i])
    cut = heights[order]
    _, ours = ref.outline(cut)
    points, layer = samples([layers[i] for i in order])
    target = 0.0 if any(layers[i].loops for i in order) else -width / 2
    boxes = np.array([box(layers[i], width) for i in order])
    centres, wanted = _centres(boxes), _centres(ours)
    fixed = np.zeros(2) if shift == "none" else None if isinstance(shift, str) else np.array(shift, float)
    # Where a file does not tell outer walls from inner ones, only those near where an outer one should be count.
    named = target == 0.0 or any((k.beads.role == OUTER).any() for k in layers if k.beads is not None)
    reach = 1.0 if named else width / 2

    def start(name: str) -> Floats:
        if fixed is not None:
            return fixed
        off = wanted - centres @ np.array(TURNS[name]).T
        off = off[np.isfinite(off).all(axis=1)]  # layers that both sides have
        return np.asarray(np.median(off, axis=0)) if len(off) else np.zeros(2)

    def laid(name: str) -> tuple[Floats, Floats]:
        cloud, offset = points @ np.array(TURNS[name]).T, start(name)
        if fixed is None:
            offset = _refined(ref, cut, cloud, offset, layer, target, reach)
        return _misses(ref, cut, [cloud + offset], layer, target)[0], offset

    left, offset = laid(theirs.turned)
    if float(np.percentile(np.abs(left), 99)) < _FITS:
        return theirs.turned, offset
    clouds = {name: points @ np.array(TURNS[name]).T + start(name) for name in TURNS}
    misses = _misses(ref, cut, list(clouds.values()), layer, target)
    scores = dict(zip(TURNS, (_typical(m) for m in misses), strict=True))
    usual = _typical(left)
    for name in sorted(TURNS, key=lambda name: scores[name]):
        if name == theirs.turned or scores[name] > 2 * min(scores.values()):
            continue
        missed, other = laid(name)
        typical = _typical(missed)
        if typical < min(_CLEARLY * usual, usual - _NOTHING) or (typical < usual and _chosen(left, missed, layer)):
            return name, other
    return theirs.turned, offset


def _chosen(usual: Floats, other: Floats, layer: Ints) -> bool:
    """Whether another turn fits clearly better where the two differ at all: in most layers in which they do.

    Beads miss in many places whichever way they are turned, and a part may be nearly the same as its mirror image.
    """
    usual, other = np.abs(usual), np.abs(other)
    better = np.bincount(layer, (usual > _FITS) & (other < _FITS / 2), minlength=int(layer.max()) + 1)
    worse = np.bincount(layer, (other > _FITS) & (usual < _FITS / 2), minlength=len(better))
    for_it, against = int((better > worse).sum()), int((worse > better).sum())
    return bool(better.sum() >= _VOTES * max(worse.sum(), 4)) and for_it >= max(_LAYERS, 2 * against)


def _typical(misses: Floats) -> float:
    """Return by how much points miss on the average."""
    return float(np.mean(np.minimum(np.abs(misses), 2.0)))


def _centres(boxes: Floats) -> Floats:
    return (boxes[:, :2] + boxes[:, 2:]) / 2


def _misses(ref: Side, cut: Floats, clouds: list[Floats], layer: Ints, target: float) -> list[Floats]:
    """Return by how much the points of each cloud miss where they should be, mm outward."""
    found = [np.zeros(len(layer)) for _ in clouds]
    for boundary in ref.boundaries(cut):
        mine = np.flatnonzero((layer >= boundary.first) & (layer < boundary.last))
        asked = np.concatenate([c[mine] for c in clouds])
        got = boundary.distance(asked, np.tile(layer[mine] - boundary.first, len(clouds))) - target
        for values, part in zip(found, np.split(got, len(clouds)), strict=True):
            values[mine] = part
    return found


def _refined(
    ref: Side, cut: Floats, points: Floats, offset: Floats, layer: Ints, target: float, near: float
) -> Floats:
    """Return the offset at which the points miss least, the sum of distances, not of squares: few cannot bend it."""
    step = 0.02
    for _ in range(4):
        shifts = [np.zeros(2), np.array([step, 0]), np.array([-step, 0]), np.array([0, step]), np.array([0, -step])]
        e, px, mx, py, my = _misses(ref, cut, [points + offset + s for s in shifts], layer, target)
        slope = np.stack([px - mx, py - my], axis=1) / (2 * step)
        keep = (np.abs(e) < near) & (np.abs(np.hypot(*slope.T) - 1) < 0.2)
        if keep.sum() < 20 or np.linalg.cond(slope[keep].T @ slope[keep]) > 1e6:
            break
        step_to = np.zeros(2)
        for _ in range(6):
            weight = np.sqrt(1 / np.maximum(np.abs(e[keep] - slope[keep] @ step_to), 0.002))
            step_to = np.linalg.lstsq(slope[keep] * weight[:, None], e[keep] * weight, rcond=None)[0]
        offset = offset - step_to
        near = max(0.1, min(near, 3 * float(np.median(np.abs(e[keep])))))
    return np.asarray(np.round(offset, 5))
