"""Layers drawn as pictures: area of the difference, its largest pieces, and what no bead reaches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .findings import Measures, judge_area
from .form import SUPPORT, Beads, Floats, TheirLayer
from .frame import closed_walls
from .loops import area as signed_area
from .reference import Side, outlines

MOST_PIXELS = 1500  # along the longer side
SHIFT = 6  # fractional bits of the drawn coordinates
FAR = 1e6  # pixels from what is not there
Mask = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Canvas:
    """A picture of some square millimetres.

    Attributes
    ----------
    low : (2,) float64
        Where the lower left corner lies, mm.
    pixel : float
        mm.
    size : tuple of int
        Height and width, pixels.
    """

    low: Floats
    pixel: float
    size: tuple[int, int]

    def _fixed(self, lines: Sequence[Floats]) -> list[NDArray[np.int32]]:
        """Return lines as OpenCV takes them."""
        if not len(lines):
            return []
        fixed = np.round(((np.concatenate(lines) - self.low) / self.pixel - 0.5) * (1 << SHIFT)).astype(np.int32)
        ends = np.cumsum([len(p) for p in lines]).tolist()
        return [fixed[a:b] for a, b in zip([0, *ends[:-1]], ends, strict=True)]

    def filled(self, loops: Sequence[Floats], onto: Mask | None = None) -> Mask:
        """Return the insides of an odd number of loops, drawn onto what is there."""
        import cv2

        image = np.zeros(self.size, np.uint8) if onto is None else onto
        if len(loops):
            cv2.fillPoly(image, self._fixed(loops), 1, shift=SHIFT)
        return image

    def wound(self, loops: Sequence[Floats]) -> Mask:
        """Return where loops wind round, holes the other way."""
        count = np.zeros(self.size, np.int16)
        for p in loops:
            count += self.filled([p]) * np.int16(1 if signed_area(p) > 0 else -1)
        return np.asarray(count != 0, np.uint8)

    def strokes(self, lines: Sequence[Floats], widths: Floats) -> Mask:
        """Return what lines of some widths, mm, cover."""
        import cv2

        image = np.zeros(self.size, np.uint8)
        thick = np.round(widths / self.pixel).astype(int).clip(1, 1000)
        fixed = self._fixed(lines)
        for t in np.unique(thick).tolist():
            drawn = [p for p, mine in zip(fixed, (thick == t).tolist(), strict=True) if mine]
            cv2.polylines(image, drawn, False, 1, thickness=t, shift=SHIFT)
        return image

    def largest(self, mask: NDArray[Any], step: int = 1) -> tuple[float, float, float] | None:
        """Return area, mm^2, and middle of the largest connected piece; seen on every ``step``-th pixel."""
        import cv2

        seen = np.ascontiguousarray(mask[::step, ::step])
        left, low, wide, high = cv2.boundingRect(seen)
        if not wide:
            return None
        some = seen[low : low + high, left : left + wide]
        _, _, stats, centres = cv2.connectedComponentsWithStats(some, connectivity=4)
        top = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
        x, y = (self.low + (step * (centres[top] + (left, low)) + 0.5) * self.pixel).tolist()
        return float(stats[top, cv2.CC_STAT_AREA]) * (step * self.pixel) ** 2, x, y

    def area(self, mask: NDArray[Any]) -> float:
        """Return the area of a mask, mm^2."""
        return float(np.count_nonzero(mask)) * self.pixel**2


def distance(mask: Mask) -> NDArray[np.float32]:
    """Return the distance of every pixel from a mask, pixels; far where it is empty."""
    import cv2

    if not mask.any():
        return np.full(mask.shape, FAR, np.float32)
    return np.asarray(cv2.distanceTransform((mask == 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE))


def canvas(lines: Sequence[Floats], pixel: float, margin: float) -> Canvas:
    """Return a picture that holds all lines, of larger pixels where it would be too large."""
    points = np.concatenate(lines)
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    pixel = max(pixel, float((high - low).max()) / MOST_PIXELS)
    width, height = np.ceil((high - low) / pixel).astype(int).tolist()
    return Canvas(low, pixel, (height, width))


def draw(
    side: Side, heights: Floats, theirs: Sequence[TheirLayer], out: Sequence[Measures],
    differ: Sequence[bool], width: float,
) -> None:  # fmt: skip
    """Measure in drawings: the difference of some layers, which replaces what was summed, and what no bead reaches.

    Parameters
    ----------
    side : Reference or Run
    heights : (N,) float64
        Ascending heights of the layers, mm.
    theirs : sequence of TheirLayer
    out : sequence of Measures
    differ : sequence of bool
        Whether the difference of each layer is asked for.
    width : float
        Of beads that do not say theirs, mm.
    """
    held = outlines(side, heights)
    for k, z in enumerate(heights.tolist()):
        ours, beads = held[z], theirs[k].beads
        lines = [*ours, *theirs[k].loops, *([beads.points] if beads is not None and len(beads.points) else [])]
        if lines:
            sheet = canvas(lines, side.grid.pitch / (4 if differ[k] else 2), 1.0 + width)
            _draw(sheet, ours, theirs[k], out[k], differ[k], width)


def _draw(sheet: Canvas, ours: list[Floats], theirs: TheirLayer, m: Measures, differ: bool, width: float) -> None:
    a, b = sheet.filled(ours), sheet.filled(theirs.loops)
    if theirs.beads is not None:
        lines, widths = lines_of(theirs.beads, width)
        reached = sheet.strokes(lines, widths)
        bare = a & ~reached & 1
        m.bare, piece = sheet.area(bare), sheet.largest(bare, 2 if differ else 4)
        if piece:
            m.bare_piece, m.bare_x, m.bare_y = piece
        b = reached | sheet.wound(closed_walls(theirs.beads, width)) if differ else b
    if differ:
        missing, extra = a & ~b & 1, b & ~a & 1
        if theirs.beads is not None:  # of contours it is known better than pixels can tell
            m.area_theirs = m.area_ours + sheet.area(extra) - sheet.area(missing)
        m.area_xor = sheet.area(missing) + sheet.area(extra)
        judge_area(m)
        for name, mask in (("missing", missing), ("extra", extra)):
            piece = sheet.largest(mask)
            for word, value in zip(("piece", "x", "y"), piece or (), strict=False):
                setattr(m, f"{name}_{word}", value)


def lines_of(beads: Beads, width: float, support: bool = False) -> tuple[list[Floats], Floats]:
    """Return the lines of beads of the part, or of support, and their widths, mm."""
    chosen = np.flatnonzero((beads.role == SUPPORT) == support)
    wide = np.where(np.isfinite(beads.width), beads.width, width)[chosen]
    return [beads.points[beads.offsets[i] : beads.offsets[i + 1]] for i in chosen.tolist()], wide
