"""Whether the supports of another program hold every overhang."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .align import Alignment
from .findings import Finding, Measures
from .form import SUPPORT, Floats, TheirLayer
from .measure import HEIGHT_SLACK
from .outlines import Shape
from .picture import Canvas, canvas, lines_of
from .reference import Side, outlines
from .verdict import LOST, Report


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


def has_supports(layers: Sequence[TheirLayer], props: Sequence[TheirLayer]) -> bool:
    """Whether a file holds supports of another program."""
    beads = [k.beads for k in (*layers, *props) if k.beads is not None]
    return any((b.role == SUPPORT).any() for b in beads) or any(k.supports for k in layers)


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
    posts = _posts(found, [k.theirs for k in report.layers], heights, width)
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


@dataclass(frozen=True, slots=True)
class _Posts:
    """Tops of supports, ascending, and what stands there."""

    tops: Floats
    layers: list[TheirLayer]
    width: float

    def drawn(self, sheet: Canvas, low: float, high: float) -> NDArray[Any]:
        """Return where supports end between two heights."""
        image = np.zeros(sheet.size, np.uint8)
        for i in range(int(np.searchsorted(self.tops, low)), int(np.searchsorted(self.tops, high))):
            k = self.layers[i]
            if k.beads is not None:
                image |= sheet.strokes(*lines_of(k.beads, self.width, support=True))
            image |= sheet.filled(k.supports)
        return image


def _posts(found: Alignment, layers: list[TheirLayer], heights: Floats, width: float) -> _Posts:
    tops = np.concatenate([heights + found.thickness / 2, found.tops])
    order = np.argsort(tops, kind="stable")
    every = [*layers, *found.props]
    return _Posts(tops[order], [every[i] for i in order], width)


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
    side: Side, m: Measures, here: list[Shape], below: list[Shape], posts: _Posts, z: Floats, asked: Holding,
    width: float,
) -> None:  # fmt: skip
    """Measure one layer: what is in all slices of it, and above none of those below it."""
    import cv2

    points = [p for shape in here for p in shape]
    if not points:
        return
    pixel, step = side.grid.pitch / 2, float(z[1] - z[0])
    sheet = canvas(points, pixel, asked.reach + 2 * width)
    part = np.bitwise_and.reduce([sheet.filled(shape) for shape in here])
    under = np.bitwise_or.reduce([sheet.filled(shape) for shape in below])
    bottom, shelf = float(z.mean()), float(step / np.tan(np.radians(asked.angle)))
    asks = _may_overhang(cv2, part, under, shelf / sheet.pixel)
    m.overhang = m.unheld = 0.0
    window = _window(cv2, asks, max(shelf, asked.reach) / sheet.pixel)
    if window is None:
        return
    asks, whole, sheet = asks[window] > 0, sheet, sheet.cut(window)
    free = _distance(cv2, under[window]) * sheet.pixel - shelf
    over = asks & (free > 0)
    m.overhang = sheet.area(over)
    if not over.any():
        return
    slack = 0.05 * step
    post = posts.drawn(whole, bottom - asked.gap * step - slack, bottom + slack)[window]
    far = _distance(cv2, post) * sheet.pixel - asked.reach
    bare = over & (far > 0)
    m.unheld = sheet.area(bare)
    piece = sheet.largest(bare.astype(np.uint8))
    if piece:
        m.unheld_piece, m.unheld_x, m.unheld_y = piece
    least = width**2
    for sure, doubt in ((True, sheet.pixel), (False, -sheet.pixel)):
        worst = sheet.largest((asks & (free > doubt) & (far > doubt)).astype(np.uint8))
        if worst and worst[0] > least:
            area, x, y = worst
            text = f"overhang without support at ({x:.2f}, {y:.2f}), a piece of {area:.2f} mm2"
            m.findings.append(Finding("overhang", sure, text, (x, y)))
            return


def _may_overhang(cv2: Any, part: NDArray[Any], under: NDArray[Any], shelf: float) -> NDArray[Any]:
    """Return the pixels of a part that can lie farther from what is under it than a shelf less a pixel, and some more.

    What lies in a square about a pixel that is under it is nearer than half of the square's diagonal.
    """
    half = int(np.floor((shelf - 1) / np.sqrt(2) - 1e-6))
    if half < 0:
        return part
    near = cv2.dilate(under, np.ones((2 * half + 1, 2 * half + 1), np.uint8)) if half else under
    return np.asarray(part & (near ^ 1))


def _window(cv2: Any, mask: NDArray[Any], reach: float) -> tuple[slice, slice] | None:
    """Return the rows and columns about all pixels of a mask, and what lies within reach, pixels, of them."""
    left, low, wide, high = cv2.boundingRect(mask)
    if not wide:
        return None
    room = int(np.ceil(reach)) + 2
    return slice(max(low - room, 0), low + high + room), slice(max(left - room, 0), left + wide + room)


def _distance(cv2: Any, mask: NDArray[Any]) -> NDArray[Any]:
    """Return the distance of every pixel from a mask, pixels; far where it is empty."""
    if not mask.any():
        return np.full(mask.shape, 1e6, np.float32)
    return np.asarray(cv2.distanceTransform((mask == 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE))


def _forgive(
    side: Side, report: Report, layers: list[int], heights: Floats, posts: _Posts, asked: Holding, width: float
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
