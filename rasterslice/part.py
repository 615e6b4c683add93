"""What is sliced: the mesh that parameters name, placed; which of its slices; where its copies stand."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import ModelError, UsageError
from .grid import slice_heights
from .intake import read_meshes
from .mesh import Mesh, place_notes, transform
from .params import Params
from .paths import Layer, Paths
from .weld import weld

Heights = NDArray[np.float64]


class Plan(NamedTuple):
    """Which slices a part has.

    Attributes
    ----------
    heights : (K,) float64
        Cutting heights, mm, ascending, one for each slice that is written.
    cut : (N,) float64
        Heights at which the mesh is cut: the same, or what option 3 copies to all.
    scaffolded : (K,) bool
        Which of the slices get their scaffold.
    """

    heights: Heights
    cut: Heights
    scaffolded: NDArray[np.bool_]


def load_part(params: Params) -> tuple[Mesh, list[str]]:
    """Read, place and weld the mesh of a run; return it with what a user should know.

    Raises
    ------
    ModelError, UsageError
        As `read_mesh` and `transform`.
    """
    try:
        mesh = read_meshes(params.files, params.units, params.lenient)
        mesh = transform(mesh, params.scaling, params.rotation, params.translation)
    except ModelError as error:
        raise ModelError(f"{params.at('files')}{error}") from None
    except UsageError as error:
        raise UsageError(f"{params.at('units' if params.scaling is None else 'scaling')}{error}") from None
    notes = list(mesh.notes)
    if params.inexact:
        count = mesh.facets
        triangles, moved, lost = weld(mesh.triangles, params.tolerance)
        if not len(triangles):
            size = f"the tolerance of {params.tolerance:g} mm"
            at = params.at("tolerance")
            raise ModelError(f"{at}{mesh.path}: all {count} facets are smaller than {size}; use a smaller one")
        mesh = dataclasses.replace(mesh, vertices=triangles.reshape(-1, 3), faces=None)
        if moved:
            size = f"{params.tolerance:g} mm"
            notes.append(f"{mesh.path}: {moved} vertices within {size} of others were welded, {lost} facets vanished")
    if not mesh.high[2] > mesh.low[2]:
        size = " x ".join(f"{v:g}" for v in mesh.high - mesh.low)
        raise ModelError(f"{params.at('files')}{mesh.path}: the part is flat, {size} mm; nothing to slice")
    return mesh, [*notes, *(f"{mesh.path}: {note}" for note in _place_notes(mesh, params))]


def _place_notes(mesh: Mesh, params: Params) -> list[str]:
    if params.machine is None:
        return place_notes(mesh)
    from .profile import read_profile

    machine = read_profile(params.machine)
    return place_notes(mesh, machine.robot.joint_high[2] - machine.robot.joint_low[2], machine.name)


def plan_slices(params: Params, zmin: float, zmax: float) -> Plan:
    """Return the slices of a part between two heights.

    Heights of fractions are ``zmin + f * (zmax - zmin)``; a slice belongs to a fraction when its cutting height is
    not below the lower one and below the upper one, or is at 1.

    Raises
    ------
    UsageError
        When no slice is left.
    """
    try:
        heights = slice_heights(zmin, zmax, params.thickness, params.slice_position)
    except UsageError as error:
        raise UsageError(f"{params.at('thickness')}{error}") from None
    asked = _within(heights, zmin, zmax, params.part_fraction)
    if not asked.any():
        low, high = params.part_fraction
        raise UsageError(
            f"{params.at('part_fraction')}part fraction {low:g} {high:g} of a part {zmax - zmin:g} mm high holds "
            f"no slice of {params.thickness:g} mm; use a wider one"
        )
    heights = heights[asked]
    scaffolded = _within(heights, zmin, zmax, params.scaffold_subset)
    cut = heights
    if params.option == 3:
        # the upper of two like slices has nothing above it, as the top of the stack; the others are like the lower
        cut = np.repeat(heights[len(heights) // 2], min(2, len(heights)))
    return Plan(heights, cut, scaffolded)


def _within(heights: Heights, zmin: float, zmax: float, fraction: tuple[float, float]) -> NDArray[np.bool_]:
    low, high = (zmin + f * (zmax - zmin) for f in fraction)
    below = heights < high if fraction[1] < 1 else np.ones(len(heights), bool)
    above = heights >= low if fraction[0] > 0 else np.ones(len(heights), bool)
    return np.asarray(below & above)


def copies_of(plan: Plan, layer: Layer) -> list[Layer]:
    """Return the slices, from the top down, that one cut stands for, each with its own number and height."""
    count = len(plan.heights)
    if len(plan.cut) == count and plan.scaffolded[layer.index]:
        return [layer]
    if len(plan.cut) == count:
        numbers = [layer.index]
    else:
        numbers = [count - 1] if layer.index else list(range(count - 2, -1, -1))
    return [_as_slice(layer, k, float(plan.heights[k]), bool(plan.scaffolded[k])) for k in numbers]


def _as_slice(layer: Layer, k: int, z: float, scaffolded: bool) -> Layer:
    stats = {**layer.stats, "layer": k, "z": z}
    if scaffolded:
        return dataclasses.replace(layer, index=k, z=z, stats=stats)
    for name, value in stats.items():
        if name.startswith("scaffold_") and value is not None:
            stats[name] = type(value)(0)
    none, lines = Paths.empty(True), Paths.empty(False)
    region = none if layer.scaffold is not None else None
    return dataclasses.replace(
        layer, index=k, z=z, stats=stats, scaffold=region, scaffold_boundary=none, scaffold_fill=lines
    )


def copy_offsets(params: Params, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where each copy stands, (C, 2) mm: what is added to x and y of the paths of the first.

    Copies stand in rows along x, then the next row along y. Between two of them lie the scaffold of each, which
    reaches the buffer beyond the part, and `Params.copy_gap`: scaffolds of neighbours cannot touch.
    """
    across, _, count = params.copies
    gap = params.copy_gap
    if gap is None:
        gap = max(params.part_width, params.support_width if params.scaffolding else 0.0)
    reach = 2 * params.scaffold_buffer if params.scaffolding else 0.0
    # whole pixels: the copies then lie on the same grid as the first
    step = [math.ceil((float(high[i] - low[i]) + reach + gap) / params.pitch) * params.pitch for i in (0, 1)]
    number = np.arange(count)
    return np.stack([number % across * step[0], number // across * step[1]], axis=1)
