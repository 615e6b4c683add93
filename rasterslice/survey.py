"""What a mesh is like: closed or not, and every kind of damage, counted."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import counted
from .intake import read_mesh
from .mesh import CHUNK, Mesh, size_notes
from .nesting import within_any
from .weld import Ids, components, hashed, vertex_ids

_WORDS = {  # what one is called, and what is said of it
    "open_edges": ("open edge", ""),
    "nonmanifold_edges": ("edge", " of more than two facets"),
    "inconsistent_edges": ("edge", " between facets that are turned against each other"),
    "degenerate_facets": ("facet", " of no area"),
    "duplicate_facets": ("facet", " in the place of another one"),
    "inverted_shells": ("shell", " turned inside out"),
}
_NO_VOLUME = 1e-12  # of the volumes of the facets, which float64 rounds


def survey(mesh: Mesh) -> dict[str, Any]:
    """Return the report of a mesh.

    Parameters
    ----------
    mesh : Mesh

    Returns
    -------
    dict
        ``facets``, ``vertices`` (of different bits), ``low``, ``high``, ``size`` (mm), ``volume_mm3`` (signed, as the
        facets are oriented), ``closed`` (every edge joins two facets that agree), ``open_edges``,
        ``nonmanifold_edges`` (of more than two facets), ``inconsistent_edges`` (two facets that disagree),
        ``degenerate_facets`` (of no area), ``duplicate_facets``, ``shells``, ``inverted_shells`` (closed, turned
        inside out, and in no other closed shell's box), ``notes``.
    """
    triangles = mesh.triangles
    with ThreadPoolExecutor(2) as pool:  # NumPy lets go of the interpreter
        measures = pool.submit(_measures, triangles)
        ids, first = vertex_ids(triangles)
        flat = (ids[:, 0] == ids[:, 1]) | (ids[:, 1] == ids[:, 2]) | (ids[:, 2] == ids[:, 0])
        counts = pool.submit(_edges, ids[~flat] if flat.any() else ids)
        root = components(ids, count=len(first))
        areas, volumes = measures.result()
        opened, many, mixed_up, duplicates, loose = counts.result()
        shells, inverted = _shells(triangles, root[ids[:, 0]], volumes, root[loose])
    return {
        **brief(mesh),
        "vertices": len(first),
        "volume_mm3": float(volumes.sum()),
        "closed": not (opened or many or mixed_up),
        "open_edges": opened,
        "nonmanifold_edges": many,
        "inconsistent_edges": mixed_up,
        "degenerate_facets": int(np.count_nonzero(flat | (areas == 0))),
        "duplicate_facets": duplicates,
        "shells": shells,
        "inverted_shells": inverted,
        "notes": [*mesh.notes, *(f"{mesh.path}: {note}" for note in size_notes(mesh))],
    }


def brief(mesh: Mesh) -> dict[str, Any]:
    """Return what of a report costs nothing: ``facets``, ``low``, ``high`` and ``size``."""
    return {
        "facets": mesh.facets,
        "low": mesh.low.tolist(),
        "high": mesh.high.tolist(),
        "size": (mesh.high - mesh.low).tolist(),
    }


def damage(report: dict[str, Any]) -> str:
    """Return the damage of a report in words, or nothing."""
    return ", ".join(counted(report[name], one) + more for name, (one, more) in _WORDS.items() if report[name])


def survey_file(path: Path, units: str = "mm", lenient: bool = False) -> dict[str, Any]:
    """Return the report of a mesh file, which names it as ``file``; errors are those of `read_mesh`."""
    return {"file": str(path), **survey(read_mesh(path, units, lenient))}


def report_lines(report: dict[str, Any]) -> list[str]:
    """Return a report as a user reads it."""
    x, y, z = (f"{v:.6g}" for v in report["size"])
    facets, shells = counted(report["facets"], "facet"), counted(report["shells"], "shell")
    lines = [
        f"{report['file']}: {facets}, {report['vertices']} vertices, {shells}",
        f"  {x} x {y} x {z} mm from ({', '.join(f'{v:.6g}' for v in report['low'])}), {report['volume_mm3']:.6g} mm3",
    ]
    found = damage(report)
    return [*lines, f"  {'closed' if report['closed'] else 'not closed'}" + (f": {found}" if found else "")]


def _measures(triangles: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return twice the area, squared, of each facet, and its signed volume to one point of the mesh."""
    areas, volumes = np.empty(len(triangles)), np.empty(len(triangles))
    base = triangles[0, 0].astype(np.float64)
    for i in range(0, len(triangles), CHUNK // 4):
        corners = np.ascontiguousarray(np.moveaxis(triangles[i : i + CHUNK // 4] - base, 0, -1))
        a, b, c = corners
        u, v = b - a, c - a
        n = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        areas[i : i + CHUNK // 4] = n[0] * n[0] + n[1] * n[1] + n[2] * n[2]
        volumes[i : i + CHUNK // 4] = (a[0] * n[0] + a[1] * n[1] + a[2] * n[2]) / 6
    return areas, volumes


def _edges(ids: Ids) -> tuple[int, int, int, int, Ids]:
    """Count edges of one facet, of more than two, of two that run along it in one direction; and double facets.

    The last that is returned are vertices of edges that are not run along as often in one direction as in the other:
    what they hang together with encloses no volume.
    """
    if not len(ids):
        return 0, 0, 0, 0, np.empty(0, np.int32)
    keys = np.empty((3, len(ids)), np.uint64)
    for row, (i, j) in zip(keys, ((0, 1), (1, 2), (2, 0)), strict=True):
        a, b = ids[:, i].astype(np.int64), ids[:, j].astype(np.int64)
        row[:] = (np.minimum(a, b) << 32) | (np.maximum(a, b) << 1) | (a < b)
    flat = keys.reshape(-1)
    flat.sort()
    edge = flat >> np.uint64(1)
    start = np.flatnonzero(np.concatenate([[True], edge[1:] != edge[:-1]]))
    number = np.diff(start, append=len(flat))
    pair = start[number == 2]
    same = (flat[pair] ^ flat[pair + 1]) & np.uint64(1) == 0
    facets = np.sort(hashed(np.sort(ids, axis=1)))
    double = int(np.count_nonzero(facets[1:] == facets[:-1]))
    many = start[number > 2]
    if len(many):
        forth = np.add.reduceat((flat & np.uint64(1)).astype(np.int32), start)[number > 2]
        many_odd = many[2 * forth != number[number > 2]]
    else:
        many_odd = many
    loose = edge[np.concatenate([start[number == 1], pair[same], many_odd])] >> np.uint64(31)
    return int((number == 1).sum()), len(many), int(same.sum()), double, loose.astype(np.int32)


def _shells(triangles: NDArray[np.float32], shell: Ids, volumes: NDArray[np.float64], loose: Ids) -> tuple[int, int]:
    """Count the shells, and those inside out that are no cavity: closed, and in the box of no other closed one.

    Parameters
    ----------
    triangles : (T, 3, 3) float32
    shell : (T,) int32
        Of each facet.
    volumes : (T,) float64
        Of each facet, to one point.
    loose : (L,) int32
        Shells that are not closed, in any order: the sign of their volume means nothing.
    """
    if not shell.any():  # all facets hang together, at the first vertex
        return 1, int(not len(loose) and volumes.sum() < -_NO_VOLUME * np.abs(volumes).sum())
    order = np.argsort(shell, kind="stable")
    start = np.flatnonzero(np.concatenate([[True], np.diff(shell[order]) != 0]))
    volume, least = (np.add.reduceat(v[order], start) for v in (volumes, _NO_VOLUME * np.abs(volumes)))
    closed = np.ones(len(start), bool)
    closed[np.searchsorted(shell[order][start], loose)] = False
    inward, outward = closed & (volume < -least), closed & (volume > least)
    if not inward.any():
        return len(start), 0
    facets = triangles[order]
    low = np.minimum.reduceat(facets.min(axis=1), start).astype(np.float64)
    high = np.maximum.reduceat(facets.max(axis=1), start).astype(np.float64)
    cavities = within_any(low[inward], high[inward], low[outward], high[outward])
    return len(start), int(np.count_nonzero(~cavities))
