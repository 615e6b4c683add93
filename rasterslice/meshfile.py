"""Mesh files: bytes to vertices and facets, with nothing welded, dropped or guessed.

Binary STL and binary PLY of triangles are read here by NumPy, ASCII STL by a pattern; what is left goes
through trimesh, which is imported only then (0.8 s). No number of a header allocates anything before the
size of the file confirms it.
"""

from __future__ import annotations

import logging
import re
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import ModelError

Vertices = NDArray[np.float32] | NDArray[np.float64]
Faces = NDArray[np.integer[Any]]
Bytes = NDArray[np.uint8]

_FACET = np.dtype([("normal", "V12"), ("corners", "V36"), ("attribute", "V2")])  # of binary STL
_OTHERS = ("3mf", "glb", "obj", "off")
_HEADER = 65536  # a PLY header is shorter
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


class _Element(NamedTuple):
    """One element of a PLY header; a property is (name, type, type of the list's length or '')."""

    name: str
    number: int
    properties: list[tuple[str, str, str]]

    def smallest(self) -> int:
        """Bytes that one element takes in a binary file at least."""
        return sum(np.dtype(length or kind).itemsize for _, kind, length in self.properties)


def read_file(path: Path) -> tuple[Vertices, Faces | None]:
    """Read a mesh file as it is; the format is known by its content, else by its suffix.

    Parameters
    ----------
    path : Path
        STL or PLY, binary or ASCII; OBJ, OFF, 3MF or GLB.

    Returns
    -------
    vertices : (N, 3) float32 or float64
        mm, as precise as the file has them; may hold values that are not finite.
    faces : (T, 3) int or None
        Corners of the facets, not checked; None when every three vertices make one.

    Raises
    ------
    ModelError
        When the file is missing, unreadable, empty, damaged or of an unknown format.
    """
    try:
        if path.is_dir():
            raise ModelError(f"{path}: is a folder; name a mesh file")
        data = np.fromfile(path, np.uint8)
    except (OSError, ValueError, MemoryError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ModelError(f"{path}: cannot read the mesh: {reason}") from None
    head, suffix = data[:512].tobytes(), path.suffix.lower().lstrip(".")
    if not data.size:
        raise ModelError(f"{path}: the file is empty")
    if re.match(rb"ply[ \t]*[\r\n]", head):
        return _read_ply(path, data)
    if data.size >= 84 and 84 + 50 * _stl_count(data) == data.size:
        return _read_stl(path, data)
    if head.lstrip().lower().startswith(b"solid") and b"\0" not in head:
        return _read_stl_text(path, data.tobytes())
    if suffix == "stl":
        return _read_stl(path, data)
    if suffix in _OTHERS:
        return _read_other(path, suffix)
    if suffix == "ply":
        raise ModelError(f"{path}: does not begin with 'ply'; the file is damaged")
    raise ModelError(f"{path}: unknown format; known are stl, ply, {', '.join(_OTHERS)}")


def _stl_count(data: Bytes) -> int:
    return int(data[80:84].view("<u4")[0])


def _read_stl(path: Path, data: Bytes) -> tuple[Vertices, None]:
    if data.size < 84:
        raise ModelError(f"{path}: {data.size} bytes, an STL header alone has 84; the file is damaged")
    count, held = _stl_count(data), (data.size - 84) // _FACET.itemsize
    if count != held:  # fewer than promised, or more: either way facets would be lost
        size = f"{count} facets ({(84 + 50 * count) / 1e6:.1f} MB)"
        raise ModelError(f"{path}: header promises {size} but the file holds {held}; export the model again")
    corners = data[84 : 84 + _FACET.itemsize * count].view(_FACET)["corners"]
    return _native(np.ascontiguousarray(corners).view("<f4")).reshape(-1, 3), None


def _read_stl_text(path: Path, text: bytes) -> tuple[Vertices, None]:
    # names of solids may hold any word, so they go first
    body = re.sub(rb"(?i)(^|[\r\n])\s*(end)?solid[^\r\n]*", rb"\1", text)
    begun, ended = (len(re.findall(rb"(?i)\b" + word + rb"\b", body)) for word in (b"facet", b"endfacet"))
    found = re.findall(rb"(?i)\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", body)
    if not begun == ended == len(found) / 3 or not re.search(rb"(?i)\bendsolid\b", text):
        raise ModelError(f"{path}: {begun} facets begin, {ended} end, with {len(found)} whole vertices; "
                         "the file is cut short or damaged, export the model again")  # fmt: skip
    try:
        return np.array(found, "S").reshape(-1, 3).astype(np.float64), None
    except ValueError as error:
        raise ModelError(f"{path}: a vertex is not made of numbers: {error}") from None


def _read_ply(path: Path, data: Bytes) -> tuple[Vertices, Faces]:
    kind, elements, start = _ply_header(path, data)
    by_name = {e.name: e for e in elements}
    vertex, face = by_name.get("vertex"), by_name.get("face")
    if vertex is None or face is None or not face.number:
        raise ModelError(f"{path}: holds no facets ({vertex.number if vertex else 0} vertices)")
    missing = {"x", "y", "z"} - {name for name, _, length in vertex.properties if not length}
    if missing:
        raise ModelError(f"{path}: vertices have no property {min(missing)}; the file is damaged")
    for e in (vertex, face):
        least = 2 * len(e.properties) if kind == "ascii" else e.smallest()
        held = (data.size - start + 1) // max(least, 1)
        if e.number > held or not e.properties:
            room = held if e.properties else 0
            raise ModelError(f"{path}: header promises {e.number} {e.name} elements but the file has room "
                             f"for {room}; export the model again")  # fmt: skip
    if kind != "ascii":
        found = _ply_binary(path, data, elements, start, "<" if "little" in kind else ">")
        if found is not None:
            return found
    vertices, faces = _read_other(path, "ply")
    if len(faces) < face.number or len(vertices) < vertex.number:
        raise ModelError(f"{path}: header promises {vertex.number} vertices and {face.number} facets but "
                         f"{len(vertices)} and {len(faces)} were found; export the model again")  # fmt: skip
    return vertices, faces


def _ply_header(path: Path, data: Bytes) -> tuple[str, list[_Element], int]:
    """Return the format, the elements and where the data begin."""
    head = data[:_HEADER].tobytes()
    end = re.search(rb"[\r\n]end_header[ \t]*(\r\n|\r|\n|$)", head)
    if end is None:
        raise ModelError(f"{path}: the PLY header has no end; the file is damaged")
    kind, elements = "", list[_Element]()
    lines = re.split(r"\r\n|\r|\n", head[: end.start()].decode("latin-1"))
    for number, line in enumerate(lines[1:], 2):
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", "ascii" | "binary_little_endian" | "binary_big_endian" as kind, _]:
                pass
            case ["element", name, count] if re.fullmatch("[0-9]{1,18}", count):
                elements.append(_Element(name, int(count), []))
            case ["property", "list", length, each, name] if elements and {length, each} <= _TYPES.keys():
                elements[-1].properties.append((name, _TYPES[each], _TYPES[length]))
            case ["property", each, name] if elements and each in _TYPES:
                elements[-1].properties.append((name, _TYPES[each], ""))
            case _:
                raise ModelError(f"{path}: line {number} of the PLY header is not understood: {line[:60]!r}")
    if not kind:
        raise ModelError(f"{path}: the PLY header names no format; the file is damaged")
    return kind, elements, end.end()


def _ply_binary(
    path: Path, data: Bytes, elements: list[_Element], start: int, order: str
) -> tuple[Vertices, Faces] | None:
    """Return the mesh, or None when it has lists other than those of triangles."""
    vertices: Vertices | None = None
    faces: Faces | None = None
    for e in elements:
        lists = [i for i, (_, _, length) in enumerate(e.properties) if length]
        if lists and (e.name != "face" or len(lists) > 1):
            return None
        fields: list[Any] = []
        for i, (_, each, length) in enumerate(e.properties):
            several = [("length", order + length), ("list", order + each, 3)]
            fields += several if length else [(f"{i}", order + each)]
        record = np.dtype(fields)
        held = min(e.number, (data.size - start) // max(record.itemsize, 1))
        rows = data[start : start + held * record.itemsize].view(record)
        if lists and not (rows["length"] == 3).all():
            return None  # polygons
        if held < e.number:
            raise ModelError(f"{path}: header promises {e.number} {e.name} elements "
                             f"({e.number * record.itemsize / 1e6:.1f} MB) but the file holds {held}; "
                             "export the model again")  # fmt: skip
        start += held * record.itemsize
        if e.name == "vertex":
            vertices = _columns(rows, [[name for name, _, _ in e.properties].index(c) for c in "xyz"])
        elif e.name == "face" and lists and rows["list"].dtype.kind in "iu":
            faces = np.ascontiguousarray(rows["list"])
        if vertices is not None and faces is not None:
            return vertices, _native(faces)
    return None


def _columns(rows: NDArray[np.void], numbers: list[int]) -> Vertices:
    """Return three columns of records as (N, 3) float32 where that loses nothing, else float64."""
    kinds = [rows.dtype[f"{i}"] for i in numbers]
    exact = all((k.kind == "f" and k.itemsize == 4) or k.itemsize <= 2 for k in kinds)
    out = np.empty((len(rows), 3), np.float32 if exact else np.float64)
    for axis, i in enumerate(numbers):
        out[:, axis] = rows[f"{i}"]
    return out


def _native(array: Any) -> Any:
    """Return an array in the byte order of the machine."""
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def _read_other(path: Path, kind: str) -> tuple[NDArray[np.float64], Faces]:
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
            if isinstance(loaded, trimesh.Scene):
                loaded = loaded.to_mesh()
        count = len(getattr(loaded, "vertices", ()))
        if not isinstance(loaded, trimesh.Trimesh):
            raise ModelError(f"{path}: holds no facets ({count} vertices)")
        return np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces)
    except ModelError:
        raise
    except ImportError as error:
        raise ModelError(f"{path}: reading {kind} files needs a package: {error}; pip install it") from None
    except Exception as error:  # whatever a damaged file makes of trimesh
        text = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise ModelError(f"{path}: cannot be read as {kind}: {text}") from None
    finally:
        log.setLevel(level)
