"""The pipeline: a mesh and parameters -> layers, top down, in batches that fit in memory."""

from __future__ import annotations

import importlib
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from . import opening as devices
from .device import Device
from .errors import UsageError
from .grid import Grid, cover
from .interrupts import unbroken
from .memory import default_budget, layer_bytes, layers_that_fit, window_segments
from .mesh import Mesh, size_notes
from .params import Params, read_params
from .part import Plan, copies_of, copy_offsets, plan_slices
from .paths import Layer
from .reading import reading
from .tiles import quanta

Progress = Callable[[int, int], None]

AHEAD = 2  # batches that are computed before they are asked for: the device does not wait for who asks
T = TypeVar("T")

#: Flags that are worth a warning at the end (docs/flags.md).
WARNINGS = {
    "open": "are open: loose ends were bridged; mend the mesh, or look at them",
    "area": "have an area that differs from that of the mesh; look at them, or use a smaller pitch",
    "lost": "have much that no path reaches, because it is thinner than a path; see lost_area",
}


@dataclass(slots=True, eq=False, repr=False)
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

    def layers(self, progress: Progress | None = None) -> Generator[Layer, None, None]:
        """Yield the layers from the top down; can be asked for once.

        The next batches, two at most, are computed in a thread while the layers of this one are used.

        Parameters
        ----------
        progress : callable, optional
            Called with (layers done, all layers) after each batch.
        """
        mesh, self._mesh = self._mesh, None
        if mesh is None:
            raise RuntimeError("the layers of a Slicing can be asked for once; prepare another")
        with unbroken():
            from .assemble import assemble
            from .batches import Batches

        total = len(self._plan.cut)
        stages = Batches(self.params, self._device, self.grid, self.heights, self.batch, self.regions, self.seconds)
        found: Counter[str] = Counter()
        made = 0.0
        with closing(_ahead(stages.run(mesh, self._plan.cut, window_segments(self.memory_budget)))) as batches:
            for finish in batches:
                batch = finish()
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


def _ahead(items: Iterator[T]) -> Generator[T, None, None]:
    """Yield what a thread computes, some of it before it is asked for."""
    with ThreadPoolExecutor(1, thread_name_prefix="compute") as thread:
        pending = deque[Future[T | None]]()
        try:
            while True:
                with unbroken():  # whoever ends has to wait for the thread in any case
                    while len(pending) < AHEAD:
                        pending.append(thread.submit(next, items, None))
                    item = pending.popleft().result()
                    pending.append(thread.submit(next, items, None))
                if item is None:
                    break
                yield item
        finally:
            for other in pending:
                other.cancel()


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
    opening, read = devices.opening(device, mapping), reading(p)
    with ThreadPoolExecutor(1, thread_name_prefix="import") as thread:
        stages = thread.submit(importlib.import_module, f"{__package__}.batches")  # beside the reading
        start = time.perf_counter()
        try:
            mesh, notes, report = read()
        finally:
            seconds["read"] = time.perf_counter() - start
            opened = Device(opened=opening.result())  # what is wrong with the device is said first
            seconds["device"] = opened.seconds
        with unbroken():
            stages.result()
    with unbroken():
        from .batches import scale_of
        from .scaffold import BOUND
        from .selftest import ensure_tested
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
    try:
        fits = layers_that_fit(
            grid_at, p.pitch, widest / 2, p.scaffolding, mesh.facets, budget, opened.largest
        )  # fmt: skip
    except UsageError as error:
        units = "" if mesh.own_units else f" (units = {p.units})"
        hints = "".join(f"; {note}{units}" for note in size_notes(mesh))
        raise UsageError(f"{p.at('pitch')}{error}{hints}") from None
    scale = scale_of(p)
    quantum = {"distance": 1.0 / scale}
    if p.scaffolding:
        quantum["union"] = 1.0 / min(scale, quanta(p.scaffold_buffer / p.pitch + BOUND))
    return Slicing(
        p, mesh.facets, report, low, high, grid, plan.heights, copy_offsets(p, low, high), opened.name,
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
