"""Contours of a DXF of any program: lines that meet become rings, and names of layers say what is support."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from .form import Floats, TheirLayer, Theirs, ring
from .loops import area, depths

_SCAFFOLD = re.compile(r"scaffold|sme", re.IGNORECASE)  # by our rule: sacrificial material all round
_SUPPORT = re.compile(r"support", re.IGNORECASE)
_FILL = re.compile(r"fill|hatch", re.IGNORECASE)
_GRID = 1e-3  # mm: ends that are equal when rounded to this meet


@dataclass(frozen=True, slots=True)
class Polyline:
    """One polyline, or line, of a DXF.

    Attributes
    ----------
    z : float
        mm.
    name : str
        Of its layer in the sense of DXF.
    line : int
        Of the file.
    points : (N, 2) float64
        mm.
    closed : bool
    """

    z: float
    name: str
    line: int
    points: Floats
    closed: bool


def as_areas(polylines: list[Polyline], precision: float, notes: list[str]) -> Theirs:
    """Return contours by height; their order and direction say nothing in this format.

    Open polylines that meet are joined. What stays open and has three points is a contour that lacks its last edge;
    single lines are skipped, and so is whatever lies on a layer named after fill.
    """
    by_height: dict[float, dict[str, list[Polyline]]] = {}
    filling = 0
    for p in polylines:
        if _FILL.search(p.name):
            filling += 1
        else:
            by_height.setdefault(round(p.z, 4) + 0.0, {}).setdefault(p.name, []).append(p)
    layers, mended, lines = [], 0, 0
    for z in sorted(by_height):
        layer = TheirLayer(z, f"line {min(p.line for held in by_height[z].values() for p in held)}")
        for name, held in by_height[z].items():
            rings, opened = _rings(held)
            mended += sum(len(p) > 2 for p in opened)
            lines += sum(len(p) < 3 for p in opened)
            rings += [p for p in opened if len(p) > 2]
            beside = layer.supports if _SUPPORT.search(name) else layer.loops
            (layer.scaffold if _SCAFFOLD.search(name) else beside).extend(rings)
        layer.loops[:] = [p[::-1] if (area(p) > 0) == bool(d % 2) else p
                          for p, d in zip(layer.loops, depths(layer.loops), strict=True)]  # fmt: skip
        layer.declared.extend([0] * len(layer.loops))
        layers.append(layer)
    for count, what in ((filling, "polylines of fill were skipped"), (lines, "lines that meet no other were skipped"),
                        (mended, "open polylines were closed by a straight line")):  # fmt: skip
        if count:
            notes.append(f"{count} {what}")
    return Theirs("DXF", layers, None, precision, scaffold=any(k.scaffold for k in layers), notes=notes)


def _rings(polylines: list[Polyline]) -> tuple[list[Floats], list[Floats]]:
    """Return the closed contours of some polylines, and what stays open."""
    rings: list[Floats] = []
    loose: list[Floats] = []
    for p in polylines:
        points = ring(p.points)
        if len(points) > 2 and (p.closed or len(points) < len(p.points)):
            rings.append(points)
        elif len(p.points) > 2 or bool(np.any(p.points[0] != p.points[-1])):
            loose.append(p.points)
    ends = [[_key(p[0]), _key(p[-1])] for p in loose]
    meeting: dict[tuple[int, int], list[int]] = {}
    for i, pair in enumerate(ends):
        for key in pair:
            meeting.setdefault(key, []).append(i)
    opened: list[Floats] = []
    used = [False] * len(loose)
    starts = sorted(range(len(loose)), key=lambda i: min(len(meeting[key]) for key in ends[i]))  # ends of chains first
    for first in starts:
        if used[first]:
            continue
        used[first] = True
        chain = [loose[first]]
        if len(meeting[ends[first][1]]) == 1:  # nothing follows: walk the other way
            chain[0] = loose[first][::-1]
        begin, at = _key(chain[0][0]), _key(chain[0][-1])
        while at != begin:
            while meeting[at] and used[meeting[at][-1]]:
                meeting[at].pop()
            if not meeting[at]:
                break
            following = meeting[at].pop()
            used[following] = True
            step = loose[following] if ends[following][0] == at else loose[following][::-1]
            chain.append(step[1:])
            at = _key(step[-1])
        points = np.concatenate(chain)
        closed = at == begin and len(points) > 3
        (rings if closed else opened).append(points[:-1] if closed else points)
    return rings, opened


def _key(point: Floats) -> tuple[int, int]:
    x, y = np.round(point / _GRID).astype(np.int64).tolist()
    return x, y
