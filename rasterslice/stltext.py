"""ASCII STL: blocks of whole facets, read side by side.

A block in which every facet is spelled in 21 words, as programs write them, is read by NumPy. Any other one is
read word by word: names that hold keywords, text after the end tags, facets without a normal, comments.
"""

from __future__ import annotations

import re
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import ModelError, counted
from .numbertext import NotANumber, Text, number_of, parse, words_of
from .streams import Block, blocks, in_order, line_of

_KEYWORDS = {0: b"facet", 1: b"normal", 5: b"outer", 6: b"loop", 7: b"vertex", 11: b"vertex", 15: b"vertex",
             19: b"endloop", 20: b"endfacet"}  # fmt: skip
_WORDS = 21  # of a facet
_PLACES = np.array(list(_KEYWORDS))
_LENGTHS = np.array([len(word) for word in _KEYWORDS.values()])
_LETTERS = [
    (np.flatnonzero(j < _LENGTHS), np.array([word[j] for word in _KEYWORDS.values() if len(word) > j], np.uint8))
    for j in range(int(_LENGTHS.max()))
]
_NUMBERS = [8, 9, 10, 12, 13, 14, 16, 17, 18]
_LINE = re.compile(rb"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")
_SOLID = re.compile(rb"(?:^|(?<=[\r\n]))[ \t]*(?:(?:end)?solid(?![^\s])|#)[^\r\n]*", re.IGNORECASE)
#: Lines that hold more than a name, or more than a facet; and where they are cut.
_CROWDED = re.compile(rb"endfacet[ \t]+(?:end)?solid|solid[^\r\n]*\souter\s+loop", re.IGNORECASE)
_CUT = re.compile(
    rb"[ \t](?=facet\s+(?:normal(?:\s+[-+.\w()#]+){3}\s+)?outer\s+loop\s+vertex\s)"
    rb"|(?<=endfacet)[ \t](?=\s*(?:end)?solid(?![^\s]))|(?<=endsolid)[ \t](?=\s*solid\s)", re.IGNORECASE
)  # fmt: skip
#: What stands before a facet that is not the first one; `endfacet` may also be in a name, or in text after the end.
_BETWEEN = re.compile(
    rb"endfacet(?:[ \t]+|[^\r\n]*[\r\n]\s*)(?=(?:(?:end)?solid(?!\S)[^\r\n]*[\r\n]\s*)*facet\s+(?:normal|outer)\s)",
    re.IGNORECASE,
)
_END = re.compile(rb"(?:^|\s)endsolid(?!\S)", re.IGNORECASE)


class _Fault(Exception):
    """What is wrong at a byte of a block; `cut` when the file ends inside a facet."""

    def __init__(self, place: int, message: str, cut: bool = False) -> None:
        super().__init__(message)
        self.place, self.cut, self.kept = place, cut, np.empty((0, 3))


def read_stl_text(path: Path, start: int, lenient: bool) -> tuple[NDArray[np.float64], list[str]]:
    """Read an ASCII STL file.

    Parameters
    ----------
    path : Path
    start : int
        The byte where its first word begins.
    lenient : bool
        Whether a file that is cut short gives the facets that are whole.

    Returns
    -------
    vertices : (3 T, 3) float64
        Corners of the facets in the order of the file; may hold values that are not finite.
    notes : list of str
        What a user should know.

    Raises
    ------
    ModelError
        With the line, when the file is damaged or cut short.
    """
    parts: list[NDArray[np.float64]] = []
    notes, block, end, fault = list[str](), Block(0, b"", True), 0, None
    with path.open("rb") as file:
        file.seek(start)
        found = in_order(_try_facets, blocks(file, _BETWEEN))
        with closing(found):
            for block, result in found:
                corners, end, fault = result
                parts.append(corners)
                if fault is not None and not fault.cut:
                    line = line_of(path, block.start + fault.place)
                    raise ModelError(f"{path}:{line}: {fault}; export the model again")
    vertices = np.concatenate(parts)
    whole = len(vertices) // 3
    if fault is not None or (whole and not _END.search(block.text, end)):
        if not lenient or not whole:
            remedy = ", or use --lenient to slice those" if whole else ""
            held = counted(whole, "whole facet")
            raise ModelError(f"{path}: the file is cut short after {held}; export the model again{remedy}")
        notes.append(f"the file is cut short; {counted(whole, 'whole facet')} sliced")
    return vertices, notes


def _try_facets(block: Block) -> tuple[NDArray[np.float64], int, _Fault | None]:
    try:
        return *_facets(block), None
    except _Fault as fault:
        return fault.kept, 0, fault


