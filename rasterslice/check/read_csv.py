"""Plain numbers: rows of x, y, z; a row of NaN ends a polyline, as the paper's Matlab code passes them.

Also the CSV of our own export.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from .form import (
    FILL,
    OUTER,
    SUPPORT,
    Floats,
    TheirLayer,
    Theirs,
    bounded,
    damaged,
    fold,
    load,
    number,
    pack_beads,
    ring,
)  # fmt: skip

OURS = "layer,ice,z,material,kind,path,x,y"
_ROLES = {("part", "boundary"): OUTER, ("part", "fill"): FILL}


def read(path: Path) -> Theirs:
    """Read closed contours: values stand between commas, semicolons or blanks; ``%`` and ``#`` begin a comment.

    Raises
    ------
    ModelError
        ``file:line: message``: a row that is not three numbers, a polyline that changes its height.
    """
    text = load(path).decode("utf-8-sig", "replace")
    if text.startswith(OURS):
        return _ours(text, path)
    layers: list[TheirLayer] = []
    rows: list[tuple[float, float, float]] = []
    began = 1

    def close() -> None:
        if not rows:
            return
        points: Floats = ring(bounded(np.array(rows)[:, :2], path, began))
        if len(points) < 3:
            raise damaged(path, began, f"a polyline of {len(points)} points encloses nothing")
        z = rows[0][2]
        if not layers or layers[-1].z != z:
            layers.append(TheirLayer(z, f"line {began}"))
        layers[-1].loops.append(points)
        layers[-1].declared.append(0)
        rows.clear()

    for line, raw in enumerate(text.splitlines(), 1):
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
        if rows and not math.isclose(z, rows[0][2], abs_tol=1e-9):
            raise damaged(path, line, f"z changes from {rows[0][2]:g} to {z:g} mm within a polyline", "end it with NaN")
        if not rows:
            began = line
        rows.append((x, y, z))
    close()
    if not layers:
        raise damaged(path, 1, "no polyline was found", "write rows of x, y, z")
    return Theirs("polylines with NaN between them", layers, None)


def _ours(text: str, path: Path) -> Theirs:
    """Read the beads of our own export: rows of one path follow each other."""
    paths: dict[tuple[str, ...], list[tuple[float, float]]] = {}
    for line, raw in enumerate(text.splitlines()[1:], 2):
        words = raw.split(",")
        if len(words) != 8:
            raise damaged(path, line, f"a row must hold {OURS}, got {len(words)} values", "export it anew")
        x, y = (number(word, path, line, name) for word, name in zip(words[6:], "xy", strict=True))
        number(words[2], path, line, "z")
        paths.setdefault(tuple(words[:6]), []).append((x, y))
    if not paths:
        raise damaged(path, 2, "no path was found", "export it anew")
    layers: dict[tuple[str, str], list[tuple[Floats, int]]] = {}
    for (_, ice, z, material, kind, _), row in paths.items():
        bead: Floats = np.array([*row, row[0]] if kind == "boundary" else row)
        layers.setdefault((z, ice), []).append((bead, _ROLES.get((material, kind), SUPPORT)))
    found = []
    for (z, _), lines in layers.items():
        beads = pack_beads([p for p, _ in lines], [role for _, role in lines], [math.nan] * len(lines))
        found.append(TheirLayer(float(z), f"z {z}", beads=beads))
    found = fold(found)
    parts = [k for k in found if k.beads is not None and (k.beads.role != SUPPORT).any()]
    props = [k for k in found if k.beads is not None and (k.beads.role == SUPPORT).all()]
    return Theirs("CSV of rasterslice", parts, "middle", precision=0.0001, props=props)
