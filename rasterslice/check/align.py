"""Which of our slices each of their layers is, and how their frame lies in ours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import ModelError
from .form import OUTER, WALL, Beads, Floats, TheirLayer, Theirs
from .loops import depths, segments_of, solid_area
from .ours import Reference, spread

SAMPLED = 40  # layers that alignment looks at
#: What may have happened to x and y on the way, the likeliest first.
TURNS: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {
    "": ((1, 0), (0, 1)),
    "mirrored in y": ((1, 0), (0, -1)), "mirrored in x": ((-1, 0), (0, 1)),
    "turned by 180 degrees": ((-1, 0), (0, -1)),
    "turned by 90 degrees": ((0, -1), (1, 0)), "turned by 270 degrees": ((0, 1), (-1, 0)),
    "mirrored at the diagonal": ((0, 1), (1, 0)), "mirrored at the other diagonal": ((0, -1), (-1, 0)),
}  # fmt: skip
_CLEARLY = 0.5  # another turn or height must fit twice as well
_SHIFT = {"top": -0.5, "middle": 0.0, "bottom": 0.5}  # from a height to the middle of its layer, thicknesses


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


def width_of(layers: Sequence[TheirLayer], default: float) -> float:
    """Return the width of most outer beads, mm."""
    for role in (OUTER, WALL):
        beads = [k.beads for k in layers if k.beads is not None]
        width = np.concatenate([*(b.width[b.role == role] for b in beads), np.empty(0)])
        length = np.concatenate([*(_lengths(b)[b.role == role] for b in beads), np.empty(0)])
        width, length = width[np.isfinite(width)], length[np.isfinite(width)]
        if len(width):
            order = np.argsort(width)
            reached = np.cumsum(length[order])
            return float(width[order[np.searchsorted(reached, reached[-1] / 2)]])
    return default


def _lengths(beads: Beads) -> Floats:
    """Return the length of each bead, mm."""
    step = np.diff(beads.points, axis=0)
    total = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))])
    whole = total[beads.offsets[1:] - 1] - total[beads.offsets[:-1]]
    return np.asarray(whole)


def align(ref: Reference, theirs: Theirs, width: float, shift: tuple[float, float] | str = "auto") -> Alignment:
    """Find heights, shift, turn and unit.

    Parameters
    ----------
    ref : Reference
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
    if theirs.z_is == "number":
        p = ref.params
        layers = [replace(k, z=float(ref.low[2]) + (k.z + p.slice_position) * p.thickness) for k in layers]
    faults = [] if np.all(np.diff(order) > 0) else ["layers do not come in the order of their heights"]
    notes = list(theirs.notes)
    z, thickness = _steps(layers, ref)
    picked = _pick(layers)
    boxes = np.array([_box(layers[i], width) for i in picked])
    scale = _scale(ref, boxes, z[picked], faults, notes, theirs)
    if scale != 1.0:
        layers = [_moved(k, scale * np.eye(2), np.zeros(2)) for k in layers]
        boxes = boxes * scale
    areas = np.array([solid_area(layers[i].loops, depths(layers[i].loops)) for i in picked])
    z_is, told, z_shift = _heights(ref, theirs, z[picked], thickness, boxes, areas)
    heights = z + z_shift + _SHIFT[z_is] * _each(z, thickness)
    turned, offset = _place(ref, layers, picked, heights, width, theirs, shift)
    if turned and not (theirs.any_mirror and turned == "mirrored in y"):
        faults.append(f"the file is {turned}")
    elif turned:
        notes.append("y points down in the file")
    layers = [_moved(k, np.array(TURNS[turned], float), offset) for k in layers]
    dx, dy = offset.tolist()
    return Alignment(layers, heights, thickness, z_is, told, z_shift, dx, dy, turned, scale, faults, notes)


def _steps(layers: list[TheirLayer], ref: Reference) -> tuple[Floats, float]:
    """Return their heights and the distance between most layers."""
    z = np.array([k.z for k in layers])
    if not np.isfinite(z).all():
        raise ModelError(f"{layers[int(np.argmin(np.isfinite(z)))].where}: the layer has no height; write it anew")
    steps = np.diff(z)
    steps = steps[steps > 1e-6]
    return z, float(np.median(steps)) if len(steps) else ref.params.thickness


