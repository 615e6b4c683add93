"""Slice meshes for rapid freeze prototyping, on images of signed distance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .arrays import to_lines as to_lines
    from .arrays import to_polygons as to_polygons
    from .arrays import to_stack as to_stack
    from .slicer import slice as slice
    from .spool import open_result as open

__version__ = "0.1.0"
__all__ = ["__version__", "open", "slice", "to_lines", "to_polygons", "to_stack"]


def __getattr__(name: str) -> Any:
    """Import what is public when it is asked for: OpenCL and NumPy take longer than ``--help`` should."""
    if name == "slice":
        from .slicer import slice as function

        return function
    if name == "open":
        from .spool import open_result

        return open_result
    if name.startswith("to_") and name in __all__:
        from . import arrays

        return getattr(arrays, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
