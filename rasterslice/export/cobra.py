"""Program and trajectory of an Adept Cobra 600 (docs/cobra.md)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..cobra.bundle import write_bundle
from ..cobra.fit import Site
from ..paths import Layer
from ..profile import read_profile
from ..trajectory import Planner
from .format import Context


def write(layers: Sequence[Layer], folder: Path, context: Context) -> None:
    """Write the program, the settings and the records of a job into a new folder.

    Raises
    ------
    UsageError
        When the machine profile is bad or the machine cannot do it; nothing is left then.
    """
    s = context.settings
    profile = read_profile(Path(s["machine"]) if s.get("machine") else None)
    planner = Planner(
        profile, context.thickness, s.get("slice_position", 0.5), s.get("smooth_angle", 45.0),
        s.get("part_layers_per_slice", 2),
    )  # fmt: skip
    widths = context.part_width, context.support_width
    low = context.about.get("mesh", {}).get("low")
    site = Site(np.array(context.about.get("copies") or [(0.0, 0.0)]), tuple(low[:2]) if low else None)
    made = write_bundle(layers, folder, planner, context.stem, widths, site)
    context.warnings.extend(f"cobra: {text}" for text in made["warnings"])
