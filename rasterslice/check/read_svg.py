"""SVG slices: Slic3r's and PrusaSlicer's, and the drawings of our own export."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from xml.parsers import expat

import numpy as np

from ..errors import ModelError
from .form import Floats, TheirLayer, Theirs, bounded, damaged, load, number, numbered, numbers, ring
from .svg_frame import hidden, transform
from .xmltext import parse

_NUMBERS = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
_PIECES = re.compile(r"([A-Za-z])([^A-Za-z]*(?:[eE][-+]?[0-9]+[^A-Za-z]*)*)")
_LEGACY_SCALE = 1e6  # Slic3r before 1.3 wrote heights of metres per millimetre squared: 2e-07 stands for 0.2 mm
_TITLE = re.compile(r"layer ([0-9]+), z ([-0-9.]+) mm")
_HIDDEN = {"defs", "clipPath", "mask", "symbol", "pattern"}
_DRAWN = {"polygon", "path", "rect", "circle", "ellipse", "polyline", "line", "image", "use"}


class _Reader:
    """Collects the loops of each layer while expat reads."""

    def __init__(self, path: Path, single: bool) -> None:
        self.path, self.single = path, single
        self.layers: list[TheirLayer] = []
        self.loops: list[tuple[str, int, Floats]] = []  # part or scaffold, what it is called, points
        self.z, self.where, self.slic3r, self.ours, self.scale = math.nan, "line 1", False, False, 1.0
        self.stack: list[str] = []
        self.frames = [np.eye(3)]  # of each open element
        self.unseen = 0  # depth of the outermost element that is not shown
        self.box: tuple[float, ...] = ()
        self.single_ours = False  # our export of all layers in one file
        self.group, self.title, self.group_depth = "part", "", 0
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = self.text
        self.parser.buffer_text = True

    @property
    def line(self) -> int:
        return self.parser.CurrentLineNumber

    def text(self, text: str) -> None:
        if self.stack and self.stack[-1] == "title":
            self.title += text

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self.stack.append(name)
        if len(self.stack) > 64:
            raise damaged(self.path, self.line, "elements are nested deeper than 64")
        if hidden(attributes) and not self.unseen:
            self.unseen = len(self.stack)
        self.frames.append(self.frames[-1] @ self.frame(name, attributes))
        if name == "g":
            self.open_group(attributes)
        elif name == "svg" and len(self.stack) == 1:
            self.unit(attributes)
        elif name in _DRAWN and not self.unseen and not _HIDDEN & set(self.stack):
            self.shape(name, attributes)

    def unit(self, attributes: dict[str, str]) -> None:
        """Take the length of a user unit from size and viewBox."""
        size = re.fullmatch(r"([0-9]+(?:\.[0-9]*)?)(mm|cm|in)", attributes.get("width", "").strip())
        words = attributes.get("viewBox", "").replace(",", " ").split()
        self.box = tuple(numbers(words, self.path, self.line, "viewBox: a value").tolist())
        if size and len(self.box) == 4 and self.box[2] > 0:
            self.scale = float(size[1]) * {"mm": 1.0, "cm": 10.0, "in": 25.4}[size[2]] / self.box[2]

    def frame(self, name: str, attributes: dict[str, str]) -> Floats:
        """Return the matrix of an element; the one of our own drawings only says that y points up in the file."""
        text = attributes.get("transform", "")
        if name == "g" and text.replace(" ", "") == "scale(1,-1)":
            self.ours = True
            text = ""
        return np.vstack([transform(text, self.path, self.line), [0.0, 0.0, 1.0]])

    def open_group(self, attributes: dict[str, str]) -> None:
        if attributes.get("id") in ("part", "scaffold"):
            self.group = attributes["id"]
        z = attributes.get("slic3r:slice-z", attributes.get("slic3r:z"))
        layered = re.match("layer[0-9]", attributes.get("id", "")) and not self.single
        if z is None and layered and self.slic3r:
            what = f"the layer {attributes['id'][:30]} says no slic3r:z"
            raise damaged(self.path, self.line, what, "write its height")
        if z is not None:
            self.single_ours |= "slic3r:layer-height" in attributes
            self.slic3r, self.where, self.group_depth = True, f"line {self.line}", len(self.stack)
            self.z = number(z, self.path, self.line, "slic3r:z")

    def shape(self, name: str, attributes: dict[str, str]) -> None:
        if name == "polygon":
            self.polygon(attributes)
        elif name == "path":
            self.drawn_path(attributes)
        elif name == "rect":
            self.rect(attributes)
        else:
            raise damaged(self.path, self.line, f"element {name} is not built yet", "write polygons or paths")

    def rect(self, attributes: dict[str, str]) -> None:
        """Take a rectangle, unless it is the ground of the drawing."""
        if any("%" in attributes.get(key, "") for key in ("width", "height")):
            return
        x, y, wide, high = (
            number(attributes.get(key, "0"), self.path, self.line, key) for key in ("x", "y", "width", "height")
        )
        if self.ours or (len(self.box) == 4 and wide >= self.box[2] and high >= self.box[3]):
            return
        self.add("part", 0, np.array([(x, y), (x + wide, y), (x + wide, y + high), (x, y + high)]))

    def polygon(self, attributes: dict[str, str]) -> None:
        values = attributes.get("points", "").replace(",", " ").split()
        flat = numbers(values, self.path, self.line, "a coordinate")
        if len(flat) % 2:
            raise damaged(self.path, self.line, f"{len(flat)} numbers make no points")
        kind = {"contour": 1, "hole": -1}.get(attributes.get("slic3r:type", ""), 0)
        self.add("part", kind, flat.reshape(-1, 2))

    def drawn_path(self, attributes: dict[str, str]) -> None:
        what, name = attributes.get("slic3r:type", "perimeter"), attributes.get("id", "")
        if what == "infill":
            raise damaged(self.path, self.line, "a shelled layer is not built yet", "write solid layers")
        if self.ours and not name.endswith("_region"):
            return  # our drawings: lines of beads
        for loop in path_loops(attributes.get("d", ""), self.path, self.line):
            beside = "scaffold" if self.single_ours else "support"
            group = beside if what == "support" else self.group
            self.add(group, 0, loop)

    def add(self, group: str, kind: int, points: Floats) -> None:
        frame = self.frames[-1][:2]
        if np.linalg.det(frame[:, :2]) < 0:
            points = points[::-1]  # what a mirror turns over
        points = ring(bounded((points @ frame[:, :2].T + frame[:, 2]) * self.scale, self.path, self.line))
        if len(points) < 3 and (self.ours or self.single_ours):
            return  # regions of ours may hold some, where a tongue is thinner than a pixel
        if len(points) < 3:
            raise damaged(self.path, self.line, f"a contour of {len(points)} points encloses nothing")
        self.loops.append((group, kind, points))

    def end(self, name: str) -> None:
        if self.slic3r and name == "g" and len(self.stack) == self.group_depth:
            self.close_layer()
        self.unseen = 0 if self.unseen == len(self.stack) else self.unseen
        self.frames.pop()
        self.stack.pop()

    def close_layer(self) -> None:
        part = [(kind, p) for group, kind, p in self.loops if group == "part"]
        scaffold, supports = ([p for group, _, p in self.loops if group == name] for name in ("scaffold", "support"))
        kinds = [kind for kind, _ in part]
        layer = TheirLayer(self.z, self.where, [p for _, p in part], scaffold, kinds, supports=supports)
        self.layers.append(layer)
        self.loops = []

    def parse(self) -> None:
        parse(self.parser, load(self.path), self.path)
        if self.single and not self.slic3r:
            found = _TITLE.match(self.title)
            self.z = number(found[2], self.path, 1, "the height in the title") if found else math.nan
            self.close_layer()


def path_loops(data: str, path: Path, line: int) -> list[Floats]:
    """Return the loops of the data of a path element made of straight lines."""
    loops: list[list[tuple[float, float]]] = []
    x = y = 0.0
    for code, rest in _PIECES.findall(data):
        values = numbers(_NUMBERS.findall(rest), path, line, "a coordinate").tolist()
        if odd := _NUMBERS.sub("", rest).replace(",", " ").split():
            raise damaged(path, line, f"a coordinate must be a number, got {odd[0][:30]!r} in {rest.strip()[:30]!r}")
        if code in "Zz":
            if loops:
                x, y = loops[-1][0]
            continue
        if code not in "MmLlHhVv" or (code in "MmLl" and len(values) % 2) or not values:
            what = f"path command {code!r} with {len(values)} numbers"
            raise damaged(path, line, f"{what} is not built yet", "write M, L and Z")
        pairs = list(zip(values[::2], values[1::2], strict=True)) if code in "MmLl" else [(v, v) for v in values]
        for i, (u, v) in enumerate(pairs):
            base = (x, y) if code.islower() else (0.0, 0.0)
            x = x if code in "Vv" else base[0] + u
            y = y if code in "Hh" else base[1] + v
            if code in "Mm" and i == 0:
                loops.append([])
            if not loops:
                raise damaged(path, line, "a path must begin with M")
            loops[-1].append((x, y))
    return [np.array(loop) for loop in loops]


def read(path: Path) -> Theirs:
    """Read one SVG file that holds all layers, as Slic3r writes it.

    Raises
    ------
    ModelError
        ``file:line: message``: no XML, entities, numbers out of bounds, shapes that are not read yet.
    """
    reader = _Reader(path, single=False)
    reader.parse()
    if not reader.layers:
        raise ModelError(f"{path}: no group has a slic3r:z, so no layer was found; name a folder for one file a layer")
    z = [layer.z for layer in reader.layers]
    legacy = max(z) < 1e-3
    if legacy:
        reader.layers = [
            replace(k, z=k.z * _LEGACY_SCALE) for k in reader.layers
        ]
    if reader.single_ours:
        scaffold = any(k.scaffold for k in reader.layers)
        return Theirs(
            "SVG of rasterslice", reader.layers, "middle", 0.025, scaffold=scaffold, turned="mirrored in y",
            grain=math.nan,
        )  # fmt: skip
    return Theirs(
        "SVG by Slic3r" + (", heights times 1e-6" if legacy else ""), reader.layers, "middle", any_mirror=True
    )


def read_folder(files: list[Path]) -> Theirs:
    """Read one SVG file a layer, in the order of the numbers in their names; heights only from our own."""
    layers, ours = [], True
    for path in files:
        reader = _Reader(path, single=True)
        reader.parse()
        ours &= reader.ours
        found = reader.layers[0] if reader.layers else TheirLayer(math.nan, path.name)
        layers.append(replace(found, where=path.name))
    if ours:
        scaffold = any(k.scaffold for k in layers)
        return Theirs("SVG of rasterslice", layers, "middle", 0.025, scaffold=scaffold, grain=math.nan)
    layers = [
        replace(k, z=n) for n, k in zip(numbered(files), layers, strict=True)
    ]
    return Theirs("SVG, one file a layer", layers, "number", any_mirror=True)
