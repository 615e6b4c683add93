"""Level sets of images -> closed, decimated loops, linked by the edges of the pixel grid."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .device import Array, Device
from .grid import TILE, Grid
from .tiles import Contours, Images, Keys, put_keys

RUN = 16  # chords that are tested together for crossings; the kernel relies on it
LANES = 4  # images for each core of a CPU from which on following several side by side pays
ROUNDING = 2e-5  # added to the least spacing, relative, so that float32 pixels do not fall below it in mm


class Seeds:
    """Where the contours of ``count`` images begin.

    The first ``layers`` are traced at ``levels[0]``, the others at ``levels[1]``, in quanta of the images.
    """

    def __init__(
        self, device: Device, grid: Grid, images: Images, count: int, layers: int, levels: tuple[int, int]
    ) -> None:
        self.images, self.count, self.levels = images, count, (layers, levels)
        self.seeds = device.scratch("seeds", count * grid.tiles * TILE, np.uint16)
        self.crossings = device.zeros("crossings", count, np.int32)
        self.starts = device.zeros("seed count", count, np.int32)
        self._device, self._grid, self._found = device, grid, list[Keys]()

    def find(self, where: NDArray[np.int32], first: int) -> None:
        """Begin to look for the contours of images from number ``first`` on, of which ``where`` is the map."""
        stored = np.flatnonzero(where >= 0) + first * self._grid.tiles
        self._found.append(put_keys(self._device, f"keys {len(self._found)}", stored))
        self._run(self._found[-1])

    def find_again(self) -> None:
        """Find all that was found: following uses it up."""
        for keys in self._found:
            self._run(keys)

    def _run(self, keys: Keys) -> None:
        where = (self.images.map, self.images.pool, keys.buffer, self._grid.tiles_x, self._grid.tiles_y)
        found = (*self.levels, self.seeds, self.crossings, self.starts)
        self._device.run_tiles("find_seeds", keys.number, *where, *found)


def trace(
    device: Device, grid: Grid, seeds: Seeds, tolerance: float, spacing: float, sharp: tuple[bool, bool]
) -> Contours:
    """Follow the contours of all images.

    Parameters
    ----------
    seeds : Seeds
        Of all images.
    tolerance : float
        Largest distance of a dropped point from its chord, pixels; 0 drops only what lies on a chord.
    spacing : float
        Least distance of successive points, pixels; 0 is none. It beats the tolerance.
    sharp : (bool, bool)
        Whether corners are put back where the slope of the images breaks, for both kinds of image.

    Notes
    -----
    Loops of which a chord meets another chord are traced again with a finer tolerance, and if that does not help
    with all their points: contours of marching squares are simple.
    """
    images, count = seeds.images, seeds.count
    place, sums = device.offsets(seeds.crossings, count, "place")
    loop_place, loop_sums = device.offsets(seeds.starts, count, "loop place")
    total, loops = int(sums[-1]), int(loop_sums[-1])
    points = device.scratch("points", 2 * total, np.float32)
    following, loop_of = device.scratch("next", total, np.int32), device.scratch("loop of", total, np.int32)
    loop_end, totals = device.scratch("loop end", loops, np.int32), device.scratch("totals", 4 * count, np.int32)
    mode = np.zeros(loops, np.uint8)
    kernel, items = _walkers(device, count)
    for level in (1, 2, 3):
        device.run(
            kernel, items,
            images.map, images.pool, grid.tiles_x, grid.tiles_y, *seeds.levels, seeds.seeds, place, loop_place,
            device.put("mode", mode), float(tolerance), float(spacing * (1 + ROUNDING)),
            np.array(sharp, np.float32) / np.float32(images.scale),
            points, following, loop_of, loop_end, totals, count,
        )  # fmt: skip
        made = device.get(totals, 4 * count, np.int32).reshape(count, 4)
        if level == 3 or (tolerance == 0 and spacing == 0 and not any(sharp)):
            break
        crossed = _crossed(device, points, following, loop_of, place, totals, sums, made, loops)
        if not crossed.any():
            break
        mode[crossed] = level
        seeds.find_again()
    buffers = (points, following, place, totals)
    return _collect(device, buffers, loop_end, sums, loop_sums, made, mode)


def _walkers(device: Device, images: int) -> tuple[str, int]:
    """Return which kernel follows the contours of some images, and with how many work-items."""
    if device.wide or images < LANES * device.units:
        return "follow_contours", images
    return "follow_lanes", device.units


def _crossed(
    device: Device, points: Any, following: Any, loop_of: Any, place: Any, totals: Any,
    sums: Array, made: Array, loops: int,
) -> NDArray[np.bool_]:  # fmt: skip
    """Return which loops meet another or themselves."""
    runs = -(-made[:, 0] // RUN)
    image = np.repeat(np.arange(len(made), dtype=np.int32), runs)
    first = sums[image] + RUN * (np.arange(len(image)) - np.repeat(np.cumsum(runs) - runs, runs))
    n = len(image)
    box = device.scratch("run box", 4 * n, np.float32)
    where = (device.put("run image", image), device.put("run first", first.astype(np.int32)), place, totals, n)
    crossed = device.zeros("crossed", loops, np.uint8)
    device.run("find_boxes", n, points, following, *where, box, group=16)
    device.run("find_crossings", n, points, following, loop_of, *where, box, crossed, group=16)
    return np.asarray(device.get(crossed, loops, np.uint8) != 0)


def _collect(
    device: Device, buffers: tuple[Any, Any, Any, Any], loop_end: Any, sums: Array, loop_sums: Array, made: Array,
    mode: NDArray[np.uint8],
) -> Contours:  # fmt: skip
    """Pack what the images wrote into their own places."""
    with device.view(buffers[0], 2 * int(sums[-1]), np.float32) as raw:
        pairs = raw.reshape(-1, 2)
        points = [pairs[a : a + n] for a, n in zip(sums[:-1].tolist(), made[:, 0].tolist(), strict=True)]
        packed = np.concatenate(points) if points else pairs[:0].copy()
    ends = device.get(loop_end, int(loop_sums[-1]), np.int32)
    image = np.repeat(np.arange(len(made)), made[:, 1])
    first_loop = np.cumsum(made[:, 1]) - made[:, 1]
    place = np.arange(len(image)) + (loop_sums[:-1] - first_loop)[image]
    ends = ends[place] - sums[image].astype(np.int64)
    before = np.concatenate([[0], ends[:-1]])
    before[first_loop[made[:, 1] > 0]] = 0
    held = ends > before
    last = np.cumsum(np.bincount(image[held], minlength=len(made)))
    ends = ends[held]
    loops = [ends[a:b] for a, b in itertools.pairwise([0, *last.tolist()])]
    dense = np.bincount(image[mode[place] == 2], minlength=len(made))
    first = np.concatenate([[0], np.cumsum(made[:, 0], dtype=np.int64)])
    return Contours(packed, first, loops, made[:, 2].astype(np.int64), dense, buffers)
