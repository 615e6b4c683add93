"""The pipeline: a mesh and parameters -> layers, top down, in batches that fit in memory."""

from __future__ import annotations

import builtins
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .assemble import Batch, assemble, contour_paths
from .bins import sort_pieces
from .contour import trace
from .corners import restore_corners
from .device import Device
from .distance import part_distance
from .fill import Hatch, hatch_lines
from .grid import Grid, cover
from .isoline import areas, lost_areas
from .memory import default_budget, layer_bytes, layers_that_fit, window_segments
from .mesh import Mesh
from .overlap import boundary_pieces, find_contacts
from .params import Params, read_params
from .part import Plan, copies_of, copy_offsets, load_part, plan_slices
from .paths import Layer, Paths
from .scaffold import BOUND, Union, scaffold_distance
from .section import Sectioner, Sections, to_pixels
from .selftest import ensure_tested
from .survey import brief, damage, survey
from .tiles import WOUND, Contours, Images, Pieces, new_images, quanta

BAND_MARGIN = 2.0  # a band reaches this far beyond its level, pixels: the cells that it crosses, and slopes
OUTER = 3.5  # how far outside distances are needed, pixels: slopes outside of a corner
DEVIATION_MM, DEVIATION_PX = 0.05, 0.1  # largest deviation of a decimated path; the smaller of both holds

Progress = Callable[[int, int], None]
Fills = list[NDArray[np.float64]]

#: Flags that are worth a warning at the end (docs/flags.md).
WARNINGS = {
    "open": "are open: loose ends were bridged; mend the mesh, or look at them",
    "area": "have an area that differs from that of the mesh; look at them, or use a smaller pitch",
    "lost": "have much that no path reaches, because it is thinner than a path; see lost_area",
}


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

    def layers(self, progress: Progress | None = None) -> Generator[Layer, None, None]:
        """Yield the layers from the top down; can be asked for once.

        The next batch is computed in a thread while the layers of this one are used.

        Parameters
        ----------
        progress : callable, optional
            Called with (layers done, all layers) after each batch.
        """
        mesh, self._mesh = self._mesh, None
        if mesh is None:
            raise RuntimeError("the layers of a Slicing can be asked for once; prepare another")
        total = len(self._plan.cut)
        with ThreadPoolExecutor(1, thread_name_prefix="compute") as thread:
            batches = self._batches(mesh)
            pending = thread.submit(next, batches, None)
            found: Counter[str] = Counter()
            made = 0.0
            while (batch := pending.result()) is not None:
                pending = thread.submit(next, batches, None)
                layers = [copy for layer in assemble(batch) for copy in copies_of(self._plan, layer)]
                made += float(batch.areas[: len(batch.lost)].sum())
                found.update(flag for layer in layers for flag in str(layer.stats["flags"]).split(";"))
                yield from layers
                if progress is not None:
                    progress(total - batch.top - 1 + len(batch.lost), total)
        if not made:
            self.warnings.append(
                f"no layer holds any part with winding = {self.params.winding}; is the mesh turned inside out?"
            )
        self.warnings += [f"{found[flag]} of {total} layers {text}" for flag, text in WARNINGS.items() if found[flag]]

    def _batches(self, mesh: Mesh) -> Iterator[Batch]:
        """Compute the batches, top first."""
        with self._timed("section"):
            triangles = mesh.triangles
            to_pixels(triangles, mesh.origin, self.grid, float(self.low[2]))
            window = window_segments(self.memory_budget)
            sectioner = Sectioner(self._device, triangles, self._plan.cut - self.low[2], window)
        if self.params.scaffolding:
            buffer = self.params.scaffold_buffer / self.grid.pitch
            own = self.params.scaffold_union == "own"
            self._union = Union(self._device, self.grid, buffer, own, _scale(self.params))
        for first, last in sectioner.windows():
            with self._timed("section"):
                sections = sectioner.cut(first, last)
            for end in range(last, first, -self.batch):
                yield self._compute(sections, max(first, end - self.batch), end)

    def _compute(self, sections: Sections, start: int, end: int) -> Batch:
        """Compute slices start .. end - 1."""
        p, grid, device, layers, top = self.params, self.grid, self._device, end - start, end - 1
        count = 2 * layers if p.scaffolding else layers
        which = builtins.slice(start - sections.first, end - sections.first)
        offsets = sections.offsets[which.start : which.stop + 1]
        with self._timed("sort"):
            span = (int(offsets[0]), int(offsets[-1]))
            pieces, wind = sort_pieces(device, grid, sections.segments, sections.slice_of, span, top, layers)
        near, images, counter, tangled = self._distances(pieces, wind, layers, count)
        part_slots = images.slots
        if self._union is not None:
            with self._timed("scaffold"):
                above = self._union.descend(near, images, layers)
                bands = (_band(p), OUTER)
                scaffold_distance(device, grid, above, self._union.level, layers, bands, images, counter)
        with self._timed("area"):
            area = areas(device, grid, images, count, layers)
            half = p.part_width / 2 / grid.pitch
            lost = lost_areas(device, grid, images, layers, part_slots, half)
        with self._timed("contour"):
            levels = (images.level(-half), images.level(-p.support_width / 2 / grid.pitch))
            tolerance = min(DEVIATION_MM / grid.pitch, DEVIATION_PX)
            spacing = p.min_point_spacing / grid.pitch
            boundary = trace(device, grid, images, count, layers, levels, tolerance, spacing, (True, True))
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
        p, grid, device, near = self.params, self.grid, self._device, pieces
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
                    images, counter = new_images(device, "sdf", count, grid, _scale(p))
                    where = (wind, layers, _band(p), p.winding, images, counter, suspects)
                    part_distance(device, grid, near, pieces, *where)
            wound = (device.get(suspects, layers, np.int32) & WOUND) != 0
            if not (wound & ~known).any():
                break
            known |= wound
        return near, images, counter, tangled | wound

    def _fills(self, boundary: Contours, top: int, layers: int, count: int) -> tuple[Fills | None, Fills | None]:
        """Return the fill lines of all images, and those of the second ice layers of the parts, where asked for."""
        p, limits = self.params, (self.params.fill_inset, self.params.min_point_spacing)
        if not p.fill:
            return None, None
        n, angle = p.part_layers_per_slice, p.fill_angles
        numbers = [0 if p.option == 3 else top - i for i in range(layers)]  # option 3: one slice for all

        def parts(ice: int) -> list[Hatch]:
            """Return the hatches of an ice layer: one sequence of angles over the ice layers of all slices."""
            return [Hatch(angle[(n * k + ice) % len(angle)], p.part_width) for k in numbers]

        with self._timed("fill"):
            scaffolds = [Hatch(angle[k % len(angle)], p.support_width) for k in numbers[: count - layers]]
            fills = hatch_lines(self._device, self.grid, boundary, parts(0) + scaffolds, *limits)
            second = hatch_lines(self._device, self.grid, boundary, parts(1), *limits) if n > 1 else None
            return fills, second

    def _regions(
        self, images: Images, count: int, layers: int, sections: Sections, offsets: NDArray[np.int64]
    ) -> list[Paths]:
        """Return the contours at level 0 of all images; those of the parts with the corners of their segments."""
        with self._timed("regions"):
            contours = trace(self._device, self.grid, images, count, layers, (0, 0), 0.0, 0.0, (False, True))
            regions = contour_paths(contours, self.grid)
            for i in range(layers):
                a, b = (int(o) for o in offsets[layers - 1 - i : layers + 1 - i])
                source = self._device.get(sections.segments, 4 * (b - a), np.float32, 4 * a).reshape(-1, 4)
                points, ends = restore_corners(contours, i, source)
                regions[i] = Paths(self.grid.to_mm(points), np.concatenate([[0], ends]).astype(np.uint32), True)
        return regions

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


