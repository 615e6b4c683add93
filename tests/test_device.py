"""The device works on arrays where they lie, and they stay there until it has."""

import time
import weakref

import numpy as np
import pyopencl as cl
import pytest

from rasterslice import opening as devices
from rasterslice.device import Device
from rasterslice.errors import DeviceError, UsageError
from rasterslice.sources import compose, kernel_source

WIDTH, ROWS = 8, 16


@pytest.fixture(scope="module")
def device():
    device = Device("cpu")
    if device.kind != "cpu":
        pytest.skip("no device that shares memory")
    return device


def test_an_array_stays_while_work_on_it_is_under_way(device):
    buffer = device.put("ones", np.ones(WIDTH * ROWS, np.int32))
    array = np.ones(WIDTH * ROWS, np.int32)
    lent, watched = device.put("other ones", array), weakref.ref(array)
    assert (device.get(buffer, WIDTH, np.int32) == 1).all(), "results may be read between the two"
    device.run("sum_rows", ROWS, lent, WIDTH, group=16)
    del array, lent
    assert watched() is not None
    device.finish()
    assert watched() is None


def test_kernels_work_on_the_array_itself(device):
    array = np.ones((ROWS, WIDTH), np.int32)
    device.run("sum_rows", ROWS, device.put("ones", array), WIDTH, group=16)
    device.finish()
    assert (array == np.arange(1, WIDTH + 1)).all()


def test_offsets_are_there_and_here(device):
    counts = device.put("counts", np.array([2, 0, 3], np.int32))
    start, sums = device.offsets(counts, 3, "places")()
    assert sums.tolist() == [0, 2, 2, 5]
    assert device.get(start, 4, np.int32).tolist() == sums.tolist()


@pytest.mark.parametrize("mapping", [[], ["-DWIDE"]], ids=["cpu", "gpu"])
def test_the_compiler_has_nothing_to_say(device, mapping):
    program = cl.Program(device._context, compose())
    program.build(["-cl-std=CL1.2", "-Werror", *mapping], cache_dir=False)


def test_an_answer_is_of_the_moment_it_was_asked_for(device):
    ones = np.ones((ROWS, WIDTH), np.int32)
    buffer = device.put("ones", ones)
    before = device.ask(buffer, WIDTH, np.int32)
    device.run("sum_rows", ROWS, buffer, WIDTH, group=16)
    after = device.ask(buffer, 3, np.int32, WIDTH + 2)
    assert after.read().tolist() == [3, 4, 5]
    assert before.read().tolist() == [1] * WIDTH
    assert before.read() is before.array, "it can be read twice"


def test_a_device_that_was_begun_is_opened_once():
    devices.begin("cpu")
    begun = devices.opening("cpu")
    devices.begin("cpu")
    devices.begin("cpu")  # a job that failed early left one
    again = devices.opening("cpu")
    assert begun.result() is not again.result() and "cpu" not in devices._BEGUN
    assert devices.opening("cpu") not in (begun, again)


def test_a_device_that_was_begun_in_vain_is_opened_anew():
    devices.begin("no such device")
    with pytest.raises(DeviceError):
        devices._BEGUN["no such device"].result()
    first = devices._BEGUN["no such device"]
    second = devices.opening("no such device")
    assert second is not first
    with pytest.raises(DeviceError, match="no OpenCL device matches"):
        second.result()


def test_who_gives_way_waits_for_the_device_and_not_for_long(monkeypatch):
    devices.give_way("cpu", 60.0)  # nothing was begun
    devices.begin("cpu")
    devices.give_way("cpu", 60.0)
    assert devices._BEGUN["cpu"].done()
    devices.opening("cpu").result()
    monkeypatch.setattr(devices, "open_device", lambda *_: time.sleep(0.5))
    devices.begin("slow")
    start = time.perf_counter()
    devices.give_way("slow", 0.01)
    assert not devices._BEGUN["slow"].done(), f"waited for {time.perf_counter() - start} s"
    devices.opening("slow").result()
    monkeypatch.undo()
    devices.begin("no such device")
    devices.give_way("no such device", 60.0)  # who needs it says so
    with pytest.raises(DeviceError, match="no OpenCL device matches"):
        devices._BEGUN.pop("no such device").result()


@pytest.mark.parametrize("mapping", ["cpu", "gpu"])
@pytest.mark.parametrize("n", [0, 1, 2, 63, 64, 65, 1000])
def test_places_are_sums_of_the_counts_before(mapping, n):
    device = Device(mapping=mapping)
    counts = np.random.default_rng(n).integers(0, 9, n).astype(np.int32)
    buffer = device.put("counts", counts.copy())
    start, total = device.places(buffer, n, "places")
    sums = np.concatenate([[0], np.cumsum(counts)])
    assert total() == sums[-1]
    assert device.get(start, n + 1, np.int32).tolist() == sums.tolist()
    assert device.get(buffer, n, np.int32).tolist() == sums[:-1].tolist()


def test_more_places_than_a_batch_can_hold_are_refused(device):
    counts = device.put("counts", np.full(3, 2**30, np.int32))
    with pytest.raises(UsageError, match=r"places: 3221225472 items in one batch \(limit 2\^31\); use a"):
        device.places(counts, 3, "places")[1]()


@pytest.mark.parametrize("mapping", ["cpu", "gpu"])
@pytest.mark.parametrize("groups", [1, 2, 36, 37, 38, 41, 74, 82, 135, 37 * 41, 2 * 37 * 41])
def test_items_that_are_spread_are_all_there_once(device, mapping, groups):
    """And neighbours in the order of groups are no neighbours on the grid, where there are enough of them."""
    source = kernel_source("common") + "__kernel void visit(__global int *at) { at[get_global_id(0)] = spread_item(); }"
    each, options = (64, ["-DWIDE"]) if mapping == "gpu" else (16, [])
    kernel = cl.Program(device._context, source).build(["-cl-std=CL1.2", *options], cache_dir=False).visit
    at = np.full(groups * each, -1, np.int32)
    buffer = cl.Buffer(device._context, cl.mem_flags.COPY_HOST_PTR, hostbuf=at)
    kernel(device._queue, at.shape, (each,), buffer)
    cl.enqueue_copy(device._queue, at, buffer)
    first = at.reshape(groups, each)[:, 0] // (1 if mapping == "gpu" else each)
    assert sorted(first) == list(range(groups))
    assert mapping == "gpu" or sorted(at) == list(range(groups * each))
    if groups > 80 and groups % (37 * 41):
        assert np.abs(np.diff(first)).min() > 1
