"""Output formats: one module each, and the table that names them."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from pathlib import Path

from ..errors import UsageError
from ..paths import Layer
from .cobra import write as _write_cobra
from .format import Context, Format
from .sheet import write as _write_sheet
from .svg import write as _write_svg

__all__ = ["FORMATS", "Context", "Format", "find", "write"]

#: Every format by name.
FORMATS: dict[str, Format] = {
    f.name: f
    for f in (
        Format("sheet", "sheet.png", _write_sheet, True, "contact sheet of evenly spread layers, PNG"),
        Format("svg", "svg", _write_svg, True, "one drawing per layer: regions, boundaries, fill lines"),
        Format("cobra", "{stem}.cobra", _write_cobra, False, "program and records of an Adept Cobra 600", True),
    )
}


def find(names: Iterable[str]) -> list[Format]:
    """Return the formats of these names, each once, in the order of the table.

    Raises
    ------
    UsageError
        When a name is unknown; with the nearest known one.
    """
    wanted = set(names)
    for name in sorted(wanted - FORMATS.keys()):
        near = difflib.get_close_matches(name, FORMATS, 1)
        hint = f"did you mean '{near[0]}'? " if near else ""
        raise UsageError(f"unknown export '{name}'; {hint}there are: {', '.join(FORMATS)}")
    return [f for f in FORMATS.values() if f.name in wanted]


def write(formats: Iterable[Format], layers: Sequence[Layer], folder: Path, context: Context) -> list[str]:
    """Write formats into an output folder; return what was made, relative to it."""
    made = []
    for f in formats:
        target = f.target.format(stem=context.stem)
        f.write(layers, folder / target, context)
        made.append(target)
    return made
