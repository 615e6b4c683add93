"""Tiles that are as they were in the layer above: what is made of them is not made again."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Repeats(NamedTuple):
    """Which tiles of some images repeat those of the image before.

    Attributes
    ----------
    new : (images, tiles_y, tiles_x) bool
        Whether the tile, or one around it, is not what it was in the image before.
    source : (images, tiles_y, tiles_x) int32
        Key of the tile in the last image where it was new.
    """

    new: NDArray[np.bool_]
    source: NDArray[np.int32]

    def own(self, where: NDArray[np.int32]) -> NDArray[np.int64]:
        """Return the keys of the stored tiles of a map that repeat none."""
        return np.flatnonzero((where >= 0) & self.new)


def find_repeats(where: NDArray[np.int32], reach: int = 1) -> Repeats:
    """Return which tiles are new, and where those that are not were it last.

    Parameters
    ----------
    where : (images, tiles_y, tiles_x) int32
        As from `ask_map`; a tile that is as it was in the image before has the slot that it had there.
    reach : int
        How many tiles around a tile have to be the same.
    """
    # images as rows of tiles: NumPy is slow where innermost loops are short
    layers, tiles_x = len(where), where.shape[2]
    images = where.reshape(layers, where.shape[1] * tiles_x)
    new = np.ones(images.shape, bool)
    np.not_equal(images[1:], images[:-1], out=new[1:])
    for _ in range(reach):
        tall = new.copy()
        tall[:, tiles_x:] |= new[:, :-tiles_x]
        tall[:, :-tiles_x] |= new[:, tiles_x:]
        new, beside = tall.copy(), tall.reshape(where.shape)
        ends = beside[:, :, [0, -1]]
        beside[:, :, -1] = False  # the next in memory is no neighbour
        new[:, 1:] |= tall[:, :-1]
        beside[:, :, [0, -1]] = ends
        beside[:, :, 0] = False
        new[:, :-1] |= tall[:, 1:]
    source = np.arange(where.size, dtype=np.int32).reshape(images.shape)
    source *= new
    for i in range(1, layers):
        np.maximum(source[i], source[i - 1], out=source[i])  # keys ascend
    return Repeats(new.reshape(where.shape), source.reshape(where.shape))
