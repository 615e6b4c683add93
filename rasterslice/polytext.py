"""OBJ and OFF: vertices and polygons as text, line by line; everything else is skipped."""

from __future__ import annotations

import re
from array import array
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import ModelError, counted
from .numbertext import number_of
from .polygons import Ints, fans, mend_fans, polygon_notes

Found = tuple[NDArray[np.float64], Ints, list[str]]

_MOST = 1 << 31  # vertices that a facet can name
_MOST_CORNERS = 1_000_000
_WIDTH = 32  # characters of a number that is read fast
_SKIPPED = frozenset([b"", *(bytes([c]) for c in b"#" + bytes(range(65, 91)) + bytes(range(97, 123)))])
_SLASH = re.compile(rb"/[^\s]*")
_OFF = re.compile(rb"(ST)?(C)?(N)?(4)?(n)?OFF$")


def read_obj(path: Path, size: int, lenient: bool) -> Found:
    """Read the `v` and `f` lines of an OBJ file.

    Returns
    -------
    vertices : (N, 3) float64
    faces : (T, 3) int64
        Corners of triangles, not checked.
    notes : list of str

    Raises
    ------
    ModelError
        With the line, when it is not understood.
    """
    data = path.read_bytes().removeprefix(b"\xef\xbb\xbf")
    found = _plain_obj(data)
    return _result(*(found or _walk_obj(path, data)), [])


def _plain_obj(data: bytes) -> tuple[Any, Any, Any] | None:
    """Return vertices, corners and sizes of a file as most programs write it, or None."""
    lines = data.splitlines()
    kinds = {b"v ": list[bytes](), b"f ": list[bytes]()}
    for line in lines:
        if (kind := kinds.get(line[:2])) is not None:
            kind.append(line)
        elif line[:1] not in _SKIPPED or line[:2] in (b"v\t", b"f\t"):
            return None
    points = _table(kinds[b"v "], np.float64)
    facets = None if b"\\" in data else _table(kinds[b"f "], np.int64)
    if points is None or facets is None or points.shape[1] < 4 or (facets[:, 1:] <= 0).any():
        return None
    return points[:, 1:4], facets[:, 1:].ravel() - 1, np.full(len(facets), facets.shape[1] - 1)


def _table(lines: list[bytes], kind: Any) -> NDArray[Any] | None:
    """Return rows of one width behind a letter, where lines hold them; a number ends at a slash."""
    if not lines:
        return None
    width = len(lines[0].split())
    text = b"\n".join(lines)
    if kind is np.int64 and b"/" in text:
        text = _SLASH.sub(b"", text)
    words = text.split()
    if len(words) != width * len(lines) or width < 4 or max(map(len, words)) > _WIDTH or b"_" in text or b"#" in text:
        return None
    table = np.array(words).reshape(-1, width)
    if (table[:, 0] != lines[0][:1]).any():
        return None
    try:
        table[:, 0] = b"0"
        return np.asarray(table.astype(kind))
    except (ValueError, OverflowError):
        return None


def _walk_obj(path: Path, data: bytes) -> tuple[Any, Any, Any]:
    """Read line by line."""
    vertices, corners, sizes = array("d"), array("q"), array("q")
    line, joined = 0, b""
    for line, raw in enumerate(data.splitlines(), 1):
        if raw.endswith(b"\\"):  # goes on in the next line
            joined += raw[:-1] + b" "
            continue
        words = (joined + raw).partition(b"#")[0].split()
        joined = b""
        if not words:
            continue
        if words[0] == b"v":
            vertices.extend(_point(path, line, words[1:4]))
        elif words[0] == b"f":
            count = len(vertices) // 3
            for word in words[1:]:
                number = _whole(path, line, word.partition(b"/")[0])
                if number == 0:
                    raise _damaged(path, line, "the first vertex of an OBJ file is 1, got 0")
                corners.append(number - 1 if number > 0 else count + number)
            sizes.append(len(words) - 1)
        elif not words[0][:1].isalpha():
            raise _damaged(path, line, f"expected v, f or another keyword, got {_shown(words[0])}")
    if joined:
        raise _damaged(path, line, "the last line says that another one follows")
    return np.array(vertices).reshape(-1, 3), corners, sizes


