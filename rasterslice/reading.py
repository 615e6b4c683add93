"""The mesh of a run, read before it is needed: beside the imports that are left."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial

from .mesh import Mesh
from .params import Params
from .part import load_part
from .survey import brief, damage, survey

#: The part, what is to be said of it, and its report.
Read = tuple[Mesh, list[str], dict[str, object]]

_begun: tuple[Params, Future[Read]] | None = None


def begin(params: Params) -> None:
    """Begin to read the mesh of a run, in a thread; `reading` with the same parameters then has it sooner."""
    global _begun
    _begun = params, ThreadPoolExecutor(1, thread_name_prefix="read").submit(_read, params)


def reading(params: Params) -> Callable[[], Read]:
    """Return what reads the mesh, or waits for what was begun."""
    global _begun
    begun, _begun = _begun, None
    return begun[1].result if begun is not None and begun[0] is params else partial(_read, params)


def _read(params: Params) -> Read:
    mesh, notes = load_part(params)
    report = survey(mesh) if params.report else brief(mesh)
    if params.report and damage(report):
        notes.append(f"{mesh.path}: {damage(report)}")
    return mesh, notes, report
