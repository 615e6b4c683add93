"""The pipeline: a mesh and parameters -> layers, top down, in batches that fit in memory."""

from __future__ import annotations

import builtins
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .assemble import Batch, assemble, contour_paths
from .bins import sort_pieces
from .contour import trace
from .corners import restore_corners
from .device import Device
from .distance import part_distance
from .errors import UsageError
from .fill import Hatch, hatch_lines
from .grid import Grid, cover
from .isoline import areas, isoline, lost_areas
from .mesh import Mesh
from .overlap import boundary_pieces
from .params import Params, read_params
from .part import Plan, copies_of, copy_offsets, load_part, plan_slices
from .paths import Layer, Paths
from .scaffold import BOUND, Union, scaffold_distance
from .section import Sectioner, Sections, to_pixels
from .survey import brief, damage, survey
from .tiles import PIXELS, new_images, quanta

LARGEST_BATCH = 24  # more layers at once gain nothing
BAND_MARGIN = 3.5  # a band reaches this far beyond its level, pixels: slopes in the cells that it crosses need it
DEVIATION_MM, DEVIATION_PX = 0.05, 0.1  # largest deviation of a decimated path; the smaller of both holds

Progress = Callable[[int, int], None]


@dataclass(slots=True)
class Slicing:
    """One part, ready to be sliced.

    Attributes
    ----------
    params : Params
    facets : int
    report : dict
        Of the transformed mesh: `survey.survey` where ``params.report`` asks for it, else `survey.brief`.
    low, high : (3,) float64
        Bounds of the transformed part, mm.
    grid : Grid
    heights : (K,) float64
        Cutting heights, mm, ascending.
    copies : (C, 2) float64
        What is added to x and y of the paths for each copy of the part, mm; the layers hold the first.
    device_name : str
    batch : int
        Layers that are computed together.
    image_bytes : int
        Memory of one layer of a batch, at most.
    memory_budget : int
        Bytes.
    regions : bool
        Whether the layers hold their regions.
    quantum : dict
        Smallest difference of distance, pixels, of the part's and scaffold's images and of the union.
    seconds : dict
        Time of each stage so far.
    warnings : list of str
    """

    params: Params
    facets: int
    report: dict[str, object]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    grid: Grid
    heights: NDArray[np.float64]
    copies: NDArray[np.float64]
    device_name: str
    batch: int
    image_bytes: int
    memory_budget: int
    regions: bool
    quantum: dict[str, float]
    seconds: dict[str, float]
    warnings: list[str]
    _device: Device
    _mesh: Mesh | None
    _plan: Plan
    _union: Union | None = field(default=None, init=False)

    def layers(self, progress: Progress | None = None) -> Iterator[Layer]:
        """Yield the layers from the top down; can be asked for once.

        Parameters
        ----------
        progress : callable, optional
            Called with (layers done, all layers) after each batch.
        """
        mesh, self._mesh = self._mesh, None
        if mesh is None:
            raise RuntimeError("the layers of a Slicing can be asked for once; prepare another")
        with self._timed("section"):
            triangles = mesh.triangles
            to_pixels(triangles, mesh.origin, self.grid, float(self.low[2]))
            sectioner = Sectioner(self._device, triangles, self._plan.cut - self.low[2])
        if self.params.scaffolding:
            buffer = self.params.scaffold_buffer / self.grid.pitch
            own = self.params.scaffold_union == "own"
            self._union = Union(self._device, self.grid, buffer, own, _scale(self.params))
        total = len(self._plan.cut)
        for first, last in sectioner.windows():
            with self._timed("section"):
                sections = sectioner.cut(first, last)
            for end in range(last, first, -self.batch):
                start = max(first, end - self.batch)
                for layer in self._layers_of(sections, start, end):
                    yield from copies_of(self._plan, layer)
                if progress is not None:
                    progress(total - start, total)

    def _layers_of(self, sections: Sections, start: int, end: int) -> list[Layer]:
        """Compute slices start .. end - 1."""
        p, grid, device, layers, top = self.params, self.grid, self._device, end - start, end - 1
        count = 2 * layers if p.scaffolding else layers
        which = builtins.slice(start - sections.first, end - sections.first)
        offsets = sections.offsets[which.start : which.stop + 1]
        with self._timed("sort"):
            span = (int(offsets[0]), int(offsets[-1]))
            pieces, wind = sort_pieces(device, grid, sections.segments, sections.slice_of, span, top, layers)
        with self._timed("overlap"):
            near, tangled = boundary_pieces(device, grid, pieces, wind, layers, p.winding)
        with self._timed("distance"):
            images, counter = new_images(device, "sdf", count, grid, _scale(p))
            part_distance(device, grid, near, pieces, wind, layers, _band(p), p.winding, images, counter)
            part_slots = images.slots
        if self._union is not None:
            with self._timed("scaffold"):
                above = self._union.descend(near, images, layers)
                grown = isoline(device, grid, above, layers, above.slots, self._union.level, "grown")
                scaffold_distance(device, grid, grown, above, self._union.level, layers, _band(p), images, counter)
        with self._timed("area"):
            area = areas(device, grid, images, count)
            half = p.part_width / 2 / grid.pitch
            lost = lost_areas(device, grid, images, layers, part_slots, half)
        with self._timed("contour"):
            levels = (images.level(-half), images.level(-p.support_width / 2 / grid.pitch))
            tolerance = min(DEVIATION_MM / grid.pitch, DEVIATION_PX)
            spacing = p.min_point_spacing / grid.pitch
            boundary = trace(device, grid, images, count, layers, levels, tolerance, spacing, (True, True))
        fills = None
        if p.fill:
            with self._timed("fill"):
                hatches = [Hatch(self._angle(top - i), p.part_width) for i in range(layers)]
                hatches += [Hatch(self._angle(top - i), p.support_width) for i in range(count - layers)]
                fills = hatch_lines(device, grid, boundary, hatches, p.fill_inset, p.min_point_spacing)
        regions = None
        if self.regions:
            with self._timed("regions"):
                contours = trace(device, grid, images, count, layers, (0, 0), 0.0, 0.0, (False, True))
                regions = contour_paths(contours, grid)
                for i in range(layers):
                    a, b = (int(o) for o in offsets[layers - 1 - i : layers + 1 - i])
                    source = device.get(sections.segments, 4 * (b - a), np.float32, 4 * a).reshape(-1, 4)
                    points, ends = restore_corners(contours, i, source)
                    ends = np.concatenate([[0], ends]).astype(np.uint32)
                    regions[i] = Paths(grid.to_mm(points), ends, True)
        exact = np.abs(sections.exact_area[which][::-1])
        is_open = sections.gap[which][::-1] * grid.pitch > p.tolerance
        with self._timed("assemble"):
            exact[tangled | is_open] = np.nan
            rows = sections.open_rows[which][::-1] * is_open
            return assemble(Batch(
                top, self.heights, grid, area, exact, lost, rows, is_open, tangled, boundary, regions, fills
            ))  # fmt: skip

    def _angle(self, k: int) -> float:
        k = 0 if self.params.option == 3 else k  # one slice for all
        return self.params.fill_angles[k % len(self.params.fill_angles)]

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self._device.finish()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start


