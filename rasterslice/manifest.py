"""The manifest and the table of layers: what a run says about itself."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import __version__
from .folder import PROGRAM
from .grid import Grid
from .paths import COLUMNS, Stat

if TYPE_CHECKING:
    from .params import Params
    from .slicer import Slicing

#: How many layers the manifest lists under each heading of ``worst``.
WORST = 5

_LENGTHS = ("part_boundary_mm", "scaffold_boundary_mm", "part_fill_mm", "scaffold_fill_mm")
_COUNTS = {"layer", "part_contours", "scaffold_contours", "part_points", "scaffold_points", "open_rows"}

Rows = list[dict[str, Stat]]


def csv_row(stats: dict[str, Stat]) -> str:
    """Return the row of a slice in ``layers.csv``: mm and mm^2 with four decimals, blanks empty."""
    return ",".join(map(_cell, COLUMNS, map(stats.get, COLUMNS)))


def write_csv(rows: list[str], path: Path) -> None:
    """Write ``layers.csv``: one row per slice, bottom-up."""
    path.write_bytes(("\n".join([",".join(COLUMNS), *rows]) + "\n").encode("ascii"))


def describe(params: Params, slicing: Slicing, stats: Rows, made: list[str]) -> dict[str, Any]:
    """Return the manifest of a run, still without what only the end of it can tell.

    Parameters
    ----------
    stats : list of dict
        Of each layer, bottom-up.
    made : list of str
        Files and folders of the exports, relative to the output folder.
    """
    return {
        "program": PROGRAM,
        "version": __version__,
        "name": stem(params),
        "settings": settings(params),
        "inputs": [],
        "device": slicing.device_name,
        "grid": grid_entry(slicing.grid),
        "quantum": _plain(slicing.quantum),
        "layers": len(stats),
        "copies": [[round(float(v), 6) for v in offset] for offset in slicing.copies],
        "facets": slicing.facets,
        "mesh": {k: v for k, v in slicing.report.items() if k not in ("facets", "notes")},
        "batch": slicing.batch,
        "seconds": {},
        "peak_memory_mib": None,
        "warnings": list(slicing.warnings),
        "flagged_layers": sum(bool(row["flags"]) for row in stats),
        "worst": {
            "area": _worst(stats, "relative_error", _relative_error),
            "open_rows": _worst(stats, "open_rows", lambda row: _number(row["open_rows"])),
            "lost_area": _worst(stats, "lost_area", lambda row: _number(row["lost_area"])),
        },
        "totals": {
            **{name: round(math.fsum(_number(row[name]) for row in stats), 4) for name in _LENGTHS},
            "part_mm3": round(math.fsum(_number(row["part_area"]) for row in stats) * params.thickness, 4),
            "scaffold_mm3": round(math.fsum(_number(row["scaffold_area"]) for row in stats) * params.thickness, 4),
        },
        "exports": sorted(made),
        "files": [],
    }


def settings(params: Params) -> dict[str, Any]:
    """Return every parameter as the manifest holds it."""
    return {name: value for name, value in _plain(dataclasses.asdict(params)).items() if name != "lines"}


def grid_entry(grid: Grid) -> dict[str, float | int]:
    """Return a grid as the manifest holds it."""
    return {**dataclasses.asdict(grid), "width": grid.width, "height": grid.height}


def stem(params: Params) -> str:
    """Return the name of a job: that of its parameter file, or of its first mesh."""
    return (params.source or params.files[0]).stem


def peak_memory_mib() -> float | None:
    """Return the largest resident size that this process has had, where the system tells."""
    try:
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):  # getrusage would count the parent's memory before exec, too
                return round(int(line.split()[1]) / 1024, 1)
    except OSError:
        pass
    try:
        import resource
    except ImportError:
        return None
    unit = 1 if sys.platform == "darwin" else 1024
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20, 1)


def _worst(stats: Rows, name: str, badness: Callable[[dict[str, Stat]], float]) -> list[dict[str, Any]]:
    """Return the layers with the largest positive badness, worst first, the lower one first where equal."""
    ranked = sorted(((-badness(row), i) for i, row in enumerate(stats)))[:WORST]
    return [{"layer": i, "z": stats[i]["z"], name: -minus} for minus, i in ranked if minus < 0]


def _relative_error(row: dict[str, Stat]) -> float:
    exact = _number(row["part_area_exact"])
    return abs(_number(row["part_area"]) - exact) / exact if exact > 0 and row["part_area"] is not None else 0.0


def _number(value: Stat) -> float:
    return float(value) if isinstance(value, int | float) else 0.0


def _cell(name: str, value: Stat) -> str:
    if value is None or value != value:
        return ""
    if isinstance(value, str) or name in _COUNTS:
        return str(value)
    return f"{value:z.4f}"  # no -0.0000


def _plain(value: Any) -> Any:
    """Return a value as JSON can hold it."""
    if isinstance(value, dict):
        return {str(key): _plain(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
