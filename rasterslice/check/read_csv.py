"""Plain numbers: rows of x, y, z; a row of NaN ends a polyline, as the paper's Matlab code passes them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from .form import Floats, TheirLayer, Theirs, bounded, damaged, load, number, ring


def read(path: Path) -> Theirs:
    """Read closed contours: values stand between commas, semicolons or blanks; ``%`` and ``#`` begin a comment.

    Raises
    ------
    ModelError
        ``file:line: message``: a row that is not three numbers, a polyline that changes its height.
    """
    text = load(path).decode("utf-8-sig", "replace")
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
