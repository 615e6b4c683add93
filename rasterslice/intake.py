"""Mesh files -> one clean mesh in mm: units, dirt, several files made one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import ModelError
from .mesh import CHUNK, FAR_MM, Mesh, bounds
from .meshfile import read_file
from .plyfile import Vertices
from .plyhead import Faces
from .settings import UNITS

#: Facets with a vertex that is not finite are dropped up to this share; more of them are an error.
DROPPED = 0.01
_MOST_MM = 1e9  # float64 resolves 1e-7 mm there


def read_meshes(paths: Sequence[Path], units: str = "mm", lenient: bool = False) -> Mesh:
    """Read mesh files into one mesh, whose facets are those of the files one after the other.

    Parameters
    ----------
    paths : sequence of Path
        At least one.
    units, lenient
        As for `read_mesh`.

    Returns
    -------
    Mesh
        With the path of the first file and the notes of all. Overlapping shells stay as they are: the winding
        rule unites them.

    Raises
    ------
    ModelError
        As `read_mesh`.
    """
    meshes = [read_mesh(path, units, lenient) for path in paths]
    if len(meshes) == 1:
        return meshes[0]
    origin = np.min([m.low for m in meshes], axis=0) if any(m.origin.any() for m in meshes) else np.zeros(3)
    vertices = np.empty((sum(len(m.vertices) for m in meshes), 3), np.float32)
    faces = np.empty((sum(m.facets for m in meshes), 3), np.int32)
    at, made = 0, 0
    for m in meshes:
        own = np.arange(len(m.vertices), dtype=np.int32).reshape(-1, 3) if m.faces is None else m.faces
        faces[made : made + len(own)] = own + np.int32(at)
        made += len(own)
        shift = m.origin - origin
        for i in range(0, len(m.vertices), CHUNK):
            part = m.vertices[i : i + CHUNK]
            vertices[at : at + len(part)] = part + shift if shift.any() else part
            at += len(part)
    notes = tuple(note for m in meshes for note in m.notes)
    return Mesh(vertices, faces, origin, paths[0], notes, any(m.own_units for m in meshes))


def read_mesh(path: str | Path, units: str = "mm", lenient: bool = False) -> Mesh:
    """Read a mesh file, clean it, and reduce it to its own origin where float32 needs that.

    Parameters
    ----------
    path : str or Path
        STL, PLY, or what `meshfile.read_file` knows.
    units : str
        One of `UNITS`, for files that do not name their own.
    lenient : bool
        Whether a file that is cut short gives the facets that are whole.

    Returns
    -------
    Mesh
        The facets of the file in their order, mm, in the frame of the file, without those that have a vertex
        that is not finite; `notes` says how many these were, and what else is odd.

    Raises
    ------
    ModelError
        When the file is missing, unreadable or damaged; holds no facets, or facets of vertices that it does not
        have; when more than 1 % of its facets are not finite; or a coordinate is beyond 1e9 mm.
    """
    path = Path(path)
    file = read_file(path, lenient)
    vertices, faces = file.vertices, file.faces
    if (len(vertices) // 3 if faces is None else len(faces)) == 0:
        raise ModelError(f"{path}: holds no facets ({len(vertices)} vertices); nothing to slice")
    if faces is not None and (faces.min() < 0 or faces.max() >= len(vertices)):
        bad = int(faces.min()) if faces.min() < 0 else int(faces.max())
        raise ModelError(f"{path}: a facet names vertex {bad} of {len(vertices)}; the file is damaged")
    notes = list(file.notes)
    vertices, faces = _finite_only(path, *_used_only(vertices, faces), notes)
    vertices, origin = _reduced(path, vertices)
    mm = UNITS[units] if file.mm is None else file.mm
    mesh = Mesh(vertices, faces, origin, path)
    most = mm * float(np.abs([mesh.low, mesh.high]).max())
    if most > _MOST_MM:
        raise ModelError(f"{path}: a coordinate of {most:.3g} mm is beyond {_MOST_MM:g} mm; check its units")
    if most > FAR_MM:
        notes.append(f"a coordinate of {most:.3g} mm is beyond {FAR_MM:g} mm; check its units")
    if mm != 1.0:
        for i in range(0, len(vertices), CHUNK):
            vertices[i : i + CHUNK] = vertices[i : i + CHUNK].astype(np.float64) * mm
        mesh = Mesh(vertices, faces, origin * mm, path)
    named = tuple(f"{path}: {note}" for note in notes)
    return dataclasses.replace(mesh, notes=named, own_units=file.mm is not None)


def _used_only(vertices: Vertices, faces: Faces | None) -> tuple[Vertices, NDArray[np.int32] | None]:
    """Leave out vertices of no facet, which may be anything; the order stays."""
    if faces is None:
        return vertices, None
    used = np.zeros(len(vertices), bool)
    for i in range(0, len(faces), CHUNK):  # NumPy makes wider numbers of all that it is given
        used[faces[i : i + CHUNK]] = True
    if used.all():
        return vertices, faces.astype(np.int32, copy=False)
    number = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return vertices[used], number[faces]


def _finite_only(
    path: Path, vertices: Vertices, faces: NDArray[np.int32] | None, notes: list[str]
) -> tuple[Vertices, NDArray[np.int32] | None]:
    """Drop facets with a vertex that is not finite; they are noted, or too many."""
    if np.isfinite(bounds(vertices)).all():
        return vertices, faces
    finite = np.asarray(np.isfinite(vertices.reshape(-1, 9) if faces is None else vertices).all(axis=1))
    if faces is not None:
        finite = np.asarray(finite[faces].all(axis=1))
    bad, count = int((~finite).sum()), len(finite)
    what = f"{bad} of {count} facets, the first is number {int(finite.argmin())}, have a vertex that is NaN or infinite"
    if bad > DROPPED * count:
        raise ModelError(f"{path}: {what}; more than {DROPPED:.0%} cannot be dropped: repair the model")
    notes.append(f"{what}; they are dropped")
    if faces is None:
        return vertices.reshape(-1, 9)[finite].reshape(-1, 3), None
    return _used_only(vertices, faces[finite])


def _reduced(path: Path, vertices: Vertices) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Take vertices to their own origin, where they lie far from 0, and round those in float64 there."""
    origin = np.zeros(3)
    if vertices.dtype != np.float32:
        low, high = bounds(vertices)
        most = float(np.abs([low, high]).max())
        if most > 1e30:  # float32 ends at 3e38
            raise ModelError(f"{path}: a coordinate of {most:.3g} is no length; the file is damaged")
        far = (low > high - low) | (-high > high - low)
        if far.any() and not _are_single(vertices):
            origin = np.where(far, low, 0.0)
        single = np.empty((len(vertices), 3), np.float32)
        for i in range(0, len(vertices), CHUNK):
            single[i : i + CHUNK] = vertices[i : i + CHUNK] - origin
        vertices = single
    if not origin.any():
        # far from 0 these differences are exact: both operands lie within a factor of 2 (Sterbenz)
        low, high = bounds(vertices)
        origin = np.where((low > high - low) | (-high > high - low), low, 0.0)
        if origin.any():
            vertices -= origin.astype(np.float32)
    return vertices.astype(np.float32, copy=False), origin


def _are_single(vertices: Vertices) -> bool:
    """Return whether all numbers are float32, or float32 that were written with nine digits."""
    for i in range(0, len(vertices), CHUNK):
        part = vertices[i : i + CHUNK]
        if (np.abs(part.astype(np.float32) - part) > 6e-9 * np.abs(part)).any():
            return False
    return True
