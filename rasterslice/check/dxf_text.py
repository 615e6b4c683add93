"""Text of DXF -> groups of code and value, and runs of vertices of the plainest kind as numbers."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

from .form import LIMIT_MM, damaged
from .textlines import text_lines

_NUMBER = rb" *([-+]?[0-9]{1,6}(?:\.[0-9]{0,12})?)\r?\n"
_FLAGS = rb"(?: *70\r?\n *(?:0|32)\r?\n)?"  # none that says anything here
#: A vertex of a layer, a place and perhaps flags: what most writers make of most of their vertices.
_VERTEX = (
    rb" *0\r?\n *VERTEX\r?\n *8\r?\n[^\s]{1,80}\r?\n" + _FLAGS
    + rb" *10\r?\n" + _NUMBER + rb" *20\r?\n" + _NUMBER + rb" *30\r?\n" + _NUMBER + _FLAGS
)  # fmt: skip
_RUN = re.compile(rb"(?<=\n)(?:" + re.sub(rb"\((?!\?)", rb"(?:", _VERTEX) + rb")+")
_EACH = re.compile(_VERTEX)

Vertices = tuple[list[float], list[float], list[float]]


def groups(
    data: bytes, path: Path, vertices: Callable[[Vertices, int], bool]
) -> Iterator[tuple[int, str, int]]:
    """Give code, value and line of each group, but of the vertices that are taken together.

    Parameters
    ----------
    data : bytes
    path : Path
        For errors.
    vertices : callable
        Is offered x, y and z of vertices that follow each other, as the file gives them, and the line of the first;
        says whether it took them. If not, they come as groups.
    """
    line, at, code = 0, 0, ""
    for run in [*_RUN.finditer(data), None]:
        start, end = run.span() if run else (len(data), len(data))
        for first, last, whole in ((at, start, False), (start, end, True)):
            if whole and not code and _offered(data, first, last, vertices, line + 1):
                line += data.count(b"\n", first, last)
                continue
            for _, text in text_lines(data[first:last], path, 4000, line):
                line += 1
                word = text.strip()
                if code:
                    yield int(code), word, line
                    code = ""
                elif not (word.isascii() and word.isdigit() and len(word) <= 4):
                    raise damaged(path, line, f"the code of a group must be a whole number, got {word[:30]!r}")
                else:
                    code = word
        at = end
    if code:
        raise damaged(path, line, "a group has a code and no value")


def _offered(
    data: bytes, first: int, last: int, vertices: Callable[[Vertices, int], bool], line: int
) -> bool:
    """Offer a run of vertices, if all of them lie within bounds; return whether they were taken."""
    found = _EACH.findall(data, first, last)
    x, y, z = ([float(v) for v in column] for column in zip(*found, strict=True)) if found else ([], [], [])
    within = all(min(v) >= -LIMIT_MM and max(v) <= LIMIT_MM for v in (x, y, z) if v)
    return bool(found) and within and vertices((x, y, z), line)
