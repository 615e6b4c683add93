"""Transforms of SVG, and what it does not show."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from .form import Floats, damaged, number

_CALL = re.compile(r"\s*([A-Za-z]+)\s*\(([^()]*)\)\s*,?")
_COUNTS = {"translate": (1, 2), "scale": (1, 2), "rotate": (1, 3), "matrix": (6,)}


def transform(text: str, path: Path, line: int) -> Floats:
    """Return the (2, 3) matrix of an attribute ``transform``.

    Raises
    ------
    ModelError
        Another word than translate, scale, rotate and matrix, or numbers that do not belong to it.
    """
    found, at = np.eye(3), 0
    while text[at:].strip():
        call = _CALL.match(text, at)
        values = [number(v, path, line, "a transform") for v in call[2].replace(",", " ").split()] if call else []
        if not call or len(values) not in _COUNTS.get(call[1], ()):
            shown = text[at : at + 40].strip()
            raise damaged(path, line, f"transform {shown} is not built yet", "write it without")
        found, at = found @ _matrix(call[1], values), call.end()
    return np.asarray(found[:2])


def _matrix(name: str, v: list[float]) -> Floats:
    if name == "matrix":
        return np.array([v[0::2], v[1::2], [0.0, 0.0, 1.0]])
    if name == "scale":
        return np.diag([v[0], v[-1], 1.0])
    if name == "translate":
        return np.array([[1, 0, v[0]], [0, 1, v[1] if len(v) > 1 else 0.0], [0, 0, 1.0]])
    c, s = math.cos(math.radians(v[0])), math.sin(math.radians(v[0]))
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    if len(v) < 3:
        return turn
    return np.asarray(_matrix("translate", v[1:]) @ turn @ _matrix("translate", [-v[1], -v[2]]))


def hidden(attributes: dict[str, str]) -> bool:
    """Whether an element says that it is not shown."""
    style = attributes.get("style", "").replace(" ", "")
    none = attributes.get("display") == "none" or attributes.get("visibility") in ("hidden", "collapse")
    return none or "display:none" in style or "visibility:hidden" in style
