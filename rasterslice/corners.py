"""Sharp corners of the part's contour, put back from the segments that made it."""

from __future__ import annotations

from .device import Device
from .grid import Grid
from .tiles import Contours, Pieces


def restore_corners(device: Device, contours: Contours, near: Pieces, layers: int, grid: Grid) -> None:
    """TODO."""
