"""Machine profiles: the TOML file that says what a robot cell is and how it deposits.

Lengths are mm, angles degrees, times s, speeds mm/s, accelerations mm/s^2.
"""

from __future__ import annotations

import functools
import math
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from .errors import UsageError

#: The profile whose values stand for whatever a user's file leaves out.
DEFAULT = Path(__file__).parent / "cobra" / "cobra600.toml"

Triple = tuple[float, float, float]
Four = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Robot:
    """A SCARA arm: links, ranges, signs. J3 is mm, positive down."""

    links: tuple[float, float]
    joint_low: Four
    joint_high: Four
    joint_speed: Four
    elbow: int
    side: str
    j4_sign: int
    j4_zero: float
    z_zero: float


@dataclass(frozen=True, slots=True)
class Place:
    """Where the part lies in the robot's frame, how the tool is turned, and how large a part may be."""

    frame: Triple
    roll: float
    envelope: Triple


@dataclass(frozen=True, slots=True)
class Nozzle:
    """One nozzle with its valve: tip in the frame of the flange, output, speed, delays, height, purge."""

    offset: Triple
    valve: int
    speed: float
    open_delay: float
    close_delay: float
    standoff: float
    purge: float


@dataclass(frozen=True, slots=True)
class Motion:
    """Acceleration, and all that happens with the valve shut; places are in the part's frame."""

    accel: float
    accel_percent: float
    travel_speed: float
    start_percent: float
    rise_to: float
    settle: float
    lift: float
    clearance: float
    purge_at: tuple[float, float]
    park_at: tuple[float, float]
    keep_out: float
    idle_gap: float


@dataclass(frozen=True, slots=True)
class PlayerRules:
    """Whether the player wants its guard, and what V+ calls a task that runs."""

    guard: bool
    running: int


@dataclass(frozen=True, slots=True)
class PathRules:
    """How paths become motions."""

    tick: float
    segment_time: float
    min_spacing: float
    chord_tolerance: float
    lead_time: float
    overlap: float
    max_points: int
    hold_every: int
    scaffold_first: bool
    speed_tolerance: float


@dataclass(frozen=True, slots=True)
class FileRules:
    """Limits of the files that the controller reads."""

    max_record: int
    max_line: int
    literal_steps: int


@dataclass(frozen=True, slots=True)
class Profile:
    """One machine; sections as in the TOML file, `part_nozzle` and `scaffold_nozzle` from ``[nozzle.*]``."""

    name: str
    robot: Robot
    part: Place
    part_nozzle: Nozzle
    scaffold_nozzle: Nozzle
    motion: Motion
    program: PlayerRules
    path: PathRules
    files: FileRules

    @property
    def nozzles(self) -> tuple[Nozzle, Nozzle]:
        """Nozzles by material: 0 ice, 1 scaffold."""
        return self.part_nozzle, self.scaffold_nozzle

    @property
    def accel(self) -> float:
        """Acceleration that the program asks for, mm/s^2."""
        return self.motion.accel * self.motion.accel_percent / 100

    def spacing(self, speed: float) -> float:
        """Return the least distance of two points at a speed, mm."""
        return max(self.path.min_spacing, speed * self.path.segment_time)

    def finer(self) -> str:
        """Say what would bring points nearer to one another: which of the two bounds of the spacing holds."""
        by = {n.speed * self.path.segment_time > self.path.min_spacing for n in self.nozzles}
        ways = ["nozzle.speed or path.segment_time"] * (True in by) + ["path.min_spacing"] * (False in by)
        return f"lower {', or '.join(ways)}"

    def lead(self, speed: float) -> float:
        """Return the length that the arm needs to reach a speed from rest and to settle, mm."""
        return speed**2 / (2 * self.accel) + speed * self.path.lead_time


_SECTIONS: dict[str, tuple[str, type[Any]]] = {
    "robot": ("robot", Robot), "part": ("part", Place), "nozzle.part": ("part_nozzle", Nozzle),
    "nozzle.scaffold": ("scaffold_nozzle", Nozzle), "motion": ("motion", Motion),
    "program": ("program", PlayerRules), "path": ("path", PathRules),
    "files": ("files", FileRules),
}  # fmt: skip
_POSITIVE = {
    "links", "joint_speed", "envelope", "speed", "accel", "accel_percent", "travel_speed", "lift", "clearance",
    "tick", "segment_time", "min_spacing", "chord_tolerance", "valve", "start_percent",
}  # fmt: skip
_SIGNED = {
    "joint_low", "joint_high", "elbow", "j4_sign", "j4_zero", "z_zero", "frame", "roll", "offset", "purge_at",
    "park_at", "rise_to", "running",
}  # fmt: skip
_AT_MOST = {"tick": 1.0, "segment_time": 10.0, "accel_percent": 100.0,
            "start_percent": 100.0, "speed_tolerance": 1.0, "max_record": 72,
            "max_line": 140, "valve": 9999}  # fmt: skip
_AT_LEAST = {"max_record": 32, "max_line": 100, "speed": 0.1, "max_points": 8}


