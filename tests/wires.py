"""Serial lines for tests: a pty with the program at one end, a simulated controller at the other, faults between."""

from __future__ import annotations

import contextlib
import os
import pty
import random
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rasterslice.cobra.vplus import Program, Stop


class Faults:
    """Damages what passes: flips bits, loses, doubles and delays bytes, and cuts the line.

    `at` gives what happens to a byte by its number since the beginning, both ways counted together.
    """

    def __init__(self, at: dict[int, str] | None = None, cut: int | None = None, seed: int = 0) -> None:
        self.at, self.cut, self.count = at or {}, cut, 0
        self._random = random.Random(seed)
        self._lock = threading.Lock()

    @classmethod
    def spread(cls, kind: str, n: int, over: int, seed: int = 1) -> Faults:
        places = random.Random(seed).sample(range(over), n)
        return cls(dict.fromkeys(places, kind), seed=seed)

    def through(self, data: bytes) -> bytes:
        out = bytearray()
        with self._lock:
            for byte in data:
                kind = self.at.get(self.count)
                self.count += 1
                if self.cut is not None and self.count > self.cut:
                    raise EOFError
                if kind == "flip":
                    byte ^= 1 << self._random.randrange(8)
                elif kind == "delay":
                    time.sleep(0.05)
                if kind != "lose":
                    out += bytes([byte]) * (2 if kind == "double" else 1)
        return bytes(out)


class Far:
    """The far end of a pty."""

    def __init__(self, fd: int, faults: Faults) -> None:
        self._fd, self._faults, self._buffer = fd, faults, bytearray()
        self.stop = threading.Event()

    def line(self) -> bytes:
        """Return bytes up to a line feed."""
        while (end := self._buffer.find(b"\n")) < 0:
            self.fill()
        text = bytes(self._buffer[:end])
        del self._buffer[: end + 1]
        return text

    def fill(self, seconds: float | None = None) -> bytes:
        end = None if seconds is None else time.monotonic() + seconds
        while end is None or time.monotonic() < end:
            if self.stop.is_set():
                raise Stop
            if select.select([self._fd], [], [], 0.02)[0]:
                try:
                    raw = os.read(self._fd, 4096)
                    data = self._faults.through(raw)
                except (OSError, EOFError):
                    raise Stop from None
                if not raw:  # the other end of a socket is closed
                    raise Stop
                self._buffer += data
                return data
        return b""

    def write(self, data: bytes) -> None:
        try:
            os.write(self._fd, self._faults.through(data))
        except (OSError, EOFError):
            raise Stop from None

    # As `port.Line`, for what runs our own protocol code at the far end.
    def read(self, seconds: float) -> bytes:
        data = self.fill(seconds) if not self._buffer else bytes(self._buffer)
        self._buffer.clear()
        return data


class Receiver:
    """The host of ``rs.recv``: a line and a disk."""

    def __init__(self, far: Far, disk: Path) -> None:
        self._far, self._disk, self._file, self._status = far, disk, None, 0

    def attach(self, device: str) -> int:
        return 5 if device.startswith("SERIAL") else 6

    def open(self, unit: int, name: str, write: bool) -> None:
        assert write
        self._status = 0
        try:
            self._file = (self._disk / name).open("wb")
        except OSError:
            self._status = -508

    def close(self, unit: int) -> None:
        self._file.close()

    def end(self) -> None:
        if self._file is not None:
            self._file.close()

    def read(self, unit: int) -> str:
        return self._far.line().decode("latin-1")

    def write(self, unit: int, text: str) -> None:
        data = text.encode("latin-1") + b"\r\n"  # V+ adds CR LF
        if unit == 5:
            self._far.write(data)
        else:
            self._file.write(data)

    def iostat(self, unit: int) -> int:
        return self._status if unit == 6 else 0


@contextlib.contextmanager
def controller(run: Callable[[Far], Any], faults: Faults | None = None) -> Iterator[str]:
    """Run something at the far end of a new pty; give the name of the near end."""
    master, slave = pty.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    far = Far(master, faults or Faults())

    def work() -> None:
        with contextlib.suppress(Stop):
            run(far)
        if faults is not None and faults.cut is not None:
            with contextlib.suppress(OSError):
                os.close(master)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        far.stop.set()
        thread.join(5)
        for fd in (master, slave):
            with contextlib.suppress(OSError):
                os.close(fd)
        assert not thread.is_alive()


def receive(bundle: Path, disk: Path) -> Callable[[Far], None]:
    """Return what runs ``rs.recv`` of a bundle's player, as it is written."""

    def run(far: Far) -> None:
        files = {n: (bundle / n).read_bytes().decode("ascii") for n in ("RSPLAY.V2", "RSCFG.V2")}
        host = Receiver(far, disk)
        try:
            Program(files, host).call("rs.recv")
        finally:
            host.end()

    return run
