"""The running union of the slices above, grown by the buffer, minus the part."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .device import Device
from .grid import TILE, Grid
from .isoline import isoline
from .repeats import find_repeats
from .tiles import PIXELS, Images, Pieces, ask_map, new_images, put_keys, quanta, reach_of

SLACK = 3.5  # tiles that come this near to the level, in pixels, are kept: slopes at the level need them
CREASE = 20.0  # least turn of a corner of the grown union, degrees: its arcs have the radius of the buffer
CELLS = 8.0  # how far from a piece of a contour, at most, the pixels lie that made it, pixels
BOUND = 4.5  # the union is known this far beyond the level, pixels: slopes at the level need it


#: The images of a union above some layers, and what gives their map.
Above = tuple[Images, Callable[[], NDArray[np.int32]]]


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

    def descend(self, near: Pieces, part: Images, layers: int) -> Above:
        """Begin to pass a batch of layers; return what lies above each of them, near the level."""
        grid = self._grid
        above, above_counter = new_images(self._device, "above", layers, grid, self.scale)
        self._device.run_tiles(
            "grow_union", grid.tiles,
            *near[:2], near.window.corner, near.window[1:], part.map, part.pool, layers, grid.tiles_x, grid.tiles_y,
            reach_of(self.bound), int(self._own), float(self.bound), float(self.scale), self.level,
            round(SLACK * self.scale), self._shift, self._shape, self._state,
            above.map, above.pool, above.owner, above_counter,
        )  # fmt: skip
        return above, ask_map(self._device, above, above_counter, 0, layers, grid)


def scaffold_distance(
    device: Device, grid: Grid, above: Images, above_map: Callable[[], NDArray[np.int32]], level: int,
    band: tuple[float, float], images: Images, counter: Any,
) -> Callable[[], NDArray[np.int32]]:  # fmt: skip
    """Begin to compute images layers .. 2 * layers - 1: sdf of the scaffold within ``band`` (inside, outside) pixels.

    The contour of the union ``above`` at ``level`` gives the distance. Most of the union is the same in layer after
    layer: its contour is taken, and measured to, only where it is not.

    Parameters
    ----------
    images, counter
        Hold the part as their first ``layers`` images.

    Returns
    -------
    callable
        Gives the map of the scaffolds, (layers, tiles_y, tiles_x) int32.
    """
    where = above_map()
    layers = len(where)
    repeats = find_repeats(where)
    keys = put_keys(device, "grown keys", repeats.own(where))
    grown = isoline(device, grid, above, layers, keys, level, "grown", CREASE)
    around = max(1, -(-int(max(band) + CELLS) // TILE))
    near = repeats if around == 1 else find_repeats(where, around)
    device.run_tiles(
        "scaffold_distance", grid.tiles,
        *grown, device.put("grown source", repeats.source),
        device.put("grown fresh", near.new.view(np.uint8)),
        above.map, above.pool, level, layers, grid.tiles_x, grid.tiles_y,
        float(band[0]), float(band[1]), reach_of(max(band)), float(images.scale),
        images.map, images.pool, images.owner, counter,
    )  # fmt: skip
    return ask_map(device, images, counter, layers, layers, grid)
