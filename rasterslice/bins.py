"""Segments of a batch of layers, cut into short pieces and sorted by the tile they lie in."""

from __future__ import annotations

from typing import Any

import numpy as np

from .device import Device
from .grid import Grid
from .tiles import Pieces


def sort_pieces(
    device: Device, grid: Grid, segments: Any, slice_of: Any, span: tuple[int, int], top: int, layers: int
) -> tuple[Pieces, Any]:
    """Cut and sort the segments of a batch.

    Parameters
    ----------
    segments, slice_of : buffers
        As in `section.Sections`.
    span : (int, int)
        Segments of the batch.
    top, layers : int
        Layer i of the batch is slice ``top - i``.

    Returns
    -------
    pieces : Pieces
    wind : buffer of (layers, height, tiles_x) int32
        Winding number at the first pixel of each row of each tile.
    """
    tiles, rows = layers * grid.tiles, layers * grid.height
    count = device.zeros("piece count", tiles, np.int32)
    wind = device.zeros("wind", rows * grid.tiles_x, np.int32)
    where = (segments, slice_of, *span, top, grid.tiles_x, grid.tiles_y)
    items = span[1] - span[0]
    device.run("count_pieces", items, *where, count, wind, group=64)
    device.run("sum_rows", rows, wind, grid.tiles_x, group=16)
    start, cursor, sums = device.offsets(count, tiles, "piece start")
    pieces = device.scratch("pieces", 4 * int(sums[-1]), np.float32)
    device.run("place_pieces", items, *where, cursor, pieces, group=64)
    return Pieces(pieces, start), wind
