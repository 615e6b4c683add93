"""Fab@Home ``.fab``: XML with one calibration per material, then every path, in mm and mm/s."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..paths import Layer, Paths
from .format import Context
from .polyline import fill_in, passes, rounded, slice_notes, unrolled

SPEED = 10.0  # mm/s, a placeholder: calibrations belong to a machine and its syringe
_NAME = {"part": "water", "scaffold": "scaffold"}
_CALIBRATION = (
    ("pathSpeed", f"{SPEED:g}"), ("pathWidth", "{width:g}"), ("depositionRate", "0.005"), ("pushout", "0.1"),
    ("suckback", "0.1"), ("suckbackDelay", "0"), ("clearance", "2"), ("pausePaths", "30"), ("pitch", "0.000397"),
)  # fmt: skip


def write(layers: Sequence[Layer], path: Path, context: Context) -> None:
    """Write the job, ice layer by ice layer; z is the height of its upper surface above the plate."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write('<?xml version="1.0" encoding="utf-8"?>\n')
        file.write(f"<!-- rasterslice; {'; '.join(slice_notes(context))} -->\n<fabAtHomePrinter>\n")
        file.write("<printAcceleration>100</printAcceleration>\n")
        for material, name in _NAME.items():
            lines = "".join(f"<{key}>{value}</{key}>\n" for key, value in _CALIBRATION)
            lines = lines.format(width=context.width(material))
            file.write(f"<materialCalibration>\n<name>{name}</name>\n{lines}</materialCalibration>\n")
        for layer in layers:
            for each in passes(layer, context):
                z = context.above_plate(layer, each.share)
                for material, _, paths in each.sets:
                    file.write(_path_elements(paths, _NAME[material], z))
        file.write("</fabAtHomePrinter>\n")


def _path_elements(paths: Paths, name: str, z: float) -> str:
    lines = unrolled(paths)
    counts = np.diff(lines.offsets)
    head = f"<path>\n<materialCalibrationName>{name}</materialCalibrationName>\n"
    point = f"<point><x>%.4f</x><y>%.4f</y><z>{z:.4f}</z></point>\n"
    patterns = {n: head + point * n + "</path>\n" for n in np.unique(counts).tolist()}
    return fill_in(counts, patterns, rounded(lines.points, 4).ravel())
