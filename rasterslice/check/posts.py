"""Tops of supports: where they stand, and whether places lie within reach of one."""

from __future__ import annotations

import numpy as np

from .align import Alignment
from .form import Floats
from .picture import Canvas, Mask, canvas, distance, lines_of
from .reference import Side

_FINER = 10  # coarse pixels in the reach of a support
#: Coarse pixels by which a distance seen there may be short: half of a diagonal at the place that is asked for, as much
#: where a line one pixel wide keeps to the middles of pixels, and what the pixels of a finer drawing add.
_SHORT = 2.5


class Posts:
    """Tops of supports, ascending, and what stands there.

    Parameters
    ----------
    side : Reference or Run
    found : Alignment
        Its layers may hold supports, and its props do.
    heights : (N,) float64
        Of the layers, mm.
    width : float
        Of beads that do not say theirs, mm.
    reach : float
        How far a support holds, seen from above, mm.
    """

    def __init__(self, side: Side, found: Alignment, heights: Floats, width: float, reach: float) -> None:
        tops = np.concatenate([heights + found.thickness / 2, found.tops])
        order = np.argsort(tops, kind="stable")
        every = [*found.layers, *found.props]
        self._tops, self._layers = tops[order], [every[i] for i in order]
        self._width, self._reach = width, reach
        pixel = max(reach / _FINER, side.grid.pitch / 2)
        self._coarse = canvas([np.array([side.low[:2], side.high[:2]])], pixel, reach + 2 * pixel)
        self._seen: dict[int, Mask] = {}

    def _between(self, low: float, high: float) -> range:
        return range(int(np.searchsorted(self._tops, low)), int(np.searchsorted(self._tops, high)))

    def drawn(self, sheet: Canvas, low: float, high: float) -> Mask:
        """Return where supports end between two heights."""
        image = np.zeros(sheet.size, np.uint8)
        for i in self._between(low, high):
            k = self._layers[i]
            if k.beads is not None:
                image |= sheet.strokes(*lines_of(k.beads, self._width, support=True))
            image |= sheet.filled(k.supports)
        return image

    def hold(self, places: Floats, low: float, high: float) -> bool:
        """Whether all places certainly lie within reach of supports that end between two heights, by more than a pixel.

        It is asked of a coarse drawing of their middle lines; the layers must come in ascending order.
        """
        between = self._between(low, high)
        for i in [i for i in self._seen if i < between.start]:
            del self._seen[i]
        sheet, image = self._coarse, np.zeros(self._coarse.size, np.uint8)
        for i in between:
            if i not in self._seen:
                self._seen[i] = self._thin(i)
            image |= self._seen[i]
        cell = ((places - sheet.low) / sheet.pixel).astype(np.int64).clip(0, np.array(sheet.size)[::-1] - 1)
        away = distance(image)[cell[:, 1], cell[:, 0]]
        return bool(((away + _SHORT) * sheet.pixel <= self._reach).all())

    def _thin(self, i: int) -> Mask:
        """Draw the middle lines of one layer."""
        k, sheet = self._layers[i], self._coarse
        image = sheet.filled(k.supports)
        if k.beads is not None:
            lines, _ = lines_of(k.beads, self._width, support=True)
            image |= sheet.strokes(lines, np.full(len(lines), sheet.pixel))
        return image
