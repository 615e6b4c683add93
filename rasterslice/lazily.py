"""Modules that the command line loads when something of them is asked for, not when they are imported.

A whole job takes half a second, and more than a tenth of its start went into modules that NumPy and Python's own
library import, and of which a job asks nothing, or little and late: what ``help()`` shows, logs, archives, addresses of
the internet, types that only type checkers read. Whoever imports these types gets stand-ins, and some modules that ask
something as they are imported get answers.

`importlib.util.LazyLoader` does this, but until Python 3.12.3 two threads that ask at once find half a module. As in
later ones, each module has a lock of its own: loading it may import others, and who imports those may ask for it. A
package that imports its own submodules may not be lazy: who imports one of them first would find half of it.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

#: What is imported by `argparse`, `pathlib`, futures, and NumPy, or by one of these.
_RARELY_ASKED = frozenset(
    {
        "ast", "bz2", "inspect", "ipaddress", "logging", "lzma", "pickle", "platform", "shutil", "textwrap",
        "traceback", "urllib.parse",
        "numpy._core._add_newdocs", "numpy._core._add_newdocs_scalars", "numpy._typing", "numpy.typing",
    }
)  # fmt: skip


class _AnyArray:
    """Stands for `numpy.typing.NDArray`."""

    def __class_getitem__(cls, _: object) -> Any:
        return Any


_TYPES = {"NDArray": _AnyArray, "ArrayLike": Any, "DTypeLike": Any}
#: What modules answer before they are loaded.
_STAND_INS: dict[str, dict[str, Any]] = {"numpy._typing": _TYPES, "numpy.typing": _TYPES}


class _Logger:
    """Stands for a logger, until it is to say something."""

    def __init__(self, name: str) -> None:
        self._name = name

    def addHandler(self, _: object) -> None:  # as `logging` calls it
        """Do nothing: what no logger handles, `logging` prints."""

    def __getattr__(self, name: str) -> Any:
        return getattr(sys.modules["logging"].getLogger(self._name), name)


def _quote_from_bytes(*args: Any) -> str:
    return str(sys.modules["urllib.parse"].quote_from_bytes(*args))


#: What modules answer some who ask, before they are loaded: NumPy, for ``help()``; futures and paths, for what they
#: hardly do.
_ANSWERS: dict[tuple[str, str], dict[str, Any]] = {
    ("inspect", "numpy._core.overrides"): {"cleandoc": str, "signature": lambda _: None},
    ("logging", "concurrent.futures._base"): {"getLogger": _Logger, "StreamHandler": object},
    ("urllib.parse", "pathlib"): {"quote_from_bytes": _quote_from_bytes},
}


class _Lazy(ModuleType):
    """A module that is loaded when it is asked for anything, or anything of it is set."""

    def __setattr__(self, name: str, value: object) -> None:
        if not name.startswith("__"):  # those are set by whoever imports it
            _load(self)
        ModuleType.__setattr__(self, name, value)

    def __getattribute__(self, name: str) -> Any:
        held = object.__getattribute__(self, "__dict__")
        if name in ("__spec__", "__path__"):  # for whoever imports it again
            return ModuleType.__getattribute__(self, name)
        if "_loader" in held:
            own = held["__name__"]
            answers = _STAND_INS.get(own) or _ANSWERS.get((own, sys._getframe(1).f_globals.get("__name__", "")), {})
            if name in answers:
                return answers[name]
        _load(self)
        return ModuleType.__getattribute__(self, name)


def _load(module: _Lazy) -> None:
    """Load a module, unless it is, or is only being made; what is loading may ask itself."""
    held = object.__getattribute__(module, "__dict__")
    lock = held.get("_loader_lock")
    if lock is None:
        return
    with lock:
        loader = held.pop("_loader", None)
        if loader is None:
            return
        try:
            loader.exec_module(module)
            object.__setattr__(module, "__class__", ModuleType)
            del held["_loader_lock"]
        except BaseException:
            held["_loader"] = loader
            raise


class _Loader:
    """Makes a module that is loaded later, by another loader."""

    def __init__(self, loader: Any) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return _Lazy(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        if type(module) is not _Lazy:  # to be loaded once more
            self._loader.exec_module(module)
            return
        spec = object.__getattribute__(module, "__spec__")
        spec.loader = self._loader
        object.__getattribute__(module, "__dict__").update(
            __loader__=self._loader, _loader=self._loader, _loader_lock=threading.RLock()
        )  # fmt: skip


class _Finder:
    """Finds the modules above, to be loaded lazily."""

    @staticmethod
    def find_spec(
        fullname: str, path: Sequence[str] | None, target: ModuleType | None = None, /
    ) -> ModuleSpec | None:  # fmt: skip
        if fullname not in _RARELY_ASKED:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and hasattr(spec.loader, "exec_module"):
            spec.loader = _Loader(spec.loader)  # type: ignore[assignment]
        return spec


def begin() -> None:
    """Load them lazily from now on."""
    sys.meta_path.insert(0, _Finder)