def read_off(path: Path, size: int, lenient: bool) -> Found:
    """Read an OFF file of text, with colours, normals and comments, which are skipped; see `read_obj`.

    Raises
    ------
    ModelError
        Also when it holds fewer vertices or facets than its header promises (a lenient reader takes the facets).
    """
    text = path.read_bytes().removeprefix(b"\xef\xbb\xbf")
    rows = ((number, raw.partition(b"#")[0].split()) for number, raw in enumerate(text.splitlines(), 1))
    lines = ((number, words) for number, words in rows if words)
    line, words = next(lines, (1, [b""]))
    if not _OFF.match(words[0]) or words[1:2] == [b"BINARY"]:
        raise _damaged(path, line, "binary OFF is not read", "save it as ASCII OFF, STL or PLY")
    if words[0][-4:-3] in (b"4", b"n"):
        raise _damaged(path, line, f"{_shown(words[0])} has vertices of another dimension", "save it with x, y and z")
    if len(words) == 1:
        line, words = next(lines, (line, []))
    else:
        words = words[1:]
    if len(words) < 2:
        raise _damaged(path, line, "expected the numbers of vertices and facets")
    promised = [_whole(path, line, word) for word in words[:2]]
    if min(promised) < 0 or 2 * sum(promised) > len(text):
        raise _damaged(path, line, f"{promised[0]} vertices and {promised[1]} facets do not fit in {size} bytes")
    vertices, corners, sizes = array("d"), array("q"), array("q")
    for _, (line, words) in zip(range(promised[0]), lines, strict=False):
        vertices.extend(_point(path, line, words[:3]))
    for _, (line, words) in zip(range(promised[1]), lines, strict=False):
        count = _whole(path, line, words[0])
        if not 0 <= count <= _MOST_CORNERS or count >= len(words):
            held = len(words) - 1
            if next(lines, None) is None:
                break  # the file is cut short
            raise _damaged(path, line, f"a facet of {count} corners, but {held} numbers follow in its line")
        try:
            corners.extend(map(int, words[1 : count + 1]))
        except (ValueError, OverflowError):
            raise _damaged(path, line, "the corners of a facet must be whole numbers") from None
        sizes.append(count)
    points, facets, notes = len(vertices) // 3, len(sizes), list[str]()
    if lenient and points == promised[0] and 0 < facets < promised[1]:
        notes.append(f"the file is cut short; {facets} of {promised[1]} facets are whole, and are sliced")
    elif [points, facets] != promised:
        remedy = ", or use --lenient to slice what is whole" if facets else ""
        raise ModelError(f"{path}: header promises {promised[0]} vertices and {promised[1]} facets but the file holds "
                         f"{points} and {facets}; export the model again{remedy}")  # fmt: skip
    return _result(np.array(vertices).reshape(-1, 3), corners, sizes, notes)


def _result(vertices: NDArray[np.float64], corners: Any, sizes: Any, notes: list[str]) -> Found:
    count = np.array(sizes, np.int64)
    faces = fans(np.array(corners, np.int64), count)
    if small := int((count < 3).sum()):
        notes.append(f"{small} of {counted(len(count), 'facet')} with fewer than 3 corners: left out")
    notes += polygon_notes(mend_fans(vertices, faces, count))
    return vertices, faces, notes


def _point(path: Path, line: int, words: list[bytes]) -> list[float]:
    try:
        if len(words) == 3:
            return [number_of(word) for word in words]
    except ValueError:
        pass
    raise _damaged(path, line, f"a vertex must be 3 numbers, got {_shown(b' '.join(words))}")


def _whole(path: Path, line: int, word: bytes) -> int:
    try:
        number = int(word) if len(word) < 20 and b"_" not in word else _MOST
    except ValueError:
        number = _MOST
    if not -_MOST < number < _MOST:
        raise _damaged(path, line, f"expected a whole number, got {_shown(word)}")
    return number


def _shown(word: bytes) -> str:
    return repr(word[:40].decode("latin-1"))


def _damaged(path: Path, line: int, what: str, remedy: str = "export the model again") -> ModelError:
    return ModelError(f"{path}:{line}: {what}; {remedy}")
