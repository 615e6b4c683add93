"""How many layers are computed at once: what a memory budget and the device's largest buffer hold."""

from __future__ import annotations

import math
import os

from .errors import UsageError
from .grid import Grid
from .tiles import PIXELS

LARGEST_BATCH = 24  # more layers at once gain nothing


def default_budget() -> int:
    """Return a quarter of the machine's memory, at most 1024 MB."""
    try:
        machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") >> 20
    except (AttributeError, OSError, ValueError):
        return 1024
    return int(min(1024, machine // 4))


def layer_bytes(grid: Grid, scaffolding: bool) -> int:
    """Return the memory of one layer of a batch when every tile is stored."""
    tile = 2 * PIXELS + 8
    return grid.tiles * ((3 if scaffolding else 1) * tile + 64) + 4 * grid.height * grid.tiles_x


def layers_that_fit(grid: Grid, per_layer: int, budget: int, largest: int, facets: int) -> int:
    """Return how many layers a batch may hold.

    Parameters
    ----------
    per_layer, budget, largest : int
        Bytes of a layer, of everything, and of the largest buffer of the device.
    facets : int
        Facets of the mesh, which stays in memory.

    Raises
    ------
    UsageError
        When not even one fits; it says which pitch would.
    """
    fixed = 72 * facets + 2 * PIXELS * grid.tiles
    fits = min((budget - fixed) // per_layer, largest // (4 * PIXELS * grid.tiles))
    if fits < 1:
        share = max(budget - 72 * facets, 0) / (per_layer + 2 * PIXELS * grid.tiles)
        share = min(share, largest / (4 * PIXELS * grid.tiles))
        if share <= 0:
            raise UsageError(
                f"{facets} facets need {72 * facets / 1e6:.0f} MB and images beside them; the memory budget is "
                f"{budget >> 20} MB. Use a larger memory_mb"
            )
        pitch = math.ceil(grid.pitch / math.sqrt(share) * 1e4) / 1e4
        raise UsageError(
            f"pitch {grid.pitch:g} mm needs {grid.width} x {grid.height} px, {per_layer / 1e6:.0f} MB a layer; the "
            f"memory budget is {budget >> 20} MB. Use --pitch {pitch:g} or more, or a larger memory_mb"
        )
    return int(min(fits, LARGEST_BATCH))
