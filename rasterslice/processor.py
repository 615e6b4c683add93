"""Tells PoCL the name of a processor that its LLVM is too old to know."""

from __future__ import annotations

import contextlib
import ctypes
import os
import struct
from collections.abc import Set
from functools import cache

from .errors import DeviceError

_CPUS = (  # flags that the system lists, processor that LLVM 14 knows; as PoCL chooses among its built-in libraries
    ({"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}, "skylake-avx512"),
    ({"avx2", "fma", "f16c", "abm", "bmi1", "bmi2"}, "haswell"),
    ({"avx", "f16c"}, "ivybridge"),
    ({"avx"}, "sandybridge"),
    ({"sse4_1"}, "penryn"),
    ({"ssse3"}, "core2"),
    (set[str](), "x86-64"),
)
_DEVICE_BYTES = 8192  # more than the record of a device takes in any PoCL

_named: dict[int, str] = {}  # devices that `ensure_cpu` has mended


def ensure_cpu(version: str, handle: int) -> str | None:
    """Name the processor to a PoCL whose LLVM is older than it.

    LLVM calls a processor that it does not know "generic", PoCL hands that name to its compiler, and the compiler
    refuses it. No setting of PoCL 3 and 4 changes the name, so it is replaced in the record of the device, by the
    name that fits the library of built-in functions that PoCL takes for the same processor. Nothing is touched unless
    the record holds, side by side, a target of x86-64 and that name.

    Parameters
    ----------
    version : str
        Version string of the device or of its platform, as OpenCL gives it.
    handle : int
        Its ``cl_device_id`` (``pyopencl.Device.int_ptr``).

    Returns
    -------
    str or None
        The name given; None where PoCL knows the processor.

    Raises
    ------
    DeviceError
        When the version says that PoCL does not know the processor and the record holds no such name.
    """
    if "pocl" not in version.lower():
        return None
    if handle not in _named:
        field = _find_field(handle, b"x86_64-", b"generic\0")
        if field is None:
            if "x86_64" not in version or not version.endswith("-generic"):
                return None
            raise DeviceError(
                f"{version}: PoCL does not know this processor and cannot build for it; install a newer PoCL "
                "or the OpenCL driver of the processor's maker"
            )
        name = _cpu_name(cpu_flags())
        duplicate = ctypes.CDLL(None).strdup  # PoCL may free it, so it comes from malloc
        duplicate.restype = ctypes.c_void_p
        ctypes.c_void_p.from_address(field).value = duplicate(name.encode())
        _named[handle] = name
    return _named[handle]


def _find_field(record: int, first: bytes, second: bytes) -> int | None:
    """Return the address of the pointer to `second` that follows a pointer to `first` in a record.

    Memory is read through the system, for which an address that is none is an error and not a crash.
    """
    try:
        memory = os.open("/proc/self/mem", os.O_RDONLY)
    except OSError:
        return None
    try:
        data = _peek(memory, record, _DEVICE_BYTES)
        words = struct.unpack(f"={len(data) // 8}Q", data[: len(data) // 8 * 8])
        for i in range(len(words) - 1):
            if _peek(memory, words[i], len(first)) == first and _peek(memory, words[i + 1], len(second)) == second:
                return record + 8 * (i + 1)
    finally:
        os.close(memory)
    return None


def _peek(memory: int, address: int, size: int) -> bytes:
    try:
        return os.pread(memory, size, address)
    except (OSError, OverflowError):
        return b""


@cache
def cpu_flags() -> frozenset[str]:
    """Return what this processor can do, in the words of the system; nothing where it has none."""
    with contextlib.suppress(OSError), open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
        for line in file:
            if line.startswith("flags"):
                return frozenset(line.partition(":")[2].split())
    return frozenset()


def _cpu_name(flags: Set[str]) -> str:
    """Return the processor for which code of this one's abilities is made."""
    return next(name for needed, name in _CPUS if needed <= flags)