def _each(z: Floats, thickness: float) -> Floats:
    """Return the thickness of each layer: its own step, unless layers are missing below it."""
    steps = np.diff(z, prepend=z[0] - thickness)
    whole = np.abs(steps / thickness - np.round(steps / thickness)) < 0.02
    return np.where(whole | (steps < 1e-6) | (steps > 2.5 * thickness), thickness, steps)


def _pick(layers: list[TheirLayer]) -> list[int]:
    """Return some layers that hold something, spread over the height."""
    held = [i for i, k in enumerate(layers) if len(k.loops) or _walls(k.beads) is not None]
    if not held:
        raise ModelError("the file holds no contour and no perimeter; name one that does")
    count = min(SAMPLED, len(held))
    return [held[(2 * i + 1) * len(held) // (2 * count)] for i in range(count)]


def _walls(beads: Beads | None) -> np.ndarray | None:
    """Return which beads bound the part: outer perimeters, else all perimeters."""
    for role in (OUTER, WALL) if beads is not None else ():
        chosen = np.asarray(beads.role == role) if beads is not None else np.zeros(0, bool)
        if chosen.any():
            return chosen
    return None


def _wall_points(layer: TheirLayer) -> Floats:
    """Return the points of contours, or of outer perimeters."""
    if layer.loops:
        return np.concatenate(layer.loops)
    chosen = _walls(layer.beads)
    if layer.beads is None or chosen is None:
        return np.empty((0, 2))
    return layer.beads.points[np.repeat(chosen, np.diff(layer.beads.offsets))]


def _box(layer: TheirLayer, width: float) -> Floats:
    points, grow = _wall_points(layer), 0.0 if layer.loops else width / 2
    return np.concatenate([points.min(axis=0) - grow, points.max(axis=0) + grow])


def _sizes(boxes: Floats) -> Floats:
    return np.asarray(boxes[:, 2:] - boxes[:, :2])


def _scale(ref: Reference, boxes: Floats, z: Floats, faults: list[str], notes: list[str], theirs: Theirs) -> float:
    """Return the factor that brings their lengths to mm, and say what it means."""
    whole = np.concatenate([boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)])[None]
    ratio = float(np.exp(np.mean(np.log(_sizes(whole)[0].clip(1e-9)) - np.log((ref.high - ref.low)[:2]))))
    if any("how large a pixel" in note for note in notes):
        return 1.0 / ratio
    for factor, name in ((25.4, "25.4 times too large: millimetres read as inches"),
                         (1 / 25.4, "25.4 times too small: inches read as millimetres")):  # fmt: skip
        if abs(ratio / factor - 1) < 0.05:
            faults.append(f"the file is {name}")
            return 1.0 / factor
    return 1.0


def _heights(
    ref: Reference, theirs: Theirs, z: Floats, thickness: float, boxes: Floats, areas: Floats
) -> tuple[str, bool, float]:
    """Return what their heights mean, whether the shape told, and what to add to them."""
    if theirs.z_is == "number":
        return "middle", False, 0.0
    bases = {0.0: None, float(ref.low[2]): None}
    tried = [(name, base) for base in bases for name in _SHIFT]
    habit = theirs.z_is or "middle"
    scores = {}
    for name, base in tried:
        cut = z + base + _SHIFT[name] * thickness
        order = np.argsort(cut)
        found, box = ref.outline(cut[order])
        off = np.sort(np.abs(_sizes(box) - _sizes(boxes[order])), axis=1).max(axis=1)
        if areas.any():  # as a mean offset of the boundary
            off = np.abs(found - areas[order]) / np.sqrt(found + areas[order] + 1e-9)
        scores[name, base] = float(np.mean(np.minimum(np.nan_to_num(off, nan=5.0), 5.0)))
    best = min(scores, key=lambda key: scores[key])
    usual = min(((habit, base) for base in bases), key=lambda key: scores[key])
    told = scores[best] < _CLEARLY * scores[usual] and scores[usual] > 0.003
    name, base = best if told else usual
    return name, told, base


def _place(
    ref: Reference, layers: list[TheirLayer], picked: list[int], heights: Floats, width: float,
    theirs: Theirs, shift: tuple[float, float] | str,
) -> tuple[str, Floats]:  # fmt: skip
    """Return turn and offset."""
    order = sorted(picked, key=lambda i: heights[i])
    cut = heights[order]
    _, ours = ref.outline(cut)
    points, layer = _samples([layers[i] for i in order])
    target = 0.0 if any(layers[i].loops for i in order) else -width / 2
    boxes = np.array([_box(layers[i], width) for i in order])
    centres, wanted = _centres(boxes), _centres(ours)
    fixed = np.zeros(2) if shift == "none" else None if isinstance(shift, str) else np.array(shift, float)
    starts = {}
    for name, turn in TURNS.items():
        off = np.nanmedian(wanted - centres @ np.array(turn).T, axis=0)
        starts[name] = np.nan_to_num(off) if fixed is None else fixed
    clouds = {name: points @ np.array(TURNS[name]).T + starts[name] for name in TURNS}
    misses = _misses(ref, cut, list(clouds.values()), layer, target)
    scores = dict(zip(TURNS, (float(np.mean(np.minimum(np.abs(m), 2.0))) for m in misses), strict=True))
    best = min(scores, key=lambda key: scores[key])
    turned = best if scores[best] < _CLEARLY * scores[""] and scores[""] > 0.05 else ""
    offset = starts[turned]
    if fixed is None:
        offset = _refined(ref, cut, clouds[turned] - offset, offset, layer, target)
    return turned, offset


def _samples(layers: list[TheirLayer]) -> tuple[Floats, np.ndarray]:
    """Return some hundred points of each layer."""
    found, which = [], []
    for i, k in enumerate(layers):
        points = _wall_points(k)
        if k.loops:
            points = spread(*segments_of([k.loops])[:2], 1.0).points
        points = points[:: max(1, len(points) // 300)]
        found.append(points)
        which.append(np.full(len(points), i))
    return np.concatenate(found), np.concatenate(which)


def _centres(boxes: Floats) -> Floats:
    return (boxes[:, :2] + boxes[:, 2:]) / 2


def _misses(ref: Reference, cut: Floats, clouds: list[Floats], layer: np.ndarray, target: float) -> list[Floats]:
    """Return by how much the points of each cloud miss where they should be, mm outward."""
    found = [np.zeros(len(layer)) for _ in clouds]
    for boundary in ref.boundaries(cut):
        mine = np.flatnonzero((layer >= boundary.first) & (layer < boundary.last))
        asked = np.concatenate([c[mine] for c in clouds])
        got = boundary.distance(asked, np.tile(layer[mine] - boundary.first, len(clouds))) - target
        for values, part in zip(found, np.split(got, len(clouds)), strict=True):
            values[mine] = part
    return found


def _refined(ref: Reference, cut: Floats, points: Floats, offset: Floats, layer: np.ndarray, target: float) -> Floats:
    """Return the offset at which the points miss least, by least squares on those that nearly fit."""
    step, near = 0.02, 1.0
    for _ in range(4):
        shifts = [np.zeros(2), np.array([step, 0]), np.array([-step, 0]), np.array([0, step]), np.array([0, -step])]
        e, px, mx, py, my = _misses(ref, cut, [points + offset + s for s in shifts], layer, target)
        slope = np.stack([px - mx, py - my], axis=1) / (2 * step)
        keep = (np.abs(e) < near) & (np.abs(np.hypot(*slope.T) - 1) < 0.2)
        if keep.sum() < 20 or np.linalg.cond(slope[keep].T @ slope[keep]) > 1e6:
            break
        offset = offset - np.linalg.lstsq(slope[keep], e[keep], rcond=None)[0]
        near = max(0.1, 3 * float(np.median(np.abs(e[keep]))))
    return np.asarray(np.round(offset, 5))


def _moved(layer: TheirLayer, turn: Floats, offset: Floats) -> TheirLayer:
    """Return a layer in another frame; a mirror reverses what it turns over, so that solids stay left."""
    flip = -1 if np.linalg.det(turn) < 0 else 1
    beads = layer.beads
    if beads is not None:
        beads = Beads(beads.points @ turn.T + offset, beads.offsets, beads.role, beads.width)
    return replace(
        layer,
        loops=[(p @ turn.T + offset)[::flip] for p in layer.loops],
        scaffold=[(p @ turn.T + offset)[::flip] for p in layer.scaffold],
        beads=beads,
    )
