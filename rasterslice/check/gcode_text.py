"""Text of G-code -> plain moves as columns of numbers, and every other line as it is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..numbertext import NotANumber, parse, words_of
from .form import Floats, damaged
from .loops import Ints

Flags = NDArray[np.bool_]

BLOCK = 1 << 18  # bytes that are looked at together: what is made of them stays in the cache
_KIND = np.full(256, 9, np.uint8)  # of the first character of a word: a column, 4 a speed, 9 anything else
_KIND[list(b"XYZEF")] = range(5)
_NUMBER, _NO_TEXT = 1, 2
_CLASS = np.zeros(256, np.uint8)  # of every character
_CLASS[:32] = _NO_TEXT
_CLASS[list(b"\t\n\v\f\r")] = 0
_CLASS[list(b"0123456789.+-")] = _NUMBER
_G, _ONE, _REMARK = b"G1;"


@dataclass(slots=True)
class Lines:
    """Lines of a file of G-code, numbered from 1.

    Attributes
    ----------
    line : (N,) int64
        Where the plain moves stand: ``G0`` or ``G1``, then X, Y, Z, E and F, each with digits behind it.
    given : (N, 4) float64
        What each gives for X, Y, Z and E, as it stands there; nan where it gives nothing.
    others : list of (int, bytes, bool)
        Line number and text of every other line that is not blank; and, when they were asked for, of the comments at
        the ends of plain moves, which are marked by True.
    count : int
        Lines in all.
    """

    line: Ints
    given: Floats
    others: list[tuple[int, bytes, bool]]
    count: int


def split(data: bytes, path: Path, remarks: bool) -> Lines:
    """Sort the lines of a file into plain moves and others.

    Parameters
    ----------
    data : bytes
    path : Path
        For errors.
    remarks : bool
        Whether to give the comments at the ends of moves.

    Raises
    ------
    ModelError
        ``file:line: message`` where a word of a plain move is no number, or where there is no text.
    """
    line, given, count = [np.empty(0, np.int64)], [np.empty((0, 4))], 0
    others: list[tuple[int, bytes, bool]] = []
    for first, last in _blocks(data):
        block = _Block(data[first:last], count + 1, path)
        others += block.others(remarks)
        numbers = block.numbers()
        line.append(numbers[0])
        given.append(numbers[1])
        count += len(block.breaks) - 1
    return Lines(np.concatenate(line), np.concatenate(given), others, count + (not data.endswith(b"\n")))


def _blocks(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield where blocks of whole lines begin and end."""
    first = 0
    while first < len(data):
        last = data.rfind(b"\n", first, first + BLOCK) + 1 or data.find(b"\n", first + BLOCK) + 1 or len(data)
        yield first, last
        first = last


class _Block:
    """Some whole lines, cut into words.

    Attributes
    ----------
    breaks : (L,) int64
        Where the lines end; the last is empty, but at the end of a file.
    """

    def __init__(self, data: bytes, line: int, path: Path) -> None:
        self._data, self._line, self._path = data, line, path
        self._text = text = np.frombuffer(data, np.uint8)
        self._starts, self._ends = starts, ends = words_of(text)
        self.breaks = np.append(np.flatnonzero(text == 10), len(text))
        reached = np.searchsorted(starts, self.breaks)
        words = np.diff(reached, prepend=0)  # of each line
        self._row = row = np.repeat(np.arange(len(words)), words)
        self._kind = _KIND[text[starts]]
        self._remark = np.full(len(words), len(starts))  # word at which the comment of each line begins
        marks = np.flatnonzero(text[starts] == _REMARK)[::-1]
        self._remark[row[marks]] = marks  # the last that is written is the first of its line
        self._code = np.arange(len(starts)) < self._remark[row]
        odd = self._code & ~self._spelled()
        heads = (reached - words)[words > 0]
        size, first, last = ends[heads] - starts[heads], text[starts[heads]], text[ends[heads] - 1]
        odd[heads] = ~((size == 2) & (first == _G) & (last | 1 == _ONE))  # neither G0 nor G1
        self._held = words > 0
        self._plain = self._held.copy()
        self._plain[row[odd]] = False

    def _spelled(self) -> Flags:
        """Whether each word is the letter of an axis or a speed, with characters of a number behind it."""
        found = _CLASS[self._text]
        if (found == _NO_TEXT).any():
            line = self._line + int(np.count_nonzero(self._text[: np.argmax(found)] == 10))
            raise damaged(self._path, line, "this is not text", "name a G-code file")
        seen = np.zeros(len(found) + 1, np.int32)
        np.cumsum(found, dtype=np.int32, out=seen[1:])
        size = self._ends - self._starts - 1
        return np.asarray((self._kind < 9) & (size > 0) & (seen[self._ends] - seen[self._starts + 1] == size))

    def others(self, remarks: bool) -> Iterator[tuple[int, bytes, bool]]:
        """Give the lines that are no plain moves, and the remarks behind moves when they are asked for."""
        behind = self._plain & (self._remark < len(self._starts)) & remarks
        begins = np.concatenate([[0], self.breaks[:-1] + 1])
        begins[behind] = self._starts[self._remark[behind]]
        for i in np.flatnonzero(self._held & ~self._plain | behind).tolist():
            yield self._line + i, self._data[int(begins[i]) : int(self.breaks[i])], bool(behind[i])

    def numbers(self) -> tuple[Ints, Floats]:
        """Return line and columns of the plain moves; those that give nothing name the kind of motion that goes on."""
        chosen = np.flatnonzero(self._plain[self._row] & self._code & (self._kind < 4))
        try:
            values = parse(self._text, self._starts[chosen] + 1, self._ends[chosen])
        except NotANumber as wrong:
            at = chosen[wrong.index]
            what = f"{chr(self._text[self._starts[at]])} must be a number, got {wrong.word!r}"
            raise damaged(self._path, self._line + int(self._row[at]), what) from None
        given = np.full((int(self._plain.sum()), 4), np.nan)
        given[(np.cumsum(self._plain) - 1)[self._row[chosen]], self._kind[chosen]] = values
        return self._line + np.flatnonzero(self._plain), given
