"""Level sets of images -> closed, decimated loops, linked by the edges of the pixel grid."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .device import Answer, Array, Device
from .grid import TILE, Grid
from .tiles import Contours, Images, Keys, Traced, put_keys

RUN = 16  # chords that are tested together for crossings; the kernel relies on it
LANES = 4  # images for each core of a CPU from which on following several side by side pays
ROUNDING = 2e-5  # added to the least spacing, relative, so that float32 pixels do not fall below it in mm

_NOTHING: Iterator[object] = iter(())
#: Gives the offsets of the points and of the loops of images: each a buffer, and the same here.
Offsets = Callable[[], tuple[tuple[Any, Array], tuple[Any, Array]]]


class Seeds:
    """Where the contours of ``count`` images begin.

    The first ``layers`` are traced at ``levels[0]``, the others at ``levels[1]``, in quanta of the images.
    """

    def __init__(
        self, device: Device, grid: Grid, images: Images, count: int, layers: int, levels: tuple[int, int]
    ) -> None:
        self.images, self.number, self.levels = images, count, (layers, levels)
        tiles = count * grid.tiles
        self.seeds = device.scratch("seeds", tiles * TILE, np.uint16)
        self.stored, self.numbers = (device.scratch(name, tiles, np.int32) for name in ("stored", "stored number"))
        self.crossings = device.zeros("crossings", count, np.int32)
        self.starts = device.zeros("seed count", count, np.int32)
        self._device, self._grid, self._found, self._begin = device, grid, list[Keys](), [np.zeros(1, np.int64)]

    def find(self, where: NDArray[np.int32], first: int) -> Keys:
        """Begin to look for the contours of images from number ``first`` on, the next; return their stored tiles.

        ``where`` is their map.
        """
        tiles, before = self._grid.tiles, sum(keys.number for keys in self._found)
        stored = np.flatnonzero(where >= 0)
        self._begin.append(np.searchsorted(stored, np.arange(1, len(where) + 1) * tiles) + before)
        stored += first * tiles
        self._found.append(put_keys(self._device, f"keys {len(self._found)}", stored))
        self._run(self._found[-1], before)
        return self._found[-1]

    def where(self) -> tuple[Any, Any, Any, Any]:
        """Return the seeds of all stored tiles, the key of each, the first of each image, and the number of a key."""
        begin = np.concatenate(self._begin).astype(np.int32)
        return self.seeds, self.stored, self._device.put("first stored", begin), self.numbers

    def count(self) -> Offsets:
        """Begin to count them, when those of all images are found.

        What is returned waits for the offsets (`device.Device.offsets`) of the images' points, at most, and loops.
        """
        points = self._device.offsets(self.crossings, self.number, "place")
        loops = self._device.offsets(self.starts, self.number, "loop place")
        return lambda: (points(), loops())

    def find_again(self) -> None:
        """Find all that was found: following uses it up."""
        first = 0
        for keys in self._found:
            self._run(keys, first)
            first += keys.number

    def _run(self, keys: Keys, first: int) -> None:
        where = (self.images.map, self.images.pool, keys.buffer, self._grid.tiles_x, self._grid.tiles_y, first)
        found = (*self.levels, self.seeds, self.stored, self.numbers, self.crossings, self.starts)
        self._device.run_tiles("find_seeds", keys.number, *where, *found)


def trace(
    device: Device, grid: Grid, seeds: Seeds, tolerance: float, spacing: float, sharp: tuple[bool, bool],
    counted: Offsets, meanwhile: Iterator[object] = _NOTHING,
) -> tuple[Traced, Callable[[], Contours]]:  # fmt: skip
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
    counted : callable
        As from `Seeds.count`.
    meanwhile : iterator, optional
        Each of its steps begins something else on the device; one is taken before waiting for the loops, and one before
        waiting for where they cross.

    Returns
    -------
    traced : Traced
        What was found, on the device.
    read : callable
        Gives it on the host; must be called once, before the next is traced.

    Notes
    -----
    Loops of which a chord meets another chord are traced again with a finer tolerance, and if that does not help
    with all their points: contours of marching squares are simple.
    """
    images, count = seeds.images, seeds.number
    (place, sums), (loop_place, loop_sums) = counted()
    total, loops = int(sums[-1]), int(loop_sums[-1])
    points, following = device.scratch("points", 2 * total, np.float32), device.scratch("next", total, np.int32)
    loop_of, loop_end = device.scratch("loop of", total, np.int32), device.scratch("loop end", loops, np.int32)
    traced = Traced(points, following, place, device.scratch("totals", 4 * count, np.int32))
    mode = np.zeros(loops, np.uint8)
    kernel, items, where = *_walkers(device, count), seeds.where()
    for level in (1, 2, 3):
        device.run(
            kernel, items,
            images.map, images.pool, grid.tiles_x, grid.tiles_y, *seeds.levels, *where, place, loop_place,
            device.put("mode", mode), float(tolerance), float(spacing * (1 + ROUNDING)),
            np.array(sharp, np.float32) / np.float32(images.scale),
            points, following, loop_of, loop_end, traced.totals, count,
        )  # fmt: skip
        asked = device.ask(traced.totals, 4 * count, np.int32)
        next(meanwhile, None)
        made = asked.read().reshape(count, 4)
        last = level == 3 or (tolerance == 0 and spacing == 0 and not any(sharp))
        crossed = None if last else _crossed(device, traced, loop_of, sums, made, loops)
        ends, shown = device.ask(loop_end, loops, np.int32), device.show(points, 2 * total, np.float32)
        if crossed is None:
            break
        next(meanwhile, None)
        meet = crossed.read() != 0
        if not meet.any():
            break
        device.hide(shown.read())
        mode[meet] = level
        seeds.find_again()

    def read() -> Contours:
        pairs = shown.read().reshape(-1, 2)
        runs = zip(sums[:-1].tolist(), made[:, 0].tolist(), strict=True)
        packed = np.concatenate([pairs[:0], *(pairs[a : a + n] for a, n in runs)])
        device.hide(shown.array)
        return _loops(packed, ends.read(), sums, loop_sums, made, mode)

    return traced, read


