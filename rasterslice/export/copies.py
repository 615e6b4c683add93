"""All copies of a part, for formats that hold a whole build: sliced once, laid out where the copies stand."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..grid import TILE, Grid
from ..paths import DEPOSITION, REGIONS, Layer, Stat
from ..spool import Spool


class Copied(Sequence[Layer]):
    """The layers of a build: the paths of each layer once for each copy, copy after copy.

    Parameters
    ----------
    layers : sequence of Layer
        Of one copy.
    offsets : (C, 2) array_like
        What is added to x and y of each copy, mm.

    Notes
    -----
    The statistics stay those of one copy.
    """

    def __init__(self, layers: Sequence[Layer], offsets: NDArray[np.float64]) -> None:
        self.of_one, self._offsets = layers, np.asarray(offsets, np.float64)

    def __len__(self) -> int:
        return len(self.of_one)

    def __getitem__(self, k: Any) -> Any:
        if isinstance(k, slice):
            return [self[i] for i in range(len(self))[k]]
        layer = self.of_one[k]
        sets: dict[str, Any] = {name: getattr(layer, name) for name in (*REGIONS, *DEPOSITION)}
        return dataclasses.replace(layer, **{n: p.repeated(self._offsets) for n, p in sets.items() if p is not None})


def rows_of(layers: Sequence[Layer]) -> list[dict[str, Stat]]:
    """Return the statistics of all layers; paths of a spool are not read for it."""
    layers = layers.of_one if isinstance(layers, Copied) else layers
    return layers.rows() if isinstance(layers, Spool) else [layer.stats for layer in layers]


def grid_of_copies(grid: Grid, offsets: NDArray[np.float64]) -> Grid:
    """Return the grid that holds all copies; offsets are not negative."""
    more = [math.ceil(float(v) / grid.pitch / TILE) for v in np.max(offsets, axis=0)]
    return dataclasses.replace(grid, tiles_x=grid.tiles_x + more[0], tiles_y=grid.tiles_y + more[1])
