"""What one entry of the table of formats is, and what every format is told."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..grid import Grid
from ..paths import Layer

Box = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """What a format needs to know besides the layers; all lengths in mm.

    Attributes
    ----------
    stem : str
        Name of the job, that of the parameter file without its ending.
    grid : Grid
        The pixels, whose box holds every path.
    thickness, part_width, support_width : float
        Height of a slice, and widths of the beads.
    slice_position : float
        Where in its slice a layer was cut, 0 (bottom) to 1 (top).
    about : dict
        The manifest as far as it is known, for what tells about the run.
    settings : mapping
        Every parameter, as the manifest holds it; empty where there was no job.
    warnings : list of str
        Where a format says what it left out.
    """

    stem: str
    grid: Grid
    thickness: float
    part_width: float
    support_width: float
    slice_position: float = 0.5
    about: dict[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    @property
    def part_layers(self) -> int:
        """How many ice layers a slice has; one where there was no job."""
        return int(self.settings.get("part_layers_per_slice", 1))

    def top(self, layer: Layer, share: float = 1.0) -> float:
        """Return the height of the upper surface of a slice, or of a share of it, mm, in the part frame."""
        return layer.z + (share - self.slice_position) * self.thickness

    def above_plate(self, layer: Layer, share: float = 1.0) -> float:
        """Return the height above the plate of the upper surface of a slice, or of a share of it, mm."""
        return (layer.index + share) * self.thickness

    def bead_height(self, material: str) -> float:
        """Return the height of a bead of ``part`` or ``scaffold``, mm."""
        return self.thickness / (self.part_layers if material == "part" else 1)

    def width(self, material: str) -> float:
        """Return the width of a bead of ``part`` or ``scaffold``, mm."""
        return self.part_width if material == "part" else self.support_width


#: Names at the top of an output folder that are the run's own, whatever the job is called.
RESERVED = frozenset({"layers", "layers.csv", "manifest.json", "report.html", "sheet.png", "svg", "png"})


class Format(NamedTuple):
    """One entry of the table.

    Attributes
    ----------
    target : str
        File or folder inside the output folder; ``{stem}`` stands for the name of the job.
    write : callable
        ``write(layers, destination, context)`` makes that file or folder from layers in print order.
    needs_regions : bool
        Whether it draws `Layer.part` and `Layer.scaffold`, which are traced only then.
    description : str
        One line for the help.
    wants_regions : bool
        Whether regions are traced for what reads the format later, though it can be written without.
    precheck : callable, optional
        ``precheck(context, low, high)`` refuses before slicing what is known then to fail: of a part between two
        corners, mm, whose heights are those of the bottom of the first slice and the top of the last.
    """

    name: str
    target: str
    write: Callable[[Sequence[Layer], Path, Context], None]
    needs_regions: bool
    description: str
    wants_regions: bool = False
    precheck: Callable[[Context, Box, Box], None] | None = None

    def path(self, stem: str) -> str:
        """Return the file or folder of a job's export, relative to the output folder.

        A name that is `RESERVED` is not taken: the stem gets a ``_``, so that a job called ``layers`` makes
        ``layers_.csv``. Letters are compared without their case, because some disks do.
        """
        name = self.target.format(stem=stem)
        if "{stem}" in self.target and name.casefold() in RESERVED:
            return self.target.format(stem=f"{stem}_")
        return name
