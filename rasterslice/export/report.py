"""The report of a run: one HTML page without scripts, with what went in, what came out, and the worst layers.

It tells about the run and not about the part alone, so it holds times, and its bytes differ from run to run. Every run
writes it: it draws regions where there are any, and beads alone where there are none.
"""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..paths import DEPOSITION, REGIONS, Layer, Stat
from ..profile import Profile
from .assets import asset
from .copies import rows_of
from .format import Context
from .material import build_hours, column, machine_of, material_rows, time_note, times_laid
from .svg import drawing
from .viewdata import lost_places

PICTURES = 6  # layers that are shown, at most
_PLOT = (640, 260)
_LEGEND = "Part, then scaffold; red: flagged layers. Together at most {most:,.0f} mm&sup2;; {height:.1f} mm high."


def write(layers: Sequence[Layer], path: Path, context: Context) -> None:
    """Write the page; what the manifest does not tell is left out."""
    about, rows = context.about, rows_of(layers)
    profile = machine_of(context)
    inputs = ((i["path"], f"{i['bytes']:,} bytes", i["sha256"]) for i in about.get("inputs", []))
    sections = {
        "Material and time": _material(rows, path.parent, context, profile),
        "Area over height": _plot(rows) + f"<p class=grey>{_legend(rows, context)}</p>",
        "Warnings": "".join(f"<p class=flag>{_text(w)}</p>" for w in about.get("warnings", [])),
        "Flags": _flags(rows),
        "Layers to look at": "".join(_figure(layers[k], why, context) for k, why in _worst(rows, about)),
        "Seconds": _bars(about.get("seconds", {})),
        "Input": _table(inputs),
        "Settings": _table(sorted(about.get("settings", {}).items())),
    }
    body = f"<h1>{_text(context.stem)}</h1><p class=grey>rasterslice {__version__}</p>{_tiles(rows, context, profile)}"
    body += "".join(f"<h2>{title}</h2>{text}\n" for title, text in sections.items() if text)
    head = f"<!doctype html>\n<html lang=en><head><meta charset=utf-8><title>{_text(context.stem)} - report</title>"
    head += '<meta name=viewport content="width=device-width, initial-scale=1">'
    page = f"{head}<style>\n{asset('report.css')}</style></head>\n<body>\n{body}</body></html>\n"
    path.write_text(page, encoding="utf-8", newline="\n")


def _tiles(rows: list[dict[str, Stat]], context: Context, profile: Profile) -> str:
    about = context.about
    hours = sum(build_hours(rows, times_laid(context), profile).values())
    tiles = [("layers", f"{len(rows)}"), ("thickness", f"{context.thickness:g} mm"), ("beads alone", f"{hours:.1f} h")]
    tiles.append(("flagged layers", str(sum(bool(row.get("flags")) for row in rows))))
    copies = len(about.get("copies") or [()])
    tiles += [("copies", str(copies))] if copies > 1 else []
    tiles += [("facets", f"{about['facets']:,}")] if "facets" in about else []
    tiles += [("device", _text(about["device"]))] if "device" in about else []
    return "<dl>" + "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in tiles) + "</dl>"


def _material(rows: list[dict[str, Stat]], folder: Path, context: Context, profile: Profile) -> str:
    table = _table(material_rows(rows, context, profile)).replace("<table>", "<table class=even>")
    return f"{table}<p class=grey>{_text(time_note(folder, context, profile))}</p>"


def _plot(rows: list[dict[str, Stat]]) -> str:
    """Return area over height, as a drawing."""
    width, height = _PLOT
    part, scaffold = (column(rows, f"{name}_area") for name in ("part", "scaffold"))
    if not len(rows):
        return ""
    most = max(float((part + scaffold).max()), 1e-9)
    level = height - (np.arange(len(rows)) + 0.5) / len(rows) * height

    def band(left: Any, right: Any, kind: str) -> str:
        edge = np.concatenate([np.column_stack([right, level]), np.column_stack([left, level])[::-1]])
        return f'<polygon class={kind} points="' + ("%.1f,%.1f " * len(edge)) % tuple(edge.ravel().tolist()) + '"/>'

    first, second = part / most * (width - 10), (part + scaffold) / most * (width - 10)
    marks = [f'<path class=mark d="M{width - 7} {level[k]:.1f}h7"/>' for k, row in enumerate(rows) if row.get("flags")]
    shapes = band(first, second, "scaffold") + band(0 * first, first, "part") + "".join(marks)
    title = f"<title>at most {most:.1f} mm\N{SUPERSCRIPT TWO}</title>"
    return f'<svg class=plot viewBox="0 0 {width} {height}">{title}{shapes}</svg>'


