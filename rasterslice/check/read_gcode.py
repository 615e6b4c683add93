"""G-code of PrusaSlicer, OrcaSlicer, Cura and Slic3r: the beads, what each is called, its width and its layer."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from . import form
from .form import OUTER, SUPPORT, WALL, Beads, Floats, TheirLayer, Theirs, damaged, load, shown
from .gcode_beads import CLOCKWISE, COUNTER, IGNORED, Laid, Moves, lay
from .gcode_codes import parse
from .gcode_orders import Orders
from .gcode_text import Lines, split
from .gcode_words import LAYER, Settings, program_of, role_of, spoken, width
from .loops import Ints

_SHOWN = 6  # names
_BOM = b"\xef\xbb\xbf"


def read(path: Path) -> Theirs:
    """Read the beads of a G-code file.

    Raises
    ------
    ModelError
        ``file:line: message``: no number, a command that moves the frame, an arc by its radius, coordinates that no
        command asks for, no bead at all.
    """
    data = load(path).removeprefix(_BOM)
    marked = LAYER.search(data) is not None
    lines = split(data, path, remarks=not marked)
    said = _Said(path, marked, lines.line)
    for line, raw, behind in lines.others:
        if behind:
            said.remark(raw, line)
        else:
            said.take(raw, line)
    laid = lay(said.moves(lines), np.array(said.layers, np.int64) if marked else None, path)
    _known(laid, said, lines)
    if laid is None:
        raise damaged(path, lines.count, "no bead was found", "name a G-code file that extrudes")
    return _collect(laid, said, data)


def _known(laid: Laid | None, said: _Said, lines: Lines) -> None:
    """Refuse a file of which no outer wall is left because its names of beads are not known, or are not there."""
    if said.unknown and (laid is None or not (laid.role == OUTER).any()):
        first = min(said.unknown.values())
        what = f"no outer wall is known, and these kinds of beads are not: {said.strangers()}"
        raise damaged(said.path, first, what, "write ;TYPE:External perimeter, ;TYPE:Outer wall or ;TYPE:WALL-OUTER")
    nameless = laid is None and said.marked and not said.named
    if nameless and bool((lines.given[lines.line > said.layers[0], 3] > 0).any()):
        what = "the file extrudes and marks its layers, but no line ;TYPE: or ;FEATURE: says what kind a bead is"
        raise damaged(said.path, said.layers[0], what, "write it with all comments, or without those of layers")


class _Said:
    """What lines that are no plain moves say, from each on for all moves that follow."""

    def __init__(self, path: Path, marked: bool, plain: Ints) -> None:
        self.path, self.marked, self.named = path, marked, False
        self.orders = Orders(path, plain)
        self.macros: list[tuple[int, bytes]] = []
        self.unknown: dict[bytes, int] = {}  # kinds of beads, and the first line of each
        self.settings = Settings()
        self.layers: list[int] = []  # lines where they begin
        self.role, self.piece, self.width = IGNORED if marked else WALL, 0, math.nan
        self._since: list[int] = []
        self._state: list[tuple[float, ...]] = []
        self._remember(0)

    def _remember(self, line: int) -> None:
        layer = len(self.layers) - 1
        o = self.orders
        now = (o.unit, o.relative, o.relative_e, o.unsure_e, self.role, layer, self.piece, self.width)
        self._since.append(line)
        self._state.append(now)

    def take(self, raw: bytes, line: int) -> None:
        """Take a line that is no plain move."""
        text = raw.strip()
        if text[:1] == b";":
            self._comment(text, line)
            return
        command = parse(text, self.path, line)
        if command.macro:
            self.macros.append((line, text))
        elif command.codes or command.words:
            if self.orders.take(command, line):
                self._remember(line)
            if command.remark:
                self.remark(command.remark, line)

    def _comment(self, raw: bytes, line: int) -> None:
        """Take what a comment says about layer, kind and width of what follows, or about the whole file."""
        text = raw[1:].strip()
        key, _, value = text.partition(b":")
        if key in (b"TYPE", b"FEATURE"):
            self.named = True
            role = role_of(value)
            if role is None:
                self.unknown.setdefault(value.strip(), line)
            self._next(line, IGNORED if role is None else role, self.width)
        elif key in (b"WIDTH", b"LINE_WIDTH"):
            wide = width(value, self.path, line)
            if wide != self.width:
                self._next(line, self.role, wide)
        elif LAYER.match(raw):
            self.layers.append(line)
            self._next(line, self.role, self.width)
        elif key == b"LAYER":
            raise damaged(self.path, line, f"the number of a layer must be whole, got {shown(value)}")
        elif b"=" in text:
            self.settings.take(text, self.path, line)

    def remark(self, raw: bytes, line: int) -> None:
        """Take the kind of one move from the comment at its end, where layers are not marked."""
        role = spoken(raw)
        if role is not None and not self.marked:
            self.named |= role != IGNORED
            if role != self.role:
                self._next(line, role, self.width)

    def _next(self, line: int, role: int, wide: float) -> None:
        """End the bead that is being laid; from here on they are of a role and a width."""
        self.role, self.width, self.piece = role, wide, self.piece + 1
        self._remember(line)

    def told(self) -> str:
        """Return a note of what only the printer knows."""
        line, first = self.macros[0]
        more = f", and {len(self.macros) - 1} more" if len(self.macros) > 1 else ""
        return f"line {line}, {shown(first)}{more}: a macro, and what it does to moves is not known"

    def strangers(self) -> str:
        """Return the kinds of beads that are not known."""
        more = f", and {len(self.unknown) - _SHOWN} more" if len(self.unknown) > _SHOWN else ""
        return ", ".join(f"{shown(word)} (line {line})" for word, line in list(self.unknown.items())[:_SHOWN]) + more

    def moves(self, lines: Lines) -> Moves:
        """Return all moves, each with what was said before it."""
        line, given, kind, centre = lines.line, lines.given, np.zeros(len(lines.line), np.uint8), {}
        rows = self.orders.rows
        if rows:
            own = np.array([row[0] for row in rows])
            place = np.searchsorted(line, own)
            line = np.insert(line, place, own)
            given = np.insert(given, place, np.array([row[2] for row in rows]), axis=0)
            kind = np.insert(kind, place, np.array([row[1] for row in rows], np.uint8))
            at = (place + np.arange(len(place))).tolist()
            centre = {i: row[3] for i, row in zip(at, rows, strict=True) if row[1] in (CLOCKWISE, COUNTER)}
        which = np.searchsorted(self._since, line, side="right") - 1
        state = np.array(self._state)
        unit, relative, relative_e, unsure, role, layer, piece, wide = (state[:, i] for i in range(8))
        return Moves(
            line, given, kind, centre, unit[which], relative[which] > 0, relative_e[which] > 0, unsure[which] > 0,
            role.astype(np.int64)[which], layer.astype(np.int64)[which], piece.astype(np.int64)[which], wide[which],
        )  # fmt: skip


def _collect(laid: Laid, said: _Said, data: bytes) -> Theirs:
    """Sort the beads into layers; those of support alone stand apart, those without any bead are left out."""
    widths = np.where(np.isnan(laid.width), said.settings.width, laid.width)
    found: list[TheirLayer] = []
    props: list[TheirLayer] = []
    rates = _rates(laid, widths)
    edges = np.searchsorted(laid.layer, np.arange(len(laid.heights) + 1))
    for k, (a, b) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)):
        if b > a:
            held = found if (laid.role[a:b] != SUPPORT).any() else props
            first, last = laid.starts[[a, b]].tolist()
            offsets = laid.starts[a : b + 1] - first
            beads = Beads(laid.points[first:last], offsets, laid.role[a:b], widths[a:b], rates[a:b])
            held.append(TheirLayer(float(laid.heights[k]), f"line {laid.lines[k]}", beads=beads))
    notes = [said.told()] if said.macros else []
    if said.unknown:
        notes.append(f"kinds of beads that are not known were left out: {said.strangers()}")
    notes += [] if (laid.role == OUTER).any() else ["the file does not tell outer from inner perimeters"]
    found, z_is = form.one_per_slice(found, data[:2000], said.path, 0.0)
    return Theirs(
        program_of(data), found, z_is, notes=notes, props=props, unsaid=not said.named, filament=said.settings.filament,
    )  # fmt: skip


def _rates(laid: Laid, widths: Floats) -> Floats:
    """Return the filament for one mm of each bead; nan where its width is said, or none was fed."""
    total = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(laid.points, axis=0).T))])
    length = total[laid.starts[1:] - 1] - total[laid.starts[:-1]]
    known = np.isnan(widths) & (laid.fed > 0) & (length > 0)
    return np.where(known, laid.fed / np.where(known, length, 1.0), np.nan)
