"""A Kermit server with classic packets, which gives files and takes none.

Based on: the published Kermit protocol; packets I, R, S, F, D, Z, B, G (finish, logout), N, Y, E; at most 94
characters, control quoting, block check 3 (CRC) where the client agrees, else 1. V+ talks to such a server only.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..errors import UsageError
from .port import Closed, Deadline, Line

SOH, CR, QUOTE = 1, 13, ord("#")
_TRIES = 20
_LONGEST = 94


def check1(body: bytes) -> bytes:
    """Return the block check of one character."""
    total = sum(body)
    return bytes([((total + ((total & 0xC0) >> 6)) & 0x3F) + 32])


def check3(body: bytes) -> bytes:
    """Return the block check of three characters: CRC-16/KERMIT."""
    crc = 0
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0x8408 if crc & 1 else crc >> 1
    return bytes([((crc >> 12) & 0x0F) + 32, ((crc >> 6) & 0x3F) + 32, (crc & 0x3F) + 32])


def packet(seq: int, kind: str, data: bytes = b"", check: int = 1) -> bytes:
    """Return a packet with mark and end."""
    body = bytes([len(data) + 2 + check + 32, seq % 64 + 32, ord(kind)]) + data
    return bytes([SOH]) + body + (check3(body) if check == 3 else check1(body)) + bytes([CR])


def quote(data: bytes) -> list[bytes]:
    """Return bytes as they are sent, one element for each."""
    out = []
    for byte in data:
        low = byte & 0x7F
        if low < 32 or low == 127:
            out.append(bytes([QUOTE, byte ^ 64]))
        else:
            out.append(bytes([QUOTE, byte]) if low == QUOTE else bytes([byte]))
    return out


def unquote(data: bytes) -> bytes:
    """Return bytes as they were before quoting."""
    out, i = bytearray(), 0
    while i < len(data):
        byte = data[i]
        if byte == QUOTE and i + 1 < len(data):
            i += 1
            byte = data[i]
            if 63 <= byte & 0x7F <= 95:
                byte ^= 64
        out.append(byte)
        i += 1
    return bytes(out)


class Packets:
    """Packets on a line: whatever is damaged is skipped."""

    def __init__(self, line: Line) -> None:
        self.line, self.check = line, 1
        self._buffer = bytearray()

    def send(self, seq: int, kind: str, data: bytes = b"", check: int | None = None) -> None:
        """Send a packet."""
        self.line.write(packet(seq, kind, data, self.check if check is None else check))

    def receive(self, seconds: float) -> tuple[int, str, bytes] | None:
        """Return (sequence, type, data) of the next sound packet, or None when the time is over."""
        deadline = Deadline(seconds)
        while True:
            found = self._take()
            if found is not None:
                return found
            left = deadline.left
            data = self.line.read(left) if left else b""
            if not data and not deadline.left:
                return None
            self._buffer += data

    def _take(self) -> tuple[int, str, bytes] | None:
        while True:
            start = self._buffer.find(SOH)
            if start < 0:
                self._buffer.clear()
                return None
            del self._buffer[:start]
            if len(self._buffer) < 2:
                return None
            size = self._buffer[1] - 32
            if not 3 <= size <= _LONGEST:
                del self._buffer[:1]
                continue
            if len(self._buffer) < size + 2:
                if self._buffer.find(SOH, 1) >= 0:  # a new packet began: this one lost bytes
                    del self._buffer[:1]
                    continue
                return None
            body = bytes(self._buffer[1 : size + 2])
            for n, check in ((self.check, check3 if self.check == 3 else check1), (1, check1)):
                if size >= 2 + n and body[-n:] == check(body[:-n]) and 0 <= body[1] - 32 < 64:
                    del self._buffer[: size + 2]
                    return body[1] - 32, chr(body[2]), body[3:-n]
                if body[2:3] not in (b"N", b"E", b"I", b"S", b"R", b"G", b"Y"):
                    break  # only these may still come with the first check
            del self._buffer[:1]


def serve(
    line: Line, folder: Path, say: Callable[[str], None], once: bool, seconds: float = 5.0, patience: float = 0.0
) -> list[str]:
    """Give the files of a folder to a Kermit client until it says finish.

    Parameters
    ----------
    once : bool
        Also end, without an error, when the line closes.
    seconds : float
        Until a packet is sent again.
    patience : float
        How long nothing may come, s; 0: for ever.

    Returns
    -------
    list of str
        Names of the files that were taken whole.

    Raises
    ------
    UsageError
        When the line closes, or is silent for too long.
    """
    packets, served, quiet = Packets(line), list[str](), Deadline(patience)
    say(f"serving {', '.join(sorted(f.name for f in folder.iterdir()))}; waiting for the client")
    while True:
        packets.check = 1
        try:
            got = packets.receive(seconds)
            if got is None:
                if patience and not quiet.left:
                    raise UsageError(
                        f"the line is silent for {patience:g} s; do baud rate and cable fit, and does the client call? "
                        "--wait 0 waits for ever"
                    )
                continue
            quiet = Deadline(patience)
            if _answer(packets, got, folder, say, served, seconds):
                return served
        except Closed:
            if once:
                return served
            raise


def _answer(
    packets: Packets, got: tuple[int, str, bytes], folder: Path, say: Callable[[str], None], served: list[str],
    seconds: float,
) -> bool:  # fmt: skip
    """Answer one command; return whether it was the last."""
    seq, kind, data = got
    if kind == "I":
        packets.send(seq, "Y", _parameters(), 1)
    elif kind == "R":
        name = unquote(data).decode("latin-1").strip()
        file = _find(folder, name)
        if file is None:
            say(f"{name}: asked for, not there")
            packets.send(seq, "E", b"no such file", 1)
        else:
            say(f"{file.name}: sending {file.stat().st_size} bytes")
            if _give(packets, file, seconds, say):
                served.append(file.name)
                say(f"{file.name}: sent")
    elif kind == "G" and data[:1] in (b"F", b"L"):
        packets.send(seq, "Y", b"", 1)
        return True
    elif kind in "SGCKX":
        packets.send(seq, "E", b"this server only gives files", 1)
    elif kind == "N" or kind == "Y" or kind == "E":
        pass  # the tail of something that is over
    else:
        packets.send(seq, "E", b"not known", 1)
    return False


def _parameters(longest: int = _LONGEST) -> bytes:
    """Return: length, time-out 10 s, no padding, CR, '#', no 8-bit quoting, check 3, no repeat counts."""
    return bytes([longest + 32, 10 + 32, 32, 64, CR + 32, QUOTE, ord("N"), ord("3"), ord(" ")])


def _find(folder: Path, name: str) -> Path | None:
    """Return a file by its base name, whatever its case; nothing outside the folder."""
    base = name.replace("\\", "/").rpartition("/")[2].rpartition(">")[2].lower()
    return next((f for f in folder.iterdir() if f.is_file() and f.name.lower() == base), None)


def _give(packets: Packets, file: Path, seconds: float, say: Callable[[str], None]) -> bool:
    """Send one file; return whether the client took all of it."""
    answer = _exchange(packets, 0, "S", _parameters(), seconds)
    if answer is None:
        say(f"{file.name}: the client does not answer")
        return False
    limit = answer[0] - 32 if len(answer) > 0 else 80
    longest = min(max(limit, 20), _LONGEST)
    packets.check = 3 if len(answer) > 7 and answer[7:8] == b"3" else 1
    seq = 1
    content = iter(_pieces(file.read_bytes(), longest - 2 - packets.check))
    plan: list[tuple[str, bytes]] = [("F", b"".join(quote(file.name.encode("ascii"))))]
    plan += [("D", piece) for piece in content] + [("Z", b""), ("B", b"")]
    for n, (kind, data) in enumerate(plan):
        if n % 500 == 499:
            say(f"{file.name}: {n} of {len(plan)} packets")
        if _exchange(packets, seq % 64, kind, data, seconds) is None:
            say(f"{file.name}: broken off by the client, or silence")
            return False
        seq += 1
    return True


def _pieces(data: bytes, longest: int) -> list[bytes]:
    """Return the quoted bytes of a file, packed into packets."""
    out, piece = [], bytearray()
    for item in quote(data):
        if len(piece) + len(item) > longest:
            out.append(bytes(piece))
            piece.clear()
        piece += item
    return [*out, bytes(piece)] if piece else out


def _exchange(packets: Packets, seq: int, kind: str, data: bytes, seconds: float) -> bytes | None:
    """Send a packet until it is acknowledged; return the data of the answer, None when the client gives up."""
    check = 1 if kind == "S" else None
    for _ in range(_TRIES):
        packets.send(seq, kind, data, check)
        deadline = Deadline(seconds)
        while (got := packets.receive(deadline.left)) is not None:
            number, what, text = got
            if what == "Y" and number == seq:
                return text
            if what == "N" and number == (seq + 1) % 64:
                return b""
            if what == "E":
                return None
            if (what == "N" and number == seq) or (what == "R" and kind == "S"):
                break  # once more
    return None
