"""The layer viewer: one HTML file that holds everything, works from a disk and fetches nothing.

Its page, style and scripts lie in ``viewer/`` and are put together here; the layers follow as blocks of
text, each of which the page decodes when one of its layers is shown.
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..paths import Layer, Stat
from .format import Context
from .relief import Relief, levels, relief
from .viewdata import packed, varints, zigzag

BLOCK = 8  # layers that are decoded together
_COLUMNS = (
    "part_area", "scaffold_area", "part_boundary_mm", "scaffold_boundary_mm", "part_fill_mm", "scaffold_fill_mm",
    "lost_area",
)  # fmt: skip
_MARK = "<!-- data -->"


def write(layers: Sequence[Layer], path: Path, context: Context) -> None:
    """Write the viewer, block by block."""
    quantum = context.grid.pitch / 20
    corner = (context.grid.x0, context.grid.y0)
    head, tail = _page(context.stem).split(_MARK)
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(head)
        _script(file, "meta", "application/json", _json(_meta(layers, context, quantum)))
        for start in range(0, len(layers), BLOCK):
            items = [packed(layers[k], quantum, corner) for k in range(start, min(start + BLOCK, len(layers)))]
            data = varints(np.array([len(item) for item in items])) + b"".join(items)
            _script(file, f"block{start // BLOCK}", "text/plain", base64.b64encode(data).decode("ascii"))
        for name in ("part", "scaffold"):
            regions = len(layers) and layers[0].part is not None
            surface = relief(layers, name, context, "" if regions else f"{name}_boundary")
            data = _packed_relief(surface, quantum, corner)
            _script(file, f"relief_{name}", "text/plain", base64.b64encode(data).decode("ascii"))
        file.write(tail)


def asset(name: str) -> str:
    """Return the text of one of the files in ``viewer/``."""
    return resources.files(__package__).joinpath("viewer", name).read_text(encoding="utf-8")


def _page(title: str) -> str:
    page = asset("viewer.html").replace("<!-- title -->", html.escape(title))
    page = page.replace("/* style */", asset("viewer.css"))
    scripts = "\n".join(asset(name) for name in ("data.js", "flat.js", "plot.js", "stack.js", "viewer.js"))
    return page.replace("/* script */", scripts)


def _script(file: Any, name: str, kind: str, text: str) -> None:
    file.write(f'<script type="{kind}" id="{name}">{text}</script>\n')


def _json(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _meta(layers: Sequence[Layer], context: Context, quantum: float) -> dict[str, Any]:
    rows = [(layer.index, layer.z, layer.stats) for layer in layers]
    grid = context.grid
    return {
        "name": context.stem,
        "version": __version__,
        "thickness": context.thickness,
        "widths": [context.part_width, context.support_width],
        "pitch": grid.pitch,
        "quantum": quantum,
        "corner": [grid.x0, grid.y0],
        "size": [(grid.width - 1) * grid.pitch, (grid.height - 1) * grid.pitch],
        "block": BLOCK,
        "levels": levels(len(layers)),
        "regions": bool(rows) and layers[0].part is not None,
        "index": [index for index, _, _ in rows],
        "z": [round(z, 4) for _, z, _ in rows],
        "flags": [str(stats.get("flags") or "") for _, _, stats in rows],
        **{name: [_number(stats.get(name)) for _, _, stats in rows] for name in _COLUMNS},
    }


def _number(value: Stat) -> float | None:
    return round(float(value), 3) if isinstance(value, int | float) and np.isfinite(value) else None


def _packed_relief(surface: Relief, quantum: float, corner: tuple[float, float]) -> bytes:
    """Return for each level its number of loops, the points of each, then x, y (steps) and normal of each point."""
    parts: list[Any] = []
    for paths, normals in zip(surface.outlines, surface.normals, strict=True):
        xy = np.rint((paths.points - corner) / quantum).astype(np.int64)
        step = zigzag(np.diff(xy, axis=0, prepend=np.zeros((1, 2), np.int64)))
        turned = np.rint(normals * 63).astype(np.int64) + 63  # 7 bits each
        parts += [[len(paths)], np.diff(paths.offsets.astype(np.int64)), np.hstack([step, turned]).ravel()]
    return varints(np.concatenate(parts).astype(np.int64)) if parts else b""
