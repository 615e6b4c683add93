"""The report of a run: one HTML page without scripts, with what went in, what came out, and the worst layers.

It tells about the run and not about the part alone, so it holds times, and its bytes differ from run to run.
"""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..paths import Layer, Stat
from .format import Context
from .html import asset
from .svg import drawing

SPEED = 30.0  # mm/s of a nozzle, for the estimate of the time to build; travel is not counted
PICTURES = 6  # layers that are shown, at most
_PLOT = (640, 260)
_LEGEND = "mm&sup2; to the right of each height: part, then scaffold; red: flagged layers"


def write(layers: Sequence[Layer], path: Path, context: Context) -> None:
    """Write the page; what the manifest does not tell is left out."""
    about, rows = context.about, [layer.stats for layer in layers]
    inputs = ((i["path"], f"{i['bytes']:,} bytes", i["sha256"]) for i in about.get("inputs", []))
    sections = {
        "Area over height": _plot(rows) + f"<p class=grey>{_LEGEND}</p>",
        "Warnings": "".join(f"<p class=flag>{_text(w)}</p>" for w in about.get("warnings", [])),
        "Flags": _flags(rows),
        "Layers to look at": "".join(_figure(layers[k], why, context) for k, why in _worst(rows, about)),
        "Seconds": _bars(about.get("seconds", {})),
        "Input": _table(inputs),
        "Settings": _table(sorted(about.get("settings", {}).items())),
    }
    body = f"<h1>{_text(context.stem)}</h1><p class=grey>rasterslice {__version__}</p>{_tiles(rows, context)}"
    body += "".join(f"<h2>{title}</h2>{text}\n" for title, text in sections.items() if text)
    head = f"<!doctype html>\n<html lang=en><head><meta charset=utf-8><title>{_text(context.stem)} - report</title>"
    head += '<meta name=viewport content="width=device-width, initial-scale=1">'
    page = f"{head}<style>\n{asset('report.css')}</style></head>\n<body>\n{body}</body></html>\n"
    path.write_text(page, encoding="utf-8", newline="\n")


def build_hours(rows: Iterable[dict[str, Stat]], part_layers: int) -> float:
    """Return how long the beads take at `SPEED`; the part is laid `part_layers` times in each slice."""
    times = {"part": part_layers, "scaffold": 1}
    sets = [(f"{name}_{what}_mm", times[name]) for name in times for what in ("boundary", "fill")]
    length = sum(n * _number(row.get(name)) for row in rows for name, n in sets)
    return length / SPEED / 3600


def _tiles(rows: list[dict[str, Stat]], context: Context) -> str:
    about = context.about
    tiles = [("layers", f"{len(rows)}"), ("thickness", f"{context.thickness:g} mm")]
    for name in ("part", "scaffold"):
        area = sum(_number(row.get(f"{name}_area")) for row in rows)
        length = sum(_number(row.get(f"{name}_{what}_mm")) for row in rows for what in ("boundary", "fill"))
        tiles.append((name, f"{area * context.thickness / 1000:.1f} cm&sup3;"))
        tiles.append((f"{name} paths", f"{length / 1000:.1f} m"))
    hours = build_hours(rows, int(about.get("settings", {}).get("part_layers_per_slice", 1)))
    tiles.append((f"to lay them at {SPEED:g} mm/s, crudely", f"{hours:.1f} h"))
    tiles.append(("flagged layers", str(sum(bool(row.get("flags")) for row in rows))))
    tiles += [("facets", f"{about['facets']:,}")] if "facets" in about else []
    tiles += [("device", _text(about["device"]))] if "device" in about else []
    return "<dl>" + "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in tiles) + "</dl>"


def _plot(rows: list[dict[str, Stat]]) -> str:
    """Return area over height, as a drawing."""
    width, height = _PLOT
    part, scaffold = (np.array([_number(row.get(f"{n}_area")) for row in rows]) for n in ("part", "scaffold"))
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


def _flags(rows: list[dict[str, Stat]]) -> str:
    words = [(word, k) for k, row in enumerate(rows) for word in str(row.get("flags") or "").split(";") if word]
    found = Counter(word for word, _ in words)
    return _table(
        (word, f"{n} layers", _listed(k for w, k in words if w == word)) for word, n in found.most_common()
    )


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
    grid = context.grid
    width, height = (grid.width - 1) * grid.pitch, (grid.height - 1) * grid.pitch
    box = f"{grid.x0:.3f} {-(grid.y0 + height):.3f} {width:.3f} {height:.3f}"
    flags = f"<span class=flag>{layer.stats.get('flags') or ''}</span>"
    text = f"<b>{layer.index}</b> z {layer.z:.2f} mm, {_text(why)} {flags}"
    return f'<figure><svg viewBox="{box}">{drawing(layer, context)}</svg><figcaption>{text}</figcaption></figure>'


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


def _number(value: Stat) -> float:
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else 0.0
