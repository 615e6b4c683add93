"""Output formats: one module each, and the table that names them."""

from __future__ import annotations

import dataclasses
import difflib
import importlib.util
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from ..errors import UsageError
from ..paths import Layer
from . import cli, cobra, csv, dxf, fab, gcode, html, npz, report, sheet, stack, svg, svgsingle
from .copies import Copied, grid_of_copies
from .format import Context, Format

__all__ = ["FORMATS", "Context", "Format", "find", "write"]

#: Every format by name.
FORMATS: dict[str, Format] = {
    f.name: f
    for f in (
        Format("sheet", "sheet.png", sheet.write, True, "contact sheet of evenly spread layers, PNG"),
        Format("svg", "svg", svg.write, True, "one drawing per layer: regions, boundaries, fill lines"),
        Format("svg-single", "{stem}.svg", svgsingle.write, True, "all regions in one SVG of Slic3r's layout"),
        Format("cli", "{stem}.cli", cli.write, False, "Common Layer Interface 2.0, ASCII: deposition paths"),
        Format("cli-binary", "{stem}.binary.cli", cli.write_binary, False, "the same, binary"),
        Format("gcode", "{stem}.gcode", gcode.write, False, "G-code, Marlin flavour: deposition paths"),
        Format("fab", "{stem}.fab", fab.write, False, "Fab@Home: deposition paths"),
        Format("dxf", "{stem}.dxf", dxf.write, False, "DXF R12: deposition paths; needs the extra [dxf]", "ezdxf"),
        Format("csv", "{stem}.csv", csv.write, False, "one row per vertex of the deposition paths"),
        Format("npz", "{stem}.npz", npz.write, False, "all paths as packed NumPy arrays"),
        Format("tiff", "{stem}.ome.tif", stack.write_tiff, True, "OME-TIFF of occupancy, channels part and scaffold"),
        Format("html", "{stem}.html", html.write, True, "layer viewer: one HTML file for any browser"),
        Format(
            "report", "report.html", report.write, False, "what went in and came out, worst layers; every run has it"
        ),
        Format("png", "png", stack.write_png, True, "two PNG of occupancy per layer"),
        Format(
            "cobra", "{stem}.cobra", cobra.write, False, "program and records of an Adept Cobra 600", wants_regions=True
        ),
    )
}


def find(names: Iterable[str]) -> list[Format]:
    """Return the formats of these names, each once, in the order of the table.

    Raises
    ------
    UsageError
        When a name is unknown, with the nearest known one; or when a format's extra package is not installed.
    """
    wanted = set(names)
    for name in sorted(wanted - FORMATS.keys()):
        near = difflib.get_close_matches(name, FORMATS, 1)
        hint = f"did you mean '{near[0]}'? " if near else ""
        raise UsageError(f"unknown export '{name}'; {hint}there are: {', '.join(FORMATS)}")
    found = [f for f in FORMATS.values() if f.name in wanted]
    for f in found:
        if f.package and importlib.util.find_spec(f.package) is None:
            raise UsageError(f"export '{f.name}' needs {f.package}: pip install 'rasterslice[{f.name}]'")
    return found


def write(formats: Iterable[Format], layers: Sequence[Layer], folder: Path, context: Context) -> list[str]:
    """Write formats into an output folder, with all copies of the part; return what was made, relative to it."""
    made = []
    offsets = np.array(context.about.get("copies") or [(0.0, 0.0)])
    if len(offsets) > 1:
        layers = Copied(layers, offsets)
        context = dataclasses.replace(context, grid=grid_of_copies(context.grid, offsets))
    for f in formats:
        target = f.target.format(stem=context.stem)
        f.write(layers, folder / target, context)
        made.append(target)
    return made
