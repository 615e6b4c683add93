"""Numbers in text -> float64, a block at a time, with the bits that Python's own `float` gives.

Based on: W. D. Clinger, How to read floating point numbers accurately (1990): where the digits make a whole
number below 2^53 and the power of ten is at most 22, one division or product of float64 is correctly rounded.
Differs in: done for all numbers of a block at once, one character position after the other; whatever does not
fit (17 digits, nan, rubbish) goes through NumPy's conversion of strings, which is slower and exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Text = NDArray[np.uint8]

_WIDTH = 40  # characters of a number that is read at all
_FAST = 24  # characters of a number that is read fast
_TENS = 10.0 ** np.arange(23)
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
    count = len(starts)
    mantissa, exponent = values, np.zeros(count, np.int32)
    mantissa[:] = 0.0
    digits, fraction, power_digits = (np.zeros(count, np.uint8) for _ in range(3))
    dots, marks, after_mark, power_negative = (np.zeros(count, bool) for _ in range(4))
    first = text[starts]
    negative = first == _MINUS
    signed = negative | (first == _PLUS)
    legal = signed.astype(np.uint8)  # how many characters have a meaning
    place = starts + signed
    alive = place < ends
    any_dot = any_mark = False
    for _ in range(width):
        c = text[place]
        place += 1
        alive &= c > 32
        digit = c - np.uint8(48)
        is_digit = (digit < 10) & alive
        other = alive & ~is_digit
        if any_mark:
            if after_mark.any():
                sign = after_mark & ((c == _MINUS) | (c == _PLUS))
                power_negative |= sign & (c == _MINUS)
                legal += sign
            after_mark = np.zeros(count, bool)
            power = is_digit & marks
            power_digits += power
            exponent *= _TENFOLD[power.view(np.uint8)]
            exponent += digit * power
            legal += power
            is_digit &= ~marks
        found = np.count_nonzero(is_digit)
        if found:
            if found == count:
                mantissa *= 10.0
                mantissa += digit
            else:
                mantissa *= _FACTORS[is_digit.view(np.uint8)]
                mantissa += digit * is_digit
            digits += is_digit
            legal += is_digit
            if any_dot:
                fraction += is_digit & dots
        if other.any():
            mark = other & ((c | 32) == _E) & ~marks & (digits > 0)
            dot = other & (c == _DOT) & ~dots & ~marks
            legal += dot
            legal += mark
            dots |= dot
            marks |= mark
            after_mark = mark
            any_mark = any_mark or bool(mark.any())
            any_dot = any_dot or bool(dot.any())
    np.negative(exponent, out=exponent, where=power_negative)
    exponent -= fraction
    mantissa *= _TENS[np.clip(exponent, 0, 22)]
    mantissa /= _TENS[np.clip(-exponent, 0, 22)]
    np.negative(mantissa, out=mantissa, where=negative)
    odd: NDArray[np.bool_] = (legal != ends - starts) | (digits == 0) | (digits > 15) | (np.abs(exponent) > 22)
    odd |= (marks & (power_digits == 0)) | (power_digits > 4)
    return odd


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
            for i, word in zip(index.tolist(), words.tolist(), strict=True):
                try:
                    if len(word) > 1000 or b"_" in word:
                        raise ValueError
                    float(word)
                except ValueError:
                    raise NotANumber(i, word[:30].decode("latin-1")) from None
            return np.array([float(word) for word in words.tolist()])
