"""A mesh as facets in mm: read, checked, and placed in the part frame."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import ModelError, UsageError
from .interrupts import unbroken

#: Coordinates beyond this look like a mistake of units, and no part is as large: 1 km.
FAR_MM = 1e6
#: A part that is larger than this, or higher than the stroke of its machine (here a Cobra 600), is reported.
LARGE_MM, TALL_MM = 2000.0, 210.0
CHUNK = 1 << 15  # facets or vertices at a time: 2.4 MB in float64 at most
_WIDE = 9 * 1024  # floats per row where columns are reduced: the loop over a row is then vectorised


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Facets of a part.

    Attributes
    ----------
    vertices : (N, 3) float32
        Each of them is a corner of a facet; mm, relative to `origin`.
    faces : (T, 3) int32, or None
        The corners of each facet; None when every three vertices make one.
    origin : (3,) float64
        Where (0, 0, 0) of `vertices` lies in the part frame, mm. It is 0 where the file's own float32
        hold the part well; else it lies at the part, so that nothing is lost 1e5 mm away.
    path : Path
        The file, or the first of several.
    notes : tuple of str
        What a user should know about the files, each with the name of its file.
    own_units : bool
        Whether one of the files names its unit, so that nothing about units is to be guessed.
    low, high : (3,) float64
        Bounding box in the part frame, mm.
    box : tuple
        Vertices, and their bounding box as they are stored: kept while the same vertices are moved.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32] | None
    origin: NDArray[np.float64]
    path: Path
    notes: tuple[str, ...] = ()
    own_units: bool = False
    low: NDArray[np.float64] = field(init=False)
    high: NDArray[np.float64] = field(init=False)
    box: tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.float64]] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Find the bounding box, unless it is known from a mesh of the same vertices."""
        if self.box is None or self.box[0] is not self.vertices:
            object.__setattr__(self, "box", (self.vertices, *bounds(self.vertices)))
        assert self.box is not None
        _, low, high = self.box
        object.__setattr__(self, "low", self.origin + low)
        object.__setattr__(self, "high", self.origin + high)

    @property
    def facets(self) -> int:
        """How many facets there are."""
        return len(self.vertices) // 3 if self.faces is None else len(self.faces)

    @property
    def triangles(self) -> NDArray[np.float32]:
        """Facet, corner, axis: (T, 3, 3), made when it is asked for unless the vertices are in that order."""
        if self.faces is None:
            return self.vertices.reshape(-1, 3, 3)
        corners = np.empty(self.faces.shape, "V12")  # moving whole vertices is four times as fast as moving floats
        source = np.ascontiguousarray(self.vertices).view("V12").reshape(-1)
        for i in range(0, len(corners), CHUNK):
            # the indices were checked: "clip" only spares NumPy a buffer
            np.take(source, self.faces[i : i + CHUNK], out=corners[i : i + CHUNK], mode="clip")
        return corners.view(np.float32).reshape(-1, 3, 3)


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file in hex; needs no lock, so that a thread may do it meanwhile."""
    try:
        if path.exists() and not path.is_file():
            raise ModelError(f"{path}: is not a file on disk; name a mesh file")
        with path.open("rb") as file:
            with unbroken():
                import hashlib  # loads OpenSSL, which reading need not wait for
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ModelError(f"{path}: cannot read the mesh: {error.strerror}") from None


def bounds(points: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least and the greatest x, y, z of (..., 3) points; NaN where one is NaN."""
    flat = points.reshape(-1)
    cut = flat.size // _WIDE * _WIDE
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    with np.errstate(invalid="ignore"):  # a NaN is passed on, whatever its bits
        for rows in (flat[:cut].reshape(-1, _WIDE), flat[cut:].reshape(-1, 3)):
            if len(rows):
                low = np.minimum(low, rows.min(axis=0).reshape(-1, 3).min(axis=0))
                high = np.maximum(high, rows.max(axis=0).reshape(-1, 3).max(axis=0))
    return low, high


