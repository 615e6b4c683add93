"""What OpenCL shows on this machine, and which device is taken."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from . import opencl, toolchain
from .errors import DeviceError

REMEDY = "install one with: pip install pocl-binary-distribution"


def _platforms() -> list[tuple[str, str, Any]]:
    """Return (platform name, platform version, device) of everything that OpenCL shows, CPUs last."""
    cl = opencl.load()
    about, found = cl.platform_info, []
    try:
        for platform in cl.get_platforms():
            name, version = platform.get_info(about.NAME), platform.get_info(about.VERSION)
            found += [(name, version, device) for device in platform.get_devices()]
    except cl.Error as error:
        if not found:
            raise DeviceError(f"no OpenCL device: {opencl.said(error)}; {REMEDY}") from None
    return sorted(found, key=lambda item: device_kind(item[2]) == "cpu")


def device_kind(device: Any) -> str:
    """Return ``gpu`` or ``cpu``, which is what all else counts as."""
    cl = opencl.load()
    return "gpu" if device.get_info(cl.device_info.TYPE) & cl.device_type.GPU else "cpu"


def device_name(device: Any) -> str:
    """Return the name of a device, as its driver gives it but for blanks at the ends."""
    return str(device.get_info(opencl.load().device_info.NAME)).strip()


def list_devices() -> list[dict[str, object]]:
    """Return one record per OpenCL device: name, platform, kind, driver, memory_mb, units, usable."""
    toolchain.prepare_environment()
    about = opencl.load().device_info
    return [
        {
            "name": device_name(device),
            "platform": platform,
            "kind": device_kind(device),
            "driver": device.get_info(about.DRIVER_VERSION),
            "memory_mb": device.get_info(about.GLOBAL_MEM_SIZE) >> 20,
            "units": device.get_info(about.MAX_COMPUTE_UNITS),
            "usable": bool(device.get_info(about.AVAILABLE) and device.get_info(about.COMPILER_AVAILABLE)),
        }
        for platform, _, device in _platforms()
    ]


def choose(select: str | None) -> tuple[str, str, Any]:
    """Return the platform's name, version and the device that `select` names."""
    found = _platforms()
    if not found:
        raise DeviceError(f"no OpenCL device; {REMEDY}")
    for platform, version, device in found:
        kind, text = device_kind(device), f"{platform} {device_name(device)}".lower()
        wanted = kind if select is None else select.lower()
        if wanted == kind or (wanted not in ("", "cpu", "gpu") and wanted in text):
            return platform, version, device
    names: Sequence[str] = [f"{device_name(device)} ({platform})" for platform, _, device in found]
    raise DeviceError(f'no OpenCL device matches "{select}"; there are: {", ".join(names)}')
