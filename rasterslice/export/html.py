"""The layer viewer: one HTML file that works from a disk and needs no network.

Its page, style and scripts lie in ``viewer/`` and are put together here; the layers follow as blocks of
text, each of which the page decodes when one of its layers is shown. Of a large job the blocks are scripts in a folder
beside the page, which asks for them as they are wanted: a browser opens no other files from a disk.
"""

from __future__ import annotations

import base64
import contextlib
import html
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..paths import Layer, Stat
from .assets import asset
from .format import Context
from .relief import Relief, levels, relief
from .viewdata import SETS, packed, varints, zigzag

BLOCK = 8  # layers that are decoded together
LARGE = 32_000_000  # bytes of layers in one file, at most: a browser reads the whole file before it shows the first
SAMPLES = 32  # layers that are looked at to guess the size of all
_COLUMNS = (
    "part_area", "scaffold_area", "part_boundary_mm", "scaffold_boundary_mm", "part_fill_mm", "scaffold_fill_mm",
    "lost_area",
)  # fmt: skip
_MARK = "<!-- data -->"


def write(layers: Sequence[Layer], path: Path, context: Context) -> None:
    """Write the viewer, block by block; the blocks of a large job into the folder ``<stem>.viewer`` beside it."""
    quantum = context.grid.pitch / 20
    corner = (context.grid.x0, context.grid.y0)
    folder = path.with_name(f"{context.stem}.viewer")
    apart = expected_bytes(layers, quantum, corner) > LARGE
    _clear(folder)
    try:
        if apart:
            folder.mkdir(exist_ok=True)
        with path.open("w", encoding="utf-8", newline="\n") as file:
            head, tail = _page(context.stem).split(_MARK)
            file.write(head)
            _script(
                file, "meta", "application/json", _json(_meta(layers, context, quantum, folder.name if apart else ""))
            )
            for start in range(0, len(layers), BLOCK):
                number, text = start // BLOCK, _block(layers, start, quantum, corner)
                if apart:
                    code = f'viewerBlock({number},"{text}")\n'
                    (folder / f"block{number}.js").write_text(code, encoding="ascii", newline="\n")
                else:
                    _script(file, f"block{number}", "text/plain", text)
            for name in ("part", "scaffold"):
                regions = len(layers) and layers[0].part is not None
                surface = relief(layers, name, context, "" if regions else f"{name}_boundary")
                data = _packed_relief(surface, quantum, corner)
                _script(file, f"relief_{name}", "text/plain", base64.b64encode(data).decode("ascii"))
            file.write(tail)
    except BaseException:
        _clear(folder)
        raise


def expected_bytes(layers: Sequence[Layer], quantum: float, corner: tuple[float, float]) -> int:
    """Return how much text the layers will take, from some of them."""
    some = range(0, len(layers), max(len(layers) // SAMPLES, 1))
    sizes = [len(packed(layers[k], quantum, corner)) for k in some]
    return sum(sizes) * len(layers) * 4 // (3 * len(sizes)) if sizes else 0


def _block(layers: Sequence[Layer], start: int, quantum: float, corner: tuple[float, float]) -> str:
    """Return some layers as text: their lengths, then each of them."""
    items = [packed(layers[k], quantum, corner) for k in range(start, min(start + BLOCK, len(layers)))]
    data = varints(np.array([len(item) for item in items])) + b"".join(items)
    return base64.b64encode(data).decode("ascii")


def _clear(folder: Path) -> None:
    """Remove the blocks of an earlier viewer, and their folder if nothing else is in it."""
    blocks = [path for path in folder.glob("block*.js") if path.stem.removeprefix("block").isdigit()]
    for path in blocks:
        path.unlink()
    with contextlib.suppress(OSError):
        if blocks:
            folder.rmdir()


def _page(title: str) -> str:
    page = asset("viewer.html").replace("<!-- title -->", html.escape(title))
    page = page.replace("/* style */", asset("viewer.css"))
    scripts = "\n".join(asset(name) for name in ("data.js", "flat.js", "plot.js", "stack.js", "viewer.js"))
    return page.replace("/* script */", scripts)


def _script(file: Any, name: str, kind: str, text: str) -> None:
    file.write(f'<script type="{kind}" id="{name}">{text}</script>\n')


def _json(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _meta(layers: Sequence[Layer], context: Context, quantum: float, folder: str) -> dict[str, Any]:
    grid = context.grid
    columns: dict[str, list[Any]] = {name: [] for name in ("index", "z", "flags", *_COLUMNS)}
    for k in range(len(layers)):
        layer = layers[k]
        row = (layer.index, round(layer.z, 4), str(layer.stats.get("flags") or ""))
        for name, value in zip(columns, (*row, *(_number(layer.stats.get(n)) for n in _COLUMNS)), strict=True):
            columns[name].append(value)
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
        "sets": SETS,
        "folder": folder,
        "levels": levels(len(layers)),
        "regions": bool(len(layers)) and layers[0].part is not None,
        **columns,
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
