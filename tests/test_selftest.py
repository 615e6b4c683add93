"""The self-test passes on a good device, fails on a bad one, and is remembered."""

import numpy as np
import pytest

from rasterslice import selftest
from rasterslice.device import Device
from rasterslice.errors import DeviceError


@pytest.mark.parametrize("mapping", ["cpu", "gpu"])
def test_a_good_device_passes(mapping):
    selftest.run(Device(mapping=mapping))


def test_wrong_distances_are_refused(monkeypatch):
    right = selftest.read_images
    monkeypatch.setattr(selftest, "read_images", lambda *a: right(*a) + 0.02)
    with pytest.raises(DeviceError, match=r"fails the self-test: distances are off by 0\.0\d+ pixels"):
        selftest.run(Device())


def test_wrong_contours_are_refused(monkeypatch):
    right = selftest.Seeds
    monkeypatch.setattr(selftest, "Seeds", lambda d, g, images, n, m, levels: right(d, g, images, n, m, (0, 0)))
    with pytest.raises(DeviceError, match="a contour encloses"):
        selftest.run(Device())


def test_it_is_run_once(monkeypatch, tmp_path):
    monkeypatch.setattr(selftest, "ensure_cache", lambda: tmp_path)
    device, runs = Device(), []
    monkeypatch.setattr(selftest, "run", lambda d: runs.append(d))
    selftest.ensure_tested(device)
    selftest.ensure_tested(device)
    assert len(runs) == 1
    assert np.sum([p.name.startswith("passed-") for p in (tmp_path / "rasterslice").iterdir()]) == 1
