"""The report as numbers: ``check.csv`` and ``check.json``."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..folder import PROGRAM
from .gaps import OTHER
from .verdict import FAIL, PASS, UNKNOWN, LayerResult, Report, deviation

#: Columns of check.csv: name, and how to get it from a layer.
COLUMNS = (
    "layer", "z", "their_z", "where", "copy", "verdict", "area_ours", "area_theirs", "area_xor", "iou", "to_ours",
    "to_theirs", "to_ours_95", "to_theirs_95", "mean", "islands", "holes", "islands_theirs", "holes_theirs",
    "missing_piece", "missing_x", "missing_y", "extra_piece", "extra_x", "extra_y", "bare", "bare_piece",
    "bare_x", "bare_y", "overhang", "unheld", "unheld_piece", "unheld_x", "unheld_y", "repeated", "close", "reasons",
)  # fmt: skip


def row(layer: LayerResult) -> dict[str, Any]:
    """Return the numbers of one layer, None where there is none."""
    values: dict[str, Any] = {
        "layer": layer.index, "z": layer.z, "their_z": layer.theirs.z, "where": layer.where, "copy": layer.copy or None,
        "verdict": layer.verdict,
    }  # fmt: skip
    for name in COLUMNS[6:-1]:
        values[name] = getattr(layer.measures, name)
    values["reasons"] = "; ".join(layer.reasons)
    return {name: _tidy(value) for name, value in values.items()}


def _tidy(value: Any) -> Any:
    """Return a value as JSON holds it: NumPy's own kinds are none of its."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return None if not math.isfinite(value) else round(value, 5) + 0.0
    return value


def as_dict(report: Report, what: str, against: str) -> dict[str, Any]:
    """Return the whole report as plain data."""
    a, limits = report.alignment, report.limits
    off = [deviation(k.measures) for k in report.layers if k.verdict != UNKNOWN]  # of what can be told
    mean = [k.measures.mean for k in report.layers if k.verdict != UNKNOWN and np.isfinite(k.measures.mean)]
    return {
        "program": PROGRAM, "version": __version__, "checked": against, "against": what, "format": report.format,
        "verdict": report.verdict, "faults": report.faults, "notes": report.notes,
        "layers": len(report.layers),
        "failed": [k.index for k in report.layers if k.verdict == FAIL],
        "cannot_tell": [k.index for k in report.layers if k.verdict == UNKNOWN],
        "passed": sum(k.verdict == PASS for k in report.layers),
        "worst_deviation": _tidy(max(off, default=math.nan)),
        "median_deviation": _tidy(float(np.median(off)) if off else math.nan),
        "mean_deviation": _tidy(float(np.mean(mean)) if mean else math.nan),
        "tolerance": _tidy(limits.tolerance), "width": _tidy(limits.width),
        "uncertainty": _tidy(limits.uncertainty + max(limits.shallow, limits.deep)),
        "alignment": {
            "dx": _tidy(a.dx), "dy": _tidy(a.dy), "dz": _tidy(a.z_shift), "z_is": a.z_is,
            "z_told_by_shape": _tidy(a.told), "turned": a.turned, "scale": _tidy(a.scale),
            "thickness": _tidy(a.thickness),
        },
        "copies": [[_tidy(x), _tidy(y)] for x, y in report.copies],
        "worst": [row(k) for k in report.worst(10)],
        "seconds": report.seconds,
    }  # fmt: skip


def write_json(result: dict[str, Any], path: Path) -> None:
    """Write the report as JSON."""
    path.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n", encoding="utf-8", newline="\n")


def write_csv(report: Report, path: Path) -> None:
    """Write one row a layer."""
    lines = [",".join(COLUMNS)]
    for layer in report.layers:
        lines.append(",".join(_cell(value) for value in row(layer).values()))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _cell(value: Any) -> str:
    if value is None:
        return ""
    text = f"{value:.4f}" if isinstance(value, float) else str(value)
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\n') else text


def lines(result: dict[str, Any]) -> list[str]:
    """Return what the command line prints."""
    a = result["alignment"]
    found = [
        f"{result['checked']}: {result['format']}, {result['layers']} layers of {a['thickness']:g} mm",
        "aligned   dx {:.3f}, dy {:.3f}, dz {:.3f} mm; ".format(*(round(a[k], 3) + 0.0 for k in ("dx", "dy", "dz")))
        + f"heights are the {a['z_is']} of layers"
        + ("" if a["z_told_by_shape"] else " (by custom)"),
        f"limits    tolerance {result['tolerance']:.3f} mm, our uncertainty {result['uncertainty']:.3f} mm",
        "deviation worst {:.4f} mm, median of layers {:.4f} mm (of those that can be told; what is "
        "smaller than a pixel, or beads or pixels explain, is no fault)".format(
            result["worst_deviation"] or 0, result["median_deviation"] or 0
        ),
    ]
    found += [f"fault     {text}" for text in result["faults"]]
    found += [f"note      {text}" for text in result["notes"]]
    for layer in result["worst"]:
        if layer["verdict"] != PASS:
            found.append(f"layer {layer['layer']}, z {layer['z']:.3f}: {layer['verdict']}: {layer['reasons']}")
    counts = f"{result['passed']} pass, {len(result['failed'])} fail, {len(result['cannot_tell'])} cannot tell"
    other = f"; {OTHER} than asked for" if any(text.startswith(OTHER) for text in result["notes"]) else ""
    return [*found, f"{result['verdict']}: {counts}{other}"]
