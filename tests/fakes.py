"""A slicer without a device: layers in closed form, for what comes after slicing."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import rasterslice
from rasterslice.grid import Grid, cover
from rasterslice.params import Params
from rasterslice.paths import COLUMNS, DEPOSITION, Layer, Paths

PARAMS = """\
1
cube.stl
0
2
1
0.0001
1.5 1.5
0.4
45
0 1 1 1
0 0 0 0
0 0 0 0
0 1
0 1
1 1 1
5
"""


def pack(loops: list[Any], closed: bool) -> Paths:
    if not loops:
        return Paths.empty(closed)
    ends = np.cumsum([0] + [len(loop) for loop in loops]).astype(np.uint32)
    return Paths(np.vstack([np.asarray(loop, np.float64) for loop in loops]), ends, closed)


def ring(radius: float, n: int = 40, clockwise: bool = False) -> np.ndarray:
    turn = np.arange(n) * (-1 if clockwise else 1) * 2 * np.pi / n
    return radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)


def layer(index: int, z: float, *, regions: bool = True, **sets: Paths) -> Layer:
    """Return a layer of the path sets given, others empty, with statistics that fit them."""
    names = {n: n.endswith("fill") for n in DEPOSITION}
    paths: dict[str, Paths | None] = {n: sets.get(n, Paths.empty(not is_open)) for n, is_open in names.items()}
    stats: dict[str, Any] = dict.fromkeys(COLUMNS) | {"layer": index, "z": z, "open_rows": 0, "flags": ""}
    for name in ("part", "scaffold"):
        region = sets.get(name, Paths.empty(True))
        paths[name] = region if regions else None
        stats[f"{name}_area"] = float(region.areas().sum())
        stats[f"{name}_contours"] = len(region)
        stats[f"{name}_points"] = len(paths[f"{name}_boundary"].points)  # type: ignore[union-attr]
        for what in ("boundary", "fill"):
            stats[f"{name}_{what}_mm"] = float(paths[f"{name}_{what}"].lengths().sum())  # type: ignore[union-attr]
    return Layer(index=index, z=z, stats=stats, **paths)


def washer(index: int, z: float, *, regions: bool = True) -> Layer:
    """Return a ring of radii 3 and 8 with a collar of scaffold, all shrinking upwards."""
    k = 1 - 0.02 * index
    lines = [[(-6 * k, y), (-4 * k, y)] for y in (-0.5, 0.5)]
    return layer(
        index, z, regions=regions,
        part=pack([ring(8 * k), ring(3 * k, clockwise=True)], True),
        scaffold=pack([ring(10 * k), ring(8 * k, clockwise=True)], True),
        part_boundary=pack([ring(7.5 * k), ring(3.5 * k, clockwise=True)], True),
        scaffold_boundary=pack([ring(9.5 * k), ring(8.5 * k, clockwise=True)], True),
        part_fill=pack(lines, False),
        scaffold_fill=pack([[(0, 8.6 * k), (0, 9.4 * k)]], False),
    )  # fmt: skip


@dataclass
class FakeSlicing:
    """What `slicer.prepare` gives, for ``n`` washers; fails before layer ``fail_at`` with ``failure``."""

    params: Params
    regions: bool
    n: int = 6
    fail_at: int | None = None
    failure: BaseException | None = None
    warnings: list[str] = field(default_factory=lambda: ["cube.stl: a warning"])
    seconds: dict[str, float] = field(default_factory=lambda: {"read": 0.25})
    grid: Grid = field(default_factory=lambda: cover((-10, -10), (10, 10), 0.2, 1.0))
    device_name: str = "fake"
    batch: int = 2
    image_bytes: int = 1 << 20
    memory_budget: int = 1 << 28
    quantum: dict[str, float] = field(default_factory=lambda: {"distance_px": 1 / 128})
    facets: int = 12
    report: dict[str, Any] = field(default_factory=lambda: {"low": [0, 0, 0], "notes": []})
    copies: np.ndarray = field(default_factory=lambda: np.zeros((1, 2)))
    low: np.ndarray = field(default_factory=lambda: np.array([-8.0, -8.0, 0.0]))
    high: np.ndarray = field(default_factory=lambda: np.array([8.0, 8.0, 2.4]))
    closed: bool = False

    @property
    def heights(self) -> np.ndarray:
        return (np.arange(self.n) + 0.5) * self.params.thickness

    def layers(self, progress: Callable[[int, int], None] | None = None) -> Iterator[Layer]:
        try:
            for k in reversed(range(self.n)):
                if k == self.fail_at and self.failure:
                    raise self.failure
                yield washer(k, float(self.heights[k]), regions=self.regions)
                if progress:
                    progress(self.n - k, self.n)
        finally:
            self.closed = True


def install(monkeypatch: pytest.MonkeyPatch, **settings: Any) -> list[FakeSlicing]:
    """Put the fake in the place of the slicer; return the list that will hold what it gave."""
    given: list[FakeSlicing] = []

    def prepare(params: Params, *, device: str | None = None, regions: bool = False) -> FakeSlicing:
        given.append(FakeSlicing(params, regions, **settings))
        return given[-1]

    fake = ModuleType("rasterslice.slicer")
    fake.prepare = prepare  # type: ignore[attr-defined]
    fake.begin = lambda params: None  # type: ignore[attr-defined]  # it reads no mesh
    monkeypatch.setitem(sys.modules, "rasterslice.slicer", fake)
    monkeypatch.setattr(rasterslice, "slicer", fake, raising=False)
    monkeypatch.setattr("rasterslice.opening.begin", lambda select: None)  # the fake opens no device
    return given


def params_file(folder: Path, extra: str = "") -> Path:
    """Write a parameter file and the mesh it names (which the fake does not read)."""
    (folder / "cube.stl").write_bytes(b"solid")
    path = folder / "job.txt"
    path.write_text(PARAMS + extra)
    return path


def tree(folder: Path, but: tuple[str, ...] = ()) -> dict[str, bytes]:
    """Return every file below a folder, by its path."""
    files = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    return {name: data for name, data in files.items() if name not in but}


def polygon_area(n: int, radius: float) -> float:
    return n / 2 * radius**2 * math.sin(2 * math.pi / n)
