"""Pieces -> signed distance images, stored only in tiles near the boundary."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .device import Device
from .grid import Grid
from .tiles import OUTSIDE, RULES, Images, Pieces, ask_map, reach_of


def part_distance(
    device: Device, grid: Grid, near: Pieces, all_pieces: Pieces, wind: Any, layers: int,
    band: float, rule: str, images: Images, counter: Any, tangled: Any,
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:  # fmt: skip
    """Compute images 0 .. layers - 1: the sdf of the part within ``band`` pixels of its boundary.

    ``near`` gives the distance and ``all_pieces`` with ``wind`` the sign; no pixel within the band may lie out of their
    window. ``tangled``, (layers,) int32, gets the bit
    `tiles.WOUND` where a winding number is neither 0 nor 1.

    Returns
    -------
    where : (layers, tiles_y, tiles_x) int32
        The map of the images.
    flags : (layers,) int32
        ``tangled``.
    """
    window = near.window
    if window.tiles < grid.tiles:
        device.fill(images.map, layers * grid.tiles, np.int32, OUTSIDE)
    device.run_tiles(
        "part_distance", layers * window.tiles,
        *near[:2], *all_pieces[:2], wind, *window, (grid.tiles_x, grid.tiles_y),
        float(band), reach_of(band), float(images.scale), RULES[rule], images.map, images.pool, images.owner, counter,
        tangled,
    )  # fmt: skip
    where = ask_map(device, images, counter, 0, layers, grid)
    flags = device.get(tangled, layers, np.int32)
    return where(), flags
