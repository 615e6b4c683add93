"""What OpenCL shows on this machine, and which device is taken."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from . import toolchain
from .errors import DeviceError

REMEDY = "install one with: pip install pocl-binary-distribution"


def _platforms() -> list[tuple[str, str, Any]]:
    """Return (platform name, platform version, device) of everything that OpenCL shows, CPUs last."""
    import pyopencl as cl

    found = []
    try:
        for platform in cl.get_platforms():
            found += [(platform.name, platform.version, device) for device in platform.get_devices()]
    except cl.Error as error:
        if not found:
            raise DeviceError(f"no OpenCL device: {error}; {REMEDY}") from None
    return sorted(found, key=lambda item: not item[2].type & cl.device_type.GPU)


def list_devices() -> list[dict[str, object]]:
    """Return one record per OpenCL device: name, platform, kind, driver, memory_mb, units, usable."""
    toolchain.prepare_environment()
    import pyopencl as cl

    return [
        {
            "name": device.name.strip(),
            "platform": platform,
            "kind": "gpu" if device.type & cl.device_type.GPU else "cpu",
            "driver": device.driver_version,
            "memory_mb": device.global_mem_size >> 20,
            "units": device.max_compute_units,
            "usable": bool(device.available and device.compiler_available),
        }
        for platform, _, device in _platforms()
    ]


def choose(select: str | None) -> tuple[str, str, Any]:
    """Return the platform's name, version and the device that `select` names."""
    import pyopencl as cl

    found = _platforms()
    if not found:
        raise DeviceError(f"no OpenCL device; {REMEDY}")
    for platform, version, device in found:
        kind = "gpu" if device.type & cl.device_type.GPU else "cpu"
        text = f"{platform} {device.name}".lower()
        wanted = kind if select is None else select.lower()
        if wanted == kind or (wanted not in ("", "cpu", "gpu") and wanted in text):
            return platform, version, device
    names: Sequence[str] = [f"{device.name.strip()} ({platform})" for platform, _, device in found]
    raise DeviceError(f'no OpenCL device matches "{select}"; there are: {", ".join(names)}')
