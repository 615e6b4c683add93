"""One mesh in every format and variant, as bytes: for tests and for ``bench/fuzz.py``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

KINDS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip


def ball(count: int = 6) -> tuple[Array, Array]:
    """Return vertices (V, 3) float32 and faces (T, 3) of a closed ball of latitudes and longitudes."""
    lat = np.linspace(-np.pi / 2, np.pi / 2, count + 1)[1:-1]
    turn = 2 * np.pi * np.arange(2 * count) / (2 * count)
    ring = [
        np.stack([np.cos(a) * np.cos(turn), np.cos(a) * np.sin(turn), np.full(len(turn), np.sin(a))], 1) for a in lat
    ]
    vertices = np.concatenate([[[0, 0, -1]], *ring, [[0, 0, 1]]]).astype(np.float32) * np.float32(7.3)
    n, faces = len(turn), []
    for i in range(n):
        j = (i + 1) % n
        faces += [(0, 1 + j, 1 + i), (len(vertices) - 1, len(vertices) - 1 - n + i, len(vertices) - 1 - n + j)]
        for row in range(len(lat) - 1):
            a, b = 1 + row * n, 1 + (row + 1) * n
            faces += [(a + i, a + j, b + j), (a + i, b + j, b + i)]
    return vertices, np.array(faces, np.int32)


def stl(corners: Array, header: bytes = b"binary", count: int | None = None) -> bytes:
    rows = np.zeros(len(corners), [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    rows["v"] = corners
    return header.ljust(80)[:80] + np.uint32(len(corners) if count is None else count).tobytes() + rows.tobytes()


def stl_text(
    corners: Array, *, end: str = "\n", name: str = "a ball", form: str = "%.9g", upper: bool = False, after: str = "",
    normal: str = " normal 0 0 0",
) -> bytes:  # fmt: skip
    words = ["solid", "facet", "outer loop", "vertex", "endloop", "endfacet", "endsolid"]
    if upper:
        words = [w.upper() for w in words]
    solid, facet, outer, vertex, endloop, endfacet, endsolid = words
    lines = [f"{solid} {name}"]
    for t in corners.tolist():
        lines += [f"  {facet}{normal}", f"    {outer}"]
        lines += [f"      {vertex} " + " ".join(form % v for v in p) for p in t]
        lines += [f"    {endloop}{after}", f"  {endfacet}{after}"]
    return end.join([*lines, f"{endsolid} {name}", ""]).encode()


def ply(
    vertices: Array, faces: Any, *, order: str = "", real: str = "float", index: str = "int", length: str = "uchar",
    end: str = "\n", colour: bool = False, first: bool = False, extra: bool = False, swap: bool = False,
    name: str = "vertex_indices",
) -> bytes:  # fmt: skip
    """Return a PLY file; `colour` adds properties, `extra` adds elements, `swap` turns xyz to zyx."""
    axes = "zyx" if swap else "xyz"
    head = ["ply", f"format {({'': 'ascii', '<': 'binary_little_endian', '>': 'binary_big_endian'})[order]} 1.0",
            "comment ours"]  # fmt: skip
    edge = ["element edge 2", "property int a", "property list uchar int b"] if extra else []
    head += edge if first else []
    head += [f"element vertex {len(vertices)}", *(["property uchar red"] if colour else [])]
    head += [f"property {real} {c}" for c in axes] + (["property float confidence"] if colour else [])
    head += [f"element face {len(faces)}", *(["property uchar flag"] if colour else [])]
    head += [f"property list {length} {index} {name}", *(["property float quality"] if colour else [])]
    head += [] if first else edge
    head += ["end_header", ""]

    def row(*cells: tuple[str, Any]) -> bytes:
        if not order:
            return (" ".join(_text(v) for _, v in cells) + end).encode()
        return b"".join(np.array(v, order + KINDS[kind]).tobytes() for kind, v in cells)

    edges = b"".join(row(("int", 7), ("uchar", n), *[("int", 9)] * n) for n in (2, 0)) if extra else b""
    data = b""
    for p in vertices[:, ::-1] if swap else vertices:
        data += row(*[("uchar", 5)] * colour, *((real, v) for v in p), *[("float", 0.5)] * colour)
    for f in faces:
        cells = [(length, len(f)), *((index, i) for i in f)]
        data += row(*[("uchar", 1)] * colour, *cells, *[("float", 0.25)] * colour)
    return end.join(head).encode() + (edges + data if first else data + edges)


def _text(value: Any) -> str:
    return repr(float(value)) if isinstance(value, float | np.floating) else str(int(value))


def variants(others: bool = False) -> dict[str, bytes]:
    """Return the ball in every format; `others` adds those that trimesh reads."""
    vertices, faces = ball()
    corners = vertices[faces]
    half = [list(map(int, f)) for f in faces]
    found = {
        "stl.stl": stl(corners),
        "solid.stl": stl(corners, b"solid binary"),
        "text.stl": stl_text(corners),
        "text_crlf.stl": stl_text(corners, end="\r\n", upper=True, form="%.8e"),
        "text_cr.stl": stl_text(corners, end="\r", name="Köpfe facet vertex"),
        "two.stl": stl_text(corners[:50]) + stl_text(corners[50:], name="two", after=" after"),
        "bare.stl": stl_text(corners, normal=""),
        "little.ply": ply(vertices, faces, order="<"),
        "big.ply": ply(vertices, faces, order=">", colour=True, swap=True),
        "polygons.ply": ply(vertices, [*half[:-1], [*half[-1], 0]], order="<", extra=True, index="uint", length="int"),
        "double.ply": ply(vertices, faces, order="<", real="double", extra=True, first=True),
        "text.ply": ply(vertices, faces),
        "text_crlf.ply": ply(vertices, [*half[:-1], [*half[-1], 0]], end="\r\n", colour=True, extra=True, first=True),
    }
    if others:
        import trimesh

        mesh = trimesh.Trimesh(vertices, faces, process=False)
        found |= {f"trimesh.{kind}": _bytes(mesh.export(file_type=kind)) for kind in ("obj", "off", "glb")}
    return found


def _bytes(data: Any) -> bytes:
    return data.encode() if isinstance(data, str) else bytes(data)
