"""What a program has besides the arm: the file of records, the operator's terminal, the other task."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import UsageError
from ..profile import Profile
from .ledger import Ledger, audit
from .watch import Result


class Desk:
    """Reads records and takes messages; the operator answers at once.

    Parameters
    ----------
    profile : Profile
    folder : Path
        Where the records lie.
    manifest : dict
        Of the export.
    result : Result
        Messages, holds and faults are added.

    Attributes
    ----------
    guarded : bool
        Whether task 1 runs.
    ledger : Ledger
        What the records say, once they are open.
    """

    def __init__(self, profile: Profile, folder: Path, manifest: dict[str, Any], result: Result) -> None:
        self.guarded, self.ledger = True, Ledger()
        self._profile, self._folder, self._manifest, self._result = profile, folder, manifest, result
        self._lines: Iterator[str] = iter(())
        self._status = 0

    @property
    def widths(self) -> tuple[float, float]:
        """Of the beads of part and scaffold, mm."""
        part, scaffold = self._manifest["widths"]
        return float(part), float(scaffold)

    def wait(self, value: float) -> float:
        """Stand for the operator."""
        self._result.holds += 1
        return -1.0

    def pause(self, seconds: float) -> None:
        """Wait a little."""

    def task(self, what: float, number: float) -> int:
        """Return the state of a task: ours runs, and the guard as `guarded` says."""
        return self._profile.program.running if number == 0 or self.guarded else 0

    def say(self, *items: Any) -> None:
        """Take a message to the operator."""
        text = "".join(str(i) for i in items)
        self._result.messages.append(text)
        if "hold" not in text:
            self._result.fault(f"the program says: {text}")

    def attach(self, device: str) -> int:
        """Give a unit."""
        return 5

    def detach(self, unit: int) -> None:
        """Take a unit back."""

    def open(self, unit: int, name: str, write: bool) -> None:
        """Open the records."""
        path = self._folder / name
        self._status = 0 if path.is_file() and not write else -1
        if not self._status:
            data = self.audit(name)
            self._lines = iter(data.decode("ascii", "replace").split("\r\n"))

    def audit(self, name: str | None = None) -> bytes:
        """Note what records say, by default those of the manifest; return them."""
        data = (self._folder / (name or str(self._manifest["records_file"]))).read_bytes()
        self.ledger = audit(data, self._manifest)
        return data

    def close(self, unit: int) -> None:
        """Close the records."""

    def read(self, unit: int) -> str:
        """Return the next record."""
        line = next(self._lines, None)
        self._status = 0 if line is not None else -504
        if line is not None and len(line) > self._profile.files.max_record:
            self._result.fault(f"a record of {len(line)} characters: {line[:30]}")
        return line or ""

    def write(self, unit: int, text: str) -> None:
        """Refuse: the player writes nothing."""
        raise UsageError("the player writes to a file")

    def iostat(self, unit: int) -> int:
        """Return the status of the last reading."""
        return self._status
