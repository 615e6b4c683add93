"""Common Layer Interface 2.0, ASCII and binary: contours as polylines, fill lines as hatches.

Label 1 is the part and label 2 the scaffold. Polylines repeat their first point; direction 1 is
counter-clockwise (outer), 0 clockwise (inner). Every ice layer is a layer; the scaffold of a slice lies in its last
one. The height of a layer is that of its upper surface, and an empty layer at the bottom lets readers find the
thickness of the first one.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..paths import Layer, Paths
from .format import Context
from .polyline import fill_in, passes, rounded, slice_notes, unrolled

_LABEL = {"part": 1, "scaffold": 2}
_LAYER, _POLYLINE, _HATCHES = 127, 130, 132  # command words of the long binary forms


def write(layers: Sequence[Layer], path: Path, context: Context) -> None:
    """Write the ASCII form."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(_header(layers, context, "ASCII") + "\n$$GEOMETRYSTART\n")
        if len(layers):
            file.write(f"$$LAYER/{_bottom(layers[0], context):.4f}\n")
        for layer in layers:
            for each in passes(layer, context):
                file.write(f"$$LAYER/{rounded(np.array(context.top(layer, each.share)), 4):.4f}\n")
                for material, what, paths in each.sets:
                    file.write((_polylines if what == "boundary" else _hatches)(paths, _LABEL[material]))
        file.write("$$GEOMETRYEND\n")


def write_binary(layers: Sequence[Layer], path: Path, context: Context) -> None:
    """Write the binary form: a header of text, then little-endian records with 32-bit numbers."""
    with path.open("wb") as file:
        file.write(_header(layers, context, "BINARY").encode("ascii"))
        if len(layers):
            file.write(_layer_record(_bottom(layers[0], context)))
        for layer in layers:
            for each in passes(layer, context):
                file.write(_layer_record(context.top(layer, each.share)))
                for material, what, paths in each.sets:
                    label = _LABEL[material]
                    file.write(_polyline_records(paths, label) if what == "boundary" else _hatch_record(paths, label))


def _header(layers: Sequence[Layer], context: Context, kind: str) -> str:
    grid = context.grid
    (x0, y0), (x1, y1) = grid.to_mm([(0, 0), (grid.width - 1, grid.height - 1)]).tolist()
    low, high = (_bottom(layers[0], context), context.top(layers[-1])) if len(layers) else (0.0, 0.0)
    count = context.part_layers * len(layers) + bool(layers)
    lines = [
        "$$HEADERSTART", f"$${kind}", "$$UNITS/1.0", "$$VERSION/200", "$$LABEL/1,part", "$$LABEL/2,scaffold",
        f"$$DIMENSION/{x0:.4f},{y0:.4f},{low:.4f},{x1:.4f},{y1:.4f},{high:.4f}",
        f"$$LAYERS/{count:06d}",
    ]  # fmt: skip
    if context.part_layers > 1:  # for whoever compares them with the slices of a mesh
        text = ";".join(slice_notes(context))
        lines.append(f"$$USERDATA/rasterslice,{len(text)},{text}")
    return "\n".join([*lines, "$$HEADEREND"])


def _bottom(layer: Layer, context: Context) -> float:
    return float(rounded(np.array(context.top(layer) - context.thickness), 4))


def _turns(paths: Paths) -> tuple[Paths, NDArray[np.int64]]:
    """Return closed polylines and the direction of each."""
    lines = unrolled(paths)
    ways = (Paths(lines.points, lines.offsets, True).areas() > 0).astype(np.int64)  # the repeated point adds nothing
    return lines, ways


def _polylines(paths: Paths, label: int) -> str:
    lines, ways = _turns(paths)
    return "".join(
        [
            f"$$POLYLINE/{label},{way},{len(loop)}" + (",%.4f,%.4f" * len(loop)) % tuple(loop.ravel().tolist()) + "\n"
            for way, loop in zip(ways.tolist(), Paths(rounded(lines.points, 4), lines.offsets, False), strict=True)
        ]
    )


def _hatches(paths: Paths, label: int) -> str:
    lines = _segments(paths)
    text = fill_in(np.full(len(lines), 1), {1: ",%.4f,%.4f,%.4f,%.4f"}, rounded(lines, 4).ravel())
    return f"$$HATCHES/{label},{len(lines)}{text}\n" if len(lines) else ""


def _segments(paths: Paths) -> NDArray[np.float64]:
    """Return every piece of straight line as (x0, y0, x1, y1)."""
    lines = unrolled(paths)
    begins = np.ones(len(lines.points), np.bool_)
    begins[lines.offsets[1:].astype(np.int64) - 1] = False
    (i,) = np.nonzero(begins)
    return np.hstack([lines.points[i], lines.points[i + 1]])


def _layer_record(z: float) -> bytes:
    return np.array([_LAYER], "<u2").tobytes() + np.array([z], "<f4").tobytes()


def _polyline_records(paths: Paths, label: int) -> bytes:
    lines, ways = _turns(paths)
    word = np.array([_POLYLINE], "<u2").tobytes()
    return b"".join(
        word + np.array([label, way, len(loop)], "<i4").tobytes() + loop.astype("<f4").tobytes()
        for way, loop in zip(ways.tolist(), lines, strict=True)
    )


def _hatch_record(paths: Paths, label: int) -> bytes:
    lines = _segments(paths).astype("<f4")
    head = np.array([_HATCHES], "<u2").tobytes() + np.array([label, len(lines)], "<i4").tobytes()
    return head + lines.tobytes() if len(lines) else b""
