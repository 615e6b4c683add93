"""One parameter file to one output folder: slice, spool, table, exports, manifest."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import __version__, export, folder, manifest
from .errors import ModelError, UsageError
from .grid import Grid
from .interrupts import unbroken
from .spool import open_result, open_spool

if TYPE_CHECKING:
    from .params import Params
    from .slicer import Slicing
    from .spooling import SpoolWriter

Progress = Callable[[int, int], None]

#: Basis of the estimate of `dry_run`: 765 layers of 0.55 Mpx and 1e6 facets take about 2.5 s on 2 cores.
SECONDS_PER_PIXEL, SECONDS_PER_FACET, SECONDS_TO_START = 4e-9, 0.4e-6, 0.5


def run(
    params: Params, *, out: Path | None = None, device: str | None = None, progress: Progress | None = None,
    held: list[object] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Slice, and write the output folder.

    Parameters
    ----------
    params : Params
        What to do; ``params.export`` names the exports.
    out : Path, optional
        The folder to make, or to replace if it is ours; default ``<stem>.slices`` beside the parameter file.
    device : str, optional
        Which OpenCL device; default the best one.
    progress : callable, optional
        Called with the number of finished layers and of all layers.
    held : list, optional
        Gets what it takes time to let go of; a process that ends at once need not.

    Returns
    -------
    dict
        The manifest, as written to ``manifest.json``.

    Raises
    ------
    RasterSliceError
        For whatever a user can mend; the folder is then as it was before.
    """
    from . import slicer  # imports OpenCL, which `export_more` never needs

    start = time.perf_counter()
    formats = [f for f in _formats(params) if f.name != "report"]  # which every run has
    target = out_folder(params, out)
    inputs = [path for path in (params.source, *params.files) if path is not None]
    folder.check_target(target, inputs)
    for path in params.files:
        if path.exists() and not path.is_file() and not path.is_dir():  # a pipe would block, a device never ends
            raise ModelError(f"{params.at('files')}{path}: is not a file on disk; name a mesh file")
    with ExitStack() as stack:
        scratch = stack.enter_context(folder.replacing(target))
        pool = stack.enter_context(ThreadPoolExecutor(1))  # done before the folder is renamed, or removed
        regions = any(f.needs_regions or f.wants_regions for f in formats)
        slicing = slicer.prepare(params, device=device, regions=regions)
        if held is not None:
            held.append(slicing)
        _precheck(formats, params, slicing)
        seconds: dict[str, float] = {"write": 0.0}
        spool = partial(_spool, scratch / "layers", len(slicing.heights), regions)
        writer, rows, sums = _spool_layers(
            slicing, spool, target, seconds, progress, lambda: _begin_beside(pool, formats, inputs)
        )
        with folder.writing(target):
            # beside the table, the exports and the report
            with unbroken():
                sealed = pool.submit(folder.seal, scratch, "layers/*", sums=writer.sums())
            with _timed(seconds, "write"):
                stats = writer.stats()
                layers = open_spool(scratch / "layers", stats)
                manifest.write_csv(rows, scratch / "layers.csv")
            result = manifest.describe(params, slicing, stats, [])
            with unbroken():
                result["inputs"] = sums.result()
            result["seconds"] = _rounded({**slicing.seconds, **seconds})
            with _timed(seconds, "export"):
                context = _context(params, slicing.grid, result)
                made = export.write(formats, layers, scratch, context)
            result["exports"] = sorted(made)
            result["warnings"] += context.warnings
            result["seconds"] = _rounded({**slicing.seconds, **seconds})
            context.warnings.clear()
            with _timed(seconds, "report"):  # after all else, which it tells about
                export.write(export.find(["report"]), layers, scratch, context)
            result["warnings"] += context.warnings
            with _timed(seconds, "write"), unbroken():
                result["files"] = folder.seal(scratch, sealed=sealed.result())
            result["seconds"] = _rounded({**slicing.seconds, **seconds, "total": time.perf_counter() - start})
            result["peak_memory_mib"] = manifest.peak_memory_mib()
            folder.write_manifest(scratch, result)
    return result


def export_more(where: Path, names: Iterable[str]) -> dict[str, Any]:
    """Add exports to an output folder that is complete, or make them anew; return its new manifest.

    The folder is replaced by one that shares the files that stay, so that it is whole at every moment.
    """
    formats = export.find(names)
    where = where.resolve()
    layers = open_result(where)
    old = folder.read_manifest(where) or {}
    lacking = [f.name for f in formats if f.needs_regions and not layers.regions]
    if lacking:
        raise UsageError(
            f"{where}: was sliced without regions, which {lacking[0]} draws; slice again with --export {lacking[0]}"
        )
    try:
        grid = Grid(*(old["grid"][name] for name in ("x0", "y0", "pitch", "tiles_x", "tiles_y")))
        settings = old["settings"]
        context = export.Context(
            old["name"], grid, settings["thickness"], settings["part_width"], settings["support_width"],
            settings["slice_position"], old, settings,
        )  # fmt: skip
    except (KeyError, TypeError) as error:
        raise UsageError(f"{where}: the manifest lacks {error}; slice again") from error
    seconds = dict(old.get("seconds", {}))
    with folder.replacing(where) as scratch, folder.writing(where):
        targets = [f.path(context.stem) for f in formats]
        folder.link_all(where, scratch, but={*targets, folder.MANIFEST})
        seconds["export"] = 0.0
        with _timed(seconds, "export"):
            export.write(formats, layers, scratch, context)
        made = sorted({*old.get("exports", []), *targets})
        again = tuple(f"{f.name}: " for f in formats)  # what these said before is said anew, or is over
        kept = [text for text in old.get("warnings", []) if not text.startswith(again)]
        warnings = list(dict.fromkeys([*kept, *context.warnings]))
        result = {**old, "seconds": _rounded(seconds), "warnings": warnings, "exports": made}
        result["files"] = folder.seal(scratch)
        folder.write_manifest(scratch, result)
    return result


