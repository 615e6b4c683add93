"""All layers in one SVG, in the layout of Slic3r: a group per layer with ``slic3r:z``, polygons in mm.

The part is ``polygon`` elements, ``slic3r:type`` contour or hole, as readers of the layout expect; the scaffold is
one ``path`` of type support, which they pass over. Drawings have y down, so y is turned around within the grid's box.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..paths import Layer, Paths
from .format import Context
from .polyline import rounded

_HEAD = (
    '<?xml version="1.0" encoding="UTF-8" standalone="yes"?>\n'
    '<svg width="{0:.4f}" height="{1:.4f}" xmlns="http://www.w3.org/2000/svg" '
    'xmlns:slic3r="http://slic3r.org/namespaces/slic3r" viewport-fill="black" style="background: black">\n'
    "<!-- millimetres; slic3r:z is the upper surface of a layer, slic3r:slice-z where it was cut -->\n"
)
_STYLE = {"contour": "fill: white", "hole": "fill: black"}


def write(layers: Sequence[Layer], path: Path, context: Context) -> None:
    """Write the drawing, layer by layer."""
    grid = context.grid
    width, height = (grid.width - 1) * grid.pitch, (grid.height - 1) * grid.pitch
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(_HEAD.format(width, height))
        for layer in layers:
            file.write(
                f'<g id="layer{layer.index}" slic3r:z="{context.top(layer):.4f}" slic3r:slice-z="{layer.z:.4f}" '
                f'slic3r:layer-height="{context.thickness:.4f}">\n'
            )
            file.write(_polygons(_drawn(layer.part, context)))
            file.write(_support(_drawn(layer.scaffold, context)))
            file.write("</g>\n")
        file.write("</svg>\n")


def _drawn(region: Paths | None, context: Context) -> Paths:
    """Return a region in the frame of the drawing: from the grid's upper left corner, y down."""
    if region is None:
        return Paths.empty(True)
    grid = context.grid
    top = grid.y0 + (grid.height - 1) * grid.pitch
    return Paths(rounded((region.points - (grid.x0, top)) * (1, -1), 4), region.offsets, True)


def _polygons(region: Paths) -> str:
    """Return the loops, larger ones first, so that each lies on top of the one around it."""
    area = -region.areas()  # y is turned around
    text = []
    for i in np.argsort(-np.abs(area), kind="stable").tolist():
        loop = region[i]
        if len(loop) >= 3:
            kind = "contour" if area[i] > 0 else "hole"
            points = ("%.4f,%.4f " * len(loop)) % tuple(loop.ravel().tolist())
            text.append(f'<polygon slic3r:type="{kind}" style="{_STYLE[kind]}" points="{points[:-1]}"/>\n')
    return "".join(text)


def _support(region: Paths) -> str:
    loops = [loop for loop in region if len(loop) >= 3]
    if not loops:
        return ""
    data = "".join([("M" + "%.4f,%.4f " * len(p) + "Z") % tuple(p.ravel().tolist()) for p in loops])
    return f'<path slic3r:type="support" style="fill: #666666; fill-rule: evenodd" d="{data}"/>\n'
