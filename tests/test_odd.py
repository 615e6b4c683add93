"""Twins of the odd files of other projects (docs/odd-files.md): our own bytes with the same oddity, and the outcome."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshfiles
import models
import numpy as np
import pytest

from rasterslice.errors import ModelError
from rasterslice.intake import read_mesh
from rasterslice.mesh import place_notes, size_notes
from rasterslice.params import Params
from rasterslice.part import load_part
from rasterslice.survey import survey

VERTICES, FACES = meshfiles.ball()
CORNERS = VERTICES[FACES]
CUBE = models.prism([models.rectangle(0, 0, 2, 2)], 0, 2)
ONE = np.array([[[0, 0, 0], [2, 0, 0], [0, 2, 0]]], np.float32)
TEXT = meshfiles.stl_text(CORNERS)
POINTS = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"


def cube_text(*bodies: models.Body, **how: Any) -> bytes:
    return b"".join(meshfiles.stl_text(b.triangles(), name=f"body {i}", **how) for i, b in enumerate(bodies))


#: what is odd: (bytes, message of the refusal, or (facets, what `survey` finds besides))
TWINS: dict[str, tuple[bytes, str | tuple[int, dict[str, Any]]]] = {
    # headers and words
    "binary STL that begins with solid": (meshfiles.stl(CORNERS, b"solid made by a program"), (120, {"closed": True})),
    "binary STL of an empty header": (meshfiles.stl(CORNERS, b"\0" * 80), (120, {"closed": True})),
    "binary STL of a header that is no text": (meshfiles.stl(CORNERS, b"\xff\xfe\x80" * 26), (120, {"closed": True})),
    "ASCII STL with a Chinese name": (meshfiles.stl_text(CORNERS, name="月亮"), (120, {"closed": True})),
    "ASCII STL of CRLF": (meshfiles.stl_text(CORNERS, end="\r\n"), (120, {"closed": True})),
    "ASCII STL shorter than 212 bytes": (meshfiles.stl_text(ONE, name=""), (1, {"open_edges": 3})),
    "mixed case, several solids": (
        cube_text(CUBE, upper=True) + cube_text(CUBE.moved((9, 0, 0))),
        (24, {"closed": True, "shells": 2}),
    ),
    "an empty solid before the other": (b"solid a\nendsolid a\n" + TEXT, (120, {"closed": True})),
    "PLY header of CRLF, data after it": (
        meshfiles.ply(VERTICES, FACES, order="<").replace(b"\n", b"\r\n", 10),
        (120, {"closed": True}),
    ),
    "PLY data that begin with a line end": (
        meshfiles.ply(
            np.concatenate([np.full((1, 3), 10, np.uint32).view(np.float32), VERTICES]), FACES + 1, order="<"
        ),
        (120, {"closed": True}),
    ),
    "PLY with elements besides facets": (
        meshfiles.ply(VERTICES, FACES, order="<", extra=True),
        (120, {"closed": True}),
    ),
    "quads": (
        meshfiles.ply(np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 1]]), [[0, 1, 2, 3]]),
        (2, {"open_edges": 4}),
    ),
    # nothing to slice
    "no byte": (b"", "the file is empty"),
    "ASCII STL of no facets": (b"solid a\nendsolid a\n", "holds no facets (0 vertices); nothing to slice"),
    "binary STL of no facets": (meshfiles.stl(CORNERS[:0]), "holds no facets (0 vertices); nothing to slice"),
    "PLY header without elements": (
        b"ply\nformat ascii 1.0\nend_header\n",
        "holds no facets (0 vertices); nothing to slice",
    ),
    "PLY of points": (POINTS + b"end_header\n0 0 0\n1 1 1\n", "holds no facets (2 vertices); nothing to slice"),
    "PLY of points and no faces": (
        POINTS + b"element face 0\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 1 1\n",
        "holds no facets (2 vertices); nothing to slice",
    ),
    "PLY of a header without an end": (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 9\x7f",
        "the PLY header has no end; the file is damaged",
    ),
    # damage of the surface
    "facets missing": (meshfiles.stl(CUBE.without(0, 5).triangles()), (10, {"open_edges": 6})),
    "loose facets": (
        meshfiles.stl(np.random.default_rng(2).random((100, 3, 3))),
        (100, {"open_edges": 300, "shells": 100}),
    ),
    "facets of no area": (
        meshfiles.stl(np.concatenate([CORNERS, CORNERS[:3, [0, 0, 1]]])),
        (123, {"degenerate_facets": 3}),
    ),
    "facets twice, edges of four": (
        meshfiles.stl(np.concatenate([CORNERS, CORNERS[:1]])),
        (121, {"duplicate_facets": 1, "nonmanifold_edges": 3}),
    ),
    "turned facets": (meshfiles.stl(CUBE.flipped(2).triangles()), (12, {"inconsistent_edges": 3})),
    "inside out": (meshfiles.stl(CUBE.inverted().triangles()), (12, {"inverted_shells": 1, "closed": True})),
    "shells that overlap": (
        meshfiles.stl(models.join(CUBE, CUBE.moved((1, 1, 1))).triangles()),
        (24, {"closed": True, "shells": 2}),
    ),
}


@pytest.mark.parametrize("name", TWINS)
def test_twin(tmp_path: Path, name: str) -> None:
    data, wanted = TWINS[name]
    path = tmp_path / "twin"
    path.write_bytes(data)
    if isinstance(wanted, str):
        with pytest.raises(ModelError) as caught:
            read_mesh(path.rename(tmp_path / ("a.ply" if data.startswith(b"ply") else "a.stl")))
        assert str(caught.value).endswith(wanted) and caught.value.exit_code == 3
        return
    mesh = read_mesh(path)
    found = survey(mesh)
    assert found["facets"] == wanted[0] and mesh.notes == ()
    assert {key: found[key] for key in wanted[1]} == wanted[1]


def test_vertices_apart_by_a_rounding_are_welded_by_inexact(tmp_path: Path) -> None:
    """An STL of a CAD program whose zeros are 1e-16: open for its bits, closed within the tolerance."""
    corners = CUBE.triangles()
    corners[::2][corners[::2] == 0] = 2.7e-16
    path = tmp_path / "a.stl"
    path.write_bytes(meshfiles.stl(corners))
    assert survey(read_mesh(path))["open_edges"] > 0
    mesh, notes = load_part(Params((path,), inexact=True))
    assert survey(mesh)["closed"] and "were welded" in notes[0]


@pytest.mark.parametrize(("size", "word"), [(0.2, "metres or inches"), (50_800, "check the units"), (300, "210 mm")])
def test_sizes(tmp_path: Path, size: float, word: str) -> None:
    mesh = read_mesh(models.write_stl(tmp_path / "a.stl", CUBE.triangles() * (size / 2)))
    notes = place_notes(mesh)
    assert len(notes) == 1 and word in notes[0]
    assert size_notes(mesh) == ([] if size == 300 else notes)