def _opened(select: str | None, mapping: str | None, seconds: dict[str, float]) -> Device:
    start = time.perf_counter()
    device = Device(select, mapping)
    seconds["device"] = time.perf_counter() - start
    return device


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
    seconds: dict[str, float] = {}
    with ThreadPoolExecutor(1, thread_name_prefix="device") as thread:
        opening = thread.submit(_opened, device, mapping, seconds)
        start = time.perf_counter()
        try:
            mesh, notes = load_part(p)
        finally:
            opened = opening.result()  # what is wrong with the device is said first
    report = survey(mesh) if p.report else brief(mesh)
    if p.report and damage(report):
        notes.append(f"{mesh.path}: {damage(report)}")
    seconds["read"] = time.perf_counter() - start
    start = time.perf_counter()
    ensure_tested(opened)
    seconds["self-test"] = time.perf_counter() - start
    low, high = mesh.low, mesh.high
    plan = plan_slices(p, float(low[2]), float(high[2]))
    margin = p.scaffold_buffer if p.scaffolding else 0.0
    widest = min(p.part_width, p.support_width if p.scaffolding else p.part_width)

    def grid_at(pitch: float) -> Grid:
        return cover(low[:2], high[:2], pitch, margin)

    grid = grid_at(p.pitch)
    budget = (p.memory_mb or default_budget()) << 20
    fits = layers_that_fit(
        grid_at, p.pitch, widest / 2, p.scaffolding, len(mesh.triangles), budget, opened.largest
    )  # fmt: skip
    scale = _scale(p)
    quantum = {"distance": 1.0 / scale}
    if p.scaffolding:
        quantum["union"] = 1.0 / min(scale, quanta(p.scaffold_buffer / p.pitch + BOUND))
    return Slicing(
        p, len(mesh.triangles), report, low, high, grid, plan.heights, copy_offsets(p, low, high), opened.name,
        batch or min(fits, len(plan.cut)), layer_bytes(grid, p.scaffolding), budget, regions, quantum, seconds, notes,
        opened, mesh, plan,
    )  # fmt: skip


def slice(
    params: Params | str | Path, *, device: str | None = None, progress: Progress | None = None
) -> Generator[Layer, None, None]:
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
