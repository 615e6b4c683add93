"""Every vertex of the deposition paths as one row of a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..paths import Layer
from .format import Context
from .polyline import fill_in, passes, rounded

HEADER = "layer,ice,z,material,kind,path,x,y"


def write(layers: Sequence[Layer], path: Path, context: Context) -> None:
    """Write ``layer,ice,z,material,kind,path,x,y``: mm, four decimals; closed paths do not repeat their first point.

    ``ice`` is the ice layer in the slice, from 0, and the last one for the scaffold; ``z`` is the cutting height,
    ``kind`` is ``boundary`` (closed) or ``fill`` (open), ``path`` counts within them.
    """
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(HEADER + "\n")
        for layer in layers:
            for each in passes(layer, context):
                for material, what, paths in each.sets:
                    row = f"{layer.index},{each.number},{layer.z:.4f},{material},{what},%d,%.4f,%.4f\n"
                    number = np.repeat(np.arange(len(paths)), np.diff(paths.offsets))
                    table = np.column_stack([number, rounded(paths.points, 4)])
                    file.write(fill_in(np.ones(len(table), np.int64), {1: row}, table.ravel()))
