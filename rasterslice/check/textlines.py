"""Lines of text, one at a time, none longer than a line of its format can be."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

from .form import damaged

MOST = 1000  # characters of a line


def text_lines(data: bytes, path: Path, most: int = MOST, line: int = 0) -> Iterator[tuple[int, str]]:
    """Yield number, after that of the line before, and text of each line; the line may end as on any system.

    Raises
    ------
    ModelError
        ``file:line: message``: a line is longer than any row of numbers is. No more of it is looked at.
    """
    with io.TextIOWrapper(io.BytesIO(data), "utf-8-sig", "replace") as text:
        while raw := text.readline(most + 2):
            line += 1
            if len(raw) > most + 1:
                raise damaged(path, line, f"a line of more than {most} characters; a row of numbers is shorter")
            yield line, raw.rstrip("\n")
