"""Plain numbers: rows of x, y, z; a row of NaN ends a polyline, as the paper's Matlab code passes them.

Also the CSV of our own export.
"""

from __future__ import annotations

import math
import sys
from array import array
from pathlib import Path

import numpy as np

from .form import (
    FILL,
    OUTER,
    SUPPORT,
    Floats,
    TheirLayer,
    Theirs,
    damaged,
    fold,
    load,
    number,
    pack_beads,
    ring,
)  # fmt: skip
from .textlines import text_lines

OURS = "layer,ice,z,material,kind,path,x,y"
_ROLES = {("part", "boundary"): OUTER, ("part", "fill"): FILL}


def read(path: Path) -> Theirs:
    """Read closed contours: values stand between commas, semicolons or blanks; ``%`` and ``#`` begin a comment.

    Raises
    ------
    ModelError
        ``file:line: message``: a row that is not three numbers, a polyline that changes its height.
    """
    data = load(path)
    if data.removeprefix(b"\xef\xbb\xbf").startswith(OURS.encode()):
        return _ours(data, path)
    layers: list[TheirLayer] = []
    flat = array("d")
    began, height = 1, 0.0

    def close() -> None:
        if not flat:
            return
        points: Floats = ring(np.array(flat).reshape(-1, 2))
        if len(points) < 3:
            raise damaged(path, began, f"a polyline of {len(points)} points encloses nothing")
        if not layers or layers[-1].z != height:
            layers.append(TheirLayer(height, f"line {began}"))
        layers[-1].loops.append(points)
        layers[-1].declared.append(0)
        del flat[:]

    for line, raw in text_lines(data, path):
        words = raw.split("%")[0].split("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        if all(word.lower() == "nan" for word in words):
            close()
            continue
        if line == 1 and any(word[:1].isalpha() for word in words):
            continue  # names of the columns
        if len(words) != 3:
            raise damaged(path, line, f"a row must hold x, y and z, got {len(words)} values", "write three columns")
        x, y, z = (number(word, path, line, name) for word, name in zip(words, "xyz", strict=True))
        if flat and not math.isclose(z, height, abs_tol=1e-9):
            raise damaged(path, line, f"z changes from {height:g} to {z:g} mm within a polyline", "end it with NaN")
        if not flat:
            began, height = line, z
        flat.extend((x, y))
    close()
    if not layers:
        raise damaged(path, 1, "no polyline was found", "write rows of x, y, z")
    return Theirs("polylines with NaN between them", layers, None)


def _ours(data: bytes, path: Path) -> Theirs:
    """Read the beads of our own export: rows of one path follow each other."""
    paths: list[tuple[str, str, int, Floats]] = []  # height, ice layer, role, points
    key: list[str] = []
    flat, began = array("d"), 2

    def close() -> None:
        if not flat:
            return
        _, ice, z, material, kind, _ = key
        points: Floats = np.array(flat).reshape(-1, 2)
        if len(points) < (least := 3 if kind == "boundary" else 2):
            raise damaged(path, began, f"a path of {len(points)} points, {least} are needed", "export it anew")
        bead = np.vstack([points, points[:1]]) if kind == "boundary" else points
        paths.append((sys.intern(z), sys.intern(ice), _ROLES.get((material, kind), SUPPORT), bead))
        del flat[:]

    for line, raw in text_lines(data, path):
        if line == 1:
            continue
        words = raw.split(",")
        if len(words) != 8:
            raise damaged(path, line, f"a row must hold {OURS}, got {len(words)} values", "export it anew")
        x, y = (number(word, path, line, name) for word, name in zip(words[6:], "xy", strict=True))
        if words[:6] != key:
            number(words[2], path, line, "z")
            close()
            key, began = words[:6], line
        flat.extend((x, y))
    close()
    if not paths:
        raise damaged(path, 2, "no path was found", "export it anew")
    layers: dict[tuple[str, str], list[tuple[Floats, int]]] = {}
    for z, ice, role, bead in paths:
        layers.setdefault((z, ice), []).append((bead, role))
    found = []
    for (z, _), lines in layers.items():
        beads = pack_beads([p for p, _ in lines], [role for _, role in lines], [math.nan] * len(lines))
        found.append(TheirLayer(float(z), f"z {z}", beads=beads))
    found = fold(found)
    parts = [k for k in found if k.beads is not None and (k.beads.role != SUPPORT).any()]
    props = [k for k in found if k.beads is not None and (k.beads.role == SUPPORT).all()]
    return Theirs("CSV of rasterslice", parts, "middle", precision=0.0001, props=props)