def sane(low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
    """Return whether a part is of a size that can be sliced, and lies where float64 resolves it."""
    return bool((high - low <= FAR_MM).all() and (np.abs([low, high]) <= 1000 * FAR_MM).all())  # False for NaN too


def size_notes(mesh: Mesh) -> list[str]:
    """Return what the size of a mesh says about its units."""
    largest = float((mesh.high - mesh.low).max())
    if largest < 1.0 and mesh.own_units:
        return [f"the model is {largest:.3g} mm large, in the units that its file names; scale it if that is wrong"]
    if largest > LARGE_MM and mesh.own_units:
        return [f"the model is {largest:.6g} mm large, in the units that its file names; scale it"]
    if largest < 1.0:
        return [f"the model is {largest:.3g} mm large; if its file is in metres or inches, write units = m or inch"]
    if largest > LARGE_MM:
        return [f"the model is {largest:.6g} mm large; check the units of its file, or scale it"]
    return []


def place_notes(mesh: Mesh, stroke: float = TALL_MM, machine: str = "a Cobra 600") -> list[str]:
    """Return what is odd about where a part lies, and how large it is for a machine, in the part frame."""
    notes, extent = size_notes(mesh), mesh.high - mesh.low
    if mesh.low[2] < -1e-6 * max(float(extent[2]), 1.0):
        notes.append(
            f"the part lies partly below the bed, from z = {mesh.low[2]:.6g} to {mesh.high[2]:.6g} mm; check the "
            "rotation, or set the translation of z to 0"
        )
    if stroke < extent[2] <= LARGE_MM:
        notes.append(
            f"the part is {extent[2]:.6g} mm high, more than the {stroke:g} mm that {machine} reaches; lay it on "
            "its side by a rotation, or scale it"
        )
    return notes


def transform(
    mesh: Mesh,
    scaling: Sequence[float] | None,
    rotation: Sequence[float] | None,
    translation: Sequence[float | str] | None,
) -> Mesh:
    """Scale, turn and place a mesh as the parameter file says.

    Parameters
    ----------
    mesh : Mesh
        In the frame of its file.
    scaling : three floats, or None
        Factors (> 0) along the fixed axes, after the rotation.
    rotation : three floats, or None
        1-2-3 Euler angles, degrees: about x, the new y, the new z.
    translation : three floats or str, or None
        Per axis: where the minimum goes, mm; or ``"cent"``, the centre of the box at 0; or ``"orig"``,
        the centre where it was in the file. None: the lowest point goes to z = 0.

    Returns
    -------
    Mesh
        In the part frame. Without scaling and rotation the vertices are the same array, and only the
        origin moves: nothing is rounded.

    Raises
    ------
    UsageError
        When the part would be larger than `FAR_MM`, or lie 1000 times as far away.
    """
    centre = (mesh.low + mesh.high) / 2
    moved = mesh
    if scaling is not None or rotation is not None:
        matrix = np.array(scaling or (1.0, 1.0, 1.0))[:, None] * _euler(*(rotation or (0.0, 0.0, 0.0)))
        moved = _apply(mesh, matrix)
    low, high = moved.low, moved.high
    if translation is None:
        shift = np.array([0.0, 0.0, -low[2]])
    else:
        targets = {"cent": -(low + high) / 2, "orig": centre - (low + high) / 2}
        shift = np.array([targets[str(t)][i] if isinstance(t, str) else t - low[i] for i, t in enumerate(translation)])
    placed = moved if not shift.any() else dataclasses.replace(moved, origin=moved.origin + shift)
    if not sane(placed.low, placed.high):
        size, most = float((placed.high - placed.low).max()), float(np.abs([placed.low, placed.high]).max())
        raise UsageError(
            f"{mesh.path}: the part is {size:.3g} mm large, at {most:.3g} mm, after scaling, rotation and translation; "
            f"the limit is {FAR_MM:g} mm; check units and scaling"
        )
    return placed


def _euler(a: float, b: float, c: float) -> NDArray[np.float64]:
    """Return the matrix of 1-2-3 Euler angles, exact for multiples of 90 degrees."""
    (ca, sa), (cb, sb), (cc, sc) = (_cos_sin(angle) for angle in (a, b, c))
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
    about_y = np.array([[cb, 0.0, sb], [0.0, 1.0, 0.0], [-sb, 0.0, cb]])
    about_z = np.array([[cc, -sc, 0.0], [sc, cc, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_x @ about_y @ about_z)  # the new axes: the later rotation comes first


def _cos_sin(degrees: float) -> tuple[float, float]:
    quarter, rest = divmod(degrees, 90.0)
    c, s = math.cos(math.radians(rest)), math.sin(math.radians(rest))
    return ((c, s), (-s, c), (-c, -s), (s, -c))[int(quarter) % 4]


def _apply(mesh: Mesh, matrix: NDArray[np.float64]) -> Mesh:
    """Move the low corner of the box to 0, then multiply; the result lies on its own box."""
    base = mesh.low - mesh.origin  # of the vertices as they are stored
    if np.array_equal(matrix, np.eye(3)):
        return dataclasses.replace(mesh, origin=-base)
    boxes = [bounds(points) for points in _multiplied(mesh.vertices, base, matrix)]
    low = np.min([box[0] for box in boxes], axis=0)
    out = np.empty_like(mesh.vertices)
    for i, points in enumerate(_multiplied(mesh.vertices, base, matrix)):
        out[i * CHUNK : (i + 1) * CHUNK] = points - low
    return dataclasses.replace(mesh, vertices=out, origin=low)


def _multiplied(
    vertices: NDArray[np.float32], base: NDArray[np.float64], matrix: NDArray[np.float64]
) -> Iterator[NDArray[np.float64]]:
    """Yield the turned points of one chunk of vertices after the other, in float64.

    Sums are written out: BLAS may round the same vertex differently in two places, which opens seams.
    """
    for i in range(0, len(vertices), CHUNK):
        x, y, z = (vertices[i : i + CHUNK] - base).T
        yield np.stack([m[0] * x + m[1] * y + m[2] * z for m in matrix], axis=-1)
