"""The running union of the slices above, grown by the buffer, minus the part."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .device import Device
from .grid import TILE, Grid
from .isoline import isoline
from .tiles import PIXELS, Images, Pieces, find_repeats, new_images, own_keys, put_keys, quanta, reach_of, read_map

SLACK = 3.5  # tiles that come this near to the level, in pixels, are kept: slopes at the level need them
CREASE = 20.0  # least turn of a corner of the grown union, degrees: its arcs have the radius of the buffer
CELLS = 8.0  # how far from a piece of a contour, at most, the pixels lie that made it, pixels
BOUND = 4.5  # the union is known this far beyond the level, pixels: slopes at the level need it


class Union:
    """The union of all slices so far, from the top down.

    Parameters
    ----------
    buffer : float
        How far it is grown, pixels.
    own : bool
        Whether a slice counts as above itself.
    finest : int
        Quanta per pixel of the part's images, which the union does not exceed.
    """

    def __init__(self, device: Device, grid: Grid, buffer: float, own: bool, finest: int) -> None:
        self._device, self._grid, self._own = device, grid, own
        self.bound = buffer + BOUND
        self.scale = min(finest, quanta(self.bound))
        self.level = round(buffer * self.scale)
        self._shift = finest.bit_length() - self.scale.bit_length()
        self._shape = device.scratch("union", grid.tiles * PIXELS, np.int16)
        self._state = device.zeros("union state", grid.tiles, np.int32)

    def descend(self, near: Pieces, part: Images, layers: int) -> tuple[Images, NDArray[np.int32]]:
        """Pass a batch of layers; return what lies above each of them, near the level, and its map."""
        grid = self._grid
        above, above_counter = new_images(self._device, "above", layers, grid, self.scale)
        self._device.run_tiles(
            "grow_union", grid.tiles,
            near.pieces, near.start, part.map, part.pool, layers, grid.tiles_x, grid.tiles_y,
            reach_of(self.bound), int(self._own), float(self.bound), float(self.scale), self.level,
            round(SLACK * self.scale), self._shift, self._shape, self._state,
            above.map, above.pool, above.owner, above_counter,
        )  # fmt: skip
        slots = self._device.ask(above_counter, 1, np.int32)
        where = read_map(self._device, above, 0, layers, grid)
        above.slots = int(slots.read()[0])
        return above, where


def scaffold_distance(
    device: Device, grid: Grid, above: Images, where: NDArray[np.int32], level: int, band: tuple[float, float],
    images: Images, counter: Any,
) -> NDArray[np.int32]:  # fmt: skip
    """Compute images layers .. 2 * layers - 1: the sdf of the scaffold, within ``band`` (inside, outside) pixels.

    The contour of the union ``above``, with its map ``where``, at ``level`` gives the distance. Most of the union is the same in layer after
    layer: its contour is taken, and measured to, only where it is not.

    Parameters
    ----------
    images, counter
        Hold the part as their first ``layers`` images.

    Returns
    -------
    (2 * layers, tiles_y, tiles_x) int32
        The map of all images.
    """
    layers = len(where)
    source = find_repeats(where)
    keys = put_keys(device, "grown keys", own_keys(where, source))
    grown = isoline(device, grid, above, layers, keys, level, "grown", CREASE)
    around = max(1, -(-int(max(band) + CELLS) // TILE))
    near = source if around == 1 else find_repeats(where, around)
    device.run_tiles(
        "scaffold_distance", grid.tiles,
        grown.pieces, grown.start, device.put("grown source", source),
        device.put("grown fresh", (near.ravel() == np.arange(near.size, dtype=np.int32)).view(np.uint8)),
        above.map, above.pool, level, layers, grid.tiles_x, grid.tiles_y,
        float(band[0]), float(band[1]), reach_of(max(band)), float(images.scale),
        images.map, images.pool, images.owner, counter,
    )  # fmt: skip
    slots = device.ask(counter, 1, np.int32)
    found = read_map(device, images, 0, 2 * layers, grid)
    images.slots = int(slots.read()[0])
    return found