def _walkers(device: Device, images: int) -> tuple[str, int]:
    """Return which kernel follows the contours of some images, and with how many work-items."""
    if device.wide or images < LANES * device.units:
        return "follow_contours", images
    return "follow_lanes", device.units


def _crossed(device: Device, traced: Traced, loop_of: Any, sums: Array, made: Array, loops: int) -> Answer:
    """Begin to find out which loops meet another or themselves: (loops,) uint8."""
    runs = -(-made[:, 0] // RUN)
    image = np.repeat(np.arange(len(made), dtype=np.int32), runs)
    first = sums[image] + RUN * (np.arange(len(image)) - np.repeat(np.cumsum(runs) - runs, runs))
    n = len(image)
    box = device.scratch("run box", 4 * n, np.float32)
    where = (device.put("run image", image), device.put("run first", first.astype(np.int32)), *traced[2:], n)
    crossed = device.zeros("crossed", loops, np.uint8)
    device.run("find_boxes", n, *traced[:2], *where, box, group=16)
    device.run("find_crossings", n, *traced[:2], loop_of, *where, box, crossed, group=16)
    return device.ask(crossed, loops, np.uint8)


def _loops(
    points: NDArray[np.float32], loop_ends: NDArray[np.int32], sums: Array, loop_sums: Array, made: Array,
    mode: NDArray[np.uint8],
) -> Contours:  # fmt: skip
    """Return packed points as loops, of which the images wrote the ends into their own places."""
    image = np.repeat(np.arange(len(made)), made[:, 1])
    first_loop = np.cumsum(made[:, 1]) - made[:, 1]
    place = np.arange(len(image)) + (loop_sums[:-1] - first_loop)[image]
    ends = loop_ends[place] - sums[image].astype(np.int64)
    before = np.concatenate([[0], ends[:-1]])
    before[first_loop[made[:, 1] > 0]] = 0
    held = ends > before
    last = np.cumsum(np.bincount(image[held], minlength=len(made)))
    ends = ends[held]
    loops = [ends[a:b] for a, b in itertools.pairwise([0, *last.tolist()])]
    dense = np.bincount(image[mode[place] == 2], minlength=len(made))
    first = np.concatenate([[0], np.cumsum(made[:, 0], dtype=np.int64)])
    return Contours(points, first, loops, made[:, 2].astype(np.int64), dense)
