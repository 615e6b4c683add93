"""What a build takes: volumes, lengths of beads, and the time to lay them with the machine of the job."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path

from ..errors import UsageError
from ..paths import Stat
from ..profile import Profile, read_profile
from .format import Context

Rows = list[dict[str, Stat]]


def build_hours(rows: Iterable[dict[str, Stat]], times: dict[str, int], profile: Profile) -> dict[str, float]:
    """Return how long the beads of each material take at the speed of its nozzle.

    Parameters
    ----------
    times : dict
        How often ``part`` and ``scaffold`` are laid in each slice, copies included.
    """
    speed = {"part": profile.part_nozzle.speed, "scaffold": profile.scaffold_nozzle.speed}
    found = dict.fromkeys(times, 0.0)
    for row in rows:
        for name, n in times.items():
            found[name] += n * (number(row.get(f"{name}_boundary_mm")) + number(row.get(f"{name}_fill_mm")))
    return {name: length / speed[name] / 3600 for name, length in found.items()}


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
        area = sum(number(row.get(f"{name}_area")) for row in rows)
        lengths = (n * sum(number(row.get(f"{name}_{what}_mm")) for row in rows) for what in ("boundary", "fill"))
        volume = f"{copies * area * context.thickness / 1000:.1f} cm\N{SUPERSCRIPT THREE}"
        once = f"{n // copies} x" if copies == 1 else f"{n // copies} x {copies} copies"
        lines.append((name, volume, *(f"{v / 1000:.1f} m" for v in lengths), once, f"{hours[name]:.1f} h"))
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


def number(value: Stat) -> float:
    """Return a statistic as a number; a blank is 0."""
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else 0.0
