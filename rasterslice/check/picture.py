"""Layers that do not pass, drawn: area of the difference, and its largest pieces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .findings import Measures
from .form import Floats
from .loops import chains
from .reference import Side

MOST_PIXELS = 1500  # along the longer side
SHIFT = 6  # fractional bits of the drawn coordinates


def draw_differences(side: Side, heights: Floats, theirs: Sequence[Sequence[Floats]], out: Sequence[Measures]) -> None:
    """Replace the first-order areas of layers by those of drawings, and add the largest pieces.

    Parameters
    ----------
    side : Reference or Run
    heights : (N,) float64
        Ascending heights of the layers, mm.
    theirs : sequence of lists of (M, 2) float64
        Their loops, mm.
    out : sequence of Measures
    """
    for boundary in side.boundaries(heights):
        pieces, layer = boundary.pieces()
        for i in range(boundary.last - boundary.first):
            k = boundary.first + i
            ours = [side.grid.to_mm(p) for p in chains(pieces[layer == i])]
            _draw(ours, theirs[k], side.grid.pitch / 4, out[k])


def _draw(ours: Sequence[Floats], theirs: Sequence[Floats], pixel: float, m: Measures) -> None:
    import cv2

    if not len(ours) and not len(theirs):
        return
    points = np.concatenate([*ours, *theirs])
    low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    pixel = max(pixel, float((high - low).max()) / MOST_PIXELS)
    size = tuple(np.ceil((high - low) / pixel).astype(int).tolist())

    def mask(loops: Sequence[Floats]) -> NDArray[Any]:
        image = np.zeros(size[::-1], np.uint8)
        drawn = [np.round((p - low) / pixel * (1 << SHIFT)).astype(np.int32) for p in loops]
        if drawn:
            cv2.fillPoly(image, drawn, 1, shift=SHIFT)
        return image

    a, b = mask(ours), mask(theirs)
    m.area_xor = float((a != b).sum()) * pixel**2
    either = float((a | b).sum())
    m.iou = float((a & b).sum()) / either if either else 1.0
    for name, piece in (("missing", a & ~b & 1), ("extra", b & ~a & 1)):
        count, _, stats, centres = cv2.connectedComponentsWithStats(piece, connectivity=4)
        if count > 1:
            top = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
            x, y = (low + (centres[top] + 0.5) * pixel).tolist()
            area = float(stats[top, cv2.CC_STAT_AREA]) * pixel**2
            setattr(m, f"{name}_piece", area)
            setattr(m, f"{name}_x", x)
            setattr(m, f"{name}_y", y)
