"""Exactly the part of V+ that the player uses: read program text, make it callable.

Programs become Python functions that call a *host* for whatever touches the machine: motions, signals, files. A
keyword, function or form that is not listed here is an error: the player cannot drift into what nobody has checked.
"""

from __future__ import annotations

import math
import re
import traceback
from typing import Any, NoReturn

from ..errors import UsageError
from .reader import Reader, plain
from .words import WORDS

_SOURCE = "<V+>"


class Program:
    """Programs of some files, callable by name on one host.

    Parameters
    ----------
    files : dict of str
        Program text by file name.
    host
        Has ``moves``, ``move``, ``move_joints``, ``speed``, ``percent``, ``accel``, ``signal``, ``brk``, ``delay``,
        ``brake``, ``here``, ``joints``, ``tool``, ``reacte``, ``side``.
    desk
        Has ``wait``, ``pause``, ``task``, ``say``, ``attach``, ``detach``, ``open``, ``close``, ``read``, ``write``,
        ``iostat``; default the host.
    steps : int, optional
        Turns of all loops together, after which the program counts as one that never ends.

    Raises
    ------
    UsageError
        ``file:line: what is not known``.
    """

    def __init__(self, files: dict[str, str], host: Any, steps: int | None = None, desk: Any = None) -> None:
        self._space: dict[str, Any] = {
            "_host": host, "_desk": desk or host, "_asc": _asc, "_val": _val, "_trans": _trans, "_decode": _decode,
            "_dz": _dz, "_step": self._step if steps is not None else _free, "_Halt": Halt,
        }  # fmt: skip
        self._steps = self._left = steps or 0
        self.names: set[str] = set()
        source = []
        for name, content in files.items():
            source += Reader(name, content, self.names, WORDS).python()
        arrays = sorted(set(re.findall(r"\b(v_\w+)\[", "\n".join(source))))
        self._space.update({a: {} for a in arrays})
        exec(compile("\n".join(source), _SOURCE, "exec"), self._space)  # only what Reader spelled out

    def call(self, name: str) -> None:
        """Run a program to its end.

        Raises
        ------
        UsageError
            When it reads what was never set, does what cannot be done, or never ends.
        """
        if name not in self.names:
            raise UsageError(f"no program {name}; the files hold {', '.join(sorted(self.names))}")
        try:
            self._space["p_" + plain(name)]()
        except Halt:
            return
        except RecursionError:
            raise UsageError("V+: programs call one another without end") from None
        except (NameError, KeyError, TypeError, ArithmeticError) as error:
            if traceback.extract_tb(error.__traceback__)[-1].filename != _SOURCE:
                raise
            _explain(error)

    def value(self, name: str, index: int | None = None) -> Any:
        """Return a global variable, or an element of an array.

        Raises
        ------
        UsageError
            When it was never set.
        """
        try:
            value = self._space["v_" + plain(name)]
            return value if index is None else value[index]
        except KeyError:
            place = name if index is None else f"{name}[{index}]"
            raise UsageError(f"V+: {place} is never set; take RSCFG.V2 of the export") from None

    def _step(self, place: str) -> None:
        self._left -= 1
        if self._left < 0:
            raise UsageError(f"{place}: after {self._steps} turns of its loops the program has not ended")


class Stop(Exception):
    """Raised by a host to end a program that would run for ever."""


class Halt(Exception):
    """HALT: the end of the task, wherever it is."""


def _free(place: str) -> None:
    """Count nothing."""


def _explain(error: Exception) -> NoReturn:
    if isinstance(error, NameError):
        name = (error.name or "").removeprefix("v_").replace("__", ".")
        raise UsageError(f"V+: {name}: is read before it is set") from None
    if isinstance(error, KeyError):
        raise UsageError(f"V+: element {error} of an array is read before it is set") from None
    raise UsageError(f"V+: {error}") from None


def _asc(text: str, at: int = 1) -> int:
    return ord(text[at - 1]) if len(text) >= at else -1


def _val(text: str) -> float:
    """Return the number that a string begins with, else 0, as V+ does."""
    try:
        value = float(text)
        return value if math.isfinite(value) else 0.0
    except ValueError:
        found = re.match(r"\s*[-+]?(\d+\.?\d*|\.\d+)", text)
        return float(found[0]) if found else 0.0


def _trans(*values: float) -> tuple[float, ...]:
    return values


def _dz(location: tuple[float, ...]) -> float:
    return location[2]


def _decode(text: str, mark: str, mode: int, _: str) -> tuple[str, str]:
    """Return (taken, left): up to the mark, or the marks themselves."""
    if mode == 0:
        at = text.find(mark)
        return (text, "") if at < 0 else (text[:at], text[at:])
    left = text.lstrip(mark)
    return text[: len(text) - len(left)], left
