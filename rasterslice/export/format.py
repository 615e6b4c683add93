"""What one entry of the table of formats is, and what every format is told."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..grid import Grid
from ..paths import Layer


@dataclass(frozen=True, slots=True)
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
    """

    stem: str
    grid: Grid
    thickness: float
    part_width: float
    support_width: float


@dataclass(frozen=True, slots=True)
class Format:
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
    """

    name: str
    target: str
    write: Callable[[Sequence[Layer], Path, Context], None]
    needs_regions: bool
    description: str
