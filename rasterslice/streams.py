"""Long files in pieces: worked on side by side, given back in order, and found again by their line."""

from __future__ import annotations

import os
import re
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import BinaryIO, NamedTuple, TypeVar

Result = TypeVar("Result")

BLOCK = 1 << 20  # bytes that are read at a time
_TAIL = 1 << 16  # where the last cut of a block is looked for


class Block(NamedTuple):
    """A piece of a file, from byte `start`; `last` when nothing follows."""

    start: int
    text: bytes
    last: bool


def blocks(file: BinaryIO, after: re.Pattern[bytes] | None = None) -> Iterator[Block]:
    """Cut what is left of a file into blocks, of whole lines unless it is said where.

    Parameters
    ----------
    file : binary file
        From where it stands.
    after : pattern, optional
        Of what stands before a cut.
    """
    start, rest = file.tell(), b""
    while data := file.read(max(BLOCK, len(rest))):  # a file without cuts is not copied again and again
        text = rest + data
        if after:
            tail = max(len(text) - _TAIL, 0)
            end = max((found.end() for found in after.finditer(text, tail)), default=0)
        else:
            end = max(text.rfind(b"\n"), text.rfind(b"\r", 0, len(text) - 1)) + 1
        rest = text[end:]
        if end:
            yield Block(start, text[:end], False)
            start += end
    yield Block(start, rest, True)


def in_order(work: Callable[[Block], Result], source: Iterator[Block]) -> Generator[tuple[Block, Result], None, None]:
    """Work on blocks side by side and give the results in order; only a few blocks are held."""
    ahead = 2 * (os.cpu_count() or 1)
    waiting: deque[tuple[Block, Future[Result]]] = deque()
    pool = ThreadPoolExecutor(os.cpu_count() or 1)
    try:
        for block in source:
            waiting.append((block, pool.submit(work, block)))
            while waiting and (block.last or len(waiting) > ahead):
                oldest, future = waiting.popleft()
                yield oldest, future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def line_of(path: Path, place: int) -> int:
    """Return the number of the line that holds a byte of a file, from 1."""
    lines, last = 1, b""
    with path.open("rb") as file:
        while place > 0 and (data := file.read(min(place, BLOCK))):
            lines += data.count(b"\n") + data.count(b"\r") - data.count(b"\r\n") - (last + data[:1] == b"\r\n")
            place, last = place - len(data), data[-1:]
    return lines
