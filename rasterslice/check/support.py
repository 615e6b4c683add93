"""Whether the supports of another program hold every overhang."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .findings import Finding, Measures
from .form import SUPPORT, Floats, Theirs
from .loops import Ints
from .measure import HEIGHT_SLACK
from .outlines import Shape
from .picture import FAR, Canvas, Mask, canvas, distance
from .posts import Posts
from .reference import Side, outlines
from .verdict import LOST, Report

_MANY = 1 << 19  # pixels that are looked at one by one, at most


@dataclass(frozen=True, slots=True)
class Holding:
    """When an overhang is held.

    Attributes
    ----------
    gap : float
        A support, or the part itself, may end this far below it, layers.
    reach : float
        No place of it may lie farther than this from a support, seen from above, mm; nan: three widths.
    angle : float
        What rises less steeply than this above the level is an overhang, degrees.
    """

    gap: float = 2.0
    reach: float = np.nan
    angle: float = 40.0


def has_supports(theirs: Theirs) -> bool:
    """Whether a file holds supports of another program.

    A raft, which lies below the part, holds nothing up; and one layer of support beads is a wrong name for others.
    """
    bottom = min((k.z for k in theirs.layers), default=math.inf)
    beads = [k.beads for k in (*theirs.layers, *theirs.props) if k.beads is not None and k.z >= bottom]
    return sum(bool((b.role == SUPPORT).any()) for b in beads) > 1 or any(k.supports for k in theirs.layers)


def check_supports(side: Side, report: Report, holding: Holding) -> list[str]:
    """Add overhangs that nothing holds to the findings of each layer; return what was asked, in words.

    Parameters
    ----------
    side : Reference or Run
    report : Report
    holding : Holding
    """
    found, width = report.alignment, report.limits.width
    reach = holding.reach if np.isfinite(holding.reach) else 3 * width
    asked = Holding(holding.gap, reach, holding.angle)
    heights = np.array([k.z for k in report.layers])
    posts = Posts(side, found, heights, width, reach)
    layers = _overhanging(side, report, heights)
    deep = 1 + int(asked.gap)
    slices = outlines(side, heights[sorted({j for k in layers for j in range(max(k - deep, 0), k + 1)})])
    doubtful = []
    for k in layers:
        m, below = report.layers[k].measures, [slices[z] for z in heights[max(k - deep, 0) : k]]
        _one(side, m, [slices[heights[k]]], below, posts, heights[k - 1 : k + 1], asked, width)
        if any(f.what == "overhang" and f.sure for f in m.findings):
            doubtful.append(k)
    _forgive(side, report, doubtful, heights, posts, asked, width)
    return [
        f"overhangs less steep than {asked.angle:g} degrees must have a support within {asked.reach:g} mm, "
        f"seen from above, at most {asked.gap:g} layers below"
    ]


def _overhanging(side: Side, report: Report, heights: Floats) -> list[int]:
    """Return the layers that may overhang: not on the ground, and where the parameters want a scaffold below."""
    low, high = (float(v[2]) for v in (side.low, side.high))
    first, last = (low + f * (high - low) for f in side.params.scaffold_subset)
    t = report.alignment.thickness
    return [
        k for k in range(1, len(heights))
        if report.layers[k].where != LOST and 1e-6 < heights[k] - heights[k - 1] < 1.5 * t
        and first <= heights[k] - t and heights[k] <= last + t
    ]  # fmt: skip


def _one(
    side: Side, m: Measures, here: list[Shape], below: list[Shape], posts: Posts, z: Floats, asked: Holding,
    width: float,
) -> None:  # fmt: skip
    """Measure one layer: what is in all slices of it, and above none of those below it."""
    points = [p for shape in here for p in shape]
    if not points:
        return
    pixel, step = side.grid.pitch / 2, float(z[1] - z[0])
    sheet = canvas(points, pixel, asked.reach + 2 * width)
    part = np.bitwise_and.reduce([sheet.filled(shape) for shape in here])
    under = np.zeros(sheet.size, np.uint8)
    for shape in below:
        sheet.filled(shape, under)
    bottom, shelf = float(z.mean()), float(step / np.tan(np.radians(asked.angle)))
    asks = _may_overhang(part, under, shelf / sheet.pixel)
    free = _distance_at(under, asks, shelf / sheet.pixel + 1) * sheet.pixel - shelf
    over = free > 0
    m.overhang, m.unheld = float(np.count_nonzero(over)) * sheet.pixel**2, 0.0
    between = (bottom - (asked.gap + 0.05) * step, bottom + 0.05 * step)
    if not over.any() or posts.hold(sheet.low + (asks[:, ::-1] + 0.5) * sheet.pixel, *between):
        return
    far = _distance_at(posts.drawn(sheet, *between), asks, asked.reach / sheet.pixel + 1) * sheet.pixel - asked.reach
    bare = over & (far > 0)
    m.unheld = float(np.count_nonzero(bare)) * sheet.pixel**2
    piece = sheet.largest(_mask(sheet, asks[bare]))
    if piece:
        m.unheld_piece, m.unheld_x, m.unheld_y = piece
    least = width**2
    for sure, doubt in ((True, sheet.pixel), (False, -sheet.pixel)):
        worst = sheet.largest(_mask(sheet, asks[(free > doubt) & (far > doubt)]))
        if worst and worst[0] > least:
            area, x, y = worst
            text = f"overhang without support at ({x:.2f}, {y:.2f}), a piece of {area:.2f} mm2"
            m.findings.append(Finding("overhang", sure, text, (x, y)))
            return


def _may_overhang(part: Mask, under: Mask, shelf: float) -> Ints:
    """Return row and column of the pixels that can lie farther from what is under a part than a shelf less a pixel.

    What lies in a square about a pixel that is under it is nearer than half of the square's diagonal.
    """
    import cv2

    half = int(np.floor((shelf - 1) / np.sqrt(2) - 1e-6))
    if half > 0:
        under = np.asarray(cv2.dilate(under, np.ones((2 * half + 1, 2 * half + 1), np.uint8)), np.uint8)
    found = np.flatnonzero((part & (under ^ 1) if half >= 0 else part).ravel().view(bool))  # all are 0 or 1
    return np.column_stack(np.divmod(found, part.shape[1]))


def _distance_at(mask: Mask, places: Ints, reach: float) -> Floats:
    """Return how far some pixels are from a mask, pixels; what is farther than a reach need not be exact."""
    if len(places) == 0:
        return np.empty(0)
    ring = int(np.ceil(reach))
    if len(places) * (2 * ring + 1) ** 2 > _MANY:
        low, high = places.min(axis=0), places.max(axis=0) + 1
        first = (low - ring - 1).clip(min=0)
        seen = distance(mask[first[0] : high[0] + ring + 1, first[1] : high[1] + ring + 1])
        return np.asarray(seen[tuple((places - first).T)], np.float64)
    beside = np.indices((2 * ring + 1, 2 * ring + 1)).reshape(2, -1).T - ring
    away = np.hypot(*beside.T)
    found = np.pad(mask, ring)[places[:, :1] + beside[:, 0] + ring, places[:, 1:] + beside[:, 1] + ring]
    return np.asarray(np.where(found > 0, away, FAR).min(axis=1))


def _mask(sheet: Canvas, places: Ints) -> Mask:
    """Return a picture of some pixels."""
    image = np.zeros(sheet.size, np.uint8)
    image[places[:, 0], places[:, 1]] = 1
    return image


def _forgive(
    side: Side, report: Report, layers: list[int], heights: Floats, posts: Posts, asked: Holding, width: float
) -> None:
    """Unsay what goes away when our slices may lie a little higher or lower."""
    if not layers:
        return
    near = {k: range(max(k - 1 - int(asked.gap), 0), k + 1) for k in layers}
    moves = (-HEIGHT_SLACK, HEIGHT_SLACK)
    slices = outlines(side, np.array(sorted({heights[j] + s for k in layers for j in near[k] for s in moves})))
    for k in layers:
        here = [slices[heights[k] + s] for s in moves]
        below = [slices[heights[j] + s] for j in near[k][:-1] for s in moves]
        again = Measures()
        _one(side, again, here, below, posts, heights[k - 1 : k + 1], asked, width)
        if not any(f.what == "overhang" and f.sure for f in again.findings):
            for finding in report.layers[k].measures.findings:
                if finding.what == "overhang":
                    finding.sure = False
                    finding.text += f"; within what a slice {HEIGHT_SLACK:g} mm higher or lower may be"
