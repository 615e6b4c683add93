"""One SVG drawing per layer, in millimetres and in the frame of the part (y up inside the drawing)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..paths import Layer, Paths, Stat
from .format import Context

#: Colours of region, bead and line.
INK = {"part": ("#cfe8f5", "#3f9bc9", "#0b4f78"), "scaffold": ("#f1ece4", "#cdb99c", "#8a7353")}


def write(layers: Sequence[Layer], folder: Path, context: Context) -> None:
    """Write ``layer_0000.svg`` and so on into a new folder."""
    folder.mkdir()
    head, tail = _frame(context)
    for layer in layers:
        text = head + _caption(layer, context) + drawing(layer, context) + tail
        (folder / f"layer_{layer.index:04d}.svg").write_bytes(text.encode("ascii", "xmlcharrefreplace"))


def path_data(paths: Paths) -> str:
    """Return paths as the data of one SVG path element, in mm with three decimals."""
    count = np.diff(paths.offsets)
    end = "Z" if paths.closed else ""
    # Lines are alike by the thousand: one pattern per number of points, filled in by a single operation.
    pattern = {n: "M%.3f,%.3f" + "L%.3f,%.3f" * (n - 1) + end + "\n" for n in set(count.tolist()) if n}
    rounded = np.round(paths.points, 3) + 0.0  # no -0.000
    return "".join([pattern[n] for n in count.tolist() if n]) % tuple(rounded.ravel().tolist())


def _frame(context: Context) -> tuple[str, str]:
    """Return the beginning and the end of every file: the box of the grid, and a strip for the caption."""
    grid = context.grid
    width, height = (grid.width - 1) * grid.pitch, (grid.height - 1) * grid.pitch
    strip = 2.4 * _text_size(context)
    top = -(grid.y0 + height) - strip
    box = f"{grid.x0:.3f} {top:.3f} {width:.3f} {height + strip:.3f}"
    head = (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.3f}mm" height="{height + strip:.3f}mm" '
        f'viewBox="{box}">\n'
        f'<rect x="{grid.x0:.3f}" y="{top:.3f}" width="100%" height="100%" fill="#ffffff"/>\n'
    )
    return head, "</svg>\n"


def _text_size(context: Context) -> float:
    """Return a type size, mm, at which the caption fits the width."""
    grid = context.grid
    return max(grid.width / 46, min(grid.width, grid.height) / 30) * grid.pitch * 0.9


def _caption(layer: Layer, context: Context) -> str:
    grid, size = context.grid, _text_size(context)
    x, y = grid.x0 + 0.7 * size, -(grid.y0 + (grid.height - 1) * grid.pitch) - 0.9 * size
    part = f"part {_area(layer.stats, 'part_area')}"
    scaffold = f"scaffold {_area(layer.stats, 'scaffold_area')}"
    flags = layer.stats.get("flags")
    return (
        f"<title>layer {layer.index}, z {layer.z:.3f} mm</title>\n"
        f'<text x="{x:.3f}" y="{y:.3f}" font-family="Helvetica,Arial,sans-serif" font-size="{size:.3f}" '
        f'fill="#30363c"><tspan font-weight="bold">layer {layer.index}</tspan>'
        f'<tspan dx="{size:.3f}">z {layer.z:.2f} mm</tspan>'
        f'<tspan dx="{size:.3f}" fill="{INK["part"][2]}">{part}</tspan>'
        f'<tspan dx="{size:.3f}" fill="{INK["scaffold"][2]}">{scaffold}</tspan>'
        + (f'<tspan dx="{size:.3f}" fill="#b3261e">{flags}</tspan>' if flags else "")
        + "</text>\n"
    )


def _area(stats: dict[str, Stat], name: str) -> str:
    value = stats.get(name)
    return "-" if value is None else f"{value:.1f} mm\N{SUPERSCRIPT TWO}"


def drawing(layer: Layer, context: Context) -> str:
    """Return a layer as one group, in mm, y up."""
    fills = [layer.scaffold_fill], [layer.ice_fill(i) for i in range(min(context.part_layers, 2))]
    scaffold = _body("scaffold", layer.scaffold, layer.scaffold_boundary, fills[0], context.support_width)
    part = _body("part", layer.part, layer.part_boundary, fills[1], context.part_width)
    return f'<g transform="scale(1,-1)">\n{scaffold}{part}</g>\n'


def _body(name: str, region: Paths | None, boundary: Paths, fills: list[Paths], width: float) -> str:
    """Return part or scaffold: the region as a tint, and the middle lines of its beads; a set for each fill."""
    tint, bead, line = INK[name]
    shape = path_data(region) if region else ""
    hatches = "".join(
        f'<path id="{name}_{which}fill" stroke="{bead}" d="{path_data(fill)}"/>\n'
        for which, fill in zip(("", "second_"), fills, strict=False)
    )
    return (
        f'<g id="{name}" fill="none" stroke-linejoin="round" stroke-linecap="round">\n'
        f'<path id="{name}_region" fill="{tint}" fill-rule="evenodd" d="{shape}"/>\n'
        f'<g id="{name}_lines" stroke="{line}" stroke-width="{width * 0.1:.3f}">\n'
        f'<path id="{name}_boundary" d="{path_data(boundary)}"/>\n'
        f"{hatches}</g>\n</g>\n"
    )
