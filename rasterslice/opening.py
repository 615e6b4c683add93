"""Opening a device: it is found, the kernels are built for it, all of it beside the imports, of which it needs few."""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any, NamedTuple

from . import opencl, programs, toolchain
from .errors import DeviceError
from .platforms import choose, device_kind, device_name
from .processor import cpu_flags
from .sources import compose


class Opened(NamedTuple):
    """An OpenCL device that has been opened.

    Attributes
    ----------
    name, platform : str
    kind : {"cpu", "gpu"}
    units : int
        Work-groups that it takes at once.
    identity : str
        Platform, device and driver with their versions.
    wide : bool
        Whether kernels divide a tile among 64 work-items.
    largest : int
        Bytes of the largest buffer.
    device, context, queue
        Of `opencl.load`.
    built : Future of programs.Program
        The kernels.
    seconds : float
        Time that it took, but for the kernels.
    """

    name: str
    platform: str
    kind: str
    units: int
    identity: str
    wide: bool
    largest: int
    device: Any
    context: Any
    queue: Any
    built: Future[programs.Program]
    seconds: float


def open_device(select: str | None = None, mapping: str | None = None) -> Opened:
    """Open a device; parameters and errors are those of `device.Device`."""
    start = time.perf_counter()
    toolchain.prepare_environment()
    toolchain.load_pocl()
    source, _ = compose(), cpu_flags()  # while others import NumPy, which is waited for here
    cl = opencl.load()
    platform, version, device = choose(select)
    about, name, kind = cl.device_info, device_name(device), device_kind(device)
    if platform == toolchain.POCL:
        toolchain.prepare_pocl(version, device.int_ptr)
    context = cl.Context([device])
    identity = f"{platform} {version} {name} {device.get_info(about.DRIVER_VERSION)}"
    wide = (mapping or kind) == "gpu"
    largest = min(int(device.get_info(about.MAX_MEM_ALLOC_SIZE)), 2**31 - 1)  # kernels index with int
    queue, units = cl.CommandQueue(context), int(device.get_info(about.MAX_COMPUTE_UNITS))
    thread = ThreadPoolExecutor(1, thread_name_prefix="build")
    built = thread.submit(_build, name, context, device, identity, source, ["-cl-std=CL1.2"] + ["-DWIDE"] * wide)
    seconds = time.perf_counter() - start
    return Opened(name, platform, kind, units, identity, wide, largest, device, context, queue, built, seconds)


def _build(
    name: str, context: Any, device: Any, identity: str, source: str, options: list[str]
) -> programs.Program:  # fmt: skip
    try:
        return programs.build(context, device, identity, source, options)
    except opencl.load().Error as error:
        raise DeviceError(f"device {name} cannot build the kernels: {opencl.said(error)[:600]}") from None


_BEGUN: dict[str | None, Future[Opened]] = {}


def begin(select: str | None = None) -> None:
    """Begin to open a device, in a thread, before it is known what for: the `opening` that follows has it sooner."""
    if select not in _BEGUN:  # an earlier job may have failed before it needed one
        _BEGUN[select] = _open(select, None)


def give_way(select: str | None, most: float) -> None:
    """Wait until a device that is being opened is, for `most` seconds at most: what imports modules holds it up."""
    if select in _BEGUN:
        wait([_BEGUN[select]], most)


def opening(select: str | None = None, mapping: str | None = None) -> Future[Opened]:
    """Return a device that is being opened in a thread; parameters and errors are those of `device.Device`."""
    begun = _BEGUN.pop(select, None) if mapping is None else None
    if begun is None or (begun.done() and begun.exception() is not None):
        return _open(select, mapping)
    return begun


def _open(select: str | None, mapping: str | None) -> Future[Opened]:
    return ThreadPoolExecutor(1, thread_name_prefix="device").submit(open_device, select, mapping)
