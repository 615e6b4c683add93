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
    out = np.empty((sum(len(m.triangles) for m in meshes), 3, 3), np.float32)
    at, notes = 0, tuple(note for m in meshes for note in m.notes)
    for m in meshes:
        shift = m.origin - origin
        for i in range(0, len(m.triangles), CHUNK):
            part = m.triangles[i : i + CHUNK]
            out[at : at + len(part)] = part + shift if shift.any() else part
            at += len(part)
    return Mesh(out, origin, paths[0], notes, any(m.own_units for m in meshes))


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
    if vertices.dtype == np.float32:
        triangles, origin = _reduced_facets(path, gather(vertices, faces), notes)
    else:
        triangles, origin = _reduced_vertices(path, vertices, faces, notes)
    mm = UNITS[units] if file.mm is None else file.mm
    mesh = Mesh(triangles, origin, path)
    most = mm * float(np.abs([mesh.low, mesh.high]).max())
    if most > _MOST_MM:
        raise ModelError(f"{path}: a coordinate of {most:.3g} mm is beyond {_MOST_MM:g} mm; check its units")
    if most > FAR_MM:
        notes.append(f"a coordinate of {most:.3g} mm is beyond {FAR_MM:g} mm; check its units")
    if mm != 1.0:
        for i in range(0, len(triangles), CHUNK):
            triangles[i : i + CHUNK] = triangles[i : i + CHUNK].astype(np.float64) * mm
        mesh = Mesh(triangles, origin * mm, path)
    named = tuple(f"{path}: {note}" for note in notes)
    return dataclasses.replace(mesh, notes=named, own_units=file.mm is not None)


def _reduced_facets(
    path: Path, triangles: NDArray[np.float32], notes: list[str]
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Take float32 corners to their own origin, where they lie far from 0, without a rounding."""
    low, high = bounds(triangles)
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        triangles = triangles[_finite(path, triangles.reshape(-1, 9), None, notes)]
        low, high = bounds(triangles)
    # far from 0 these differences are exact: both operands lie within a factor of 2 (Sterbenz)
    extent = high - low
    origin = np.where((low > extent) | (-high > extent), low, 0.0)
    if origin.any():
        triangles -= origin.astype(np.float32)
    return triangles, origin


def _reduced_vertices(
    path: Path, vertices: Vertices, faces: Faces | None, notes: list[str]
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Take float64 vertices to their own origin, and round them there."""
    used = vertices if faces is None else vertices[_used(faces, len(vertices))]
    low, high = bounds(used)
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        kept = _finite(path, vertices, faces, notes)
        if faces is None:
            used = vertices = vertices.reshape(-1, 9)[kept].reshape(-1, 3)
        else:
            faces = faces[kept]
            used = vertices[_used(faces, len(vertices))]
        low, high = bounds(used)
    most = float(np.abs([low, high]).max())
    if most > 1e30:  # float32 ends at 3e38
        raise ModelError(f"{path}: a coordinate of {most:.3g} is no length; the file is damaged")
    far = (low > high - low) | (-high > high - low)
    origin = np.where(far, low, 0.0) if far.any() and not _are_single(used) else np.zeros(3)
    reduced = np.empty((len(vertices), 3), np.float32)
    with np.errstate(all="ignore"):  # vertices of no facet may be anything
        for i in range(0, len(vertices), CHUNK):
            reduced[i : i + CHUNK] = vertices[i : i + CHUNK] - origin
    triangles = gather(reduced, faces)
    return (triangles, origin) if origin.any() else _reduced_facets(path, triangles, notes)


def _are_single(vertices: Vertices) -> bool:
    """Return whether all numbers are float32, or float32 that were written with nine digits."""
    for i in range(0, len(vertices), CHUNK):
        part = vertices[i : i + CHUNK]
        if (np.abs(part.astype(np.float32) - part) > 6e-9 * np.abs(part)).any():
            return False
    return True


def _finite(path: Path, vertices: Vertices, faces: Faces | None, notes: list[str]) -> NDArray[np.bool_]:
    """Return which facets are finite; the others are noted, or too many."""
    finite = np.asarray(np.isfinite(vertices.reshape(-1, 9) if faces is None else vertices).all(axis=1))
    if faces is not None:
        finite = np.asarray(finite[faces].all(axis=1))
    bad, count = int((~finite).sum()), len(finite)
    what = f"{bad} of {count} facets, the first is number {int(finite.argmin())}, have a vertex that is NaN or infinite"
    if bad > DROPPED * count:
        raise ModelError(f"{path}: {what}; more than {DROPPED:.0%} cannot be dropped: repair the model")
    notes.append(f"{what}; they are dropped")
    return finite


def _used(faces: Faces, count: int) -> NDArray[np.bool_]:
    used = np.zeros(count, bool)
    used[faces] = True
    return used


def gather(vertices: Vertices, faces: Faces | None) -> NDArray[np.float32]:
    """Return (T, 3, 3) corners; moving whole vertices is four times as fast as moving floats."""
    if faces is None:
        return vertices.astype(np.float32, copy=False).reshape(-1, 3, 3)
    corners = np.empty(faces.shape, "V12")
    source = np.ascontiguousarray(vertices, np.float32).view("V12").reshape(-1)
    for i in range(0, len(faces), CHUNK):
        # the indices are checked: "clip" only spares NumPy a buffer
        np.take(source, faces[i : i + CHUNK], out=corners[i : i + CHUNK], mode="clip")
    return corners.view(np.float32).reshape(-1, 3, 3)
