"""Numbers in text -> float64, a block at a time, with the bits that Python's own `float` gives.

Based on: W. D. Clinger, How to read floating point numbers accurately (1990): where the digits make a whole
number below 2^53 and the power of ten is at most 22, one division or product of float64 is correctly rounded.
Differs in: done for all numbers of a block at once, one character position after the other; whatever does not
fit (17 digits, nan, rubbish) goes through NumPy's conversion of strings, which is slower and exact.
"""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import NDArray

Text = NDArray[np.uint8]

_WIDTH = 40  # characters of a number that is read at all
_FAST = 24  # characters of a number that is read fast
_TENS = 10.0 ** np.arange(23)
_NO_NUMBER = re.compile(rb"[+-]?(nan\([a-z0-9]*\)|1\.#(ind|qnan|snan)0*)", re.IGNORECASE)  # as C libraries write it
_MINUS, _PLUS, _DOT, _E, _UNDERSCORE = b"-+.e_"


class NotANumber(ValueError):
    """A word that is no number.

    Attributes
    ----------
    index : int
        Which of the words.
    word : str
    """

    def __init__(self, index: int, word: str) -> None:
        super().__init__(word)
        self.index, self.word = index, word


def words_of(text: Text) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where the words of a text start, and where they end (one past the last character)."""
    inside = np.zeros(len(text) + 2, bool)
    np.greater(text, 32, out=inside[1:-1])
    edges = np.flatnonzero(inside[1:] != inside[:-1])
    return edges[0::2], edges[1::2]


def parse(text: Text, starts: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the numbers that words of a text spell.

    Parameters
    ----------
    text : (N,) uint8
    starts, ends : (W,) int64
        Where the words begin and end.

    Returns
    -------
    (W,) float64
        Equal to ``float(word)``, NaN and infinity included.

    Raises
    ------
    NotANumber
        At the first word that is no number.
    """
    lengths = ends - starts
    values = np.empty(len(starts))
    if not len(starts):
        return values
    width = int(lengths.max())
    hard = np.zeros(len(starts), bool)
    if width > _FAST:
        hard, width = lengths > _FAST, _FAST
    if len(text) < int(starts[-1]) + width + 1:  # the last words are read beyond their ends
        text = np.concatenate([text, np.full(width + 1, 32, np.uint8)])
    hard |= _fast(text, starts, ends, width, values)
    if hard.any():
        slow = np.flatnonzero(hard)
        values[slow] = _slow(text, starts[slow], ends[slow], slow)
    return values


def _fast(
    text: Text, starts: NDArray[np.int64], ends: NDArray[np.int64], width: int, values: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Fill in the values; return which of them are not to be trusted."""
    first = text[starts]
    negative = first == _MINUS
    signed = negative | (first == _PLUS)
    place = starts + signed
    columns = _Columns(values, signed, place < ends)
    for _ in range(width):
        columns.add(text[place])
        place += 1
    trusted = columns.finish(negative)
    return np.asarray(~trusted | (columns.legal != ends - starts))


class _Columns:
    """What is known of numbers after some of their characters; one character of each is added at a time."""

    def __init__(self, values: NDArray[np.float64], signed: NDArray[np.bool_], alive: NDArray[np.bool_]) -> None:
        count = len(values)
        values[:] = 0.0
        self.mantissa, self.exponent = values, np.zeros(count, np.int32)
        self.legal = signed.astype(np.uint8)  # how many characters have a meaning
        self.digits, self.fraction, self.power_digits = (np.zeros(count, np.uint8) for _ in range(3))
        self.dots, self.marks, self.after_mark, self.power_negative = (np.zeros(count, bool) for _ in range(4))
        self.alive, self.any_dot, self.any_mark = alive, False, False

    def add(self, c: Text) -> None:
        """Take the next character of each number."""
        self.alive &= c > 32
        digit = c - np.uint8(48)
        is_digit = (digit < 10) & self.alive
        other = self.alive & ~is_digit
        if self.any_mark:
            self._power(c, digit, is_digit & self.marks)
            is_digit &= ~self.marks
        found = np.count_nonzero(is_digit)
        if found:
            if found == len(c):
                self.mantissa *= 10.0
                self.mantissa += digit
            else:
                self.mantissa *= _FACTORS[is_digit.view(np.uint8)]
                self.mantissa += digit * is_digit
            self.digits += is_digit
            self.legal += is_digit
            if self.any_dot:
                self.fraction += is_digit & self.dots
        if other.any():
            mark = other & ((c | 32) == _E) & ~self.marks & (self.digits > 0)
            dot = other & (c == _DOT) & ~self.dots & ~self.marks
            self.legal += dot
            self.legal += mark
            self.dots |= dot
            self.marks |= mark
            self.after_mark = mark
            self.any_mark = self.any_mark or bool(mark.any())
            self.any_dot = self.any_dot or bool(dot.any())

    def _power(self, c: Text, digit: Text, power: NDArray[np.bool_]) -> None:
        """Take the characters after an e."""
        if self.after_mark.any():
            sign = self.after_mark & self.alive & ((c == _MINUS) | (c == _PLUS))
            self.power_negative |= sign & (c == _MINUS)
            self.legal += sign
            self.after_mark = np.zeros(len(c), bool)
        self.power_digits += power
        self.exponent *= _TENFOLD[power.view(np.uint8)]
        self.exponent += digit * power
        self.legal += power

    def finish(self, negative: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Put mantissa, exponent and sign together; return which numbers are exact."""
        exponent = self.exponent
        np.negative(exponent, out=exponent, where=self.power_negative)
        exponent -= self.fraction
        self.mantissa *= _TENS[np.clip(exponent, 0, 22)]
        self.mantissa /= _TENS[np.clip(-exponent, 0, 22)]
        np.negative(self.mantissa, out=self.mantissa, where=negative)
        trusted = (self.digits > 0) & (self.digits <= 15) & (np.abs(exponent) <= 22) & (self.power_digits <= 4)
        return np.asarray(trusted & (~self.marks | (self.power_digits > 0)))


_FACTORS, _TENFOLD = np.array([1.0, 10.0]), np.array([1, 10], np.int32)


def _slow(
    text: Text, starts: NDArray[np.int64], ends: NDArray[np.int64], index: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Convert words one by one; `index` is what they are called in an error."""
    words = np.array([text[a:b].tobytes() for a, b in zip(starts.tolist(), ends.tolist(), strict=True)])
    with np.errstate(over="ignore"):
        try:
            if words.dtype.itemsize > _WIDTH or b"_" in words.tobytes():
                raise ValueError
            return words.astype(np.float64)
        except ValueError:
            found = np.empty(len(words))
            for j, (i, word) in enumerate(zip(index.tolist(), words.tolist(), strict=True)):
                try:
                    found[j] = number_of(word)
                except ValueError:
                    raise NotANumber(i, word[:30].decode("latin-1")) from None
            return found


def number_of(word: bytes) -> float:
    """Return the number that one word spells: as `float`, but also ``-nan(ind)`` and ``1.#QNAN``, and no ``1_000``."""
    if len(word) > 1000 or b"_" in word:
        raise ValueError(word[:30])
    try:
        return float(word)
    except ValueError:
        if _NO_NUMBER.fullmatch(word):
            return math.nan
        raise