def _band(params: Params) -> float:
    """Return how far from the boundary distances are needed, pixels."""
    width = max(params.part_width, params.support_width if params.scaffolding else 0.0)
    return width / 2 / params.pitch + BAND_MARGIN


def _scale(params: Params) -> int:
    return quanta(_band(params))


def prepare(
    params: Params | str | Path, *, device: str | None = None, regions: bool = False,
    batch: int | None = None, mapping: str | None = None,
) -> Slicing:  # fmt: skip
    """Read the mesh, lay the grid, open the device and plan the memory.

    Parameters
    ----------
    params : Params or path of a parameter file
    device : str, optional
        As in `device.Device`.
    regions : bool
        Whether the layers hold their regions.
    batch : int, optional
        Layers that are computed together; the result does not depend on it. Default: what fits in memory.
    mapping : {"cpu", "gpu"}, optional
        As in `device.Device`.

    Raises
    ------
    RasterSliceError
        Bad parameters, model, memory budget or device.
    """
    p = params if isinstance(params, Params) else read_params(params)
    start = time.perf_counter()
    opened = Device(device, mapping)
    seconds = {"device": time.perf_counter() - start}
    start = time.perf_counter()
    mesh, notes = load_part(p)
    report = survey(mesh) if p.report else brief(mesh)
    if p.report and damage(report):
        notes.append(f"{mesh.path}: {damage(report)}")
    seconds["read"] = time.perf_counter() - start
    low, high = mesh.low, mesh.high
    plan = plan_slices(p, float(low[2]), float(high[2]))
    grid = cover(low[:2], high[:2], p.pitch, p.scaffold_buffer if p.scaffolding else 0.0)
    budget = (p.memory_mb or _default_budget()) << 20
    per_layer = _layer_bytes(grid, p.scaffolding)
    fits = _layers_that_fit(grid, per_layer, budget, opened.largest, len(mesh.triangles))
    scale = _scale(p)
    quantum = {"distance": 1.0 / scale}
    if p.scaffolding:
        quantum["union"] = 1.0 / min(scale, quanta(p.scaffold_buffer / p.pitch + BOUND))
    return Slicing(
        p, len(mesh.triangles), report, low, high, grid, plan.heights, copy_offsets(p, low, high), opened.name,
        batch or min(fits, len(plan.cut)), per_layer, budget, regions, quantum, seconds, notes, opened, mesh, plan,
    )  # fmt: skip


def slice(
    params: Params | str | Path, *, device: str | None = None, progress: Progress | None = None
) -> Iterator[Layer]:
    """Slice a part and yield its layers from the top down, as they are computed.

    Parameters
    ----------
    params : Params or path of a parameter file
    device : str, optional
        As in `device.Device`.
    progress : callable, optional
        Called with (layers done, all layers).
    """
    return prepare(params, device=device).layers(progress)


def _default_budget() -> int:
    """Return a quarter of the machine's memory, at most 1024 MB."""
    try:
        machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") >> 20
    except (AttributeError, OSError, ValueError):
        return 1024
    return int(min(1024, machine // 4))


def _layer_bytes(grid: Grid, scaffolding: bool) -> int:
    """Return the memory of one layer of a batch when every tile is stored."""
    tile = 2 * PIXELS + 8
    return grid.tiles * ((3 if scaffolding else 1) * tile + 64) + 4 * grid.height * grid.tiles_x


def _layers_that_fit(grid: Grid, per_layer: int, budget: int, largest: int, facets: int) -> int:
    """Return the size of a batch, or say which pitch would fit."""
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
