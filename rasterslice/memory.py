"""How many layers are computed at once: what a memory budget and the device's largest buffer hold."""

from __future__ import annotations

import math
import os
from collections.abc import Callable

from .errors import UsageError
from .grid import Grid
from .tiles import PIXELS

LARGEST_BATCH = 48  # more layers at once gain nothing
LARGE_GRIDS = 24  # nor do more than these where they have many tiles
LARGEST_TILES = 1 << 17  # that many are, in a batch


def default_budget() -> int:
    """Return a quarter of the machine's memory, at most 1024 MB."""
    try:
        machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") >> 20
    except (AttributeError, OSError, ValueError):
        return 1024
    return int(min(1024, machine // 4))


def window_segments(budget: int) -> int:
    """Return how many segments are held at once: a tenth of the budget, at 40 bytes each."""
    return max(100_000, min(2_000_000, budget // 400))


def layer_bytes(grid: Grid, scaffolding: bool) -> int:
    """Return the memory of one layer of a batch when every tile is stored."""
    tile = 2 * PIXELS + 8
    return grid.tiles * ((3 if scaffolding else 1) * tile + 64) + 4 * grid.height * grid.tiles_x


def _fit(grid: Grid, scaffolding: bool, fixed: int, budget: int, largest: int) -> int:
    """Return how many layers of a grid fit beside ``fixed`` bytes."""
    union = 2 * PIXELS * grid.tiles if scaffolding else 0
    pool = 2 * PIXELS * grid.tiles * (2 if scaffolding else 1)
    return min((budget - fixed - union) // layer_bytes(grid, scaffolding), largest // pool)


def layers_that_fit(
    grid_at: Callable[[float], Grid], pitch: float, coarsest: float, scaffolding: bool, facets: int,
    budget: int, largest: int,
) -> int:  # fmt: skip
    """Return how many layers a batch may hold.

    Parameters
    ----------
    grid_at : callable
        Gives the grid for a pitch.
    pitch, coarsest : float
        The pitch that is wanted, and the coarsest that the path widths allow, mm.
    facets : int
        Facets of the mesh, which stays in memory.
    budget, largest : int
        Bytes of everything, and of the largest buffer of the device.

    Raises
    ------
    UsageError
        When not even one fits; it says which pitch would, where one does.
    """
    fixed = 72 * facets + 40 * window_segments(budget)
    grid = grid_at(pitch)
    fits = _fit(grid, scaffolding, fixed, budget, largest)
    if fits >= 1:
        return min(fits, LARGEST_BATCH, max(LARGE_GRIDS, LARGEST_TILES // grid.tiles))
    tries = (math.ceil(pitch * 1.03**n * 1e4) / 1e4 for n in range(1, 400))
    fitting = (p for p in tries if p > coarsest or _fit(grid_at(p), scaffolding, fixed, budget, largest) >= 1)
    better = next(fitting, math.inf)
    remedy = f"Use --pitch {better:g} or more, or" if better <= coarsest else "Use"
    raise UsageError(
        f"pitch {pitch:g} mm needs {grid.width} x {grid.height} px, {layer_bytes(grid, scaffolding) / 1e6:.1f} MB a "
        f"layer, beside {fixed / 1e6:.0f} MB for {facets} facets; the memory budget is {budget >> 20} MB. "
        f"{remedy} a larger memory_mb"
    )
