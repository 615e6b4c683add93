"""Fab@Home: paths of beads, with the material of each and the width of its calibration."""

from __future__ import annotations

import math
import re
from array import array
from pathlib import Path
from xml.parsers import expat

import numpy as np

from ..errors import ModelError
from .form import (
    FILL,
    OUTER,
    SUPPORT,
    WALL,
    Floats,
    TheirLayer,
    Theirs,
    damaged,
    load,
    number,
    one_per_slice,
    pack_beads,
)  # fmt: skip
from .xmltext import parse

_SUPPORT = re.compile(r"scaffold|sme|support", re.IGNORECASE)
_OURS = b"<!-- rasterslice"
_MOST_TEXT = 200  # characters within an element
_MOST_MATERIALS = 100


class _Reader:
    """Collects paths while expat reads."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.stack: list[str] = []
        self.said = ""
        self.name, self.width = "", math.nan  # of the calibration that is open
        self.widths: dict[str, float] = {}
        self.paths: list[tuple[float, int, str, Floats]] = []  # height, line, material, points
        self.material, self.began, self.points = "", 0, array("d")
        self.place: dict[str, float] = {}
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = self.text

    @property
    def line(self) -> int:
        return self.parser.CurrentLineNumber

    def text(self, text: str) -> None:
        self.said += text
        if len(self.said) > _MOST_TEXT:
            if not self.said.isspace():
                raise damaged(self.path, self.line, f"an element holds more than {_MOST_TEXT} characters of text")
            self.said = ""

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self.stack.append(name)
        if len(self.stack) > 16:
            raise damaged(self.path, self.line, "elements are nested deeper than 16")
        self.said = ""
        if name == "path":
            self.material, self.began, self.points = "", self.line, array("d")
        elif name == "materialCalibration":
            self.name, self.width = "", math.nan
        elif name == "point":
            self.place = {}

    def end(self, name: str) -> None:
        self.stack.pop()
        said, self.said = self.said.strip(), ""
        inside = self.stack[-1] if self.stack else ""
        if inside == "point" and name in ("x", "y", "z"):
            self.place[name] = number(said, self.path, self.line, name)
        elif name == "point" and inside == "path":
            if len(self.place) != 3:
                raise damaged(self.path, self.line, "a point must hold x, y and z")
            self.points.extend((self.place["x"], self.place["y"], self.place["z"]))
        elif name == "materialCalibrationName":
            self.material = said
        elif inside == "materialCalibration" and name == "name":
            self.name = said
        elif inside == "materialCalibration" and name == "pathWidth":
            self.width = number(said, self.path, self.line, name)
        elif name == "materialCalibration":
            self.widths[self.name] = self.width
            if len(self.widths) > _MOST_MATERIALS:
                raise damaged(self.path, self.line, f"more than {_MOST_MATERIALS} calibrations")
        elif name == "path":
            self.close()

    def close(self) -> None:
        points = np.frombuffer(self.points, np.float64).reshape(-1, 3)
        if len(points) < 2:
            raise damaged(self.path, self.began, f"a path of {len(points)} points lays nothing")
        low, high = float(points[:, 2].min()), float(points[:, 2].max())
        if high > low:
            what = f"z changes from {low:g} to {high:g} mm within a path"
            raise damaged(self.path, self.began, f"{what}, which is not built yet", "write flat paths")
        self.paths.append((low, self.began, self.material, points[:, :2]))


def read(path: Path) -> Theirs:
    """Read a Fab@Home file: a path that comes back to its start is a wall, any other fill; a new height is a layer.

    Raises
    ------
    ModelError
        ``file:line: message``: no XML, entities, numbers out of bounds, paths that climb.
    """
    data, reader = load(path), _Reader(path)
    parse(reader.parser, data, path)
    if not reader.paths:
        raise ModelError(f"{path}: no path was found; name a Fab@Home file that lays something")
    ours = _OURS in data[:2000]
    found: list[list[tuple[float, int, str, Floats]]] = []
    for item in reader.paths:
        if not found or found[-1][-1][0] != item[0]:
            found.append([])
        found[-1].append(item)
    layers = [_layer(k, reader.widths, ours) for k in found]
    layers, z_is = one_per_slice(layers, data[:2000] if ours else b"", path, 0.0)
    parts = [k for k in layers if k.beads is not None and (k.beads.role != SUPPORT).any()]
    props = [k for k in layers if k.beads is not None and (k.beads.role == SUPPORT).all()]
    notes = [] if ours else ["the file does not tell outer from inner perimeters"]
    kind = "Fab@Home of rasterslice" if ours else "Fab@Home"
    return Theirs(kind, parts, z_is, precision=0.0001, props=props, notes=notes)


def _layer(paths: list[tuple[float, int, str, Floats]], widths: dict[str, float], ours: bool) -> TheirLayer:
    roles = []
    for _, _, material, points in paths:
        closed = len(points) > 3 and bool(np.all(points[0] == points[-1]))
        wall = OUTER if ours else WALL
        roles.append(SUPPORT if _SUPPORT.search(material) else wall if closed else FILL)
    wide = [w if (w := widths.get(material, math.nan)) > 0 else math.nan for _, _, material, _ in paths]
    return TheirLayer(paths[0][0], f"line {paths[0][1]}", beads=pack_beads([p for *_, p in paths], roles, wide))
