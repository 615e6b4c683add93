"""Whether the manifest of an export is one that was written here: every key, its type and its range."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

from ..profile import Profile, range_faults

_FILE = re.compile(r"[A-Za-z0-9_-]{1,40}\.[A-Za-z0-9]{1,8}")


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < math.inf


def _count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 10**12


def _above(value: Any) -> bool:
    return _number(value) and value > 0


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _file(value: Any) -> bool:
    return isinstance(value, str) and _FILE.fullmatch(value) is not None


def _table(value: Any) -> bool:
    return isinstance(value, dict)


def _numbers(count: int, each: Callable[[Any], bool] = _number) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, list) and len(value) == count and all(map(each, value))


def _or_none(sound: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: value is None or sound(value)


def _many(each: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, list) and all(map(each, value))


def _lengths(value: Any) -> bool:
    return isinstance(value, dict) and all(_number(value.get(name)) for name in ("part", "scaffold"))


def _entry(value: Any) -> bool:
    return (isinstance(value, dict) and _file(value.get("path")) and _count(value.get("bytes"))
            and _text(value.get("sha256")) and len(value["sha256"]) == 64)  # fmt: skip


_KEYS: dict[str, Callable[[Any], bool]] = {
    "program": _text, "version": _text, "kind": _text, "name": _text, "records_file": _file, "layers": _count,
    "paths": _count, "points": _count, "records": _count, "low": _or_none(_numbers(3)), "high": _or_none(_numbers(3)),
    "wet_mm": _lengths, "dry_mm": _number, "travel_mm": _number, "tool_changes": _count, "estimated_seconds": _number,
    "trajectory": _table, "warnings": _many(_text), "checks": _table, "bottom": _or_none(_number),
    "copies": lambda value: bool(value) and _many(_numbers(2))(value), "thickness": _above, "slice_position": _number,
    "smooth_angle": _number, "part_layers": lambda value: _count(value) and value > 0, "widths": _numbers(2, _above),
    "profile": _table, "files": _many(_entry),
}  # fmt: skip


def manifest_fault(manifest: dict[str, Any]) -> str | None:
    """Return what is wrong with a manifest, but for its profile; None when it is sound."""
    for key, sound in _KEYS.items():
        if key not in manifest:
            return f"{key} is missing"
        if not sound(manifest[key]):
            return f"{key} is not what was written: {str(manifest[key])[:40]}"
    have = {entry["path"] for entry in manifest["files"]}
    lacking = sorted({"RSPLAY.V2", "RSCFG.V2", manifest["records_file"]} - have)
    return f"files does not name {lacking[0]}" if lacking else None


def profile_fault(profile: Profile) -> str | None:
    """Return what is wrong with the profile of a manifest; None when it is sound."""
    if not _text(profile.name):
        return "the name of the profile is no text"
    return next(iter(range_faults(profile, "profile")), None)
