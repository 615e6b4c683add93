"""The door to OpenCL: the compiled module of pyopencl, for the command line without the Python around it.

pyopencl is a compiled module, ``pyopencl._cl``, and Python that makes it pleasant. That Python takes 0.035 s to import,
most of it for what it imports itself, and 0.012 s to write and compile a function for each of our kernels; a whole job
takes 0.6 s. So the compiled module is called as pyopencl's own Python calls it, and the command line loads it by itself
(`alone`). In a process of somebody else pyopencl is imported as it should be: another thread may import it, too.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.machinery import PathFinder
from types import ModuleType
from typing import Any

from .errors import DeviceError

#: Whether nobody but this module imports pyopencl in this process.
alone = False

_NAME = "pyopencl._cl"
#: What is called of the module, and not part of pyopencl's documented interface.
_INNER = ("_Program", "_enqueue_read_buffer", "_enqueue_write_buffer", "_enqueue_fill_buffer")
_INNER_KERNEL = ("_set_arg_multi", "_set_arg_buf_multi", "_set_arg_buf_pack_multi")
_LOCK = threading.RLock()


def load() -> Any:
    """Return pyopencl's compiled module; `toolchain.prepare_environment` comes first.

    Raises
    ------
    DeviceError
        When it is not the module that this program knows.
    """
    with _LOCK:
        module = (sys.modules.get(_NAME) or _load_alone()) if alone else None
    module = module or getattr(whole(), "_cl", None)
    lacking = [name for name in _INNER if not hasattr(module, name)]
    lacking += [name for name in _INNER_KERNEL if not hasattr(getattr(module, "Kernel", None), name)]
    if lacking:
        version = getattr(whole(), "VERSION_TEXT", "of no version")
        raise DeviceError(
            f"pyopencl {version} has no {', '.join(lacking)}, which rasterslice calls; "
            "install one that it was tested with: pip install 'pyopencl<2027'"
        )
    return module


def _load_alone() -> Any:
    """Load the compiled module by itself; return None where it is not where wheels have it."""
    import numpy  # noqa: F401  # whole: the module asks for a part of it, which another thread may be about to import

    package = importlib.util.find_spec("pyopencl")
    places = (package and package.submodule_search_locations) or []
    spec = PathFinder.find_spec(_NAME, places)
    if spec is None or spec.loader is None:
        return None
    os.environ["PYOPENCL_HOME"] = places[0]  # as pyopencl does: OpenCL's loader in its wheel looks for drivers there
    module = importlib.util.module_from_spec(spec)
    sys.modules[_NAME] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[_NAME]
        raise
    return module


def kernels_of(program: Any) -> dict[str, Any]:
    """Return all kernels of a program by their names.

    pyopencl makes two Python functions for each kernel, and imports all of itself for that. They are never called
    here, so a stand-in makes nothing; where that does not do, or all is imported already, pyopencl makes them.
    """
    with _LOCK:
        if alone and "pyopencl" not in sys.modules:
            with suppress(Exception), _stand_in():
                return _kernels_of(program)
        whole()
        return _kernels_of(program)


def _kernels_of(program: Any) -> dict[str, Any]:
    name = load().kernel_info.FUNCTION_NAME
    return {kernel.get_info(name): kernel for kernel in program.all_kernels()}


@contextmanager
def _stand_in() -> Iterator[None]:
    """Let the compiled module find what it calls for each kernel."""
    invoker = ModuleType("pyopencl.invoker")
    invoker.generate_enqueue_and_set_args = lambda *_, **__: (None, None)  # type: ignore[attr-defined]
    modules = {"pyopencl": ModuleType("pyopencl"), "pyopencl.invoker": invoker}
    context = sys.modules[_NAME].Context
    lent = not hasattr(context, "devices")  # which pyopencl adds to it
    sys.modules.update(modules)
    if lent:
        context.devices = ()
    try:
        yield
    finally:
        if lent:
            del context.devices
        for each in modules:
            del sys.modules[each]


def whole() -> Any:
    """Import pyopencl with its Python, and return it."""
    with _LOCK:
        import pyopencl
    return pyopencl


def said(error: Exception) -> str:
    """Return what an error of OpenCL says, on one line."""
    whole()  # teaches the errors to say it
    return " ".join(str(error).split())
