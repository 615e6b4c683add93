"""The stages, batch by batch: sections of a mesh -> what layers are assembled from."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .assemble import Batch, contour_paths
from .bins import sort_pieces
from .contour import trace
from .corners import restore_corners
from .device import Device
from .distance import part_distance
from .fill import Hatch, hatch_lines
from .grid import Grid
from .isoline import areas, lost_areas
from .mesh import Mesh
from .overlap import boundary_pieces, find_contacts
from .params import Params
from .paths import Paths
from .scaffold import Union, scaffold_distance
from .section import Sectioner, Sections, to_pixels
from .tiles import WOUND, Contours, Images, Pieces, new_images, quanta

BAND_MARGIN = 2.0  # a band reaches this far beyond its level, pixels: the cells that it crosses, and slopes
OUTER = 3.5  # how far outside distances are needed, pixels: slopes outside of a corner
DEVIATION_MM, DEVIATION_PX = 0.05, 0.1  # largest deviation of a decimated path; the smaller of both holds

Fills = list[Paths] | None


@dataclass(slots=True)
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

    def run(self, mesh: Mesh, cut: NDArray[np.float64], window: int) -> Iterator[Batch]:
        """Compute the batches, top first.

        Parameters
        ----------
        mesh : Mesh
            Its triangles are moved to pixels, in place.
        cut : (K,) float64
            Where each slice is cut, mm, ascending.
        window : int
            Segments that are held at once.
        """
        bottom = float(mesh.low[2])
        with self._timed("section"):
            triangles = mesh.triangles
            to_pixels(triangles, mesh.origin, self.grid, bottom)
            sectioner = Sectioner(self.device, triangles, cut - bottom, window)
        if self.params.scaffolding:
            buffer = self.params.scaffold_buffer / self.grid.pitch
            own = self.params.scaffold_union == "own"
            self._union = Union(self.device, self.grid, buffer, own, scale_of(self.params))
        for first, last in sectioner.windows():
            with self._timed("section"):
                sections = sectioner.cut(first, last)
            for end in range(last, first, -self.size):
                yield self._compute(sections, max(first, end - self.size), end)

    def _compute(self, sections: Sections, start: int, end: int) -> Batch:
        """Compute slices start .. end - 1."""
        p, grid, device, layers, top = self.params, self.grid, self.device, end - start, end - 1
        count = 2 * layers if p.scaffolding else layers
        which = slice(start - sections.first, end - sections.first)
        offsets = sections.offsets[which.start : which.stop + 1]
        with self._timed("sort"):
            span = (int(offsets[0]), int(offsets[-1]))
            pieces, wind = sort_pieces(device, grid, sections.segments, sections.slice_of, span, top, layers)
        near, images, counter, tangled = self._distances(pieces, wind, layers, count)
        part_slots = images.slots
        if self._union is not None:
            with self._timed("scaffold"):
                above = self._union.descend(near, images, layers)
                bands = (band_of(p), OUTER)
                scaffold_distance(device, grid, above, self._union.level, layers, bands, images, counter)
        with self._timed("area"):
            area = areas(device, grid, images, count, layers)
        with self._timed("contour"):
            half = p.part_width / 2 / grid.pitch
            levels = (images.level(-half), images.level(-p.support_width / 2 / grid.pitch))
            tolerance = min(DEVIATION_MM / grid.pitch, DEVIATION_PX)
            spacing = p.min_point_spacing / grid.pitch
            boundary = trace(device, grid, images, count, layers, levels, tolerance, spacing, (True, True))
        with self._timed("area"):
            lost = lost_areas(device, grid, images, boundary, layers, part_slots, half)
        fills, second = self._fills(boundary, top, layers, count)
        regions = self._regions(images, count, layers, sections, offsets) if self.regions else None
        exact = np.abs(sections.exact_area[which][::-1])
        is_open = sections.gap[which][::-1] * grid.pitch > p.tolerance
        exact[tangled | is_open] = np.nan
        rows = sections.open_rows[which][::-1] * is_open
        return Batch(
            top, self.heights, grid, area, exact, lost, rows, is_open, tangled, boundary, regions, fills, second
        )  # fmt: skip

    def _distances(
        self, pieces: Pieces, wind: Any, layers: int, count: int
    ) -> tuple[Pieces, Images, Any, NDArray[np.bool_]]:
        """Return what bounds the parts, ``count`` images (the parts' are done), their counter, and tangled layers.

        Where shells touch, boundary is told from what lies inside before distances are measured; a shell that lies
        wholly in another shows only in the winding numbers, which come with the distances.
        """
        p, grid, device, near = self.params, self.grid, self.device, pieces
        tangled = np.zeros(layers, bool)
        with self._timed("overlap"):
            suspects = find_contacts(device, grid, pieces, layers)
            known = device.get(suspects, layers, np.int32) != 0
        for again in (False, True):
            if known.any():
                with self._timed("overlap"):
                    near, tangled = boundary_pieces(device, grid, pieces, wind, suspects, layers, p.winding)
            if not again or near is not pieces:
                with self._timed("distance"):
                    images, counter = new_images(device, "sdf", count, grid, scale_of(p))
                    where = (wind, layers, band_of(p), p.winding, images, counter, suspects)
                    part_distance(device, grid, near, pieces, *where)
            wound = (device.get(suspects, layers, np.int32) & WOUND) != 0
            if not (wound & ~known).any():
                break
            known |= wound
        return near, images, counter, tangled | wound

    def _fills(self, boundary: Contours, top: int, layers: int, count: int) -> tuple[Fills, Fills]:
        """Return the fill lines of all images, and those of the second ice layers of the parts, where asked for."""
        p, limits = self.params, (self.params.fill_inset, self.params.min_point_spacing)
        if not p.fill:
            return None, None
        n, angles = p.part_layers_per_slice, p.fill_angles
        slices = np.zeros(layers, np.int64) if p.option == 3 else top - np.arange(layers)  # option 3: one for all
        hatches = [Hatch(angle, width) for width in (p.part_width, p.support_width) for angle in angles]

        def parts(ice: int) -> NDArray[np.int64]:
            """Return the hatches of an ice layer: one sequence of angles over the ice layers of all slices."""
            return (n * slices + ice) % len(angles)

        with self._timed("fill"):
            scaffolds = len(angles) + slices[: count - layers] % len(angles)
            where = (self.device, self.grid, boundary, hatches)
            fills = hatch_lines(*where, np.concatenate([parts(0), scaffolds]), *limits)
            return fills, hatch_lines(*where, parts(1), *limits) if n > 1 else None

    def _regions(
        self, images: Images, count: int, layers: int, sections: Sections, offsets: NDArray[np.int64]
    ) -> list[Paths]:
        """Return the contours at level 0 of all images; those of the parts with the corners of their segments."""
        with self._timed("regions"):
            contours = trace(self.device, self.grid, images, count, layers, (0, 0), 0.0, 0.0, (False, True))
            regions = contour_paths(contours, self.grid)
            for i in range(layers):
                a, b = (int(o) for o in offsets[layers - 1 - i : layers + 1 - i])
                source = self.device.get(sections.segments, 4 * (b - a), np.float32, 4 * a).reshape(-1, 4)
                points, ends = restore_corners(contours, i, source)
                regions[i] = Paths(self.grid.to_mm(points), np.concatenate([[0], ends]).astype(np.uint32), True)
        return regions

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.device.finish()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start


def band_of(params: Params) -> float:
    """Return how far from the boundary distances are needed, pixels."""
    width = max(params.part_width, params.support_width if params.scaffolding else 0.0)
    return width / 2 / params.pitch + BAND_MARGIN


def scale_of(params: Params) -> int:
    """Return the quanta per pixel of the distances of a job."""
    return quanta(band_of(params))
