"""Pieces of boundary, images of distance, contours: what the stages hand to each other, in pixels."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .device import Array, Device
from .errors import UsageError
from .grid import TILE, Grid
from .window import Window

PIECE = 8.0  # longest piece, pixels; the kernels rely on it
OUTSIDE, INSIDE = -1, -2  # tiles without pixels; the kernels rely on these
PIXELS = TILE * TILE
FINEST = 4096  # quanta per pixel, at most
ROOM = 8  # pixels behind the last tile: kernels that look for corners load eight at a time
WOUND = 2  # bit of a layer that has a winding number other than 0 and 1; the kernels rely on it
#: Which winding numbers are solid, as the kernels number the rules.
RULES = {"nonzero": 0, "positive": 1, "evenodd": 2}


class Pieces(NamedTuple):
    """Short segments sorted by (layer, tile), on the device.

    Attributes
    ----------
    pieces : buffer of (N, 4) float32
        x0, y0, x1, y1 in pixels; each reaches at most 4 pixels beyond its tile.
    start : buffer of (layers * window.tiles + 1,) int32
        First piece of each tile of the window.
    window : Window
        Where all of them lie.
    """

    pieces: Any
    start: Any
    window: Window


class Keys(NamedTuple):
    """Tiles of images to work on: ``number`` of them, image * tiles + tile, in a buffer of int32."""

    buffer: Any
    number: int


class Contours(NamedTuple):
    """Loops of some images.

    Attributes
    ----------
    points : (N, 2) float32
        Pixels; outer loops counter-clockwise, holes clockwise.
    first : (images + 1,) int64
        Points of image i are ``points[first[i]:first[i + 1]]``.
    ends : list of int64 arrays
        Of each image: ends of its loops, counted from its first point.
    dropped : (images,) int64
        Loops that could not hold three points.
    dense : (images,) int64
        Loops that kept every point, closer than the least spacing, because they met something otherwise.
    """

    points: NDArray[np.float32]
    first: NDArray[np.int64]
    ends: list[NDArray[np.int64]]
    dropped: NDArray[np.int64]
    dense: NDArray[np.int64]


class Traced(NamedTuple):
    """Loops of some images, on the device.

    Attributes
    ----------
    points : buffer of (N, 2) float32
        Pixels; an image has its own run of it, with room behind.
    following : buffer of (N,) int32
        Next point of each.
    place : buffer of (images + 1,) int32
        First point of each image.
    totals : buffer of (images, 4) int32
        Points, loops, dropped loops and 0 of each image.
    """

    points: Any
    following: Any
    place: Any
    totals: Any


def reach_of(radius: float) -> int:
    """Return how many tiles around a tile hold all pieces within a radius in pixels."""
    return int(np.ceil((radius + PIECE / 2) / TILE))


@dataclass(slots=True, eq=False, repr=False)
class Images:
    """Signed distances of some images, in tiles.

    Attributes
    ----------
    map : buffer of (images * tiles,) int32
        Slot of each tile, or OUTSIDE or INSIDE.
    pool : buffer of (slots, 16, 16) int16
        Pixel q is the distance (q + 0.5) / scale pixels, negative inside, exact within the band.
    owner : buffer of (slots,) int32
        image * tiles + tile of each slot, or of the first of those that share it.
    slots : int
        Slots in use.
    scale : int
        Quanta per pixel.
    """

    map: Any
    pool: Any
    owner: Any
    slots: int
    scale: int

    def level(self, distance: float) -> int:
        """Return a distance in pixels as a whole number of quanta, which no pixel has."""
        return round(distance * self.scale)


def quanta(farthest: float) -> int:
    """Return the finest power of two of quanta per pixel that holds a distance in 16 bits.

    At least 1/128 px to 250 px; beyond that the quantum doubles each time the distance does.
    """
    if farthest > 16000:
        raise UsageError(f"distances of {farthest:.0f} pixels is too large (limit 16000); use a larger pitch")
    return int(min(FINEST, 2 ** math.floor(math.log2(32000.0 / farthest))))


def new_images(device: Device, name: str, images: int, grid: Grid, scale: int) -> tuple[Images, Any]:
    """Return scratch memory for some images, and their counter of slots, which is 0."""
    tiles = images * grid.tiles
    return Images(
        device.scratch(f"{name} map", tiles, np.int32),
        device.scratch(f"{name} pool", tiles * PIXELS + ROOM, np.int16),
        device.scratch(f"{name} owner", tiles, np.int32),
        0,
        scale,
    ), device.zeros(f"{name} slots", 1, np.int32)


def ask_map(
    device: Device, images: Images, counter: Any, first: int, count: int, grid: Grid
) -> Callable[[], NDArray[np.int32]]:
    """Begin to read where the tiles of some images live; what is returned waits for it.

    It sets `Images.slots` from their counter, and gives (count, tiles_y, tiles_x) int32.
    """
    slots = device.ask(counter, 1, np.int32)
    found = device.ask(images.map, count * grid.tiles, np.int32, first * grid.tiles)

    def read() -> NDArray[np.int32]:
        images.slots = int(slots.read()[0])
        return found.read().reshape(count, grid.tiles_y, grid.tiles_x)

    return read


def put_keys(device: Device, name: str, keys: NDArray[np.int64]) -> Keys:
    """Return keys on the device."""
    return Keys(device.put(name, keys.astype(np.int32)), len(keys))


def read_pieces(device: Device, pieces: Pieces, layers: int) -> tuple[Array, Array]:
    """Return the pieces of some layers, (N, 4) float32, and the starts, on the host."""
    start = device.get(pieces.start, layers * pieces.window.tiles + 1, np.int32)
    return device.get(pieces.pieces, 4 * int(start[-1]), np.float32).reshape(-1, 4), start


def read_images(device: Device, images: Images, count: int, grid: Grid) -> Array:
    """Return dense images, (count, height, width) float64 pixels, infinite in tiles without slots."""
    where = device.get(images.map, count * grid.tiles, np.int32)
    pool = device.get(images.pool, images.slots * PIXELS, np.int16).reshape(-1, TILE, TILE)
    tiles = np.full((len(where), TILE, TILE), np.inf)
    tiles[where == INSIDE] = -np.inf
    tiles[where >= 0] = (pool[where[where >= 0]] + 0.5) / images.scale
    grid_of_tiles = tiles.reshape(count, grid.tiles_y, grid.tiles_x, TILE, TILE)
    return grid_of_tiles.transpose(0, 1, 3, 2, 4).reshape(count, grid.height, grid.width)
