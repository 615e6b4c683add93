"""Program and trajectory of an Adept Cobra 600 (docs/cobra.md)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..cobra.bundle import write_bundle
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
    made = write_bundle(layers, folder, planner, context.stem, widths)
    context.warnings.extend(f"cobra: {text}" for text in made["warnings"])
