"""Pieces of overlapping shells -> the pieces that bound their union."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .device import Device
from .tiles import RULES, Pieces


def find_contacts(device: Device, pieces: Pieces, layers: int) -> Any:
    """Return a buffer of (layers,) int32: 1 where any two pieces cross or touch.

    Where none do, and no pixel has a winding number other than 0 and 1 (`distance.part_distance` adds that), all pieces
    are boundary, which is the case for clean meshes and much cheaper to find out.
    """
    tangled = device.zeros("contacts", layers, np.int32)
    device.run_tiles("find_contacts", layers * pieces.window.tiles, *pieces[:2], *pieces.window, tangled)
    return tangled


def boundary_pieces(
    device: Device, pieces: Pieces, wind: Any, suspects: Any, layers: int, rule: str
) -> tuple[Pieces, NDArray[np.bool_]]:
    """Return the pieces, or parts of pieces, that bound the solid.

    Parameters
    ----------
    pieces, wind
        As from `bins.sort_pieces`: closed loops.
    suspects : buffer of (layers,) int32
        0 where all pieces are known to be boundary.
    rule : {"nonzero", "positive", "evenodd"}
        What winding numbers are solid.

    Returns
    -------
    boundary : Pieces
        ``pieces`` itself when all of them are boundary.
    tangled : (layers,) bool
        Layers where shells overlap, cross or touch.
    """
    tiles = layers * pieces.window.tiles
    count = device.zeros("boundary count", tiles, np.int32)
    tangled = device.zeros("tangled", layers, np.int32)
    where = (*pieces[:2], wind, *pieces.window, RULES[rule], suspects)
    device.run_tiles("find_boundary", tiles, *where, 0, count, tangled, pieces.pieces)
    flags = device.get(tangled, layers, np.int32)
    cut = (flags & 1) != 0
    if not flags.any():
        return pieces, cut
    start, total = device.places(count, tiles, "boundary start")
    boundary = device.scratch("boundary", 4 * total(), np.float32)
    device.run_tiles("find_boundary", tiles, *where, 1, count, tangled, boundary)
    return Pieces(boundary, start, pieces.window), cut
