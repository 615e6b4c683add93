"""The tiles of a grid that a batch has to do with: work on pieces is done in these alone."""

from __future__ import annotations

from typing import NamedTuple

from .grid import TILE, Grid


class Window(NamedTuple):
    """Some tiles of a grid, in rows and columns.

    Attributes
    ----------
    corner : (int, int)
        Column and row of the first.
    tiles_x, tiles_y : int
        Columns and rows.
    """

    corner: tuple[int, int]
    tiles_x: int
    tiles_y: int

    @property
    def tiles(self) -> int:
        """How many they are."""
        return self.tiles_x * self.tiles_y


def whole(grid: Grid) -> Window:
    """Return all tiles of a grid."""
    return Window((0, 0), grid.tiles_x, grid.tiles_y)


def window_around(grid: Grid, box: tuple[float, float, float, float] | None, reach: int) -> Window:
    """Return the tiles that a box, left, low, right and high in pixels, lies in, and ``reach`` more on each side."""
    if box is None:
        return Window((0, 0), 1, 1)
    x, y = (max(int(v) // TILE - reach, 0) for v in box[:2])
    right, top = (int(v) // TILE + reach for v in box[2:])
    return Window((x, y), min(right, grid.tiles_x - 1) - x + 1, min(top, grid.tiles_y - 1) - y + 1)
