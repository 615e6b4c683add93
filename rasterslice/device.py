"""An OpenCL device as the stages see it: kernels and buffers, by their names.

A stage asks for scratch memory by name (`Device.scratch`: kept and grown, never freed between batches) and runs
kernels by name (`Device.run`). All kernels are one program (`programs.build`), which is built in a thread, while the
mesh is read.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from . import opencl
from .errors import DeviceError, UsageError
from .kernel import Kernel
from .opening import Opened, open_device

Array = NDArray[Any]

_BYTES = {value: np.array([value & 0xFF], np.uint8) for value in (0, -1)}
# At most SHARERS of common.cl
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
    opened : Opened, optional
        What was opened by `opening`, instead of what the others name.

    Raises
    ------
    DeviceError
        When there is no such device, or it cannot build the kernels.
    """

    def __init__(self, select: str | None = None, mapping: str | None = None, opened: Opened | None = None) -> None:
        self._opened = opened = opened or open_device(select, mapping)
        self.name, self.platform, self.kind, self.units = opened.name, opened.platform, opened.kind, opened.units
        self.identity, self.wide, self.largest = opened.identity, opened.wide, opened.largest
        self.seconds = opened.seconds  # that opening took, but for the kernels
        self._cl, self._context, self._queue = opencl.load(), opened.context, opened.queue
        self._scratch: dict[str, tuple[int, Any]] = {}
        self._under_way: deque[Any] = deque()  # what work that may not be done yet works on
        self._done = 0  # pieces of work that are known to be done
        self._lock = threading.Lock()  # of both: results may be waited for in another thread
        self._kernels: dict[str, Kernel] = {}

    def run(self, kernel: str, items: int, *args: Any, group: int = 1) -> None:
        """Enqueue a kernel over ``items`` work-items, rounded up to whole groups (kernels that need it check)."""
        if items <= 0:
            return
        function = self._kernels.get(kernel)
        if function is None:
            function = self._kernels[kernel] = Kernel.called_with(self._opened.built.result().kernel(kernel), args)
        self._under_way.append(args)  # else an array could go before the work on it is done
        total = -(-items // group) * group
        with self._said(f"run {kernel}"):
            function.set_args(args)
            self._cl.enqueue_nd_range_kernel(self._queue, function.kernel, (total,), (group,))

    def run_tiles(self, kernel: str, tiles: int, *args: Any) -> None:
        """Enqueue a kernel that works on whole tiles, in the mapping of this device."""
        if self.wide:
            self.run_groups(kernel, tiles, tiles, *args)
        else:
            self.run(kernel, tiles, tiles, *args, group=TILE_GROUP)

    def run_groups(self, kernel: str, groups: int, *args: Any) -> None:
        """Enqueue a kernel of which a group of work-items takes each thing: of one on a CPU."""
        lanes = WIDE_GROUP if self.wide else 1
        self.run(kernel, groups * lanes, *args, group=lanes)

    def scratch(self, name: str, shape: int, dtype: DTypeLike) -> Any:
        """Return uninitialised memory for ``shape`` items, the same for the same name while it is large enough."""
        need = max(int(shape), 1) * np.dtype(dtype).itemsize
        have, buffer = self._scratch.get(name, (0, None))
        if have < need:
            if need > self.largest:
                raise DeviceError(
                    f"{name} needs {need / 2**20:.0f} MiB; the largest buffer of {self.name} is "
                    f"{self.largest / 2**20:.0f} MiB. Use a larger pitch or a smaller memory_mb"
                )
            self._scratch.pop(name, None)
            size = min(max(need, have + have // 4), self.largest)
            buffer = None  # before the next is made
            with self._said(f"hold {size / 2**20:.0f} MiB for {name}"):
                buffer = self._cl.Buffer(self._context, self._cl.mem_flags.READ_WRITE, size)
            self._scratch[name] = size, buffer
        return buffer

    def zeros(self, name: str, shape: int, dtype: DTypeLike) -> Any:
        """Return scratch memory filled with zero."""
        buffer = self.scratch(name, shape, dtype)
        self.fill(buffer, max(int(shape), 1), dtype, 0)
        return buffer

    def fill(self, buffer: Any, shape: int, dtype: DTypeLike, value: int) -> None:
        """Fill ``shape`` items of a buffer with a value of which all bytes are the same: 0 or -1."""
        size = shape * np.dtype(dtype).itemsize
        self._cl._enqueue_fill_buffer(self._queue, buffer, _BYTES[value], 0, size)

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
                self._cl._enqueue_write_buffer(self._queue, buffer, array)
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
            event = self._cl._enqueue_read_buffer(self._queue, buffer, out, start * out.itemsize, None, False)
        return Answer(self, out, event, self._done + len(self._under_way))

    def get(self, buffer: Any, shape: int, dtype: DTypeLike, start: int = 0) -> Array:
        """Return ``shape`` items of a buffer, from item ``start`` on, when all work before it is done."""
        out = np.empty(shape, dtype)
        if out.size:
            with self._said("return results"):
                self._cl._enqueue_read_buffer(self._queue, buffer, out, start * out.itemsize)
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

    def show(self, buffer: Any, shape: int, dtype: DTypeLike) -> Answer:
        """Begin to return items of a buffer: where the device shares memory, those themselves, to be hidden again."""
        if self.kind != "cpu" or shape <= 0:
            return self.ask(buffer, shape, dtype)
        with self._said("return results"):
            array, event = self._cl.enqueue_map_buffer(
                self._queue, buffer, self._cl.map_flags.READ, 0, (shape,), np.dtype(dtype), is_blocking=False
            )
        return Answer(self, np.asarray(array), event, self._done + len(self._under_way))

    def hide(self, array: Array) -> None:
        """Take back what was shown: the device may write there again."""
        mapped: Any = array.base
        if hasattr(mapped, "release"):
            mapped.release(self._queue)

    def offsets(self, counts: Any, n: int, name: str) -> Callable[[], tuple[Any, Array]]:
        """Begin to return exclusive sums of ``n`` int32 counts: a buffer of n + 1, and the array; see `places`."""
        asked = self.ask(counts, n, np.int32)

        def read() -> tuple[Any, Array]:
            totals = np.cumsum(asked.read(), dtype=np.int64)
            _check_total(int(totals[-1]) if n else 0, name)
            sums = np.zeros(n + 1, np.int32)
            sums[1:] = totals
            return self.put(name, sums), sums

        return read

    def places(self, counts: Any, n: int, name: str) -> tuple[Any, Callable[[], int]]:
        """Begin to sum ``n`` int32 counts: return exclusive sums, a buffer of n + 1, and what gives the sum of all.

        The counts become the same sums, to advance; nothing of them is seen by the host.
        """
        start, total = self.scratch(name, n + 1, np.int32), self.scratch("total", 1, np.int64)
        self.run_groups("sum_counts", 1, n, counts, start, total)
        asked = self.ask(total, 1, np.int64)

        def read() -> int:
            found = int(asked.read()[0])
            _check_total(found, name)
            return found

        return start, read

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
            log = opencl.said(error)[:300]
            raise DeviceError(f"device {self.name} cannot {self.what}: {log}; try a smaller memory_mb") from None


def _check_total(items: int, name: str) -> None:
    if items >= 2**31:
        raise UsageError(f"{name}: {items} items in one batch (limit 2^31); use a smaller memory_mb")
