"""How a batch begins: its pieces are sorted and held against each other, while the batch before it is finished."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from .bins import count_pieces, place_pieces
from .device import Answer, Device
from .grid import Grid
from .overlap import find_contacts
from .section import Sections
from .tiles import Pieces
from .window import window_around


class Sorted(NamedTuple):
    """The pieces of a batch.

    Attributes
    ----------
    pieces : Pieces
    wind : buffer
        As in `bins.Counted`.
    suspects : buffer of (layers,) int32
        As from `overlap.find_contacts`; what is read of it is ``touching``.
    touching : Answer
    """

    pieces: Pieces
    wind: Any
    suspects: Any
    touching: Answer


class Sorting:
    """Sorts the pieces of slices start .. end - 1, by the tiles that they lie in and ``reach`` more on each side.

    Attributes
    ----------
    start, end : int
    steps : iterator
        Each step begins something on the device, and waits for little; who waits for something else takes one first.
    """

    def __init__(self, device: Device, grid: Grid, sections: Sections, start: int, end: int, reach: int) -> None:
        self.start, self.end = start, end
        self._device, self._grid, self._sections, self._reach = device, grid, sections, reach
        self._made: Sorted | None = None
        self.steps: Iterator[None] = self._steps()

    def _steps(self) -> Iterator[None]:
        device, sections, start, end = self._device, self._sections, self.start, self.end
        layers, window = end - start, window_around(self._grid, sections.box(start, end), self._reach)
        span = int(sections.offsets[start - sections.first]), int(sections.offsets[end - sections.first])
        counted = count_pieces(device, window, sections.segments, sections.slice_of, span, end - 1, layers)
        yield
        pieces = place_pieces(device, counted)
        suspects = find_contacts(device, pieces, layers)
        self._made = Sorted(pieces, counted.wind, suspects, device.ask(suspects, layers, np.int32))
        yield

    def result(self) -> Sorted:
        """Take the steps that are left, and return what they made."""
        for _ in self.steps:
            pass
        assert self._made is not None
        return self._made
