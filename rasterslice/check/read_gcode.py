"""G-code of PrusaSlicer, OrcaSlicer, Cura and Slic3r: the beads, what each is called, its width and its layer."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from . import form
from .form import OUTER, SUPPORT, WALL, Beads, Floats, TheirLayer, Theirs, damaged, load, number, shown
from .gcode_beads import CLOCKWISE, COUNTER, IGNORED, SET, STRAIGHT, Laid, Moves, lay
from .gcode_text import Lines, respelled, split
from .gcode_words import LAYER, Settings, program_of, role_of, spoken, width

_KNOWN = {b"G", b"M", b";", b"T", b"%"}  # first letters of a line as slicers write it
_ENDS = {b" ", b"", b"0", b"1", b"2", b"3", b"8", b"9"}  # what follows G and a digit
_PLAIN = re.compile(rb"[A-Za-z][-+0-9.]*(?:e[-+]?[0-9]+)?")  # a capital E is a word of its own
_MOVES = {b"G0": STRAIGHT, b"G1": STRAIGHT, b"G2": CLOCKWISE, b"G3": COUNTER}
_MOST_FED = 1e9  # mm of filament


def read(path: Path) -> Theirs:
    """Read the beads of a G-code file.

    Raises
    ------
    ModelError
        ``file:line: message``: no number, a command that moves the frame, an arc by its radius, no bead at all.
    """
    data = load(path)
    marked = LAYER.search(data) is not None
    lines = split(data, path, remarks=not marked)
    said = _Said(path, marked)
    for line, raw, behind in lines.others:
        if behind:
            said.remark(raw, line)
        else:
            said.take(raw, line)
    laid = lay(said.moves(lines), np.array(said.layers, np.int64) if marked else None, path)
    if laid is None:
        raise damaged(path, lines.count, "no bead was found", "name a G-code file that extrudes")
    return _collect(laid, said, data)


class _Said:
    """What lines that are no plain moves say, from each on for all moves that follow."""

    def __init__(self, path: Path, marked: bool) -> None:
        self.path, self.marked, self.named = path, marked, False
        self.settings = Settings()
        self.layers: list[int] = []  # lines where they begin
        self.unit, self.relative, self.relative_e = 1.0, False, False
        self.role, self.piece, self.width = IGNORED if marked else WALL, 0, math.nan
        self._since: list[int] = []
        self._state: list[tuple[float, ...]] = []
        self._rows: list[tuple[int, int, list[float], tuple[float, float]]] = []
        self._remember(0)

    def _remember(self, line: int) -> None:
        layer = len(self.layers) - 1
        now = (self.unit, self.relative, self.relative_e, self.role, layer, self.piece, self.width)
        self._since.append(line)
        self._state.append(now)

    def take(self, raw: bytes, line: int) -> None:
        """Take a line, or the remark behind a move."""
        first = raw[:1]
        padded = raw[1:2] == b"0" and raw[2:3].isdigit()  # G01
        if first not in _KNOWN or (first in b"GM" and padded) or (first == b"G" and raw[2:3] not in _ENDS):
            raw = respelled(raw)
            first = raw[:1]
        if first == b";":
            self._comment(raw, line)
        elif first == b"G":
            self._command(raw, line)
        elif raw[:3] in (b"M82", b"M83"):
            self.relative_e = raw[:3] == b"M83"
            self._remember(line)

    def _comment(self, raw: bytes, line: int) -> None:
        """Take what a comment says about layer, kind and width of what follows, or about the whole file."""
        text = raw[1:].strip()
        key, _, value = text.partition(b":")
        if key in (b"TYPE", b"FEATURE"):
            self.named = True
            self._next(line, role_of(value), self.width)
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

    def _command(self, raw: bytes, line: int) -> None:
        """Take a command that begins with G."""
        words = raw.split()
        code = words[0]
        if code in _MOVES:
            self._move(raw, line)
        elif code in (b"G90", b"G91"):
            self.relative = self.relative_e = code == b"G91"
            self._remember(line)
        elif code in (b"G20", b"G21"):
            self.unit = 25.4 if code == b"G20" else 1.0
            self._remember(line)
        elif code == b"G92":
            given = self._numbers(words, line)
            if not math.isnan(given[3]):
                self._rows.append((line, SET, [math.nan, math.nan, math.nan, given[3]], (0.0, 0.0)))
            if not all(math.isnan(value) for value in given[:3]):
                what = "G92 moves the frame, which is not built yet"
                raise damaged(self.path, line, what, "write the file without it")
        elif code in (b"G18", b"G19", b"G5"):
            what = f"{code.decode()} is not built yet"
            raise damaged(self.path, line, what, "write the file without it")

    def _move(self, raw: bytes, line: int) -> None:
        """Take a move in another than the usual spelling, or an arc."""
        code, mark, remark = raw.partition(b";")
        words = code.split()
        if not all(_PLAIN.fullmatch(word) for word in words[1:]):
            apart = respelled(code).split()
            words = apart if len(apart) > len(words) else words  # G1 X1Y2
        kind = _MOVES[words[0]]
        given = self._numbers(words, line)
        i, j, radius = given[4:]
        if kind != STRAIGHT and (not math.isnan(radius) or (math.isnan(i) and math.isnan(j))):
            raise damaged(self.path, line, "an arc without I and J is not built yet", "write arcs with a centre")
        if mark:
            self.remark(mark + remark, line)
        centre = (0.0 if math.isnan(i) else i * self.unit, 0.0 if math.isnan(j) else j * self.unit)
        self._rows.append((line, kind, given[:4], centre))

    def _numbers(self, words: list[bytes], line: int) -> list[float]:
        """Return what the words of a command give for X, Y, Z, E, I, J and R; nan where they give nothing."""
        given = [math.nan] * 7
        for word in words[1:]:
            if word[:1] == b";":
                break
            place = b"XYZEIJR".find(word[:1].upper())
            if place >= 0:
                limit = _MOST_FED if place == 3 else form.LIMIT_MM
                given[place] = number(word[1:], self.path, line, "XYZEIJR"[place], limit)
        return given

    def moves(self, lines: Lines) -> Moves:
        """Return all moves, each with what was said before it."""
        line, given, kind, centre = lines.line, lines.given, np.zeros(len(lines.line), np.uint8), {}
        if self._rows:
            own = np.array([row[0] for row in self._rows])
            place = np.searchsorted(line, own)
            line = np.insert(line, place, own)
            given = np.insert(given, place, np.array([row[2] for row in self._rows]), axis=0)
            kind = np.insert(kind, place, np.array([row[1] for row in self._rows], np.uint8))
            at = (place + np.arange(len(place))).tolist()
            centre = {i: row[3] for i, row in zip(at, self._rows, strict=True) if row[1] in (CLOCKWISE, COUNTER)}
        which = np.searchsorted(self._since, line, side="right") - 1
        state = np.array(self._state)
        unit, relative, relative_e, role, layer, piece, wide = (state[:, i] for i in range(7))
        return Moves(
            line, given, kind, centre, unit[which], relative[which] > 0, relative_e[which] > 0,
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
    notes = [] if (laid.role == OUTER).any() else ["the file does not tell outer from inner perimeters"]
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
