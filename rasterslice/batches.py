"""The stages, batch by batch: sections of a mesh -> what layers are assembled from."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .assemble import Batch, contour_paths
from .contour import Seeds, trace
from .corners import restore_corners
from .device import Device
from .distance import part_distance
from .fill import Hatch, hatch_lines
from .grid import Grid
from .isoline import areas, lost_areas
from .mesh import Mesh
from .overlap import boundary_pieces
from .params import Params
from .paths import Paths
from .scaffold import Above, Union, scaffold_distance
from .section import Sectioner, Sections, to_pixels
from .sorting import Sorted, Sorting
from .tiles import WOUND, Images, Pieces, Traced, new_images, quanta, reach_of

BAND_MARGIN = 2.0  # a band reaches this far beyond its level, pixels: the cells that it crosses, and slopes
OUTER = 3.5  # how far outside distances are needed, pixels: slopes outside of a corner
DEVIATION_MM, DEVIATION_PX = 0.05, 0.1  # largest deviation of a decimated path; the smaller of both holds

Fills = list[Paths] | None
Filled = tuple[Fills, Fills, NDArray[np.float64] | None]  # all images, the parts again, lengths of all images


@dataclass(slots=True, eq=False, repr=False)
class Batches:
    """Computes the layers of one part in batches, top first.

    Attributes
    ----------
    params : Params
    device : Device
    grid : Grid
    heights : (K,) float64
        Cutting heights that layers show, mm, ascending.
    size : int
        Layers that are computed together.
    regions : bool
        Whether layers hold their regions.
    seconds : dict
        Time of each stage so far.
    """

    params: Params
    device: Device
    grid: Grid
    heights: NDArray[np.float64]
    size: int
    regions: bool
    seconds: dict[str, float]
    _union: Union | None = field(default=None, init=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False)

    def run(self, mesh: Mesh, cut: NDArray[np.float64], window: int) -> Iterator[Callable[[], Batch]]:
        """Compute the batches, top first; each is given as what waits for its last results, in any thread.

        Parameters
        ----------
        mesh : Mesh
            Its vertices are moved to pixels, in place.
        cut : (K,) float64
            Where each slice is cut, mm, ascending.
        window : int
            Segments that are held at once.
        """
        bottom = float(mesh.low[2])
        with self._timed("section"):
            to_pixels(mesh.vertices, mesh.origin, self.grid, bottom)
            sectioner = Sectioner(self.device, mesh.vertices, mesh.faces, cut - bottom, window)
        if self.params.scaffolding:
            buffer = self.params.scaffold_buffer / self.grid.pitch
            own = self.params.scaffold_union == "own"
            self._union = Union(self.device, self.grid, buffer, own, scale_of(self.params))
        for first, last in sectioner.windows():
            with self._timed("section"):
                sections = sectioner.cut(first, last)
            ends = range(last, first, -self.size)
            reach = reach_of(band_of(self.params))
            where = (self.device, self.grid, sections)
            sortings = [Sorting(*where, max(first, end - self.size), end, reach) for end in ends]
            for sorting, following in itertools.zip_longest(sortings, sortings[1:]):
                yield self._compute(sections, sorting, following.steps if following else iter(()))

    def _compute(self, sections: Sections, sorting: Sorting, ahead: Iterator[None]) -> Callable[[], Batch]:
        """Compute a batch; what is returned waits for the last results.

        The device works through what it is told in turn. So it is told more before a result is waited for: parts and
        scaffolds take turns, and ``ahead`` begins the next batch.
        """
        p, grid, device = self.params, self.grid, self.device
        start, end = sorting.start, sorting.end
        layers, top = end - start, end - 1
        count = 2 * layers if p.scaffolding else layers
        with self._timed("sort"):
            made = sorting.result()
        near, images, counter, tangled, where = self._distances(made, layers, count)
        part_slots, half, spacing = images.slots, p.part_width / 2 / grid.pitch, p.min_point_spacing / grid.pitch
        levels = (images.level(-half), images.level(-p.support_width / 2 / grid.pitch))
        seeds = Seeds(device, grid, images, count, layers, levels)
        with self._timed("scaffold", p.scaffolding):
            union = self._union.descend(near, images, layers) if self._union else None
        with self._timed("contour"):
            stored = seeds.find(where, 0)
        with self._timed("scaffold", p.scaffolding):
            scaffolds = self._scaffolds(union, images, counter)
        with self._timed("area"):
            area = [areas(device, grid, images, where, 0, stored)]
            exact = np.abs(sections.exact_areas(start, end)[::-1])
        with self._timed("scaffold", p.scaffolding):
            others = scaffolds()
        with self._timed("contour"):
            seeds.find(others, layers)
            counted = seeds.count()
        with self._timed("area"):
            area.append(areas(device, grid, images, others, layers))
        with self._timed("contour"):
            tolerance = min(DEVIATION_MM / grid.pitch, DEVIATION_PX)
            traced, read = trace(device, grid, seeds, tolerance, spacing, (True, True), counted, ahead)
        with self._timed("area"):
            measure = lost_areas(device, grid, images, traced, layers, part_slots, half)
        with self._timed("fill", p.fill):
            lay = self._fills(traced, top, layers, count)
        with self._timed("area"):
            lost = measure()
        with self._timed("contour"):
            boundary = read()
        with self._timed("fill", p.fill):
            fills = lay()
        with self._timed("regions", self.regions):
            maps = (where, others)
            regions = self._regions(images, maps, layers, sections, start) if self.regions else None
        which = slice(start - sections.first, end - sections.first)
        is_open = sections.gap[which][::-1] * grid.pitch > p.tolerance
        exact[tangled | is_open] = np.nan
        rows = sections.open_rows[which][::-1] * is_open

        def finish() -> Batch:
            with self._timed("area"):
                found = np.concatenate([measured() for measured in area]), exact, lost()
            with self._timed("fill", p.fill):
                filled = fills()
            return Batch(top, self.heights, grid, *found, rows, is_open, tangled, boundary, regions, *filled)

        return finish

    def _scaffolds(self, union: Above | None, images: Images, counter: Any) -> Callable[[], NDArray[np.int32]]:
        """Begin the scaffolds' images, where there are any; return what gives their map."""
        if self._union is None or union is None:
            return lambda: np.empty((0, self.grid.tiles_y, self.grid.tiles_x), np.int32)
        bands, level = (band_of(self.params), OUTER), self._union.level
        return scaffold_distance(self.device, self.grid, *union, level, bands, images, counter)

    def _distances(
        self, made: Sorted, layers: int, count: int
    ) -> tuple[Pieces, Images, Any, NDArray[np.bool_], NDArray[np.int32]]:
        """Return what bounds the parts, ``count`` images, their counter, tangled layers, and the parts' map.

        The parts' images are done. Where shells touch, boundary is told from what lies inside before distances are
        measured; a shell that lies wholly in another shows only in the winding numbers, which come with the distances.
        """
        p, grid, device = self.params, self.grid, self.device
        pieces, wind, suspects, touching = made
        near, tangled = pieces, np.zeros(layers, bool)
        with self._timed("overlap"):
            known = touching.read() != 0
        for again in (False, True):
            if known.any():
                with self._timed("overlap"):
                    near, tangled = boundary_pieces(device, pieces, wind, suspects, layers, p.winding)
            if not again or near is not pieces:
                with self._timed("distance"):
                    images, counter = new_images(device, "sdf", count, grid, scale_of(p))
                    rest = (wind, layers, band_of(p), p.winding, images, counter, suspects)
                    where, flags = part_distance(device, grid, near, pieces, *rest)
                    wound = (flags & WOUND) != 0
            if not (wound & ~known).any():
                break
            known |= wound
        return near, images, counter, tangled | wound, where

    def _fills(self, boundary: Traced, top: int, layers: int, count: int) -> Callable[[], Callable[[], Filled]]:
        """Begin to fill all images, and the parts again for the second ice layers, where asked for: `hatch_lines`."""
        p, limits = self.params, (self.params.fill_inset, self.params.min_point_spacing)
        if not p.fill:
            return lambda: lambda: (None, None, None)
        n, angles = p.part_layers_per_slice, p.fill_angles
        slices = np.zeros(layers, np.int64) if p.option == 3 else top - np.arange(layers)  # option 3: one for all
        hatches = tuple(Hatch(angle, width) for width in (p.part_width, p.support_width) for angle in angles)
        # one sequence of angles over the ice layers of all slices
        scaffolds = len(angles) + slices[: count - layers] % len(angles)
        which = [n * slices % len(angles), scaffolds, (n * slices + 1) % len(angles)]
        image = np.concatenate([np.arange(count), np.arange(layers)])
        filled = count + layers if n > 1 else count
        where = (self.device, self.grid, boundary, hatches)
        lay = hatch_lines(*where, np.concatenate(which)[:filled], image[:filled], *limits)

        def lines() -> Callable[[], Filled]:
            read = lay()

            def fills() -> Filled:
                paths, lengths = read()
                return paths[:count], paths[count:] or None, lengths[:count]

            return fills

        return lines

    def _regions(
        self, images: Images, maps: tuple[NDArray[np.int32], ...], layers: int, sections: Sections, start: int
    ) -> list[Paths]:
        """Return the contours at level 0 of all images; those of the parts with the corners of their segments."""
        seeds = Seeds(self.device, self.grid, images, sum(map(len, maps)), layers, (0, 0))
        seeds.find(maps[0], 0)
        seeds.find(maps[1], layers)
        contours = trace(self.device, self.grid, seeds, 0.0, 0.0, (False, True), seeds.count())[1]()
        regions = contour_paths(contours, self.grid.to_mm(contours.points))
        offsets = sections.offsets[start - sections.first :]
        for i in range(layers):
            a, b = (int(o) for o in offsets[layers - 1 - i : layers + 1 - i])
            points, ends = restore_corners(contours, i, sections.host[a:b])
            regions[i] = Paths(self.grid.to_mm(points), np.concatenate([[0], ends]).astype(np.uint32), True)
        return regions

    @contextmanager
    def _timed(self, stage: str, asked: bool = True) -> Iterator[None]:
        """Add the time of a block to that of a stage, which the job may not have asked for."""
        start = time.perf_counter()
        yield
        if asked:
            with self._lock:  # results are waited for in another thread
                self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start


def band_of(params: Params) -> float:
    """Return how far from the boundary distances are needed, pixels."""
    width = max(params.part_width, params.support_width if params.scaffolding else 0.0)
    return width / 2 / params.pitch + BAND_MARGIN


def scale_of(params: Params) -> int:
    """Return the quanta per pixel of the distances of a job."""
    return quanta(band_of(params))
