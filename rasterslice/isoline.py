"""Level sets of images as pieces, and the areas inside them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .device import Device
from .grid import Grid
from .repeats import find_repeats
from .tiles import PIXELS, Images, Keys, Traced, put_keys, reach_of

#: What marching squares on an exact distance cuts off a circle of any radius, px^2 (docs/accuracy.md).
LOOP_LOSS = 0.65
#: Distance beyond half a width that is forgiven before an area counts as lost, pixels.
LOST_SLACK = 0.25


def isoline(
    device: Device, grid: Grid, images: Images, count: int, keys: Keys, level: int, name: str, sharp: float
) -> tuple[Any, Any, Any]:
    """Return the level set of the tiles ``keys`` of ``count`` images: pieces, and the first and the end of each tile's.

    Corners that turn by more than ``sharp`` degrees are put back where the slope of the images breaks; an arc with a
    radius of r pixels turns by about 80 / r degrees in a cell.
    """
    counts = device.zeros(f"{name} count", count * grid.tiles, np.int32)
    where = (images.map, images.pool, keys.buffer, grid.tiles_x, grid.tiles_y, level)
    device.run_tiles("count_isoline", keys.number, *where, counts)
    start, total = device.places(counts, count * grid.tiles, f"{name} start")
    pieces = device.scratch(name, 4 * total(), np.float32)
    cosine = float(np.cos(np.radians(sharp)))
    device.run_tiles("place_isoline", keys.number, *where, 1.0 / images.scale, cosine, counts, pieces)
    return pieces, start, counts


def areas(
    device: Device, grid: Grid, images: Images, where: NDArray[np.int32], first: int, stored: Keys | None = None
) -> Callable[[], NDArray[np.float64]]:
    """Begin to measure the area inside level 0 of images, px^2; call what is returned to have them.

    ``where`` is the map of the images from number ``first`` on. ``stored`` are their tiles that have pixels, where it
    is known that each has its own.
    """
    source, keys = None, stored
    if keys is None:
        repeats = find_repeats(where)
        keys = put_keys(device, "area keys", repeats.own(where) + first * grid.tiles)
        source = device.put("area sources", repeats.source)
    area = device.scratch("area", (first + len(where)) * grid.tiles, np.int32)
    cells = (images.map, images.pool, keys.buffer, grid.tiles_x, grid.tiles_y, 0, 1.0 / images.scale, LOOP_LOSS / 4)
    device.run_tiles("isoline_area", keys.number, *cells, area)
    return _summed(device, grid, images, first, len(where), source, area, PIXELS << 16)


def _summed(
    device: Device, grid: Grid, images: Images, first: int, count: int, source: Any, area: Any, inside: int
) -> Callable[[], NDArray[np.float64]]:
    """Begin to add up areas of the tiles of some images, px^2, as the kernel says."""
    total = device.scratch("areas", count, np.int64)
    device.run_groups("sum_areas", count, grid.tiles, first, images.map, source, area, inside, total)
    quanta = device.ask(total, count, np.int64)
    return lambda: np.asarray(quanta.read() / 65536.0)


def lost_areas(
    device: Device, grid: Grid, images: Images, boundary: Traced, layers: int, slots: int, half_width: float
) -> Callable[[], Callable[[], NDArray[np.float64]]]:
    """Begin to measure the area of each part that is farther than half a path width from its boundary paths, px^2.

    The part's images are the first ``layers`` and take the first ``slots`` slots; ``boundary`` is traced from them.
    Call what is returned when the chords may be counted, to go on; and what that returns, to have the areas.
    """
    chords = (*boundary, grid.tiles_x, grid.tiles_y)
    counts = device.scratch("chord count", layers * grid.tiles, np.int32)
    device.run("count_chords", layers, *chords, counts)
    start, total = device.places(counts, layers * grid.tiles, "chord start")

    def measure() -> Callable[[], NDArray[np.float64]]:
        pieces = device.scratch("chords", 4 * total(), np.float32)
        device.run("place_chords", layers, *chords, counts, pieces)
        lost = device.scratch("lost", layers * grid.tiles, np.int32)
        reach = reach_of(half_width + LOST_SLACK + 1.0)
        device.run_tiles(
            "lost_area", slots,
            pieces, start, images.pool, images.owner, grid.tiles_x, grid.tiles_y,
            reach, float(half_width), LOST_SLACK, images.level(-half_width), float(images.scale), lost,
        )  # fmt: skip
        return _summed(device, grid, images, 0, layers, None, lost, 0)

    return measure
