"""One check from files to a report on disk."""

from __future__ import annotations

import dataclasses
import math
import time
from pathlib import Path
from typing import Any

from ..errors import UsageError
from ..folder import read_manifest, writing
from ..params import Params, read_params
from ..slicer import prepare
from . import readers
from .copies import split
from .form import Floats, Theirs
from .frame import width_of
from .page import write_page
from .pixels import DISC, STRAIGHT
from .plate import alone, merged
from .reference import Reference, Run
from .scaffold import compare_scaffolds
from .support import Holding, check_supports, has_supports
from .table import as_dict, write_csv, write_json
from .unit import in_mm
from .verdict import Report, judge, limits_of, rejudge
from .width import align_and_width

Shift = tuple[float, float] | str
FAR = 1e5  # mm: how far a part may be said to stand aside
WIDTHS = (0.1, 10.0)  # of a bead that may be given, path widths


def check(
    what: Path, against: Path, *, shift: Shift = "auto", tolerance: float | None = None, width: float | None = None,
    holding: Holding | None = None, device: str | None = None, out: Path | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Check a file against the slices of a parameter file, or one run against another.

    Parameters
    ----------
    what : Path
        A parameter file, or the folder of a run.
    against : Path
        What another program wrote, or another run.
    shift : "auto", "none" or (dx, dy)
        How to find the shift in x and y, or the shift, mm.
    tolerance, width : float, optional
        mm; default from the pitch and the width of beads, and what the file says.
    holding : Holding, optional
        When a support holds an overhang; given, overhangs are checked even if the file has no supports.
    device : str, optional
        As in `device.Device`.
    out : Path, optional
        Folder for ``check.csv``, ``check.json`` and ``check.html``; made if need be.

    Returns
    -------
    dict
        As in ``check.json``; ``verdict`` is "pass", "fail" or "cannot tell".

    Raises
    ------
    RasterSliceError
        Whatever a user can mend, in one line.
    """
    if out is not None and out.exists() and not out.is_dir():
        raise UsageError(f"{out}: is a file; name a folder with -o")
    watch = _Watch()
    side: Reference | Run
    if what.is_dir():
        side, theirs = _two_runs(what, against, device)
    else:
        params = read_params(what)
        theirs = readers.read(against)
        _check_options(params, theirs, shift, tolerance, width)
        side = Reference(params, device)
        theirs = in_mm(side, theirs)
    watch.lap("read")
    plate = split(side, theirs) if isinstance(side, Reference) and not theirs.pitch else None
    watch.lap("copies")
    slices, reports = _Scaffolds(device), []
    for one in (plate.copies if plate else []) or [theirs]:
        reports.append(_compare(side, one, watch, shift, tolerance, width))
        _scaffold(side, one, reports[-1], holding, slices)
        watch.lap("scaffold")
    report = reports[0]
    if plate and isinstance(side, Reference):
        report = merged(side, plate, reports) if plate.copies else alone(side, plate, report)
    report.seconds = {**watch.seconds, "total": round(time.perf_counter() - watch.start, 3)}
    result = as_dict(report, str(what), str(against))
    if out is not None:
        _write(report, side, result, out)
    return result


def _check_options(
    params: Params, theirs: Theirs, shift: Shift, tolerance: float | None, width: float | None
) -> None:
    """Refuse what would let anything pass."""
    bead = params.part_width
    if tolerance is not None and tolerance > bead / 2:
        raise UsageError(f"--tolerance {tolerance:g} mm: more than half of a path of {bead:g} mm; give at most that")
    if not isinstance(shift, str) and max(map(abs, shift)) > FAR:
        raise UsageError(f"--align {shift[0]:g},{shift[1]:g} mm: farther than {FAR:g} mm; give it in mm")
    if width is None:
        return
    if not WIDTHS[0] * bead <= width <= WIDTHS[1] * bead:
        low, high = (bead * share for share in WIDTHS)
        raise UsageError(f"--width {width:g} mm: paths are {bead:g} mm wide; give {low:g} to {high:g} mm")
    said = width_of(theirs.layers, math.nan)
    if abs(said - width) > 0.01 * said:
        raise UsageError(f"--width {width:g} mm: the file says that its outer beads are {said:g} mm wide; leave it out")


def _compare(
    side: Reference | Run, theirs: Theirs, watch: _Watch, shift: Shift, tolerance: float | None, width: float | None
) -> Report:
    """Align one copy and judge it, without its scaffold."""
    found, wide = align_and_width(side, theirs, width, shift)
    watch.lap("align")
    report = judge(side, theirs, found, limits_of(side, theirs, wide, tolerance, found.scale), wide.doubt)
    watch.lap("measure")
    return report


class _Watch:
    """Seconds of each stage."""

    def __init__(self) -> None:
        self.start = self._last = time.perf_counter()
        self.seconds: dict[str, float] = {}

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name] = round(self.seconds.get(name, 0.0) + now - self._last, 3)
        self._last = now


def _write(report: Report, side: Reference | Run, result: dict[str, Any], out: Path) -> None:
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        parts = {name: out / f".{name}.part" for name in ("check.csv", "check.json", "check.html")}
        try:  # three files of one check, or those of the last one
            write_csv(report, parts["check.csv"])
            write_json(result, parts["check.json"])
            write_page(report, side, result, parts["check.html"])
            for name, part in parts.items():
                part.replace(out / name)
        finally:
            for part in parts.values():
                part.unlink(missing_ok=True)


def _two_runs(what: Path, against: Path, device: str | None) -> tuple[Run, Theirs]:
    """Read two runs; where one has no regions, compare boundary paths."""
    for folder in (what, against):
        if read_manifest(folder) is None:
            raise UsageError(f"{folder}: is no run of rasterslice; to check a file, name a parameter file first")
    areas = "regions" if readers.has_regions(what) and readers.has_regions(against) else "boundary"
    first, second = readers.ours(what, areas), readers.ours(against, areas)
    manifest = read_manifest(what) or {}
    try:
        fields = {f.name for f in dataclasses.fields(Params)}
        settings = {k: v for k, v in manifest["settings"].items() if k in fields and k not in ("source", "export")}
        params = Params(**settings)
    except (KeyError, TypeError) as error:
        raise UsageError(f"{what}: the manifest lacks {error}; slice again") from error
    side, pixels = Run(first.layers, params, device), sorted({first.pitch, second.pitch})
    said = (
        f"pixels of {' and '.join(f'{p:g}' for p in pixels)} mm: what one run lacks counts where a disc of "
        f"{2 * DISC * pixels[-1]:g} mm fits into it, or where both run straight for {2 * STRAIGHT * pixels[-1]:g} mm"
    )
    return side, dataclasses.replace(second, precision=first.precision + second.precision, notes=[said])


def _scaffold(
    side: Reference | Run, theirs: Theirs, report: Report, holding: Holding | None, slices: _Scaffolds
) -> None:  # fmt: skip
    """Look whether supports hold every overhang; compare scaffolds by our rule, or say why not."""
    params, layers = side.params, [k.theirs for k in report.layers]
    if holding is not None or has_supports(theirs):
        report.notes += check_supports(side, report, holding or Holding())
        rejudge(report)
    elif not theirs.scaffold and params.scaffolding:
        report.notes.append("the file has no supports: whether every overhang is held was not checked")
    if not theirs.scaffold:
        return
    if not params.scaffolding:
        report.notes.append("the file has a scaffold and the parameters ask for none: it is not checked")
        return
    if isinstance(side, Run):
        ours = [k.scaffold for k in side.at(report.alignment.heights)]
    else:
        ours = slices.at(params, report)
        if not ours:
            report.notes.append("the scaffold was not checked: the layers lie at other heights than ours")
            return
    compare_scaffolds(side, ours, layers, [k.measures for k in report.layers], report.limits)
    rejudge(report)


class _Scaffolds:
    """Our own scaffolds, sliced once for all copies."""

    def __init__(self, device: str | None) -> None:
        self._device, self._found = device, dict[int, tuple[float, list[Floats]]]()

    def at(self, params: Params, report: Report) -> list[list[Floats]]:
        """Return our scaffold at each of their layers; none when heights differ."""
        if not self._found:
            slicing = prepare(params, device=self._device, regions=True)
            for layer in slicing.layers():
                loops = [p.copy() for p in layer.scaffold or () if len(p) >= 3]
                self._found[layer.index] = float(slicing.heights[layer.index]), loops
        found, heights = self._found, report.alignment.heights.tolist()
        off = [abs(found[k.index][0] - z) for k, z in zip(report.layers, heights, strict=True)]
        return [] if max(off) > 0.01 * params.thickness else [found[k.index][1] for k in report.layers]
