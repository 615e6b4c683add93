"""Output formats: one module each, and the table that names them."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UsageError
from ..interrupts import unbroken
from ..paths import Layer
from .copies import Copied, grid_of_copies
from .format import Box, Context, Format

__all__ = ["FORMATS", "Context", "Format", "find", "precheck", "write"]


def _late(module: str, function: str = "write") -> Callable[..., None]:
    """Return a function that imports its module when it is called: a run that exports nothing starts sooner."""

    def late(*values: Any) -> None:
        with unbroken():  # another thread may wait for what is being imported
            imported = importlib.import_module(f"{__name__}.{module}")
        getattr(imported, function)(*values)

    late.__module__ = f"{__name__}.{module}"
    return late


#: Every format by name.
FORMATS: dict[str, Format] = {
    f.name: f
    for f in (
        Format("sheet", "sheet.png", _late("sheet"), True, "contact sheet of evenly spread layers, PNG"),
        Format("svg", "svg", _late("svg"), True, "one drawing per layer: regions, boundaries, fill lines"),
        Format("svg-single", "{stem}.svg", _late("svgsingle"), True, "all regions in one SVG of Slic3r's layout"),
        Format("cli", "{stem}.cli", _late("cli"), False, "Common Layer Interface 2.0, ASCII: deposition paths"),
        Format("cli-binary", "{stem}.binary.cli", _late("cli", "write_binary"), False, "the same, binary"),
        Format("gcode", "{stem}.gcode", _late("gcode"), False, "G-code, Marlin flavour: deposition paths"),
        Format("fab", "{stem}.fab", _late("fab"), False, "Fab@Home: deposition paths"),
        Format("dxf", "{stem}.dxf", _late("dxf"), False, "DXF R12: deposition paths"),
        Format("csv", "{stem}.csv", _late("csv"), False, "one row per vertex of the deposition paths"),
        Format("npz", "{stem}.npz", _late("npz"), False, "all paths as packed NumPy arrays"),
        Format("tiff", "{stem}.ome.tif", _late("stack", "write_tiff"), True, "OME-TIFF of occupancy: part, scaffold"),
        Format("html", "{stem}.html", _late("html"), True, "layer viewer: one HTML file for any browser"),
        Format("report", "report.html", _late("report"), False, "what went in and came out; in every run"),
        Format("png", "png", _late("stack", "write_png"), True, "two PNG of occupancy per layer"),
        Format(
            "cobra", "{stem}.cobra", _late("cobra"), False, "program and records of an Adept Cobra 600",
            wants_regions=True, precheck=_late("cobra", "precheck"),
        ),
    )
}


def find(names: Iterable[str]) -> list[Format]:
    """Return the formats of these names, each once, in the order of the table.

    Raises
    ------
    UsageError
        When a name is unknown, with the nearest known one.
    """
    wanted = set(names)
    for name in sorted(wanted - FORMATS.keys()):
        import difflib

        near = difflib.get_close_matches(name, FORMATS, 1)
        hint = f"did you mean '{near[0]}'? " if near else ""
        raise UsageError(f"unknown export '{name}'; {hint}there are: {', '.join(FORMATS)}")
    return [f for f in FORMATS.values() if f.name in wanted]


def load(formats: Iterable[Format]) -> None:
    """Import what formats need, before they are written."""
    for f in formats:
        importlib.import_module(f.write.__module__)


def precheck(formats: Iterable[Format], context: Context, low: Box, high: Box) -> None:
    """Refuse, before slicing, what is known to fail after it; see `Format`."""
    for f in formats:
        if f.precheck is not None:
            f.precheck(context, low, high)


def write(formats: Iterable[Format], layers: Sequence[Layer], folder: Path, context: Context) -> list[str]:
    """Write formats into an output folder, with all copies of the part; return what was made, relative to it."""
    made = []
    offsets = np.array(context.about.get("copies") or [(0.0, 0.0)])
    if len(offsets) > 1:
        layers = Copied(layers, offsets)
        context = dataclasses.replace(context, grid=grid_of_copies(context.grid, offsets))
    for f in formats:
        target = f.path(context.stem)
        f.write(layers, folder / target, context)
        made.append(target)
    return made
