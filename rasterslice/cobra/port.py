"""A serial line: the only place that opens one. Anything that pyserial takes as a URL will do."""

from __future__ import annotations

import errno
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from ..errors import UsageError


class Line(Protocol):
    """What the protocols need of a line."""

    def read(self, seconds: float) -> bytes:
        """Return what has come, waiting for at most so long; empty when nothing came."""

    def write(self, data: bytes) -> None:
        """Send bytes."""


class Closed(UsageError):
    """The line is gone."""


class Port:
    """A serial port that waits with a deadline and says in one line what is wrong with it."""

    def __init__(self, device: Any, name: str) -> None:
        self._device, self._name = device, name

    def read(self, seconds: float) -> bytes:
        """Return what has come, waiting for at most so long; empty when nothing came."""
        try:
            self._device.timeout = max(seconds, 0.0)
            data = self._device.read(1)
            if data and (more := self._device.in_waiting):
                data += self._device.read(more)
            return bytes(data)
        except (OSError, TypeError) as error:
            raise self._closed(error) from None

    def write(self, data: bytes) -> None:
        """Send bytes."""
        import serial

        try:
            self._device.write(data)
            self._device.flush()
        except serial.SerialTimeoutException:
            raise UsageError(
                f"{self._name}: the other side takes nothing; check the cable, and the flow control (--xonxoff)"
            ) from None
        except OSError as error:
            raise self._closed(error) from None

    def _closed(self, error: Exception) -> Closed:
        return Closed(f"{self._name}: the line was closed ({error}); plug it in again, then go on with send --resume")


@contextmanager
def open_port(name: str, baud: int, timeout: float, xonxoff: bool = False) -> Iterator[Port]:
    """Open a port by name or URL, 8N1. Modem lines are left alone, and nothing is sent.

    Raises
    ------
    UsageError
        When it is missing, busy, forbidden, or no port at all.
    """
    import serial

    if not name.strip():
        raise UsageError("--port is empty; name a device, or any pyserial URL: /dev/ttyUSB0, COM3, socket://host:port")
    if not 50 <= baud <= 4_000_000:
        raise UsageError(f"--baud must be 50 to 4000000, got {baud}")
    if not 0 < timeout <= 3600:
        raise UsageError(f"--timeout must be > 0 and at most 3600 s, got {timeout:g}")
    try:
        device = serial.serial_for_url(
            name, baud, timeout=timeout, write_timeout=max(4 * timeout, 5.0), xonxoff=xonxoff, exclusive=True
        )
    except (OSError, ValueError) as error:
        raise UsageError(f"{name}: {_reason(error)}") from None
    try:
        device.reset_input_buffer()
        yield Port(device, name)
    except OSError as error:
        raise Closed(f"{name}: the line was closed ({error}); plug it in again") from None
    finally:
        device.close()


class Deadline:
    """How long is left of a time."""

    def __init__(self, seconds: float) -> None:
        self._end = time.monotonic() + seconds

    @property
    def left(self) -> float:
        """Seconds, not below 0."""
        return max(self._end - time.monotonic(), 0.0)


def _reason(error: Exception) -> str:
    code = getattr(error, "errno", None)
    text = str(error)
    if code == errno.ENOENT or "No such file" in text:
        return "no such port; see which there are: python -m serial.tools.list_ports"
    if code in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in text or "busy" in text.lower():
        return "the port is busy; close the program that holds it"
    if code in (errno.EACCES, errno.EPERM) or "Permission" in text:
        return "no permission; join the group that owns serial ports, often dialout"
    if text.startswith("invalid URL") or "NoneType" in text or "expected a string in the form" in text:
        return "cannot be opened: not a URL that pyserial takes; write it like socket://host:port"
    return f"cannot be opened: {text}; check the name, the cable and the settings"
