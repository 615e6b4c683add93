"""Exactly the part of V+ that the player uses: read program text, make it callable.

Programs become Python functions that call a *host* for whatever touches the machine: motions, signals, files. A
keyword, function or form that is not listed here is an error: the player cannot drift into what nobody has checked.
"""

from __future__ import annotations

import math
import re
from typing import Any

from ..errors import UsageError
from .reader import Reader, plain
from .words import WORDS


class Program:
    """Programs of some files, callable by name on one host.

    Parameters
    ----------
    files : dict of str
        Program text by file name.
    host
        Has ``moves(x, y, z, roll)``, ``speed``, ``signal``, ``brk``, ``delay``, ``tool``, ``wait``, ``say``, ``accel``,
        ``attach``, ``detach``, ``open``, ``close``, ``read``, ``write``, ``iostat``.

    Raises
    ------
    UsageError
        ``file:line: what is not known``.
    """

    def __init__(self, files: dict[str, str], host: Any) -> None:
        self._space: dict[str, Any] = {
            "_host": host, "_asc": _asc, "_val": _val, "_trans": _trans, "_decode": _decode, "_Stop": Stop,
        }  # fmt: skip
        self.names: set[str] = set()
        source = []
        for name, content in files.items():
            source += Reader(name, content, self.names, WORDS).python()
        arrays = sorted(set(re.findall(r"\b(v_\w+)\[", "\n".join(source))))
        self._space.update({a: {} for a in arrays})
        exec(compile("\n".join(source), "<V+>", "exec"), self._space)  # only what Reader spelled out

    def call(self, name: str) -> None:
        """Run a program to its end."""
        if name not in self.names:
            raise UsageError(f"no program {name}; the files hold {', '.join(sorted(self.names))}")
        try:
            self._space["p_" + plain(name)]()
        except NameError as error:
            raise UsageError(f"V+: {error}: a variable is read before it is set") from None
        except KeyError as error:
            raise UsageError(f"V+: element {error} of an array is read before it is set") from None

    def value(self, name: str) -> Any:
        """Return a global variable or array."""
        return self._space["v_" + plain(name)]


class Stop(Exception):
    """Raised by a host to end a program that would run for ever."""


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


def _decode(text: str, mark: str, mode: int, _: str) -> tuple[str, str]:
    """Return (taken, left): up to the mark, or the marks themselves."""
    if mode == 0:
        at = text.find(mark)
        return (text, "") if at < 0 else (text[:at], text[at:])
    left = text.lstrip(mark)
    return text[: len(text) - len(left)], left
