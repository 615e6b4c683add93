"""DXF (R12): deposition paths as 3-D polylines on one layer per kind, by ezdxf's streaming writer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..paths import Layer
from .format import Context
from .polyline import passes


def write(layers: Sequence[Layer], path: Path, context: Context) -> None:
    """Write polylines at the upper surface of what they lay, mm, on the layers ``PART_BOUNDARY`` and so on."""
    from ezdxf.addons.r12writer import r12writer  # the extra [dxf]

    with r12writer(str(path)) as file:
        for layer in layers:
            for each in passes(layer, context):
                z = round(context.top(layer, each.share), 4)
                for material, what, paths in each.sets:
                    for line in paths:
                        if len(line) >= 2:
                            xyz = np.column_stack([np.round(line, 4) + 0.0, np.full(len(line), z)])
                            name = f"{material}_{what}".upper()
                            file.add_polyline(xyz.tolist(), layer=name, closed=paths.closed)
