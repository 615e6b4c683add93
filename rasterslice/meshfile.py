"""Mesh files: bytes to vertices and facets, with nothing welded, dropped or guessed.

The format is known by the content. No number of a header allocates anything before the size of the file confirms it.
What only some formats need is imported when one comes; 3MF and GLB go through trimesh (0.8 s).
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import ModelError, counted
from .interrupts import unbroken
from .meshkind import HEAD, STL_HEAD, facet_count, kind_of
from .plyfile import Vertices, read_ply
from .plyhead import Faces

_FACET = np.dtype([("normal", "V12"), ("corners", "V36"), ("attribute", "V2")])  # of binary STL
_CHUNK = 1 << 15  # facets of binary STL that are read at a time

Found = tuple[Vertices, Faces | None, list[str]]


class MeshFile(NamedTuple):
    """What a mesh file holds.

    Attributes
    ----------
    vertices : (N, 3) float32 or float64
        As precise as the file has them; may hold values that are not finite.
    faces : (T, 3) int or None
        Corners of the facets, not checked; None when every three vertices make one.
    mm : float or None
        The file's own unit, mm, where it names one.
    notes : list of str
        What a user should know.
    """

    vertices: Vertices
    faces: Faces | None
    mm: float | None
    notes: list[str]


def read_file(path: Path, lenient: bool = False) -> MeshFile:
    """Read a mesh file as it is.

    Parameters
    ----------
    path : Path
        STL or PLY, binary or ASCII; OBJ, OFF, 3MF or GLB.
    lenient : bool
        Whether a file that is cut short gives the facets that are whole.

    Returns
    -------
    MeshFile

    Raises
    ------
    ModelError
        When the file is missing, unreadable, empty, damaged or of an unknown format.
    """
    try:
        if path.is_dir():
            raise ModelError(f"{path}: is a folder; name a mesh file")
        if path.exists() and not path.is_file():  # a pipe would block, and a device never ends
            raise ModelError(f"{path}: is not a file on disk; name a mesh file")
        with path.open("rb") as file:
            head, size = file.read(HEAD), path.stat().st_size
        if not head:
            raise ModelError(f"{path}: the file is empty")
        kind = kind_of(path, head, size)
        if kind.name == "text":
            with unbroken():
                from .stltext import read_stl_text
            corners, notes = read_stl_text(path, kind.start, lenient)
            return MeshFile(corners, None, None, notes)
        reader = _READERS.get(kind.name)
        if reader is None:
            return _read_other(path, kind.name)
        vertices, faces, notes = reader(path, size, lenient)
        return MeshFile(vertices, faces, None, notes)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ModelError(f"{path}: cannot read the mesh: {reason}") from None
    except MemoryError:
        raise ModelError(f"{path}: the mesh does not fit in memory; use a coarser one") from None


def _read_stl(path: Path, size: int, lenient: bool) -> Found:
    """Read binary STL; the size of the file, and not the header, says how many facets there can be."""
    if size < STL_HEAD:
        raise ModelError(f"{path}: {size} bytes, an STL header alone has 84; the file is damaged")
    with path.open("rb") as file:
        count, held, notes = facet_count(file.read(STL_HEAD)), (size - STL_HEAD) // _FACET.itemsize, list[str]()
        promise = f"84-byte header promises {counted(count, 'facet')} ({(84 + 50 * count) / 1e6:.1f} MB)"
        if count > held or (not count and held):
            if not lenient or not held:
                remedy = ", or use --lenient to slice those" if held else ""
                raise ModelError(f"{path}: {promise} but the file holds {held}; export the model again{remedy}")
            notes.append(f"{promise}; the file holds {held}, sliced")
            count = held
        elif 84 + 50 * count < size:
            trailing = counted(size - 84 - 50 * count, "byte")
            more, rest = divmod(size - 84 - 50 * count, 50)
            facets = f", just as many as {counted(more, 'facet')} more would take" if not rest else ""
            notes.append(f"{trailing} after the {counted(count, 'facet')} that the header promises{facets}: ignored")
        corners = np.empty(count, "V36")
        buffer = np.empty(min(count, _CHUNK), _FACET)
        for i in range(0, count, _CHUNK):
            part = buffer[: count - i]
            if file.readinto(part.view(np.uint8).data) != part.nbytes:
                raise ModelError(f"{path}: the file became shorter while it was read; try again")
            corners[i : i + _CHUNK] = part["corners"]
    vertices: NDArray[np.float32] = corners.view("<f4").astype(np.float32, copy=False).reshape(-1, 3)
    return vertices, None, notes


def _read_other(path: Path, kind: str) -> MeshFile:
    """Read through trimesh, whose every complaint becomes a ModelError."""
    import trimesh

    log = logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)  # what it has to say comes as our own error
    try:
        with warnings.catch_warnings(), path.open("rb") as file:
            warnings.simplefilter("ignore")
            options: dict[str, Any] = {"process": False, "maintain_order": True, "skip_materials": True}
            options["resolver"] = trimesh.resolvers.FilePathResolver(str(path))
            loaded: Any = trimesh.load(file, file_type=kind, **options)
            unit = getattr(loaded, "units", None) if kind == "3mf" else None
            mm = float(trimesh.units.unit_conversion(unit, "mm")) if unit else None
            if isinstance(loaded, trimesh.Scene):
                loaded = loaded.to_mesh()
        count = len(getattr(loaded, "vertices", ()))
        if not isinstance(loaded, trimesh.Trimesh):
            raise ModelError(f"{path}: holds no facets ({count} vertices); nothing to slice")
        vertices, faces = np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces)
        if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,) or faces.dtype.kind not in "iu":
            raise ModelError(f"{path}: vertices or facets do not have three numbers each; the file is damaged")
        return MeshFile(vertices, faces, mm, [])
    except ModelError:
        raise
    except ImportError as error:
        raise ModelError(f"{path}: reading {kind} files needs a package: {error}; pip install it") from None
    except Exception as error:  # whatever a damaged file makes of trimesh
        text = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise ModelError(f"{path}: cannot be read as {kind}: {text}") from None
    finally:
        log.setLevel(level)


def _read_obj(path: Path, size: int, lenient: bool) -> Found:
    with unbroken():
        from .polytext import read_obj
    return read_obj(path, size, lenient)


def _read_off(path: Path, size: int, lenient: bool) -> Found:
    with unbroken():
        from .polytext import read_off
    return read_off(path, size, lenient)


_READERS: dict[str, Callable[[Path, int, bool], Found]] = {
    "ply": read_ply, "stl": _read_stl, "obj": _read_obj, "off": _read_off,
}  # fmt: skip
