"""A first parameter file for a mesh: values that slice it as it is, with the reasons beside them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import ModelError, UsageError, counted
from .intake import read_meshes
from .mesh import FAR_MM, LARGE_MM, TALL_MM, Mesh
from .params import Params, write_params
from .settings import UNITS

_MOST_PIXELS = 4e6  # of a layer: 16 MB of distances
_FINEST = 1e-3  # mm: slices, pixels and steps are not smaller, see `settings.SPECS`
_SMALLEST = 0.04  # mm: twenty beads of two pixels
_LEAST_SCALE = 1e-6


def starter(files: list[Path], source: Path, lenient: bool = False, units: str | None = None) -> tuple[str, list[str]]:
    """Return a commented parameter file for mesh files, which runs as it is, and what a user should know of them.

    Parameters
    ----------
    files : list of Path
    source : Path
        Where the text will stand: the names of the meshes are relative to it.
    lenient : bool
        Whether a mesh file that is cut short is taken as far as it goes.
    units : str, optional
        Of files that do not name their own; default mm, or m where mm would make the model smaller than a bead.

    Raises
    ------
    RasterSliceError
        When a mesh cannot be read, a name cannot be written, or no parameters slice a part as small or as large.
    """
    mesh = read_meshes([f.absolute() for f in files], units or "mm", lenient)
    if not (mesh.high > mesh.low).all():
        flat = " x ".join(f"{v:g}" for v in mesh.high - mesh.low)
        raise ModelError(f"{files[0]}: the mesh is flat, {flat} mm; nothing to slice")
    unit = units or _unit(mesh)
    size = (mesh.high - mesh.low) * (1.0 if units else UNITS[unit])
    factor = _round(TALL_MM / float(size.max()), 0.0) if size.max() > LARGE_MM else 1.0
    size = size * factor
    rotation = (-90.0, 0.0, 0.0) if size[2] > TALL_MM >= size[1] >= _FINEST else None
    if rotation:
        size = size[[0, 2, 1]]
    _check_size(files[0], mesh, size, factor, unit)
    width = 1.5 if float(size.max()) >= 20 else _round(float(size.max()) / 20)
    thickness = _round(min(0.4, width / 1.5 * 0.4, float(size[2]) / 5))
    buffer = 5.0 if width == 1.5 else _round(3 * width)
    area = float((size[0] + 2 * buffer) * (size[1] + 2 * buffer))
    pitch = _round(min(width / 2, max(width / 7.5, math.sqrt(area / _MOST_PIXELS))))
    params = Params(
        tuple(f.absolute() for f in files), rotation=rotation, scaling=(factor,) * 3 if factor < 1 else None,
        translation=("cent", "cent", 0.0),
        part_width=width, support_width=width, thickness=thickness, scaffold_buffer=buffer, pitch=pitch,
        units=unit, min_point_spacing=min(0.2, max(width / 7.5, _FINEST)), source=source.absolute(),
        export=("sheet",), lenient=lenient,
    )  # fmt: skip
    x, y, z = (f"{v:.6g}" for v in size)
    facets, slices = counted(mesh.facets, "facet"), counted(math.ceil(size[2] / thickness), "slice")
    guesses = _guesses(mesh, None if units else unit, factor, rotation is not None)
    head = [f"{facets}; {x} x {y} x {z} mm as sliced, {slices} or so.", *(f"Guessed: {text}" for text in guesses)]
    notes = [*mesh.notes, *(f"{source}: guessed: {text}" for text in guesses)]
    return "\n".join(f"% {line}" for line in head) + "\n\n" + write_params(params), notes


def _check_size(file: Path, mesh: Mesh, size: NDArray[np.float64], factor: float, unit: str) -> None:
    """Refuse what no parameters slice; `size` is that of the part as it would be sliced."""
    x, y, z = (f"{v:.4g}" for v in size)
    told = "its own units" if mesh.own_units else f"units = {unit}"
    part = f"{file}: the part would be {x} x {y} x {z} mm (with {told}, scaled by {factor:g})"
    remedy = "scale the model" + ("" if mesh.own_units else ", or name its units with --units")
    if factor < _LEAST_SCALE:
        raise ModelError(f"{part}; the least scale factor is {_LEAST_SCALE:g}: {remedy}")
    if size.max() < _SMALLEST:
        raise ModelError(f"{part}; it must be {_SMALLEST:g} mm large or more, for beads of two pixels: {remedy}")
    if size[2] < _FINEST:
        raise ModelError(f"{part}; it must be {_FINEST:g} mm high or more, which is the thinnest slice: {remedy}")


def _guesses(mesh: Mesh, unit: str | None, factor: float, turned: bool) -> list[str]:
    """Return what was guessed, why, and what to change where it is wrong."""
    largest = float((mesh.high - mesh.low).max())
    found = []
    if unit not in (None, "mm"):
        why = f"the model is {largest:.3g} large, and in mm would be smaller than a bead"
        found.append(f"units = {unit}, because {why}; change units where that is wrong")
    if factor < 1:
        why = f"the model is {largest:.6g} mm large and no machine is"
        why += "" if mesh.own_units else "; check the units of its file"
        found.append(f"scaling by {factor:g}, because {why}")
    if turned:
        why = f"the model is higher than the {TALL_MM:g} mm that a Cobra 600 reaches"
        found.append(f"rotation by -90 degrees about x, because {why}")
    return found


def _unit(mesh: Mesh) -> str:
    """Guess the unit of a mesh: mm, unless that makes it smaller than a bead; nothing where a file names its own."""
    largest, far = float((mesh.high - mesh.low).max()), float(np.abs([mesh.low, mesh.high]).max())
    return "m" if not mesh.own_units and largest < 1.0 and far <= FAR_MM else "mm"


def _round(value: float, least: float = _FINEST) -> float:
    """Return a value with two digits, rounded down, so that it can be read."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{max(math.floor(value / step + 1e-4) * step, least):.6g}")


def write_starter(files: list[Path], target: Path, lenient: bool = False, units: str | None = None) -> list[str]:
    """Write `starter` to a new file; return what a user should know of the meshes.

    Raises
    ------
    UsageError
        When the file exists or cannot be written.
    """
    text, notes = starter(files, target, lenient, units)
    try:
        with target.open("x", encoding="utf-8", newline="\n") as file:
            file.write(text)
    except FileExistsError:
        raise UsageError(f"{target}: exists and is not replaced; name another with -o") from None
    except OSError as error:
        raise UsageError(f"{target}: cannot be written: {error.strerror}") from None
    return notes
