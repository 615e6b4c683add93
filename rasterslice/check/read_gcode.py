"""G-code of PrusaSlicer, OrcaSlicer, Cura and Slic3r: the beads, what each is called, its width and its layer."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from . import form
from .form import FILL, LIMIT_MM, OUTER, SUPPORT, WALL, Beads, TheirLayer, Theirs, damaged, load, number

#: Words of the comments of all four programs, in small letters: PrusaSlicer, OrcaSlicer, Cura; Slic3r's end a move.
ROLES = {
    "external perimeter": OUTER, "outer wall": OUTER, "wall-outer": OUTER,
    "perimeter": WALL, "overhang perimeter": WALL, "inner wall": WALL, "overhang wall": WALL, "wall-inner": WALL,
    "thin wall": WALL, "gap fill": WALL, "gap infill": WALL,
    "internal infill": FILL, "solid infill": FILL, "top solid infill": FILL, "bridge infill": FILL, "infill": FILL,
    "ironing": FILL, "sparse infill": FILL, "internal solid infill": FILL, "top surface": FILL, "bottom surface": FILL,
    "bridge": FILL, "internal bridge": FILL, "internal bridge infill": FILL, "fill": FILL, "skin": FILL,
    "support material": SUPPORT, "support material interface": SUPPORT, "support": SUPPORT,
    "support interface": SUPPORT, "support-interface": SUPPORT, "support transition": SUPPORT,
}  # fmt: skip
IGNORED = -1  # skirt, brim, wipe and prime towers, custom code
_PROGRAMS = (
    (b"PrusaSlicer", "G-code by PrusaSlicer"), (b"OrcaSlicer", "G-code by OrcaSlicer"),
    (b"BambuStudio", "G-code by BambuStudio"), (b"Cura", "G-code by Cura"), (b"Slic3r", "G-code by Slic3r"),
)  # fmt: skip
_WIDTH = re.compile(
    rb"^; *(?:external perimeters extrusion width|external_perimeter_extrusion_width|outer_wall_line_width)"
    rb" *= *([0-9.]+)(?: *mm)?(?: *\([^)\n]*\))?\s*$",
    re.MULTILINE,
)
_LAYER = re.compile(rb"^; ?(?:LAYER_CHANGE|CHANGE_LAYER|LAYER:-?[0-9]+)\s*$", re.MULTILINE)
_SAGITTA, _MOST_STEPS = 0.005, 4096  # mm that an arc may be cut; steps of one arc


@dataclass(slots=True)
class _State:
    """Where the head is and what has been laid down."""

    marked: bool
    x: float = 0.0
    y: float = 0.0
    z: float = math.nan
    e: float = 0.0
    unit: float = 1.0
    relative: bool = False
    relative_e: bool = False
    role: int = WALL
    width: float = math.nan
    layer: int = -1
    joined: bool = False
    named: bool = False
    xs: list[float] = field(default_factory=list)
    ys: list[float] = field(default_factory=list)
    starts: list[int] = field(default_factory=list)
    roles: list[int] = field(default_factory=list)
    widths: list[float] = field(default_factory=list)
    layers: list[int] = field(default_factory=list)
    heights: list[float] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)


def read(path: Path) -> Theirs:
    """Read the beads of a G-code file.

    Raises
    ------
    ModelError
        ``file:line: message``: no number, a command that moves the frame, an arc by its radius, no bead at all.
    """
    data = load(path)
    marked = _LAYER.search(data) is not None
    state = _State(marked, role=IGNORED if marked else WALL)
    for line, raw in enumerate(data.split(b"\n"), 1):
        first = raw[:1]
        if first == b"G":
            _command(state, raw, line, path)
        elif first == b";":
            _comment(state, raw, line, path)
        elif first == b"M":
            if raw[:3] == b"M83":
                state.relative_e = True
            elif raw[:3] == b"M82":
                state.relative_e = False
        elif first not in b"T \t\r%" and b"\0" in raw:
            raise damaged(path, line, "this is not text", "name a G-code file")
    if not state.starts:
        raise damaged(path, line, "no bead was found", "name a G-code file that extrudes")
    return _collect(state, data)


def _command(state: _State, raw: bytes, line: int, path: Path) -> None:
    """Carry out one command that begins with G."""
    words = raw.split()
    code = words[0]
    if code == b"G1" or code == b"G0":
        x, y, e = state.x, state.y, None
        for word in words:
            kind = word[0]
            if kind == 59:  # a comment
                if state.marked is False:
                    _spoken(state, raw)
                break
            try:
                if kind == 88:
                    x = float(word[1:]) * state.unit + (state.x if state.relative else 0.0)
                elif kind == 89:
                    y = float(word[1:]) * state.unit + (state.y if state.relative else 0.0)
                elif kind == 69:
                    e = float(word[1:])
                elif kind == 90:
                    state.z = float(word[1:]) * state.unit + (state.z if state.relative else 0.0)
            except ValueError:
                number(word[1:], path, line, f"{chr(kind)}")
        _move(state, x, y, e, line, path)
    elif code in (b"G2", b"G3"):
        _arc(state, words, line, path)
    elif code in (b"G90", b"G91"):
        state.relative = state.relative_e = code == b"G91"
    elif code in (b"G20", b"G21"):
        state.unit = 25.4 if code == b"G20" else 1.0
    elif code == b"G92":
        for word in words[1:]:
            if word[:1] == b"E":
                state.e = number(word[1:], path, line, "E")
            elif word[:1] in (b"X", b"Y", b"Z"):
                raise damaged(path, line, "G92 moves the frame, which is not built yet", "write the file without it")
            elif word[:1] == b";":
                break
    elif code in (b"G18", b"G19", b"G5"):
        raise damaged(path, line, f"{code.decode()} is not built yet", "write the file without it")


def _move(state: _State, x: float, y: float, e: float | None, line: int, path: Path) -> None:
    """Go to a place, with a bead if the filament advances."""
    if not (abs(x) <= LIMIT_MM and abs(y) <= LIMIT_MM):
        raise damaged(path, line, f"a place must lie within {LIMIT_MM:g} mm, got X{x:g} Y{y:g}")
    advance = 0.0
    if e is not None:
        advance = e if state.relative_e else e - state.e
        state.e = e
    if x == state.x and y == state.y:
        return
    if advance > 0 and state.role != IGNORED:
        _bead(state, x, y, line, path)
    else:
        state.joined = False
    state.x, state.y = x, y


def _bead(state: _State, x: float, y: float, line: int, path: Path) -> None:
    if not state.marked and (not state.heights or state.heights[-1] != state.z):
        _new_layer(state, line)
    if state.layer < 0:
        return  # before the first layer: priming
    height = state.heights[state.layer]
    if height != state.z:
        if math.isnan(height):
            state.heights[state.layer] = state.z
        elif abs(height - state.z) > 1e-6:
            what = f"z changes from {height:g} to {state.z:g} mm within a layer"
            raise damaged(path, line, f"{what}, which is not built yet", "write the file without vase mode")
    if not state.joined:
        state.starts.append(len(state.xs))
        state.roles.append(state.role)
        state.widths.append(state.width)
        state.layers.append(state.layer)
        state.xs.append(state.x)
        state.ys.append(state.y)
        state.joined = True
    state.xs.append(x)
    state.ys.append(y)


def _new_layer(state: _State, line: int) -> None:
    state.layer += 1
    state.heights.append(math.nan if state.marked else state.z)
    state.lines.append(line)
    state.joined = False


def _arc(state: _State, words: list[bytes], line: int, path: Path) -> None:
    """Draw an arc as chords."""
    values: dict[str, float] = {}
    for word in words[1:]:
        if word[:1] == b";":
            break
        values[chr(word[0])] = number(word[1:], path, line, chr(word[0]))
    if "R" in values or not {"I", "J"} & values.keys():
        raise damaged(path, line, "an arc without I and J is not built yet", "write arcs with a centre")
    base = (state.x, state.y) if state.relative else (0.0, 0.0)
    x = base[0] + values["X"] * state.unit if "X" in values else state.x
    y = base[1] + values["Y"] * state.unit if "Y" in values else state.y
    cx, cy = state.x + values.get("I", 0.0) * state.unit, state.y + values.get("J", 0.0) * state.unit
    radius = math.hypot(state.x - cx, state.y - cy)
    first, last = math.atan2(state.y - cy, state.x - cx), math.atan2(y - cy, x - cx)
    sweep = (last - first) % (2 * math.pi) or 2 * math.pi
    if words[0] == b"G2":
        sweep = sweep - 2 * math.pi if sweep < 2 * math.pi else -sweep
    step = 2 * math.acos(max(0.0, 1 - _SAGITTA / radius)) if radius > _SAGITTA else math.pi
    steps = min(_MOST_STEPS, max(1, math.ceil(abs(sweep) / step)))
    e, start = values.get("E"), 0.0 if state.relative_e else state.e
    for i in range(1, steps + 1):
        turn = first + sweep * i / steps
        to = (x, y) if i == steps else (cx + radius * math.cos(turn), cy + radius * math.sin(turn))
        part = None if e is None else e / steps if state.relative_e else start + (e - start) * i / steps
        _move(state, *to, part, line, path)


def _comment(state: _State, raw: bytes, line: int, path: Path) -> None:
    """Take what a comment says about layer, kind and width of what follows."""
    text = raw[1:].strip()
    if text.startswith((b"TYPE:", b"FEATURE:")):
        word = text.partition(b":")[2].strip().decode("ascii", "replace").lower()
        state.role, state.named = ROLES.get(word, IGNORED), True
        state.joined = False
    elif text.startswith((b"WIDTH:", b"LINE_WIDTH:")):
        width = number(text.partition(b":")[2], path, line, "a width")
        if width != state.width:
            state.width, state.joined = width, False
    elif state.marked and _LAYER.match(raw):
        _new_layer(state, line)


def _spoken(state: _State, raw: bytes) -> None:
    """Take the kind of one move from the comment at its end, as Slic3r writes it when asked to."""
    word = raw.partition(b";")[2].decode("ascii", "replace").partition("(")[0].strip().lower()
    state.named |= word in ROLES
    if word in ROLES:
        role = ROLES[word]
    elif word in ("skirt", "brim"):
        role = IGNORED
    else:
        return
    if role != state.role:
        state.role, state.joined = role, False


def _collect(state: _State, data: bytes) -> Theirs:
    """Sort the beads into layers; those of support alone stand apart, those without any bead are left out."""
    points = np.column_stack([state.xs, state.ys])
    starts = np.array([*state.starts, len(points)], np.int64)
    roles, widths, layers = np.array(state.roles), np.array(state.widths), np.array(state.layers)
    said = _WIDTH.search(data)
    if said and 0 < float(said[1]) < 100:
        widths[np.isnan(widths)] = float(said[1])
    found: list[TheirLayer] = []
    props: list[TheirLayer] = []
    edges = np.searchsorted(layers, np.arange(len(state.heights) + 1))
    for k, (a, b) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)):
        if b > a:
            held = found if (roles[a:b] != SUPPORT).any() else props
            offsets = starts[a : b + 1] - starts[a]
            beads = Beads(points[starts[a] : starts[b]], offsets, roles[a:b], widths[a:b])
            held.append(TheirLayer(state.heights[k], f"line {state.lines[k]}", beads=beads))
    program = next((name for word, name in _PROGRAMS if word in data[:2000] or word in data[-2000:]), "G-code")
    notes = [] if (roles == OUTER).any() else ["the file does not tell outer from inner perimeters"]
    found, z_is = form.one_per_slice(found, data[:2000], 0.0)
    return Theirs(program, found, z_is, notes=notes, props=props, unsaid=not state.named)
