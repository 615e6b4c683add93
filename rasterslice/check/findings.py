"""What is found out about a layer: numbers, and findings with their places."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..grid import TILE
from .form import Flags, Floats
from .loops import Ints
from .ours import REACH, Samples

CELL = 8  # pixels: deviations are summed in squares of this side
MOST = REACH * TILE - 4.0 - 1e-3  # pixels: farther off nothing is measured


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
    thin : float
        Radius of a disc that pixels cannot lose, when both sides are runs of ours, mm; else 0.
    lost : float
        The same, when theirs were traced between pixels and ours were not.
    shallow, deep : float
        How much less or more than half of its width deep an outer bead may lie, because no one says how wide it is, mm.
    unsaid : bool
        Whether beads bear no names, so that fill looks like walls.
    pixel : float
        Size of the pixels of pictures in black and white, mm; 0 of anything else.
    """

    tolerance: float
    uncertainty: float
    area: float
    spacing: float
    pitch: float
    width: float
    thin: float = 0.0
    lost: float = 0.0
    shallow: float = 0.0
    deep: float = 0.0
    unsaid: bool = False
    pixel: float = 0.0


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
    missing_piece: float = np.nan  # largest connected piece that theirs lacks, and its middle
    missing_x: float = np.nan
    missing_y: float = np.nan
    extra_piece: float = np.nan
    extra_x: float = np.nan
    extra_y: float = np.nan
    bare: float = np.nan  # part that no bead reaches, the largest piece of it and its middle
    bare_piece: float = np.nan
    bare_x: float = np.nan
    bare_y: float = np.nan
    overhang: float = np.nan  # part that needs support, and what of it has none
    unheld: float = np.nan
    unheld_piece: float = np.nan
    unheld_x: float = np.nan
    unheld_y: float = np.nan
    repeated: int = 0
    close: int = 0
    findings: list[Finding] = field(default_factory=list)


def least(limits: Limits) -> float:
    """Return the deviation at which doubts begin, mm; two runs, and the middles of pixels, are known as they stand."""
    known = limits.thin or limits.pixel
    return limits.tolerance if known else max(limits.tolerance - limits.uncertainty, limits.tolerance / 2)


def compare(
    theirs: Samples, outward: Floats, mine: Samples, inward: Floats, out: list[Measures], limits: Limits,
    name: str = "", unproven: tuple[Flags, Flags] | None = None,
) -> None:  # fmt: skip
    """Put the deviations of two boundaries, each from the other, into measures.

    Parameters
    ----------
    theirs, mine : Samples
    outward, inward : (N,) float64
        Signed distance of their samples from our solid, and of ours from theirs, mm.
    name : str
        What findings begin with.
    unproven : (N,) bool, (N,) bool, optional
        Samples of theirs and of ours that accuse nobody.
    """
    doubts = unproven or (np.zeros(len(outward), bool), np.zeros(len(inward), bool))
    a, b = np.abs(outward), np.abs(inward)
    both = [spans_of(theirs.layer, len(out)), spans_of(mine.layer, len(out))]
    xor = (
        np.bincount(theirs.layer, a * theirs.length, len(out)) + np.bincount(mine.layer, b * mine.length, len(out))
    ) / 2
    sums = np.bincount(theirs.layer, outward * theirs.length, len(out))
    lengths = np.bincount(theirs.layer, theirs.length, len(out))
    for i, m in enumerate(out):
        one, two = (v[o[s[i] : s[i + 1]]] for v, (o, s) in zip((a, b), both, strict=True))
        if len(one):
            m.to_ours, m.to_ours_95, m.mean = float(one.max()), float(np.percentile(one, 95)), sums[i] / lengths[i]
        if len(two):
            m.to_theirs, m.to_theirs_95 = float(two.max()), float(np.percentile(two, 95))
        m.area_xor = float(xor[i])
    both_of = [np.concatenate(pair) for pair in (
        (theirs.points, mine.points), (theirs.layer, mine.layer), (theirs.length, mine.length), (a, b), doubts,
    )]  # fmt: skip
    beyond = np.concatenate([outward > 0, inward < 0])
    for where, what in ((beyond, "extra"), (~beyond, "missing")):
        points, layer, length, off, doubt = (v[where] for v in both_of)
        pieces(points, layer, length, off, f"{name}{what}", out, limits, doubt)


def spans_of(layer: Ints, layers: int) -> tuple[Ints, Ints]:
    """Return an order by layer, and where each layer begins in it."""
    order = np.argsort(layer, kind="stable")
    return order, np.searchsorted(layer[order], np.arange(layers + 1))


def pieces(
    points: Floats, layer: Ints, length: Floats, deviation: Floats, what: str, out: list[Measures], limits: Limits,
    unproven: Flags | None = None,
) -> None:  # fmt: skip
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
    sure &= ~unproven[bad] if unproven is not None else True
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
        by = "at least " if farthest[top] >= MOST * limits.pitch else ""
        text = f"{what} at ({x:.2f}, {y:.2f}) by {by}{farthest[top]:.3f} mm, about {total[i]:.3f} mm2 in all"
        told = bool(proven[top] > limits.area)
        if not told and unproven is not None and unproven[here].any():
            text += "; pixels explain that"
        out[i].findings.append(Finding(what, told, text, (x, y)))


def judge_area(m: Measures) -> None:
    """Fill in the overlap of areas."""
    both = m.area_ours + (m.area_theirs if np.isfinite(m.area_theirs) else 0.0)
    xor = min(m.area_xor, both) if np.isfinite(m.area_xor) else both
    m.area_xor = xor
    m.iou = (both - xor) / (both + xor) if both > 0 else 1.0
