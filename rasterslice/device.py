"""The only door to OpenCL: device, queue, programs, buffers.

A stage asks for scratch memory by name (`Device.scratch`: kept and grown, never freed between batches) and runs
kernels by name (`Device.run`). All kernels are one program (`programs.build`), which is built in a thread, while the
mesh is read.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from . import programs, toolchain
from .errors import DeviceError, UsageError
from .platforms import choose
from .sources import compose

Array = NDArray[Any]

_ZERO = np.zeros(1, np.uint8)
WIDE_GROUP = 64  # work-items that share a tile in the mapping for GPUs
TILE_GROUP = 16  # tiles that a CPU takes at once: a group costs it as much as a tile that is empty


class Device:
    """One OpenCL device, ready to run the kernels.

    Parameters
    ----------
    select : str, optional
        Part of the name of a device or platform, ``cpu`` or ``gpu``; the first that matches is taken.
        Default: the first GPU, else the first device.
    mapping : {"cpu", "gpu"}, optional
        How kernels divide a tile: one work-item with vectors, or 64 work-items. Default: by the kind of device.

    Raises
    ------
    DeviceError
        When there is no such device, or it cannot build the kernels.
    """

    def __init__(self, select: str | None = None, mapping: str | None = None) -> None:
        start = time.perf_counter()
        toolchain.prepare_environment()  # before pyopencl is imported
        import pyopencl as cl

        platform, version, device = choose(select)
        self._cl = cl
        self.name = device.name.strip()
        self.kind = "gpu" if device.type & cl.device_type.GPU else "cpu"
        self.platform = platform
        self.units = int(device.max_compute_units)
        self.identity = f"{platform} {version} {self.name} {device.driver_version}"
        self.wide = (mapping or self.kind) == "gpu"
        self.largest = min(int(device.max_mem_alloc_size), 2**31 - 1)  # kernels index with int
        if platform == toolchain.POCL:
            toolchain.prepare_pocl(version, device.int_ptr)
        self._device, self._context = device, cl.Context([device])
        self._queue = cl.CommandQueue(self._context)
        self._scratch: dict[str, Any] = {}
        self._under_way: deque[Any] = deque()  # what work that may not be done yet works on
        self._done = 0  # pieces of work that are known to be done
        self._lock = threading.Lock()  # of both: results may be waited for in another thread
        self._kernels: dict[str, Any] = {}
        self._built: Future[programs.Program] = ThreadPoolExecutor(1, thread_name_prefix="build").submit(self._build)
        self.seconds = time.perf_counter() - start  # that opening took

    def _build(self) -> programs.Program:
        options = ["-cl-std=CL1.2"] + (["-DWIDE"] if self.wide else [])
        try:
            return programs.build(self._context, self._device, self.identity, compose(), options)
        except self._cl.Error as error:
            log = " ".join(str(error).split())
            raise DeviceError(f"device {self.name} cannot build the kernels: {log[:600]}") from None

    def run(self, kernel: str, items: int, *args: Any, group: int = 1) -> None:
        """Enqueue a kernel over ``items`` work-items, rounded up to whole groups (kernels that need it check)."""
        if items <= 0:
            return
        function = self._kernels.get(kernel)
        if function is None:
            function = self._kernels[kernel] = self._built.result().kernel(kernel)
            function.set_arg_types([_kind(a) for a in args])  # else it finds out for each number, at 8 us
        function.set_args(*(np.array(a, np.int32) if type(a) is tuple else a for a in args))
        self._under_way.append(args)  # else an array could go before the work on it is done
        total = -(-items // group) * group
        with self._said(f"run {kernel}"):
            self._cl.enqueue_nd_range_kernel(self._queue, function, (total,), (group,))

    def run_tiles(self, kernel: str, tiles: int, *args: Any) -> None:
        """Enqueue a kernel that works on whole tiles, in the mapping of this device."""
        if self.wide:
            self.run(kernel, tiles * WIDE_GROUP, tiles, *args, group=WIDE_GROUP)
        else:
            self.run(kernel, tiles, tiles, *args, group=TILE_GROUP)

    def scratch(self, name: str, shape: int, dtype: DTypeLike) -> Any:
        """Return uninitialised memory for ``shape`` items, the same for the same name while it is large enough."""
        need = max(int(shape), 1) * np.dtype(dtype).itemsize
        have = self._scratch.get(name)
        if have is None or have.size < need:
            if need > self.largest:
                raise DeviceError(
                    f"{name} needs {need / 2**20:.0f} MiB; the largest buffer of {self.name} is "
                    f"{self.largest / 2**20:.0f} MiB. Use a larger pitch or a smaller memory_mb"
                )
            self._scratch.pop(name, None)
            size = need if have is None else min(max(need, have.size + have.size // 4), self.largest)
            with self._said(f"hold {size / 2**20:.0f} MiB for {name}"):
                have = self._scratch[name] = self._cl.Buffer(self._context, self._cl.mem_flags.READ_WRITE, size)
        return have

    def zeros(self, name: str, shape: int, dtype: DTypeLike) -> Any:
        """Return scratch memory filled with zero."""
        buffer = self.scratch(name, shape, dtype)
        size = max(int(shape), 1) * np.dtype(dtype).itemsize
        self._cl.enqueue_fill_buffer(self._queue, buffer, _ZERO, 0, size)
        return buffer

    def put(self, name: str, array: Array) -> Any:
        """Return memory that holds an array, which must not be changed until results have been read.

        A device that shares memory works on the array itself: nothing is copied, and nothing waited for.
        """
        array = np.ascontiguousarray(array)
        if self.kind == "cpu" and array.size:
            flags = self._cl.mem_flags
            with self._said(f"take {name}"):
                return self._cl.Buffer(self._context, flags.READ_WRITE | flags.USE_HOST_PTR, hostbuf=array)
        buffer = self.scratch(name, array.size, array.dtype)
        if array.size:
            with self._said(f"take {name}"):
                self._cl.enqueue_copy(self._queue, buffer, array)
        return buffer

    def hold(self, array: Array) -> Any:
        """Return a read-only buffer on the array itself where the device shares memory, else a copy."""
        flags = self._cl.mem_flags
        share = flags.USE_HOST_PTR if self.kind == "cpu" else flags.COPY_HOST_PTR
        with self._said(f"hold {array.nbytes / 2**20:.0f} MiB"):
            return self._cl.Buffer(self._context, flags.READ_ONLY | share, hostbuf=array)

    def ask(self, buffer: Any, shape: int, dtype: DTypeLike, start: int = 0) -> Answer:
        """Begin to return items of a buffer, as `get`; other work may follow before they are read."""
        out = np.empty(shape, dtype)
        if not out.size:
            return Answer(self, out, None, 0)
        with self._said("return results"):
            event = self._cl.enqueue_copy(self._queue, out, buffer, src_offset=start * out.itemsize, is_blocking=False)
        return Answer(self, out, event, self._done + len(self._under_way))

    def get(self, buffer: Any, shape: int, dtype: DTypeLike, start: int = 0) -> Array:
        """Return ``shape`` items of a buffer, from item ``start`` on, when all work before it is done."""
        out = np.empty(shape, dtype)
        if out.size:
            with self._said("return results"):
                self._cl.enqueue_copy(self._queue, out, buffer, src_offset=start * out.itemsize)
            self._release(self._done + len(self._under_way))
        return out

    def wait(self, event: Any, until: int) -> None:
        """Wait for an event that follows the first ``until`` pieces of work."""
        with self._said("return results"):
            event.wait()
        self._release(until)

    def _release(self, until: int) -> None:
        with self._lock:
            while self._done < until:
                self._under_way.popleft()
                self._done += 1

    def shown(self, buffer: Any, shape: int, dtype: DTypeLike) -> Array:
        """Return ``shape`` items of a buffer to read: where the device shares memory, for as long as it keeps them."""
        if self.kind != "cpu" or shape <= 0:
            return self.get(buffer, shape, dtype)
        with self._said("return results"):
            array, _ = self._cl.enqueue_map_buffer(
                self._queue, buffer, self._cl.map_flags.READ, 0, (shape,), np.dtype(dtype), is_blocking=True
            )
        self._release(self._done + len(self._under_way))
        return np.asarray(array)

    def hide(self, array: Array) -> None:
        """Take back what was `shown`: the device may write there again."""
        mapped: Any = array.base
        if hasattr(mapped, "release"):
            mapped.release(self._queue)

    @contextmanager
    def view(self, buffer: Any, shape: int, dtype: DTypeLike) -> Iterator[Array]:
        """Give ``shape`` items of a buffer to read, without a copy where the device shares memory."""
        array = self.shown(buffer, shape, dtype)
        try:
            yield array
        finally:
            self.hide(array)

    def offsets(self, counts: Any, n: int, name: str) -> tuple[Any, Array]:
        """Return exclusive sums of ``n`` int32 counts: a buffer of n + 1, and the array itself; see `places`."""
        totals = np.cumsum(self.get(counts, n, np.int32), dtype=np.int64)
        _check_total(int(totals[-1]) if n else 0, name)
        sums = np.zeros(n + 1, np.int32)
        sums[1:] = totals
        return self.put(name, sums), sums

    def places(self, counts: Any, n: int, name: str) -> tuple[Any, int]:
        """Return exclusive sums of ``n`` int32 counts, a buffer of n + 1, and the sum of all.

        The counts become the same sums, to advance; nothing of them is seen by the host.
        """
        start, total = self.scratch(name, n + 1, np.int32), self.scratch("total", 1, np.int64)
        lanes = WIDE_GROUP if self.wide else 1
        self.run("sum_counts", lanes, n, counts, start, total, group=lanes)
        found = int(self.get(total, 1, np.int64)[0])
        _check_total(found, name)
        return start, found

    def finish(self) -> None:
        """Wait until the device has done everything."""
        with self._said("finish"):
            self._queue.finish()
        self._release(self._done + len(self._under_way))

    def _said(self, what: str) -> _Said:
        return _Said(self._cl.Error, self.name, what)


class Answer(NamedTuple):
    """Items of a buffer on their way to the host."""

    device: Device
    array: Array
    event: Any
    until: int

    def read(self) -> Array:
        """Return them when they are there."""
        if self.event is not None:
            self.device.wait(self.event, self.until)
        return self.array


class _Said(NamedTuple):
    """Turns what OpenCL raises into an error that says which device could not do what."""

    error: type[Exception]
    name: str
    what: str

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, self.error):
            log = " ".join(str(error).split())[:300]
            raise DeviceError(f"device {self.name} cannot {self.what}: {log}; try a smaller memory_mb") from None


_BEGUN: dict[str | None, Future[Device]] = {}


def begin(select: str | None = None) -> None:
    """Begin to open a device, in a thread, before it is known what for: the `opening` that follows has it sooner."""
    toolchain.prepare_environment()
    import pyopencl  # noqa: F401  # here, where no other thread imports: the kernels are what all else waits for

    compose()  # imports, too
    if select not in _BEGUN:  # an earlier job may have failed before it needed one
        _BEGUN[select] = _open(select, None)


def opening(select: str | None = None, mapping: str | None = None) -> Future[Device]:
    """Return a device that is being opened in a thread; parameters and errors are those of `Device`."""
    begun = _BEGUN.pop(select, None) if mapping is None else None
    if begun is None or (begun.done() and begun.exception() is not None):
        return _open(select, mapping)
    return begun


def _open(select: str | None, mapping: str | None) -> Future[Device]:
    return ThreadPoolExecutor(1, thread_name_prefix="device").submit(Device, select, mapping)


def _check_total(items: int, name: str) -> None:
    if items >= 2**31:
        raise UsageError(f"{name}: {items} items in one batch (limit 2^31); use a smaller memory_mb")


def _kind(argument: object) -> Any:
    """Return how an argument is passed to a kernel: a type of number, a vector of so many bytes, None for a buffer."""
    if isinstance(argument, int):
        return np.int32
    if isinstance(argument, float):
        return np.float32
    if isinstance(argument, tuple):
        return np.dtype(f"V{4 * len(argument)}")
    return np.dtype(f"V{argument.nbytes}") if isinstance(argument, np.ndarray) else None
