"""DXF (R12): deposition paths as 3-D polylines on one layer per kind.

A file of R12 may hold its entities alone; readers make the layers from the names that they find. Remarks (999) at the
top tell ice layers from slices.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..paths import Layer, Paths
from .format import Context
from .polyline import fill_in, passes, rounded, slice_notes


def write(layers: Sequence[Layer], path: Path, context: Context) -> None:
    """Write polylines at the upper surface of what they lay, mm, on the layers ``PART_BOUNDARY`` and so on."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        base = [f"slice_base = {context.top(layers[0], 0.0):.4f}"] if len(layers) else []
        file.write("".join(f"999\n{note}\n" for note in [*slice_notes(context), *base]))
        file.write("0\nSECTION\n2\nENTITIES\n")
        for layer in layers:
            for each in passes(layer, context):
                z = round(context.top(layer, each.share), 4)
                for material, what, paths in each.sets:
                    file.write(_polylines(paths, f"{material}_{what}".upper(), z))
        file.write("0\nENDSEC\n0\nEOF\n")


def _polylines(paths: Paths, name: str, z: float) -> str:
    """Return the paths of two points and more; 8 is the flag of a 3-D polyline and 1 of a closed one."""
    counts: NDArray[np.int64] = np.diff(paths.offsets).astype(np.int64)
    points = paths.points[np.repeat(counts >= 2, counts)]
    counts = counts[counts >= 2]
    head = f"0\nPOLYLINE\n8\n{name}\n66\n1\n70\n{8 + int(paths.closed)}\n"
    vertex = f"0\nVERTEX\n8\n{name}\n70\n32\n10\n%.4f\n20\n%.4f\n30\n{z}\n"
    patterns = {n: head + vertex * n + "0\nSEQEND\n" for n in np.unique(counts).tolist()}
    return fill_in(counts, patterns, rounded(points, 4).ravel())
