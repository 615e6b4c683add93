"""Segments of a batch of layers, cut into short pieces and sorted by the tile they lie in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .device import Device
from .grid import TILE, Grid
from .tiles import Pieces
from .window import Window, whole


class Counted(NamedTuple):
    """Pieces that are being counted.

    Attributes
    ----------
    counts, start : buffers of int32
        Where the pieces of each tile begin; counts advance.
    total : callable
        Waits for the number of all.
    wind : buffer of (layers, 16 tiles_y, tiles_x) int32
        Winding number at the first pixel of each row of each tile of the window.
    where : tuple
        What places them.
    items, layers : int
        Segments, and layers.
    window : Window
    """

    counts: Any
    start: Any
    total: Callable[[], int]
    wind: Any
    where: tuple[Any, ...]
    items: int
    layers: int
    window: Window


def count_pieces(
    device: Device, window: Window, segments: Any, slice_of: Any, span: tuple[int, int], top: int, layers: int
) -> Counted:
    """Begin to cut and sort the segments of a batch: count their pieces, and wait for nothing.

    Parameters
    ----------
    window : Window
        Where all pieces lie.
    segments, slice_of : buffers
        As in `section.Sections`.
    span : (int, int)
        Segments of the batch.
    top, layers : int
        Layer i of the batch is slice ``top - i``.
    """
    tiles, rows = layers * window.tiles, layers * window.tiles_y * TILE
    count = device.zeros("piece count", tiles, np.int32)
    wind = device.zeros("wind", rows * window.tiles_x, np.int32)
    where = (segments, slice_of, *span, top, *window)
    items = span[1] - span[0]
    device.run("count_pieces", items, *where, count, wind, group=64)
    start, total = device.places(count, tiles, "piece start")
    device.run("sum_rows", rows, wind, window.tiles_x, group=16)
    return Counted(count, start, total, wind, where, items, layers, window)


def place_pieces(device: Device, counted: Counted) -> Pieces:
    """Sort pieces that have been counted."""
    pieces = device.scratch("pieces", 4 * counted.total(), np.float32)
    device.run("place_pieces", counted.items, *counted.where, counted.counts, pieces, group=64)
    return Pieces(pieces, counted.start, counted.window)


def sort_pieces(
    device: Device, grid: Grid, segments: Any, slice_of: Any, span: tuple[int, int], top: int, layers: int
) -> tuple[Pieces, Any]:
    """Cut and sort the segments of a batch by the tiles of a grid, at once: parameters as for `count_pieces`.

    Returns
    -------
    pieces : Pieces
    wind : buffer of (layers, height, tiles_x) int32
        Winding number at the first pixel of each row of each tile.
    """
    counted = count_pieces(device, whole(grid), segments, slice_of, span, top, layers)
    return place_pieces(device, counted), counted.wind
