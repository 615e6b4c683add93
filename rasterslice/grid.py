"""Where pixels and slices lie: the only owner of the frame of images.

::

        y (mm, up)
        ^
        |   +----+----+----+      pixel (i, j) is the *point*
        |   |    |    |    |          x = x0 + i * pitch,  i = 0 .. width - 1
        |   +----+----+----+          y = y0 + j * pitch,  j = 0 .. height - 1
        |   |    |    |    |      (x0, y0) are multiples of the pitch in the part frame,
     y0 +   *----+----+----+      row j = 0 is the lowest, y points up
        |  (0,0)
        +---x0------------------> x (mm)

Images are cut into square tiles of TILE x TILE pixels; tile (tx, ty) starts at pixel (16 tx, 16 ty).
Pictures turn y around when they are drawn, and nothing else does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import ModelError, UsageError

#: Side of a tile in pixels; the kernels rely on 16 (one vector of 16 pixels per tile row).
TILE = 16
#: Slices of one part, at most.
MOST_SLICES = 1_000_000


@dataclass(frozen=True, slots=True)
class Grid:
    """Pixels of every layer of one part.

    Attributes
    ----------
    x0, y0 : float
        Position of pixel (0, 0), mm, in the part frame.
    pitch : float
        Distance between pixels, mm.
    tiles_x, tiles_y : int
        Size in tiles.
    """

    x0: float
    y0: float
    pitch: float
    tiles_x: int
    tiles_y: int

    @property
    def width(self) -> int:
        """Pixels along x."""
        return self.tiles_x * TILE

    @property
    def height(self) -> int:
        """Pixels along y."""
        return self.tiles_y * TILE

    @property
    def tiles(self) -> int:
        """Tiles of one image."""
        return self.tiles_x * self.tiles_y

    def to_pixels(self, xy: ArrayLike) -> NDArray[np.float64]:
        """Return mm in the part frame as pixels, in float64."""
        return (np.asarray(xy, np.float64) - (self.x0, self.y0)) / self.pitch

    def to_mm(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Return pixels as mm in the part frame, in float64."""
        mm = np.array(pixels, np.float64, order="C")
        mm *= self.pitch
        mm.reshape(-1).view(np.complex128)[...] += complex(self.x0, self.y0)  # x and y at once: short rows are slow
        return mm


def cover(low: ArrayLike, high: ArrayLike, pitch: float, margin: float) -> Grid:
    """Return the grid that holds a box and an empty border.

    Parameters
    ----------
    low, high : (2,) array_like
        Corners of the part, mm.
    pitch : float
        Distance between pixels, mm.
    margin : float
        Width of the border, mm; two pixels are added to it.
    """
    lo, hi = np.asarray(low, np.float64), np.asarray(high, np.float64)
    border = math.ceil(margin / pitch) + 2
    first = np.floor(lo / pitch) - border
    last = np.ceil(hi / pitch) + border
    tiles = np.ceil((last - first + 1) / TILE)
    x0, y0 = first * pitch
    return Grid(float(x0), float(y0), pitch, int(tiles[0]), int(tiles[1]))


def slice_heights(zmin: float, zmax: float, thickness: float, position: float) -> NDArray[np.float64]:
    """Return the cutting heights ``zmin + (k + position) * thickness`` below zmax, mm.

    Raises
    ------
    ModelError
        When there is no height to slice.
    UsageError
        When no plane lies below zmax, or more than `MOST_SLICES` do.
    """
    first = zmin + position * thickness
    if not zmin < zmax:
        raise ModelError(f"the mesh is flat: its facets all lie at z = {zmin:g} mm; give it a height, or turn it")
    if not first < zmax:
        raise UsageError(
            f"slice thickness {thickness:g} mm leaves no slice in a part {zmax - zmin:g} mm high; "
            f"use less than {(zmax - zmin) / max(position, 0.5):g} mm"
        )
    if (zmax - first) / thickness > MOST_SLICES:
        raise UsageError(
            f"slice thickness {thickness:g} mm makes {(zmax - first) / thickness:.3g} slices of a part "
            f"{zmax - zmin:g} mm high; "
            f"the limit is {MOST_SLICES}: use {(zmax - zmin) / MOST_SLICES:.2g} mm or more, and check the units"
        )
    k = np.arange(math.ceil((zmax - first) / thickness) + 1)
    z = np.asarray(zmin + (k.astype(np.float64) + position) * thickness, np.float64)
    return np.asarray(z[z < zmax])
