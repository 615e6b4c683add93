"""One line of G-code -> its words, and which of its commands may be read past."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ..errors import ModelError
from .form import damaged, shown

Word = tuple[bytes, bytes]  # a capital letter, and what is written behind it

#: A small e behind the digits of a capital letter is an exponent; a capital one is a word of its own, as in ``X1Y2E3``.
_WORD = re.compile(
    rb"\s*(?:([A-Z])\s*([-+0-9.]+(?:(?<=[0-9.])e[-+]?[0-9]+)?|[A-Za-z_]{2,}|)|([a-z])\s*([-+0-9.]+|[A-Za-z_]{2,}|))"
)
_EXPONENT = re.compile(rb"[0-9.]e[-+][0-9]{2}(?![0-9.])")
_REMARK = re.compile(rb"\([^)]*\)")
_MACRO = re.compile(rb"[A-Za-z_]{3,}[0-9]*(?![^\s=])|@")
_NUMBERED = re.compile(rb"\s*[A-Za-z]\s*[-+]?\.?[0-9]")
_INNER = re.compile(rb"[^;(]*\s[Gg]\s*[0-9]")

#: Commands of the letter G, without what follows a point, that change no place: they speak of speed, end what is
#: refused when it begins (polar coordinates, offsets of a cutter, scales, turns), or name the usual plane and frame.
HARMLESS = {b"G9", b"G15", b"G17", b"G40", b"G49", b"G50", b"G54", b"G64", b"G69", b"G93", b"G94", b"G95"}
_WAIT = {b"G4", b"G10", b"G11", b"G22", b"G23", b"G60"}  # wait, retract, remember: what else the line says is theirs
#: After these the head is somewhere else: it went home, felt the bed, parked, cleaned itself, or went back.
AWAY = {b"G12", b"G27", b"G28", b"G29", b"G30", b"G31", b"G32", b"G33", b"G34", b"G35", b"G36", b"G37", b"G38", b"G39",
        b"G61", b"G76", b"G80", b"G150", b"G380", b"G392", b"G425"}  # fmt: skip
_EXACTLY = {b"G91.1", b"G92.1"}  # centres of arcs count from their starts; no offset is left
_TEXT = (b"M117", b"M118")  # what is shown
_MOVED = {b"M206", b"M428", b"M556", b"M579"}  # an offset of the frame, a skew, a scale


@dataclass(frozen=True, slots=True)
class Command:
    """One line that is no comment.

    Attributes
    ----------
    codes : list of bytes
        Its commands of the letters G, M and T, in the spelling of slicers: G1 for ``g01``.
    words : list of (bytes, bytes)
        All other words.
    remark : bytes
        The comment at its end, with its semicolon.
    macro : bool
        Whether it is the name of something that the printer is told to do, with what it is told.
    """

    codes: list[bytes]
    words: list[Word]
    remark: bytes
    macro: bool = False


def parse(raw: bytes, path: Path, line: int) -> Command:
    """Cut a line into words: in any case, with or without blanks, number of the line, sum, and remarks in brackets.

    Raises
    ------
    ModelError
        ``file:line: message`` where it is neither words nor the name of a macro.
    """
    text, mark, said = raw.strip().partition(b";")
    remark = mark + said
    text = _REMARK.sub(b" ", text).strip()
    if not text or text[:1] == b"%":
        return Command([], [], remark)
    if not _NUMBERED.match(text):
        if _MACRO.match(text):
            return Command([], [], remark, macro=True)
        raise damaged(path, line, f"{shown(text)} is no command of G-code")
    words, rest = _cut(text.partition(b"*")[0])
    if words and words[0][0] == b"N":
        words = words[1:]
    if words and words[0][0] == b"M" and (_code(words[0]) in _TEXT or not _INNER.match(text)):
        return Command([_code(words[0])], words[1:], remark)  # what follows may be a text
    if words and words[0][0] == b"G" and _family(_code(words[0])) in _WAIT | AWAY and not _INNER.match(text):
        return Command([_code(words[0])], words[1:], remark)
    if rest:
        raise damaged(path, line, f"{shown(text)} cannot be read: {shown(rest)} is no word of G-code")
    if _EXPONENT.search(text) and text == text.lower():
        raise damaged(path, line, f"{shown(text)} is ambiguous: e may be an exponent or the axis", "write E large")
    codes = [_code(word) for word in words if word[0] in b"GMT"]
    return Command(codes, [word for word in words if word[0] not in b"GMT"], remark)


def _cut(text: bytes) -> tuple[list[Word], bytes]:
    """Return the words at the beginning of a text, and what cannot be cut."""
    words, at = [], 0
    while found := _WORD.match(text, at):
        words.append(((found[1] or found[3]).upper(), found[2] if found[1] else found[4]))
        at = found.end()
    return words, text[at:].strip()


def _code(word: Word) -> bytes:
    """Return a command without zeros before its number."""
    return word[0] + (word[1].lstrip(b"0") or b"0")


def _family(code: bytes) -> bytes:
    return code.partition(b".")[0]


def goes_away(code: bytes) -> bool:
    """Whether a command moves the head to a place that the file does not say."""
    return _family(code) in AWAY


def takes_words(code: bytes) -> bool:
    """Whether what else stands in the line of a command belongs to it, so that it is no motion."""
    return code[:1] == b"M" or _family(code) in _WAIT | AWAY


def look(code: bytes, words: list[Word], path: Path, line: int) -> None:
    """Refuse a command that no reader follows, unless it changes no place.

    Raises
    ------
    ModelError
        ``file:line: message``
    """
    named = b"".join(letter for letter, _ in words)
    known = (_family(code) in HARMLESS | _WAIT | AWAY and b"." not in code) or goes_away(code) or code in _EXACTLY
    if code == b"G10" and set(named) & set(b"XYZL"):
        known = False  # offsets; else it retracts, or sets temperatures
    if code[:1] == b"G" and not known:
        raise _refused(f"{code.decode()} is not built yet: it may move what follows", path, line)
    if code in _MOVED and (code == b"M428" or set(named) & set(b"XYIJ")):
        raise _refused(f"{code.decode()} moves or bends the frame, which is not built yet", path, line)


def _refused(what: str, path: Path, line: int) -> ModelError:
    return damaged(path, line, what, "write the file without it")
