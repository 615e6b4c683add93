"""Stop-and-wait transport to the receiver ``rs.recv`` in the player: numbered lines with two sums, each acknowledged.

::

    to V+    <n>:<w>:<s>:<record> LF     s: n + sum of the bytes; w: n + sum of (place + 1) x byte
    from V+  A <n> <w>    taken, or taken before       N <last>    not sound, or not the next
             Q <last> <sum> <name>, -1: nothing open   X <status>  the file cannot be opened

Line 0 holds a command: ``O <name>`` opens, ``Q`` asks how far, ``Z`` closes. The answer repeats w, so that an answer
that was damaged is not believed. Two flipped bits in a line are always found. The sum is of all lines that were
taken, in their order: s <- (2 s + w) modulo 4194301, which numbers of V+ hold exactly; with it and the name of the
file a resumed transfer cannot join two exports.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..errors import UsageError
from .port import Deadline, Line

_LONGEST = 72
_MODULUS = 4_194_301  # a prime below 2^22
_ASKED = 3  # times that the receiver may give an answer that does not fit: the line may have damaged it


def sums(number: int, record: bytes) -> tuple[int, int]:
    """Return w and s of a line."""
    return number + sum(i * b for i, b in enumerate(record, 2)), number + sum(record)


def running_sums(records: list[bytes]) -> list[int]:
    """Return the sums of all lines up to each, as the receiver keeps them; the first, 0, is of none."""
    out = [0]
    for n, record in enumerate(records, 1):
        out.append((2 * out[-1] + sums(n, record)[0]) % _MODULUS)
    return out


def frame(number: int, record: bytes) -> bytes:
    """Return a line as it is sent."""
    w, s = sums(number, record)
    return b"%d:%d:%d:%s\n" % (number, w, s, record)


class _Talk:
    """Lines out, answers back."""

    def __init__(self, line: Line, timeout: float, tries: int) -> None:
        self._line, self._timeout, self._tries = line, timeout, tries
        self._buffer = bytearray()
        self.repeats = 0

    def ask(self, number: int, record: bytes, wanted: bytes) -> list[bytes]:
        """Send a line until its answer comes; return the words of it."""
        text, w = frame(number, record), b"%d" % sums(number, record)[0]
        heard = b""
        for n in range(self._tries):
            self.repeats += n > 0
            self._line.write(text)
            deadline = Deadline(self._timeout)
            while (answer := self._answer(deadline)) is not None:
                heard = answer or heard
                words = answer.split()
                if wanted == b"Q" and words[:1] == [b"Q"] and len(words) == 4 and _are_numbers(words[1:3]):
                    return words
                if words == [b"A", b"%d" % number, w]:
                    return words
                if words[:1] == [b"X"]:
                    status = words[-1].decode("ascii", "replace")
                    raise UsageError(
                        f"the controller cannot open the file, status {status}; make room on its disk, or delete the "
                        "old file there"
                    )
                if words[:1] == [b"N"]:
                    break  # once more
        if not heard:
            raise UsageError(
                f"line {number}: no answer after {self._tries} tries of {self._timeout:g} s; is rs.recv running there, "
                "and do baud rate and cable fit? Then go on with --resume"
            )
        raise UsageError(
            f"line {number}: not taken after {self._tries} tries, the last answer was "
            f"{heard[:40].decode('ascii', 'replace')!r}; begin anew, without --resume"
        )

    def _answer(self, deadline: Deadline) -> bytes | None:
        while (end := self._buffer.find(b"\n")) < 0:
            left = deadline.left
            data = self._line.read(left) if left else b""
            if not data and not deadline.left:
                return None
            self._buffer += data
            if len(self._buffer) > 4096:
                del self._buffer[:-256]
        answer = bytes(self._buffer[:end]).strip()
        del self._buffer[: end + 1]
        return answer


def send_file(
    line: Line, path: Path, timeout: float = 2.0, tries: int = 5, resume: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, int]:  # fmt: skip
    """Send a file of records.

    Parameters
    ----------
    line : Line
    path : Path
        ASCII, lines of at most 72 characters that end with CR LF.
    timeout : float
        s, for each answer.
    tries : int
        Of each line.
    resume : bool
        Ask the receiver how far it came and go on from there.
    progress : callable, optional
        Called with (lines done, all lines).

    Returns
    -------
    dict
        ``records``, ``first`` and ``repeats``.

    Raises
    ------
    UsageError
        When the receiver is silent, refuses, or holds another file; or the line closes.
    """
    if tries < 1:
        raise UsageError(f"--tries must be >= 1, got {tries}")
    lines = _records(path)
    talk = _Talk(line, timeout, tries)
    first = _how_far(talk, path, lines) if resume else 1
    if first == 1:
        talk.ask(0, b"O " + path.name.encode("ascii"), b"A")
    for n, record in enumerate(lines[first - 1 :], first):
        talk.ask(n, record, b"A")
        if progress is not None:
            progress(n, len(lines))
    talk.ask(0, b"Z", b"A")
    return {"records": len(lines), "first": first, "repeats": talk.repeats}


def _how_far(talk: _Talk, path: Path, lines: list[bytes]) -> int:
    """Return the line to go on with."""
    known = running_sums(lines)
    for _ in range(_ASKED):
        words = talk.ask(0, b"Q", b"Q")
        last, total, name = int(words[1]), int(words[2]), words[3].decode("ascii", "replace")
        if last < 0:
            return 1
        if name == path.name and last <= len(lines) and total == known[last]:
            return last + 1
    held = f"{last} lines of another {name}" if name == path.name else f"another file, {name}, {last} lines"
    raise UsageError(f"{path.name}: the receiver holds {held}; begin anew, without --resume")


def _records(path: Path) -> list[bytes]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    lines = data.split(b"\r\n")
    if lines.pop() or not lines:
        raise UsageError(f"{path}: does not end with CR LF; export again")
    for n, record in enumerate(lines, 1):
        if len(record) > _LONGEST or not record.isascii() or record[:1] == b":" or b"\n" in record:
            raise UsageError(f"{path}:{n}: not a record for the line: ASCII, at most {_LONGEST} characters")
    return lines


def _are_numbers(words: list[bytes]) -> bool:
    return all(word.removeprefix(b"-").isdigit() for word in words)