def read_profile(path: Path | None = None) -> Profile:
    """Read a machine profile, or the packaged one of the Cobra 600.

    Raises
    ------
    UsageError
        When the file is missing, is no TOML, or a key is unknown, of the wrong type or out of its limits.
    """
    base = _flat(_load(DEFAULT), DEFAULT)
    given = _flat(_load(path), path) if path is not None else {}
    where = path or DEFAULT
    for key in given.keys() - base.keys():
        import difflib

        near = difflib.get_close_matches(key, base, 1)
        raise UsageError(f"{where}: unknown key '{key}'; " + (f"did you mean '{near[0]}'?" if near else "remove it"))
    values = {key: _checked(f"{where}: {key}", key, given.get(key, base[key]), base[key]) for key in base}
    sections: dict[str, Any] = {}
    for prefix, (name, kind) in _SECTIONS.items():
        sections[name] = kind(**{f.name: values[f"{prefix}.{f.name}"] for f in fields(kind)})
    profile = Profile(name=values["name"], **sections)
    _check_together(profile, where)
    return profile


@functools.lru_cache(8)
def _load_bytes(data: bytes) -> dict[str, Any]:
    return tomllib.loads(data.decode("utf-8"))


def _load(path: Path) -> dict[str, Any]:
    try:
        return _load_bytes(path.read_bytes())
    except OSError as error:
        raise UsageError(f"{path}: cannot read the machine profile: {error.strerror}") from None
    except ValueError as error:
        raise UsageError(f"{path}: not a TOML file: {error}; compare it with the packaged cobra600.toml") from None


def _flat(tree: dict[str, Any], where: Path, prefix: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            out.update(_flat(value, where, f"{prefix}{key}."))
        else:
            out[prefix + key] = value
    return out


def _checked(label: str, key: str, value: Any, like: Any) -> Any:
    """Return a value in the type of the default, within its limits."""
    if isinstance(like, list):
        if not isinstance(value, list) or len(value) != len(like):
            raise UsageError(f"{label} must be {len(like)} numbers in brackets, got {value!r}")
        return tuple(_checked(label, key, v, like[0]) for v in value)
    if isinstance(like, str | bool):
        if type(value) is not type(like) or (isinstance(value, str) and not value.isascii()):
            raise UsageError(f"{label} must be {'text in ASCII' if isinstance(like, str) else 'true or false'}, "
                             f"got {value!r}")  # fmt: skip
        return value
    allowed = int | float if isinstance(like, float) else int
    if isinstance(value, bool) or not isinstance(value, allowed) or not math.isfinite(value):
        raise UsageError(f"{label} must be a {'whole ' * isinstance(like, int)}number, got {value!r}")
    name = key.rpartition(".")[2]
    if name in _POSITIVE and value <= 0:
        raise UsageError(f"{label} must be > 0, got {value!r}")
    low, high = _AT_LEAST.get(name, -1e6 if name in _SIGNED else 0), _AT_MOST.get(name, 1e6)
    if name in _POSITIVE and name not in _AT_LEAST and value > high:
        raise UsageError(f"{label} must be > 0 and at most {high:g}, got {value!r}")
    if not low <= value <= high:
        raise UsageError(f"{label} must be {low:g} to {high:g}, got {value!r}")
    return type(like)(value)


def range_faults(profile: Profile, where: str) -> list[str]:
    """Return what is out of its limits in a profile that was made otherwise, as `read_profile` would say it."""
    base, out = _flat(_load(DEFAULT), DEFAULT), []
    for prefix, (name, kind) in _SECTIONS.items():
        for f in fields(kind):
            key, value = f"{prefix}.{f.name}", getattr(getattr(profile, name), f.name)
            given = list(value) if isinstance(value, tuple) else value
            try:
                _checked(f"{where}: {key}", key, given, base[key])
            except UsageError as error:
                out.append(str(error))
    try:
        _check_together(profile, where)
    except UsageError as error:
        out.append(str(error))
    return out


def _check_together(p: Profile, where: Path | str) -> None:
    for name in ("elbow", "j4_sign"):
        if getattr(p.robot, name) not in (1, -1):
            raise UsageError(f"{where}: robot.{name} must be 1 or -1, got {getattr(p.robot, name)}")
    if p.robot.side not in ("", "LEFTY", "RIGHTY"):
        raise UsageError(f"{where}: robot.side must be LEFTY, RIGHTY or empty, got {p.robot.side!r}")
    for n, (low, high) in enumerate(zip(p.robot.joint_low, p.robot.joint_high, strict=True), 1):
        if low >= high:
            raise UsageError(f"{where}: robot.joint_low of J{n} must be below joint_high {high:g}, got {low:g}")
    low, high = p.robot.joint_low[2], p.robot.joint_high[2]
    if not low <= p.motion.rise_to <= high:
        raise UsageError(f"{where}: motion.rise_to must lie in the stroke of J3, {low:g} to {high:g} mm, "
                         f"got {p.motion.rise_to:g}")  # fmt: skip
    if p.part_nozzle.valve == p.scaffold_nozzle.valve:
        raise UsageError(f"{where}: both nozzles have valve {p.part_nozzle.valve}; give each its own output")
    if p.path.segment_time < p.path.tick:
        raise UsageError(f"{where}: path.segment_time {p.path.segment_time:g} s is below one tick of "
                         f"{p.path.tick:g} s; use at least that")  # fmt: skip
