"""What a build takes: volumes, lengths of beads, and the time to lay them with the machine of the job."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..paths import Stat
from ..profile import Profile, read_profile
from .format import Context

Rows = list[dict[str, Stat]]


def build_hours(rows: Rows, times: dict[str, int], profile: Profile) -> dict[str, float]:
    """Return how long the beads of each material take at the speed of its nozzle.

    Parameters
    ----------
    times : dict
        How often ``part`` and ``scaffold`` are laid in each slice, copies included.
    """
    speed = {"part": profile.part_nozzle.speed, "scaffold": profile.scaffold_nozzle.speed}
    return {name: n * sum(_lengths(rows, name)) / speed[name] / 3600 for name, n in times.items()}


def times_laid(context: Context) -> dict[str, int]:
    """Return how often each material is laid in each slice, copies included."""
    copies = len(context.about.get("copies") or [()])
    return {"part": copies * int(context.settings.get("part_layers_per_slice", 1)), "scaffold": copies}


def machine_of(context: Context) -> Profile:
    """Return the machine, or the one that comes with the program where the file cannot be read, with a warning."""
    machine = context.settings.get("machine")
    try:
        return read_profile(Path(machine) if machine else None)
    except UsageError as error:
        context.warnings.append(f"report: {error}; its time to build is that of the default machine")
        return read_profile(None)


def material_rows(rows: Rows, context: Context, profile: Profile) -> list[tuple[str, ...]]:
    """Return a table of both materials, all copies counted: heads, then volume, lengths, times laid, hours."""
    times = times_laid(context)
    hours = build_hours(rows, times, profile)
    copies = times["scaffold"]
    lines: list[tuple[str, ...]] = [("", "volume", "boundary", "fill", "laid in each slice", "time")]
    for name, n in times.items():
        area = float(column(rows, f"{name}_area").sum())
        volume = f"{copies * area * context.thickness / 1000:.1f} cm\N{SUPERSCRIPT THREE}"
        once = f"{n // copies} x" if copies == 1 else f"{n // copies} x {copies} copies"
        lengths = (f"{n * v / 1000:.1f} m" for v in _lengths(rows, name))
        lines.append((name, volume, *lengths, once, f"{hours[name]:.1f} h"))
    return lines


def time_note(folder: Path, context: Context, profile: Profile) -> str:
    """Return what the hours are made of, and where the program of the robot was made, its own time."""
    speeds = f"{profile.part_nozzle.speed:g} mm/s (part) and {profile.scaffold_nozzle.speed:g} mm/s (scaffold)"
    note = f"Beads at {speeds} of {profile.name}; travel, purging and waiting come on top."
    if int(context.settings.get("part_layers_per_slice", 1)) > 1:
        note += " The fill of every ice layer of a slice is counted as that of the first."
    for path in sorted((folder / f"{context.stem}.cobra").glob("*.json")):
        seconds = json.loads(path.read_text(encoding="utf-8")).get("estimated_seconds")
        if seconds is not None:
            note += f" The program of the robot takes {seconds / 3600:.1f} h, all counted."
    return note


def column(rows: Rows, name: str) -> NDArray[np.float64]:
    """Return a statistic of all layers as numbers; a blank is 0."""
    values = np.array([row.get(name) for row in rows], np.float64)
    return np.where(np.isfinite(values), values, 0.0)


def _lengths(rows: Rows, name: str) -> tuple[float, float]:
    """Return the lengths of boundary and fill of a material, laid once, mm."""
    return float(column(rows, f"{name}_boundary_mm").sum()), float(column(rows, f"{name}_fill_mm").sum())
