"""The source of the kernels: files of `kernels/`, composed into one program."""

from __future__ import annotations

from functools import cache
from pathlib import Path

#: Sources of the program, in the order in which they are composed.
SOURCES = (
    "common", "sums", "section", "bins", "overlap", "contacts", "distance", "scaffold", "cells", "crease", "isoline",
    "area", "lost", "sleeve", "contour", "lanes", "crossing", "fill", "nearest",
)  # fmt: skip


def kernel_source(name: str) -> str:
    """Return the text of ``name.cl``: inside the package when installed, beside it in a checkout."""
    package = Path(__file__).parent
    inside = package / "kernels"
    return ((inside if inside.is_dir() else package.parent / "kernels") / f"{name}.cl").read_text(encoding="utf-8")


@cache
def compose() -> str:
    """Return the whole source; ``#line`` lets the compiler name the right file."""
    return "".join(f'#line 1 "{name}.cl"\n{kernel_source(name)}\n' for name in SOURCES)
