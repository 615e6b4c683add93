"""Program and trajectory of an Adept Cobra 600 (docs/cobra.md)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..cobra.bundle import write_bundle
from ..cobra.fit import Site
from ..cobra.foresee import Box, foresee
from ..paths import Layer
from ..profile import read_profile
from ..trajectory import Planner
from .format import Context


def precheck(context: Context, low: Box, high: Box) -> None:
    """Refuse what no slicing can make fit the machine, and a bad profile, before a layer is made.

    Raises
    ------
    UsageError
        With the value, the limit and what would help.
    """
    planner = _planner(context)
    inset = np.array([context.part_width / 2, context.part_width / 2, 0.0])  # of the outer bead's middle line
    first = low + (0, 0, context.bead_height("part"))  # heights are those of upper surfaces
    reach = context.settings["scaffold_buffer"] if context.settings["scaffolding"] else 0.0
    foresee(first + inset, high - inset, reach, planner.profile, _site(context, low))


def write(layers: Sequence[Layer], folder: Path, context: Context) -> None:
    """Write the program, the settings and the records of a job into a new folder.

    Raises
    ------
    UsageError
        When the machine profile is bad or the machine cannot do it; nothing is left then.
    """
    planner = _planner(context)
    widths = context.part_width, context.support_width
    site = _site(context, context.about.get("mesh", {}).get("low"))
    made = write_bundle(layers, folder, planner, context.stem, widths, site)
    context.warnings.extend(f"cobra: {text}" for text in made["warnings"])


def _planner(context: Context) -> Planner:
    s = context.settings
    profile = read_profile(Path(s["machine"]) if s.get("machine") else None)
    return Planner(
        profile, context.thickness, s.get("slice_position", 0.5), s.get("smooth_angle", 45.0),
        s.get("part_layers_per_slice", 2),
    )  # fmt: skip


def _site(context: Context, low: Sequence[float] | Box | None) -> Site:
    copies = np.array(context.about.get("copies") or [(0.0, 0.0)])
    return Site(copies, None if low is None else (float(low[0]), float(low[1])))
