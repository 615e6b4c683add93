"""The table of layers (docs/architecture.md): a module imports only from rows above its own."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "rasterslice"

#: Rows from the top; modules of one row do not import each other. A folder counts as one module.
ROWS = (
    ("errors",),
    (
        "interrupts", "kernel", "lazily", "meshkind", "numbertext", "plyhead", "polygons", "printout", "processor",
        "profile", "repeats", "settings", "streams", "terminal", "weld",
    ),
    (
        "folder", "params", "grid", "sources", "nesting", "opencl", "paths", "plyplain", "plytext", "polytext",
        "stltext", "toolchain",
    ),
    ("plyfile", "platforms", "programs", "window"),
    ("meshfile", "opening"),
    ("device", "mesh"),
    ("tiles", "thin", "intake"),
    ("part", "starter", "survey", "isoline"),
    ("corners", "memory", "reading", "section", "bins", "overlap", "distance", "scaffold", "contour", "order", "runs"),
    ("fill", "sorting", "trajectory", "assemble"),
    ("batches", "selftest", "spool"),
    ("slicer", "spooling", "cobra"),
    ("export", "check", "manifest"),
    ("arrays", "job", "report"),
    ("commands",),
    ("cli",),
    ("__main__",),
)
ROW = {name: row for row, names in enumerate(ROWS) for name in names}

#: The only places that may import a package: whatever is not named here is stdlib, NumPy or ours.
HOMES: dict[str, set[str] | None] = {
    "numpy": None,  # anywhere
    "pyopencl": {"opencl"},
    "trimesh": {"meshfile"},
    "serial": {"cobra"},
    "cv2": {"export", "check", "cobra", "report"},
    "skimage": {"check", "device"},
    "rich": {"terminal"},
    "tifffile": {"export"},
    "shapely": {"arrays"},
}

MODULES = sorted(PACKAGE.rglob("*.py"))


def home(path: Path) -> str:
    """Return the name under which a file stands in the table."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports(tree: ast.AST, path: Path) -> Iterator[tuple[str, int]]:
    """Give every module that a file imports, absolute and dotted, with its line."""
    package = ("rasterslice", *path.relative_to(PACKAGE).parts[:-1])
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join((*base, *filter(None, [node.module])))
            if module == "rasterslice":
                yield from ((f"rasterslice.{alias.name}", node.lineno) for alias in node.names)
            else:
                yield module, node.lineno


def faults(source: str, path: Path) -> list[str]:
    """Return what a file imports that it must not."""
    me, found = home(path), []
    for module, line in imports(ast.parse(source), path):
        top, _, rest = module.partition(".")
        other = rest.partition(".")[0]
        where = f"{path.relative_to(PACKAGE)}:{line}"
        if top == "rasterslice":
            if me == "__init__" or other in ("__version__", me):
                continue  # the face of the package shows what lies below; a folder is one module
            if other not in ROW:
                found.append(f"{where}: {module} stands in no row")
            elif ROW[other] >= ROW[me]:
                found.append(f"{where}: {me} (row {ROW[me]}) imports {other} (row {ROW[other]})")
        elif (allowed := HOMES.get(top)) and me not in allowed:
            found.append(f"{where}: {top} is imported outside {', '.join(sorted(allowed))}")
    return found


def third_party(source: str, path: Path) -> set[str]:
    tops = {module.partition(".")[0] for module, _ in imports(ast.parse(source), path)}
    return tops - set(sys.stdlib_module_names) - {"rasterslice"}


def test_every_module_stands_in_a_row() -> None:
    assert {home(path) for path in MODULES} <= {*ROW, "__init__"}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_imports_come_from_rows_above(path: Path) -> None:
    assert not faults(path.read_text(encoding="utf-8"), path)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_packages_are_those_that_the_house_knows(path: Path) -> None:
    assert third_party(path.read_text(encoding="utf-8"), path) <= HOMES.keys()


@pytest.mark.parametrize(
    ("file", "line", "fault"),
    [
        ("mesh.py", "from .slicer import x", "mesh.py:1: mesh (row 5) imports slicer (row 11)"),
        ("section.py", "from . import fill", "section.py:1: section (row 8) imports fill (row 9)"),
        ("mesh.py", "def f():\n    import rasterslice.cli", "mesh.py:2: mesh (row 5) imports cli (row 15)"),
        ("export/svg.py", "from ..job import run", "export/svg.py:1: export (row 12) imports job (row 13)"),
        ("export/svg.py", "from .format import Format", None),
        (
            "section.py", "import pyopencl.array",
            "section.py:1: pyopencl is imported outside opencl",
        ),
        ("fill.py", "from .unheard import of", "fill.py:1: rasterslice.unheard stands in no row"),
        ("fill.py", "from .device import Device", None),
    ],
)
def test_the_test_finds_faults(file: str, line: str, fault: str | None) -> None:
    assert faults(line, PACKAGE / file) == ([fault] if fault else [])