def dry_run(params: Params, device: str | None = None, out: Path | None = None) -> dict[str, Any]:
    """Return what a run would do, without slicing: grid, layers, memory, and a crude time.

    The time is that of a dense statue on two CPU cores, scaled by pixels and facets; it may be wrong by a factor of
    three.
    """
    from . import slicer

    formats = _formats(params)
    folder.check_target(out_folder(params, out), [path for path in (params.source, *params.files) if path is not None])
    slicing = slicer.prepare(params, device=device, regions=any(f.needs_regions or f.wants_regions for f in formats))
    _precheck(formats, params, slicing)
    pixels = slicing.grid.width * slicing.grid.height * len(slicing.heights)
    estimate = SECONDS_TO_START + pixels * SECONDS_PER_PIXEL + slicing.facets * SECONDS_PER_FACET
    return {
        "program": folder.PROGRAM,
        "version": __version__,
        "dry_run": True,
        "grid": manifest.grid_entry(slicing.grid),
        "layers": len(slicing.heights),
        "facets": slicing.facets,
        "device": slicing.device_name,
        "batch": slicing.batch,
        "image_mib": round(slicing.image_bytes / 2**20, 3),
        "memory_budget_mib": round(slicing.memory_budget / 2**20, 1),
        "estimated_seconds": round(estimate, 1),
        "warnings": list(slicing.warnings),
    }


def out_folder(params: Params, out: Path | None) -> Path:
    """Return the absolute path of the output folder, symbolic links followed."""
    if out is None:
        if params.source is None:
            raise UsageError("these parameters come from no file, so there is no default output folder; give out=")
        out = params.source.with_suffix(".slices")
        if out == params.source:
            raise UsageError(f"{out}: the output folder would have this name too; name another with -o")
    return out.resolve()


def _formats(params: Params) -> list[export.Format]:
    try:
        return export.find(params.export)
    except UsageError as error:
        raise UsageError(f"{params.at('export')}{error}") from None


def _spool_layers(
    slicing: Slicing,
    spool: Callable[[], SpoolWriter],
    target: Path,
    seconds: dict[str, float],
    progress: Progress | None,
    begin: Callable[[], Future[list[folder.FileEntry]]],
) -> tuple[SpoolWriter, list[str], Future[list[folder.FileEntry]]]:
    """Pull the layers, top-down, into the spool; only what fails while writing is a failed write.

    Returns what wrote them, the rows of the table, bottom-up, and what ``begin`` returned. That is called with the
    first layer, for what can be done beside: before, the processors have enough to do, and the spool is not made before
    either.
    """
    writer, begun, rows = None, None, list[str]()
    try:
        with closing(slicing.layers(progress)) as layers:
            for layer in layers:
                begun = begun or begin()
                with folder.writing(target), _timed(seconds, "write"):
                    writer = writer or spool()
                    writer.append(layer)
                    rows.append(manifest.csv_row(layer.stats))
        with folder.writing(target), _timed(seconds, "write"):
            writer = writer or spool()
            writer.close()
    finally:
        if writer is not None:
            writer.abort()
    return writer, rows[::-1], begun or begin()


def _spool(where: Path, layers: int, regions: bool) -> SpoolWriter:
    with unbroken():
        from .spooling import SpoolWriter
    return SpoolWriter(where, layers, regions)


def _begin_beside(
    pool: ThreadPoolExecutor, formats: Iterable[export.Format], inputs: list[Path]
) -> Future[list[folder.FileEntry]]:
    """Begin to import what the exports need, and to hash the input files, of which the sums are returned."""
    with unbroken():
        pool.submit(export.load, [*formats, *export.find(["report"])])
        return pool.submit(_input_entries, inputs)


def _context(params: Params, grid: Grid, about: dict[str, Any]) -> export.Context:
    return export.Context(
        manifest.stem(params), grid, params.thickness, params.part_width, params.support_width, params.slice_position,
        about, manifest.settings(params),
    )  # fmt: skip


def _precheck(formats: list[export.Format], params: Params, slicing: Slicing) -> None:
    """Let the formats refuse at once what the size of the part already forbids."""
    low, high = slicing.low.copy(), slicing.high.copy()
    below, above = (share * params.thickness for share in (params.slice_position, 1 - params.slice_position))
    low[2], high[2] = slicing.heights[0] - below, slicing.heights[-1] + above
    context = _context(params, slicing.grid, {"copies": slicing.copies.tolist()})
    export.precheck(formats, context, low, high)


def _input_entries(paths: list[Path]) -> list[folder.FileEntry]:
    try:
        return [folder.file_entry(path) for path in paths]
    except OSError as error:
        raise ModelError(f"{error.filename}: cannot be read: {error.strerror}") from error


def _rounded(seconds: dict[str, float]) -> dict[str, float]:
    return {name: round(float(value), 4) for name, value in seconds.items()}


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    start = time.perf_counter()
    try:
        yield
    finally:
        seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - start