def _legend(rows: list[dict[str, Stat]], context: Context) -> str:
    most = float((column(rows, "part_area") + column(rows, "scaffold_area")).max(initial=0.0))
    return _LEGEND.format(most=most, height=len(rows) * context.thickness)


def _flags(rows: list[dict[str, Stat]]) -> str:
    words = [(word, k) for k, row in enumerate(rows) for word in str(row.get("flags") or "").split(";") if word]
    found = Counter(word for word, _ in words)
    return _table((word, f"{n} layers", _listed(k for w, k in words if w == word)) for word, n in found.most_common())


def _listed(numbers: Iterable[int], most: int = 40) -> str:
    """Return up to `most` numbers as text."""
    items = [str(n) for n in numbers]
    return ", ".join(items[:most]) + (", ..." if len(items) > most else "")


def _worst(rows: list[dict[str, Stat]], about: dict[str, Any]) -> list[tuple[int, str]]:
    """Return the layers that are shown, each with the reason: the manifest's worst, then flagged ones."""
    listed = about.get("worst", {})
    turns = [(items[i], name) for i in range(PICTURES) for name, items in listed.items() if i < len(items)]
    found = {int(item["layer"]): name.replace("_", " ") for item, name in reversed(turns)}
    order = list(dict.fromkeys(int(item["layer"]) for item, _ in turns))
    order += [k for k, row in enumerate(rows) if row.get("flags") and k not in found]
    return [(k, found.get(k, "flagged")) for k in order[:PICTURES] if k < len(rows)]


def _figure(layer: Layer, why: str, context: Context) -> str:
    x, y, width, height = _window(layer, context)
    places = "".join(
        f'<circle class=lost cx="{u:.3f}" cy="{-v:.3f}" r="{max(r, 0.02 * width):.3f}"/>'
        for u, v, r in lost_places(layer)
    )
    flags = f"<span class=flag>{_text(layer.stats.get('flags') or '')}</span>"
    bare = not any(p is not None and len(p.points) for p in (getattr(layer, name) for name in (*REGIONS, *DEPOSITION)))
    note = "no path in this layer" if bare else f"picture {width:.0f} mm wide"
    text = f"<b>{layer.index}</b> z {layer.z:.2f} mm, {_text(why)} {flags}<br>{note}"
    picture = (
        f'<svg viewBox="{x:.3f} {-(y + height):.3f} {width:.3f} {height:.3f}">{drawing(layer, context)}{places}</svg>'
    )
    return f"<figure>{picture}<figcaption>{text}</figcaption></figure>"


def _window(layer: Layer, context: Context) -> tuple[float, float, float, float]:
    """Return what is shown of a layer: the whole grid, or where the layer is much smaller, that part of it."""
    grid = context.grid
    size = np.array([(grid.width - 1) * grid.pitch, (grid.height - 1) * grid.pitch])
    sets = [getattr(layer, name) for name in (*REGIONS, *DEPOSITION)]
    points = np.concatenate([p.points for p in sets if p is not None])
    low, high = np.array([grid.x0, grid.y0]), np.array([grid.x0, grid.y0]) + size
    if len(points):
        share = float(np.max(1.3 * np.ptp(points, axis=0) / size))
        if share < 0.5:
            size = np.minimum(size * max(share, 4 * context.part_width / float(size.min())), size)
            low, high = points.min(axis=0), points.max(axis=0)
    corner = (low + high - size) / 2
    return float(corner[0]), float(corner[1]), float(size[0]), float(size[1])


def _bars(seconds: dict[str, float]) -> str:
    most = max(seconds.values(), default=0.0) or 1.0
    return _table(
        (name, f"{value:.2f}", f"<i class=bar style='width:{100 * value / most:.1f}%'></i>")
        for name, value in seconds.items()
    )


def _table(rows: Iterable[Sequence[Any]]) -> str:
    text = "".join("<tr>" + "".join(f"<td>{_cell(v)}</td>" for v in row) + "</tr>" for row in rows)
    return f"<table>{text}</table>" if text else ""


def _cell(value: Any) -> str:
    return value if isinstance(value, str) and value.startswith("<i class=bar") else _text(value)


def _text(value: Any) -> str:
    if isinstance(value, list | tuple):
        value = " ".join(str(v) for v in value)
    return html.escape("-" if value is None else str(value))
