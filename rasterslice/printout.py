"""What commands print of their results, as lines."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any


def summary_lines(summary: dict[str, Any], count: int) -> list[str]:
    """Return what is said of several runs."""
    runs = summary["runs"]
    good = sum(run["exit_code"] == 0 for run in runs)
    ends = ((len(runs) - good, "failed"), (count - len(runs), "not tried"))
    lines = [f"{good} of {count} files done" + "".join(f", {number} {end}" for number, end in ends if number)]
    for run in runs:
        state = f"failed with exit code {run['exit_code']}" if run["exit_code"] else f"done in {run['seconds']:.1f} s"
        lines.append(f"  {run['file']}: {state}")
    return lines


def plan_lines(plan: dict[str, Any]) -> list[str]:
    """Return what a dry run found."""
    grid = plan["grid"]
    return [
        f"grid      {grid['width']} x {grid['height']} px of {grid['pitch']:g} mm",
        f"layers    {plan['layers']}, {plan['batch']} at a time",
        f"facets    {plan['facets']}",
        f"memory    {plan['image_mib']:.1f} MiB an image, budget {plan['memory_budget_mib']:.0f} MiB",
        f"device    {plan['device']}",
        f"time      about {plan['estimated_seconds']:.0f} s (crude)",
    ]


def result_lines(manifest: dict[str, Any], out: Path, seconds: float) -> list[str]:
    """Return what a run wrote."""
    size = "{width} x {height} px".format(**manifest["grid"])
    lines = [
        f"{manifest['layers']} layers of {size} in {seconds:.1f} s on {manifest['device']}",
        f"{out}: report.html, layers.csv, manifest.json, layers{os.sep}",
    ]
    files = [str(entry["path"]) for entry in manifest["files"]]
    for name in manifest["exports"]:
        inside = sum(path.startswith(name + "/") for path in files)
        lines.append(f"{out / name}" + (f"{os.sep} ({inside} files)" if inside else ""))
    if manifest["flagged_layers"]:
        n = manifest["flagged_layers"]
        lines.append(f"{n} layer{'s are' if n > 1 else ' is'} flagged: see the last column of layers.csv")
    return lines


def device_lines(devices: list[dict[str, Any]]) -> list[str]:
    """Return a line for each OpenCL device."""
    return [
        f"{d['name']}  [{d['kind']}, {d['platform']}, {d['memory_mb']} MB, {d['driver']}]"
        + ("" if d["usable"] else "  not usable")
        for d in devices
    ] or ["no OpenCL device"]
