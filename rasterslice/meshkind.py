"""Which format a mesh file has, by its content; its name says so only where the content says nothing."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from .errors import ModelError

HEAD = 1 << 16  # bytes that are looked at
FACET_BYTES, STL_HEAD = 50, 84  # of binary STL

_OTHERS = ("3mf", "glb", "obj", "off")
_BOM = b"\xef\xbb\xbf"
_WIDE = rb"\xff\xfe|\xfe\xff|(?:[\x09-\x7e]\0){8}|(?:\0[\x09-\x7e]){8}"  # text of two bytes a character
_PREFACE = rb"(?:\s+|#[^\r\n]*(?=[\r\n]))*"  # blank space and comments before the first word
_OBJ_LINE = rb"(\s*|(#|o|g|s|mtllib|usemtl)(\s.*)?|(v|vn|vt|vp)(\s+[-+.\deE]+)+\s*|f(\s+[-\d/]+)+\s*)$"
_OBJ_VERTEX = rb"(?:^|[\r\n])[ \t]*v(?:[ \t]+[-+]?[.\d][-+.\deE]*){3,}[ \t]*[\r\n]"


class Kind(NamedTuple):
    """The name of a format (``text`` is ASCII STL), and the byte where its first word begins."""

    name: str
    start: int


def kind_of(path: Path, head: bytes, size: int) -> Kind:
    """Return the format of a file of `size` bytes that begins with `head`.

    Raises
    ------
    ModelError
        When it is none that is read.
    """
    if size >= STL_HEAD and STL_HEAD + FACET_BYTES * facet_count(head) == size:
        return Kind("stl", 0)
    start = len(_BOM) if head.startswith(_BOM) else 0
    if re.match(rb"ply[ \t]*[\r\n]", head[start:], re.IGNORECASE):
        return Kind("ply", start)
    for magic, name in ((b"glTF", "glb"), (b"PK\3\4", "3mf")):
        if head.startswith(magic):
            return Kind(name, 0)
    if re.match(_WIDE, head):
        raise ModelError(f"{path}: is text of two bytes a character (UTF-16); save it as ASCII or UTF-8")
    begin = re.compile(_PREFACE).match(head, start)
    word = begin.end() if begin else start
    if re.compile(rb"solid(?![^\s])|facet\s", re.IGNORECASE).match(head, word) and b"\0" not in head[:512]:
        return Kind("text", word)
    if re.compile(rb"(ST)?C?N?4?n?OFF(\s|#)").match(head, word):
        return Kind("off", 0)
    suffix = path.suffix.lower().lstrip(".")
    lines = re.split(rb"[\r\n]+", head[start:512])
    known = all(re.match(_OBJ_LINE, line) for line in lines[:-1] or lines)
    if known and (suffix != "stl" or re.search(_OBJ_VERTEX, head)):
        return Kind("obj", 0)
    if suffix == "ply":
        raise ModelError(f"{path}: does not begin with 'ply'; the file is damaged")
    if suffix == "stl" and _is_text(head):
        shown = head[word : word + 20].split(b"\n")[0].decode("latin-1")
        raise ModelError(f"{path}: text that begins with {shown!r}; an ASCII STL begins with solid, and a binary one "
                         "is no text; export the model again")  # fmt: skip
    if suffix in ("stl", *_OTHERS):
        return Kind(suffix, 0)
    raise ModelError(f"{path}: unknown format; known are stl, ply, {', '.join(_OTHERS)}")


def facet_count(head: bytes) -> int:
    """Return how many facets the header of a binary STL promises."""
    return int.from_bytes(head[80:84], "little")


def _is_text(head: bytes) -> bool:
    """Whether a file begins with text of UTF-8; the last letter may be cut."""
    return re.fullmatch(r"[^\x00-\x08\x0e-\x1f\ufffd]*\ufffd?", head[:512].decode("utf-8", "replace")) is not None
