"""The files in ``viewer/``: what pages are made of."""

from __future__ import annotations

from pathlib import Path


def asset(name: str) -> str:
    """Return the text of one of them."""
    return (Path(__file__).parent / "viewer" / name).read_text(encoding="utf-8")  # importlib.resources imports much
