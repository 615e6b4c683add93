"""Prepares the process for PoCL, the OpenCL of the CPU that comes as a wheel.

PoCL compiles a kernel in this process, with the LLVM that it brings, and links it by calling the program ``ld``.
Four things of the machine can stand in its way, and it answers none of them with an error one could act on:

=========================================  ==================================  ======================
what is missing                            what PoCL 3.0 does                  what mends it
=========================================  ==================================  ======================
a folder for compiled kernels              reports no device                   `prepare_environment`
the program ``ld`` on PATH                 kills the process                   `ensure_linker`
libgcc and libc to link (no compiler)      kills the process                   `ensure_linker`
a processor that LLVM 14 knows (Zen 5)     builds nothing: "unknown target     `processor.ensure_cpu`
                                           CPU 'generic'"
=========================================  ==================================  ======================

Call `prepare_environment` before pyopencl is imported, and `prepare_pocl` before anything is built for a device
of the platform `POCL`; other platforms need neither a linker nor a name of the processor.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import shlex
import shutil
import stat
import sys
import threading
import zlib
from pathlib import Path

from .errors import DeviceError
from .processor import ensure_cpu

#: Name of PoCL's platform.
POCL = "Portable Computing Language"
#: Where a linker lies when PATH does not say so.
USUAL_PLACES = ("/usr/bin", "/bin", "/usr/local/bin")

_FOLDER = "rasterslice-ld-"
_CACHES = ("pocl/kcache", "pyopencl", "pytools")  # who keeps what below XDG_CACHE_HOME
_LIBRARIES = ("gcc", "gcc_s", "c", "m")
_EMPTY_ARCHIVE = b"!<arch>\n"


def load_pocl() -> None:
    """Load PoCL, while other threads go on: OpenCL's loader takes 0.01 s for it and holds up all of Python.

    What cannot be loaded is passed over: it is said when it is needed.
    """
    try:
        dlopen = ctypes.CDLL(None).dlopen  # called as any function, without Python's lock; CDLL of a path holds it
    except (AttributeError, OSError, TypeError):  # a system without it, which has no such wheel
        return
    dlopen.restype, dlopen.argtypes = ctypes.c_void_p, (ctypes.c_char_p, ctypes.c_int)
    for folder in sys.path:
        for library in sorted(Path(folder, "pyopencl", ".libs").glob("libpocl*.so*")):  # where its wheel puts it
            dlopen(os.fsencode(library), os.RTLD_NOW)


def prepare_environment() -> None:
    """Make the caches usable; must be called before pyopencl is imported.

    Raises
    ------
    DeviceError
        When no folder of this machine can be written.
    """
    ensure_cache()


def prepare_pocl(version: str, handle: int) -> None:
    """Make a device of PoCL able to build kernels: `ensure_linker`, then `ensure_cpu`."""
    ensure_linker()
    ensure_cpu(version, handle)


def ensure_cache() -> Path:
    """Point PoCL and pyopencl at a cache that can be written.

    ``XDG_CACHE_HOME`` and ``POCL_CACHE_DIR`` are left as they are where they work; otherwise this process gets a
    folder of its user's own below the temporary one, which later runs find again.

    Returns
    -------
    Path
        The folder that holds the caches.

    Raises
    ------
    DeviceError
        When no folder of this machine can be written.
    """
    given = os.environ.get("XDG_CACHE_HOME")
    root = Path(given or "~/.cache").expanduser()
    if not (root.is_absolute() and all(_writable(root / name) for name in _CACHES)):
        root = _private_folder()
        os.environ["XDG_CACHE_HOME"] = str(root)
    elif not os.environ.get("HOME"):
        os.environ["XDG_CACHE_HOME"] = str(root)  # else PoCL would take a folder that all users share
    pocl = os.environ.get("POCL_CACHE_DIR")
    if pocl and not _writable(Path(pocl)):
        del os.environ["POCL_CACHE_DIR"]
    return root


def pocl_cache() -> Path:
    """Return the folder in which PoCL keeps what it compiles, when `prepare_environment` has been called."""
    given = os.environ.get("POCL_CACHE_DIR")
    root = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return Path(given) if given else root / "pocl" / "kcache"


def ensure_linker() -> Path:
    """Put an ``ld`` that works at the head of PATH.

    It is a two-line script that calls the linker of this machine, or that of the package ``ziglang``, and adds empty
    stand-ins for the libraries of a C compiler as the last place to look: PoCL asks for them, kernels need nothing
    from them, and a machine without a compiler has none.

    Returns
    -------
    Path
        The program that will link.

    Raises
    ------
    DeviceError
        When there is no linker.
    """
    linker = _find_linker()
    if linker is not None:
        command = [str(linker)]
    elif importlib.util.find_spec("ziglang") is not None:
        command = [sys.executable, "-P", "-m", "ziglang", "ld.lld"]
    else:
        raise DeviceError(
            "no linker \"ld\" on PATH; PoCL needs one to build kernels: pip install 'rasterslice[linker]' "
            "or install binutils"
        )
    script = _script(command)
    if script is not None:
        _put_first(script.parent)
        return script
    if linker is None:
        raise DeviceError(
            f"the linker of the package ziglang does not run ({shlex.join(command)} --version); install binutils"
        )
    _put_first(linker.parent)
    return linker


def _writable(folder: Path) -> bool:
    """Tell whether files can be made in a folder, which is made if it is missing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        trial = folder / f".trial-{os.urandom(8).hex()}"
        os.close(os.open(trial, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
        trial.unlink()
        return True
    except OSError:
        return False


def _private_folder() -> Path:
    """Return a folder that only this user can write: compiled programs are run from it."""
    import tempfile  # here and below: what it imports is rarely needed, and has to be waited for

    try:
        user = os.getuid() if hasattr(os, "getuid") else 0
        folder = Path(tempfile.gettempdir()) / f"rasterslice-cache-{user}"
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            found = folder.lstat()
            private = stat.S_ISDIR(found.st_mode) and found.st_uid == user and not found.st_mode & 0o022
            if private and all(_writable(folder / name) for name in _CACHES):
                return folder
        except OSError:
            pass  # the name is taken by another's file; any other name will do
        return Path(tempfile.mkdtemp(prefix="rasterslice-cache-"))
    except OSError as error:
        raise DeviceError(
            f"no folder for compiled kernels can be written ({error.strerror or error}); "
            "set XDG_CACHE_HOME or TMPDIR to one that can"
        ) from error


def _find_linker() -> Path | None:
    """Return ``ld`` of PATH or of the usual places, but never a script of ours."""
    on_path = [p for p in os.environ.get("PATH", "").split(os.pathsep) if p and not Path(p).name.startswith(_FOLDER)]
    for folder in (*on_path, *USUAL_PLACES):
        found = shutil.which("ld", path=folder)
        if found:
            return Path(found).absolute()
    return None


def _script(command: list[str]) -> Path | None:
    """Return the script ``ld`` that runs a linker, written and tried where it is new; None where it cannot be run."""
    name = f"{_FOLDER}{zlib.crc32(repr(command).encode()):08x}"
    folder = ensure_cache() / "rasterslice" / name
    script = folder / "ld"
    text = f'#!/bin/sh\nexec {shlex.join(command)} "$@" -L{shlex.quote(str(folder))}\n'.encode()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for library in (folder / f"lib{name}.a" for name in _LIBRARIES):
            if not library.is_file():  # somebody may tidy up what is not read
                write_whole(library, _EMPTY_ARCHIVE, 0o600)
        if script.is_file() and script.read_bytes() == text and os.access(script, os.X_OK):
            return script  # has its name because it ran
        trial = folder / f"ld-{os.getpid()}-{threading.get_ident()}"
        try:
            write_whole(trial, text, 0o700)
            if not _runs(trial):
                return None
            os.replace(trial, script)
        finally:
            trial.unlink(missing_ok=True)
    except OSError:
        return None  # no /bin/sh, or a folder from which nothing may be run
    return script


def _runs(linker: Path) -> bool:
    import subprocess

    try:
        return not subprocess.run([linker, "--version"], capture_output=True, check=False, timeout=60).returncode
    except subprocess.SubprocessError:
        return False


def write_whole(path: Path, data: bytes, mode: int) -> None:
    """Write a file that is whole at every moment: other processes read it."""
    import tempfile

    descriptor, name = tempfile.mkstemp(dir=path.parent)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
        os.chmod(name, mode)
        os.replace(name, path)
    except OSError:
        Path(name).unlink(missing_ok=True)
        raise


def _put_first(folder: Path) -> None:
    """Put a folder at the head of PATH, once."""
    rest = [p for p in os.environ.get("PATH", os.defpath).split(os.pathsep) if p and p != str(folder)]
    os.environ["PATH"] = os.pathsep.join([str(folder), *rest])
