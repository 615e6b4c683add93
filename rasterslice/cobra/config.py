"""What ``RSCFG.V2`` says: the settings that the controller really has, which may have been edited there."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ..errors import UsageError
from ..profile import Nozzle, Profile, range_faults
from .vplus import Program

_NEAR = 1e-4  # settings are written with four decimals


def configured(profile: Profile, program: Program) -> tuple[Profile, list[str]]:
    """Run ``rs.cfg`` and return the profile with its values, and what differs from the export.

    Parameters
    ----------
    profile : Profile
        That of the export; gives what is in no setting of the player.
    program : Program
        Holds ``rs.cfg``.

    Raises
    ------
    UsageError
        When a setting is missing, or a frame or a tool is turned.
    """
    program.call("rs.cfg")
    get = program.value
    nozzles = [_nozzle(n, i, program) for i, n in enumerate(profile.nozzles, 1)]
    m, base = profile.motion, profile.accel / profile.motion.accel_percent * 100
    made = replace(
        profile, part_nozzle=nozzles[0], scaffold_nozzle=nozzles[1],
        part=replace(profile.part, frame=_flat("rs.part", get("rs.part")), roll=float(get("rs.roll"))),
        robot=replace(profile.robot, elbow=get("rs.elbow")),
        motion=replace(
            m, accel=base, accel_percent=float(get("rs.acc")), travel_speed=float(get("rs.vt")),
            start_percent=float(get("rs.vj")), rise_to=float(get("rs.j3")), lift=float(get("rs.lift")),
            clearance=float(get("rs.clear")), purge_at=(float(get("rs.px")), float(get("rs.py"))),
            park_at=(float(get("rs.kx")), float(get("rs.ky"))),
        ),
        program=replace(profile.program, guard=bool(get("rs.grd")), running=get("rs.running")),
    )  # fmt: skip
    return made, _differences(asdict(profile), asdict(made))


def faults_of(made: Profile, export: Profile) -> list[str]:
    """Return what must not be in edited settings: beyond a range of the machine profile, or less safe than exported.

    Parameters
    ----------
    made : Profile
        From `configured`.
    export : Profile
        That of the export, whose checks hold for its height of rising only.
    """
    out = range_faults(made, "RSCFG.V2")
    rise, was = made.motion.rise_to, export.motion.rise_to
    if rise > was + _NEAR:
        out.append(f"RSCFG.V2: rs.j3 is {rise:g} mm, so the arm rises less than the export assumes; set it to {was:g} "
                   "or less, or change motion.rise_to in the machine profile and export again")  # fmt: skip
    return out


def _nozzle(nozzle: Nozzle, number: int, program: Program) -> Nozzle:
    offset = _flat(f"rs.tool[{number}]", program.value("rs.tool", number))
    valve, purge = program.value("rs.vlv", number), program.value("rs.purge", number)
    return replace(nozzle, offset=offset, valve=valve, purge=float(purge))


def _flat(name: str, value: Any) -> tuple[float, float, float]:
    """Return the place of a transformation that turns nothing."""
    if not isinstance(value, tuple) or len(value) != 6 or any(value[3:]):
        raise UsageError(
            f"RSCFG.V2: {name} must be TRANS(x, y, z, 0, 0, 0), got {value}: the model knows no turned frames and "
            "tools; turn the part instead (rotation in the parameter file)"
        )
    return float(value[0]), float(value[1]), float(value[2])


def _differences(old: dict[str, Any], new: dict[str, Any], prefix: str = "") -> list[str]:
    """Return the values that differ, one line each."""
    out = []
    for key, value in new.items():
        before = old[key]
        if isinstance(value, dict):
            out += _differences(before, value, f"{prefix}{key}.")
        elif not isinstance(value, str) and np.abs(np.subtract(value, before, dtype=float)).max() > _NEAR:
            out.append(f"{prefix}{key} is {_text(value)} in RSCFG.V2, {_text(before)} in the export")
    return out


def _text(value: Any) -> str:
    return " ".join(f"{v:g}" for v in value) if isinstance(value, tuple) else f"{value:g}"
