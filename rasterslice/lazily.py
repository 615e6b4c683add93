"""Modules that the command line loads when something of them is asked for, not when they are imported.

A whole job takes half a second, and a tenth of its start went into modules that NumPy and Python's own library import,
and of which a job asks nothing: what ``help()`` shows, archives, addresses of the internet.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType

#: What is imported, once, by `shutil`, by `urllib.parse` (for `pathlib`), and by NumPy.
_RARELY_ASKED = frozenset(
    {"bz2", "lzma", "ipaddress", "platform", "numpy._core._add_newdocs", "numpy._core._add_newdocs_scalars"}
)


class _Finder:
    """Finds the modules above, to be loaded lazily."""

    @staticmethod
    def find_spec(
        fullname: str, path: Sequence[str] | None, target: ModuleType | None = None, /
    ) -> ModuleSpec | None:  # fmt: skip
        if fullname not in _RARELY_ASKED:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and spec.loader is not None and hasattr(spec.loader, "exec_module"):
            spec.loader = LazyLoader(spec.loader)
        return spec


def begin() -> None:
    """Load them lazily from now on."""
    sys.meta_path.insert(0, _Finder)
