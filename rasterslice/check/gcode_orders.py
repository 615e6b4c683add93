"""Commands of G-code that are no plain moves -> rows of moves, and what coordinates mean after each."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from .form import LIMIT_MM, damaged, number
from .gcode_beads import AWAY, CLOCKWISE, COUNTER, SET, STRAIGHT
from .gcode_codes import Command, Word, goes_away, look, takes_words
from .loops import Ints

Row = tuple[int, int, list[float], tuple[float, float]]  # line, kind, X Y Z E, centre of an arc
_MOVES = {b"G0": STRAIGHT, b"G1": STRAIGHT, b"G2": CLOCKWISE, b"G3": COUNTER}
_MODES = {b"G90", b"G91", b"G20", b"G21", b"M82", b"M83"}
_AXES = {b"X", b"Y", b"Z", b"E", b"I", b"J", b"R"}
_OF_MOVES = {b"X", b"Y", b"Z", b"E", b"F", b"S"}  # S is the power of a laser
_OF_ARCS = {b"I", b"J", b"R"}
_TURNS = {b"K": (0.0,), b"P": (0.0, 1.0)}
_MOST_FED = 1e9  # mm of filament


class Orders:
    """What the commands of a file have said so far.

    Parameters
    ----------
    path : Path
        For errors.
    plain : (N,) int64
        Lines of the plain moves.

    Attributes
    ----------
    unit : float
        mm.
    relative, relative_e : bool
        As in `gcode_beads.Moves`.
    rows : list of (int, int, list of float, (float, float))
        Moves: line, kind, what is given for X, Y, Z and E, and the centre of an arc.
    """

    def __init__(self, path: Path, plain: Ints) -> None:
        self.path, self._plain = path, plain
        self._motion = (0, STRAIGHT)  # line and kind of the last move that is not plain
        self.unit, self.relative, self.relative_e = 1.0, False, False
        self._said_e: bool | None = None  # by M82 and M83
        self.rows: list[Row] = []

    @property
    def unsure_e(self) -> bool:
        """Whether printers disagree about E: they go by Marlin's rule, by M82 and M83 alone, or by either."""
        said = self._said_e
        return said is not None and not self.relative_e == said == (said or self.relative)

    def take(self, command: Command, line: int) -> bool:
        """Take all commands of a line: first what they say of coordinates, then the one that uses them.

        Returns
        -------
        bool
            Whether what coordinates mean has changed.

        Raises
        ------
        ModelError
            ``file:line: message``
        """
        acts = [code for code in command.codes if code in _MOVES or code == b"G92" or goes_away(code)]
        for code in command.codes:
            if code in _MODES:
                self._mode(code)
            elif code[:1] != b"T" and code not in _MOVES and code != b"G92":
                look(code, command.words, self.path, line)
        if len(acts) > 1:
            what = f"{acts[0].decode()} and {acts[1].decode()} in one line"
            raise damaged(self.path, line, what, "write one command in a line")
        named = {letter for letter, _ in command.words}
        if not acts and named & _AXES and all(code in _MODES or not takes_words(code) for code in command.codes):
            self._move(self._going_on(line), command, line)
        for code in acts:
            if code in _MOVES:
                self._move(_MOVES[code], command, line)
            elif code == b"G92":
                self._frame(command.words, line)
            else:
                axes = (named if code == b"G28" else set()) & {b"X", b"Y", b"Z"} or {b"X", b"Y", b"Z"}
                bits = sum(1 << b"XYZ".index(letter) for letter in axes)
                self.rows.append((line, AWAY | bits, [math.nan] * 4, (0.0, 0.0)))
        return any(code in _MODES for code in command.codes)

    def _mode(self, code: bytes) -> None:
        """Take what all coordinates after it are."""
        if code in (b"G90", b"G91"):
            self.relative = self.relative_e = code == b"G91"
        elif code in (b"G20", b"G21"):
            self.unit = 25.4 if code == b"G20" else 1.0
        else:
            self.relative_e = self._said_e = code == b"M83"

    def _going_on(self, line: int) -> int:
        """Return the kind of motion that goes on in a line of coordinates alone: that of the last command."""
        place = int(np.searchsorted(self._plain, line))
        before = int(self._plain[place - 1]) if place else 0
        if not before and not self._motion[0]:
            what = "coordinates before any of G0, G1, G2 and G3"
            raise damaged(self.path, line, what, "write G1 before them")
        return STRAIGHT if before > self._motion[0] else self._motion[1]

    def _frame(self, words: list[Word], line: int) -> None:
        """Take a G92: of E alone; without any word it is one of all axes."""
        given = self._numbers(words, line)
        if not words or not all(math.isnan(value) for value in given[:3]):
            what = "G92 moves the frame, which is not built yet"
            raise damaged(self.path, line, what, "write the file without it")
        if not math.isnan(given[3]):
            self.rows.append((line, SET, [math.nan, math.nan, math.nan, given[3]], (0.0, 0.0)))

    def _move(self, kind: int, command: Command, line: int) -> None:
        """Take a move in another than the usual spelling, or an arc."""
        self._motion = (line, kind)
        arc = kind != STRAIGHT
        given = self._numbers(command.words, line)
        for letter, text in command.words:
            known = letter in _OF_MOVES or (arc and letter in _OF_ARCS)
            if letter in _TURNS:  # a way along the third axis, and whole turns
                known = arc and number(text, self.path, line, letter.decode()) in _TURNS[letter]
            if not known:
                what = f"{letter.decode()} in a move is not built yet"
                raise damaged(self.path, line, what, "write moves of X, Y, Z, E and F, and arcs with I and J")
        i, j, radius = given[4:]
        if arc and (not math.isnan(radius) or (math.isnan(i) and math.isnan(j))):
            raise damaged(self.path, line, "an arc without I and J is not built yet", "write arcs with a centre")
        centre = (0.0 if math.isnan(i) else i * self.unit, 0.0 if math.isnan(j) else j * self.unit)
        self.rows.append((line, kind, given[:4], centre))

    def _numbers(self, words: list[Word], line: int) -> list[float]:
        """Return what the words of a command give for X, Y, Z, E, I, J and R; nan where they give nothing."""
        given = [math.nan] * 7
        for letter, text in words:
            place = b"XYZEIJR".find(letter)
            if place >= 0:
                limit = _MOST_FED if place == 3 else LIMIT_MM
                given[place] = number(text, self.path, line, "XYZEIJR"[place], limit)
        return given
