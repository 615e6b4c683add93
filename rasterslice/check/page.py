"""The report as one HTML page: deviation over height, and the worst layers, theirs over ours."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

import numpy as np

from .form import FILL, SUPPORT, Floats
from .reference import Side, outlines
from .verdict import FAIL, PASS, LayerResult, Report, deviation

DRAWN = 12
COLOURS = {PASS: "#3f9b5f", FAIL: "#c0392b"}
_STYLE = (
    "body{font:15px/1.45 Helvetica,Arial,sans-serif;color:#1f2a33;background:#eef1f4;margin:2em auto;max-width:1100px}"
    "h1{font-size:22px}main{display:grid;grid-template-columns:1fr 1fr;gap:12px;align-items:start}"
    "figure{margin:0;padding:10px;background:#fff;border:1px solid #d9dfe5;box-sizing:border-box}"
    "figcaption{font-size:13px;margin-top:6px}"
    "svg{width:100%;height:auto}code{background:#fff}.fail{color:#c0392b}.pass{color:#3f9b5f}li{margin:2px 0}"
)


def write_page(report: Report, side: Side, result: dict[str, Any], path: Path) -> None:
    """Write the page; it needs nothing besides itself."""
    from .table import lines

    text = "\n".join(f"<li>{html.escape(line)}</li>" for line in lines(result))
    figures = "\n".join(_figure(side, k, report.limits.width, i) for i, k in enumerate(report.worst(DRAWN)))
    word = "pass" if report.verdict == PASS else "fail" if report.verdict == FAIL else ""
    page = (
        '<!DOCTYPE html>\n<html lang="en"><meta charset="utf-8"><title>rasterslice check</title>\n'
        f"<style>{_STYLE}</style>\n<h1>rasterslice check: <span class='{word}'>{report.verdict}</span></h1>\n"
        f"<ul>{text}</ul>\n<figure>{_chart(report)}<figcaption>largest deviation of each layer over "
        "height, mm; dashed: tolerance, and tolerance with our uncertainty; a green dot above them is a place smaller "
        "than a pixel, or what beads or pixels explain; triangles lie above the chart</figcaption></figure>\n"
        "<p>Worst layers. Blue: ours. Grey: theirs. Red: what lies in one of both only; of beads, what lies outside "
        f"the part. Brown: supports. Rings: the places that the words name.</p>\n<main>\n{figures}\n</main>\n</html>\n"
    )
    path.write_text(page, encoding="utf-8", newline="\n")


def _chart(report: Report) -> str:
    """Draw deviation over height."""
    z = np.array([k.z for k in report.layers])
    off = np.array([deviation(k.measures) for k in report.layers])
    limit = report.limits.tolerance + report.limits.uncertainty
    top = max(2 * limit, float(np.percentile(off, 99)) if len(off) else 0.0)
    x = 40 + 940 * (z - z.min()) / max(float(np.ptp(z)), 1e-9)
    y = 190 - 170 * np.minimum(off, top) / top
    dots = "".join(
        _dot(a, b, value > top, COLOURS.get(k.verdict, "#c98a1b"))
        for a, b, value, k in zip(x.tolist(), y.tolist(), off.tolist(), report.layers, strict=True)
    )
    dots += f'<text x="2" y="16" font-size="11">{top:.3f}</text>'
    rules, free = "", 1e9
    for value in (report.limits.tolerance, limit):
        at = 190 - 170 * min(value / top, 1.0)
        free = min(at, free - 11)  # labels do not overlap
        rules += f'<path d="M40,{at:.1f}H980" stroke="#6b7782" stroke-dasharray="5 4"/>'
        rules += f'<text x="2" y="{free + 7:.1f}" font-size="11">{value:.3f}</text>'
    ends = "".join(
        f'<text x="{at}" y="206" font-size="11">z {value:.1f}</text>' for at, value in ((40, z.min()), (930, z.max()))
    )
    return f'<svg viewBox="0 0 1000 212"><path d="M40,190H980" stroke="#1f2a33"/>{rules}{dots}{ends}</svg>'


def _dot(x: float, y: float, beyond: bool, colour: str) -> str:
    """Draw one layer of the chart, which does not reach as high as some."""
    if beyond:
        return f'<path d="M{x - 3:.1f},{y:.1f}h6l-3,-6z" fill="{colour}"/>'
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.2" fill="{colour}"/>'


def _figure(side: Side, layer: LayerResult, width: float, number: int) -> str:
    """Draw one layer; its number on the page names its parts."""
    ours = outlines(side, np.array([layer.z]))[layer.z]
    theirs = layer.theirs.loops
    beads = layer.theirs.beads
    points = [*ours, *theirs, *([beads.points] if beads is not None and len(beads.points) else [])]
    off = deviation(layer.measures)
    told = f"layer {layer.index}, z {layer.z:.3f} mm: {layer.verdict}, deviation {off:.3f} mm"
    caption = html.escape("; ".join([told, *layer.reasons]))
    if not points:
        return f"<figure><figcaption>{caption}</figcaption></figure>"
    stack = np.concatenate(points)
    low, high = stack.min(axis=0) - 1, stack.max(axis=0) + 1
    size = high - low
    hair = float(size.max()) / 500
    part = f'<path d="{_data(ours)}" fill="#cfe8f5" fill-rule="evenodd" stroke="#0b5f92" stroke-width="{hair:.4f}"/>'
    body = f'<path d="{_data(layer.theirs.supports)}" fill="#b08d57" fill-opacity=".5" fill-rule="evenodd"/>' + part
    if beads is not None:
        name = f"part{number}"
        clip = f'<clipPath id="{name}"><path d="{_data(ours)}" clip-rule="evenodd"/></clipPath>'
        inside = f'<g clip-path="url(#{name})">{_beads(layer, width, False)}</g>'
        body = clip + _beads(layer, width, True) + part + inside
    else:
        body += f'<path d="{_data([*ours, *theirs])}" fill="#c0392b" fill-opacity=".85" fill-rule="evenodd"/>'
        body += f'<path d="{_data(theirs)}" fill="none" stroke="#55606a" stroke-width="{hair:.4f}"/>'
    for finding in layer.measures.findings:
        x, y = finding.place
        if np.isfinite(x):
            ring = f'r="{12 * hair:.3f}" fill="none" stroke="#c0392b" stroke-width="{2 * hair:.4f}"'
            body += f'<circle cx="{x:.3f}" cy="{y:.3f}" {ring}/>'
    box = f"{low[0]:.3f} {-high[1]:.3f} {size[0]:.3f} {size[1]:.3f}"
    drawing = f'<svg viewBox="{box}"><g transform="scale(1,-1)">{body}</g></svg>'
    return f"<figure>{drawing}<figcaption>{caption}</figcaption></figure>"


def _data(loops: list[Floats]) -> str:
    return "".join("M" + "L".join(f"{x:.3f},{y:.3f}" for x, y in p.tolist()) + "Z" for p in loops)


def _beads(layer: LayerResult, width: float, outside: bool) -> str:
    """Draw beads as wide as they are: in red, and supports, where they lie outside the part."""
    beads, found = layer.theirs.beads, ""
    if beads is None:
        return found
    for i, role in enumerate(beads.role.tolist()):
        p = beads.points[beads.offsets[i] : beads.offsets[i + 1]].tolist()
        wide = float(beads.width[i]) if np.isfinite(beads.width[i]) else width
        if role == SUPPORT and not outside:
            continue
        shade = "#b08d57" if role == SUPPORT else "#c0392b" if outside else "#9aa5ae" if role == FILL else "#55606a"
        data = "M" + "L".join(f"{x:.3f},{y:.3f}" for x, y in p)
        style = f'fill="none" stroke="{shade}" stroke-opacity=".5" stroke-linecap="round"'
        found += f'<path d="{data}" {style} stroke-width="{wide:.3f}"/>'
    return found
