"""A mesh as facets in mm: read, checked, and placed in the part frame."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import ModelError, UsageError
from .meshfile import Faces, Vertices, read_file

#: Coordinates beyond this are a mistake of units: 1 km.
MAX_MM = 1e6
_CHUNK = 1 << 15  # facets in float64 at a time: 2.4 MB
_WIDE = 9 * 1024  # floats per row where columns are reduced: the loop over a row is then vectorised


@dataclass(frozen=True, slots=True)
class Mesh:
    """Facets of a part.

    Attributes
    ----------
    triangles : (T, 3, 3) float32
        Facet, corner, axis; mm, relative to `origin`.
    origin : (3,) float64
        Where (0, 0, 0) of `triangles` lies in the part frame, mm. It is 0 where the file's own float32
        hold the part well; else it lies at the part, so that nothing is lost 1e5 mm away.
    path : Path
        The file.
    low, high : (3,) float64
        Bounding box in the part frame, mm.
    """

    triangles: NDArray[np.float32]
    origin: NDArray[np.float64]
    path: Path
    low: NDArray[np.float64] = field(init=False)
    high: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        """Find the bounding box once."""
        low, high = bounds(self.triangles)
        object.__setattr__(self, "low", self.origin + low)
        object.__setattr__(self, "high", self.origin + high)


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file in hex; needs no lock, so that a thread may do it meanwhile."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ModelError(f"{path}: cannot read the mesh: {error.strerror}") from None


def bounds(points: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least and the greatest x, y, z of (..., 3) points; NaN where one is NaN."""
    flat = points.reshape(-1)
    cut = flat.size // _WIDE * _WIDE
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for rows in (flat[:cut].reshape(-1, _WIDE), flat[cut:].reshape(-1, 3)):
        if len(rows):
            low = np.minimum(low, rows.min(axis=0).reshape(-1, 3).min(axis=0))
            high = np.maximum(high, rows.max(axis=0).reshape(-1, 3).max(axis=0))
    return low, high


def read_mesh(path: str | Path) -> Mesh:
    """Read a mesh file, check it, and reduce it to its own origin where float32 needs that.

    Parameters
    ----------
    path : str or Path
        STL, PLY, or what `meshfile.read_file` knows; mm.

    Returns
    -------
    Mesh
        Every facet of the file in its order, in the frame of the file.

    Raises
    ------
    ModelError
        When the file is missing, unreadable or damaged, or holds no facets, vertices that are not
        finite or beyond `MAX_MM`, or facets of vertices that it does not have.
    """
    path = Path(path)
    vertices, faces = read_file(path)
    if (len(vertices) if faces is None else len(faces)) == 0:
        raise ModelError(f"{path}: holds no facets ({len(vertices)} vertices); nothing to slice")
    if faces is not None and (faces.min() < 0 or faces.max() >= len(vertices)):
        bad = int(faces.min()) if faces.min() < 0 else int(faces.max())
        raise ModelError(f"{path}: a facet names vertex {bad} of {len(vertices)}; the file is damaged")
    if vertices.dtype == np.float32:
        triangles = _gather(vertices, faces)
        low, high = bounds(triangles)
        _check(path, low, high, triangles)
        # far from 0 these differences are exact: both operands lie within a factor of 2 (Sterbenz)
        extent = high - low
        origin = np.where((low > extent) | (-high > extent), low, 0.0)
        if origin.any():
            triangles -= origin.astype(np.float32)
        return Mesh(triangles, origin, path)
    used = vertices if faces is None else vertices[_used(faces, len(vertices))]
    low, high = bounds(used)
    if not _sane(low, high):
        _check(path, low, high, used if faces is None else vertices[faces])
    with np.errstate(all="ignore"):  # vertices of no facet may be anything
        reduced = (vertices - low).astype(np.float32)
    return Mesh(_gather(reduced, faces), low, path)


def _used(faces: Faces, count: int) -> NDArray[np.bool_]:
    used = np.zeros(count, bool)
    used[faces] = True
    return used


def _gather(vertices: Vertices, faces: Faces | None) -> NDArray[np.float32]:
    """Return (T, 3, 3) corners; moving whole vertices is four times as fast as moving floats."""
    if faces is None:
        return vertices.astype(np.float32, copy=False).reshape(-1, 3, 3)
    corners = np.empty(faces.shape, "V12")
    source = np.ascontiguousarray(vertices, np.float32).view("V12").reshape(-1)
    for i in range(0, len(faces), _CHUNK):
        # the indices are checked: "clip" only spares NumPy a buffer
        np.take(source, faces[i : i + _CHUNK], out=corners[i : i + _CHUNK], mode="clip")
    return corners.view(np.float32).reshape(-1, 3, 3)


def _sane(low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
    return bool((low >= -MAX_MM).all() and (high <= MAX_MM).all())  # False for NaN too


def _check(path: Path, low: NDArray[np.float64], high: NDArray[np.float64], corners: Vertices) -> None:
    if _sane(low, high):
        return
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        bad = np.asarray(~np.isfinite(corners.reshape(-1, 9)).all(axis=1))
        raise ModelError(
            f"{path}: {int(bad.sum())} of {len(bad)} facets, the first is number {int(bad.argmax())}, have a "
            "vertex that is NaN or infinite; repair the model"
        )
    most = float(np.abs([low, high]).max())
    raise ModelError(f"{path}: a coordinate of {most:.3g} mm is beyond {MAX_MM:g} mm; check its units")


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
        In the part frame. Without scaling and rotation the facets are the same array, and only the
        origin moves: nothing is rounded.

    Raises
    ------
    UsageError
        When the part would lie beyond `MAX_MM`.
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
    placed = moved if not shift.any() else Mesh(moved.triangles, moved.origin + shift, mesh.path)
    if not _sane(placed.low, placed.high):
        most = float(np.abs([placed.low, placed.high]).max())
        raise UsageError(
            f"{mesh.path}: scaling, rotation and translation put the part at {most:.3g} mm, "
            f"beyond {MAX_MM:g} mm; use smaller values"
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
    base = mesh.low - mesh.origin  # of the facets as they are stored
    if np.array_equal(matrix, np.eye(3)):
        return Mesh(mesh.triangles, -base, mesh.path)
    boxes = [bounds(points) for points in _multiplied(mesh.triangles, base, matrix)]
    low = np.min([box[0] for box in boxes], axis=0)
    out = np.empty_like(mesh.triangles)
    for i, points in enumerate(_multiplied(mesh.triangles, base, matrix)):
        out[i * _CHUNK : (i + 1) * _CHUNK] = points - low
    return Mesh(out, low, mesh.path)


def _multiplied(
    triangles: NDArray[np.float32], base: NDArray[np.float64], matrix: NDArray[np.float64]
) -> Iterator[NDArray[np.float64]]:
    """Yield the turned points of one chunk of facets after the other, in float64.

    Sums are written out: BLAS may round the same vertex differently in two places, which opens seams.
    """
    for i in range(0, len(triangles), _CHUNK):
        x, y, z = np.moveaxis(triangles[i : i + _CHUNK] - base, -1, 0)
        yield np.stack([m[0] * x + m[1] * y + m[2] * z for m in matrix], axis=-1)