def _facets(block: Block) -> tuple[NDArray[np.float64], int]:
    """Return the corners of a block, and a byte behind which no facet stands."""
    found = _regular(block.text)
    if found is None:
        if _CROWDED.search(block.text):  # places stay what they are
            block = block._replace(text=_CUT.sub(b"\n", block.text))
        found = _regular(_SOLID.sub(lambda m: b" " * len(m[0]), block.text))  # the names out of the way
    return _walk(block) if found is None else found


def _regular(raw: bytes) -> tuple[NDArray[np.float64], int] | None:
    """Return the corners and where the last facet ends, or None where facets are spelled in another way."""
    text: Text = np.frombuffer(raw, np.uint8)
    starts, ends = words_of(text)
    if len(starts) % _WORDS:
        return None
    starts, ends = starts.reshape(-1, _WORDS), ends.reshape(-1, _WORDS)
    keys = starts[:, _PLACES]
    if (ends[:, _PLACES] - keys != _LENGTHS).any():
        return None
    for j, (which, letters) in enumerate(_LETTERS):
        if ((text[keys[:, which] + j] | 32) != letters).any():
            return None
    numbers = starts[:, _NUMBERS].ravel()
    try:
        corners = parse(text, numbers, ends[:, _NUMBERS].ravel()).reshape(-1, 3)
        return corners, int(ends[-1, -1]) if len(ends) else 0
    except NotANumber as bad:
        raise _Fault(int(numbers[bad.index]), f"a vertex must be 3 numbers, got {bad.word!r}") from None


def _walk(block: Block) -> tuple[NDArray[np.float64], int]:
    """Read a block line by line; return the corners, and where the line begins that ends the last facet."""
    numbers, whole, state, place, end, junk, ended = list[float](), 0, 0, 0, 0, False, False
    try:
        for found in _LINE.finditer(block.text):
            line = found[0]
            words, i, junk = line.split(), 0, False
            while i < len(words):
                word = words[i].lower()
                if word.startswith(b"#") or (state == 0 and word in (b"solid", b"endsolid")):
                    ended = word == b"endsolid" if word[:1] != b"#" else ended
                    break
                if ended and not _of_a_facet(words[i : i + 4]):
                    break  # text after the end of a solid, in lines of its own
                if word == _STEPS[state]:
                    if word == b"vertex":
                        cut = block.last and place + len(line) == len(block.text)
                        numbers += _vertex(words[i + 1 : i + 4], place, cut)
                        i += 3
                    ended = False
                    junk = word in (b"facet", b"endloop", b"endfacet")  # what follows in the line is skipped
                    state = (state + 1) % len(_STEPS)
                    if state == 0:
                        whole, end = whole + 1, place
                elif not junk:
                    raise _unexpected(words[i], state, place, block)
                i += 1
            place += len(line)
        if state:
            raise _Fault(max(place - 1, 0), "the facet has no end", block.last)
    except _Fault as fault:
        fault.kept = np.array(numbers[: 9 * whole]).reshape(-1, 3)
        raise
    return np.array(numbers).reshape(-1, 3), end


_STEPS = (b"facet", b"outer", b"loop", b"vertex", b"vertex", b"vertex", b"endloop", b"endfacet")


def _of_a_facet(words: list[bytes]) -> bool:
    """Whether what follows the end of a solid is a line of a facet, and not text that begins as one."""
    match [word.lower() for word in words]:
        case [b"facet"] | [b"facet", b"normal" | b"outer", *_] | [b"outer", b"loop", *_]:
            return True
        case [b"vertex", _, _, _]:
            with suppress(_Fault):
                return bool(_vertex(words[1:], 0, False))
    return False


def _unexpected(word: bytes, state: int, place: int, block: Block) -> _Fault:
    wanted = _STEPS[state].decode() + (", solid or endsolid" if state == 0 else "")
    cut = block.last and block.text.endswith(word)  # the file ends inside a keyword
    cut &= any(step.startswith(word.lower()) for step in (_STEPS[state], *((b"endsolid",) * (state == 0))))
    return _Fault(place, f"expected {wanted}, got {word[:30].decode('latin-1')!r}", cut)


def _vertex(words: list[bytes], place: int, cut: bool) -> list[float]:
    try:
        if len(words) == 3:
            return [number_of(word) for word in words]
    except ValueError:
        pass
    shown = b" ".join(words)[:40].decode("latin-1")
    raise _Fault(place, f"a vertex must be 3 numbers, got {shown!r}", cut)
