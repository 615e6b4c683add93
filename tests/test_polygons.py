"""Polygons of PLY, OBJ and OFF become triangles that do not overlap; other text is read or refused clearly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshfiles
import models
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from rasterslice import polygons
from rasterslice.errors import ModelError
from rasterslice.intake import read_mesh
from rasterslice.polygons import ears, fans, mend_fans
from rasterslice.survey import survey

STAR = [(2.0 * (1 + i % 2) * np.cos(i * np.pi / 5), 2.0 * (1 + i % 2) * np.sin(i * np.pi / 5)) for i in range(10)]
L_SHAPE = [(0, 0), (6, 0), (6, 2), (2, 2), (2, 6), (0, 6)]
ARROW = [(0, 0), (4, -3), (1, 0), (4, 3)]  # its corner 2 is reflex
STAIRS = [(0, 0), (3, 0), (6, 0), (6, 2), (4, 2), (4, 4), (2, 4), (2, 6), (0, 6), (0, 3)]  # with straight corners


def prism(outline: Any, height: float = 3.0) -> tuple[np.ndarray, list[list[int]]]:
    """Return vertices and polygons of a prism: its ends are whole polygons."""
    n = len(outline)
    low = np.column_stack([outline, np.zeros(n)])
    vertices = np.concatenate([low, low + (0, 0, height)])
    sides = [[i, (i + 1) % n, n + (i + 1) % n, n + i] for i in range(n)]
    return vertices, [list(range(n))[::-1], list(range(n, 2 * n)), *sides]


def obj(vertices: np.ndarray, faces: list[list[int]], end: str = "\n", form: str = "{}") -> bytes:
    lines = ["# by hand", "mtllib none.mtl", "o body", *(f"v {x} {y} {z}" for x, y, z in vertices), "vn 0 0 1", "s off"]
    lines += ["f " + " ".join(form.format(i + 1) for i in f) for f in faces]
    return (end.join(lines) + end).encode()


def off(vertices: np.ndarray, faces: list[list[int]], head: str = "OFF\n", colour: str = "") -> bytes:
    lines = [f"{x} {y} {z}" for x, y, z in vertices] + [" ".join(map(str, [len(f), *f])) + colour for f in faces]
    return (head + f"{len(vertices)} {len(faces)} 0\n" + "# a comment\n" + "\n".join(lines) + "\n").encode()


WRITERS = {
    "ply": lambda v, f: meshfiles.ply(v, f, real="double"),
    "ply, binary": lambda v, f: meshfiles.ply(v, f, real="double", order="<", index="uint"),
    "ply, big, elements": lambda v, f: meshfiles.ply(v, f, real="double", order=">", extra=True, first=True),
    "obj": obj,
    "obj of CR": lambda v, f: obj(v, f, "\r"),
    "obj with normals": lambda v, f: obj(v, f, "\r\n", "{}//1"),
    "off": off,
    "off with colours": lambda v, f: off(v, f, "OFF # header\n", " 255 0 0"),
    "off on one line": lambda v, f: off(v, f, "COFF "),
}


def put(folder: Path, data: bytes, name: str = "mesh") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def flat(triangles: np.ndarray) -> list[shapely.Polygon]:
    """Return the triangles of one end of a prism."""
    return [shapely.Polygon(t[:, :2]) for t in triangles if np.ptp(t[:, 2]) == 0 and t[0, 2] > 0]


@pytest.mark.parametrize("outline", [STAR, L_SHAPE, ARROW, STAIRS], ids=["star", "L", "arrow", "stairs"])
@pytest.mark.parametrize("writer", WRITERS)
def test_concave_polygons_do_not_overlap(tmp_path: Path, writer: str, outline: Any) -> None:
    mesh = read_mesh(put(tmp_path, WRITERS[writer](*prism(outline))))
    report = survey(mesh)
    shape = shapely.Polygon(outline)
    assert report["closed"] and mesh.notes == ()
    assert len(mesh.triangles) == 2 * (len(outline) - 2) + 2 * len(outline)
    assert report["volume_mm3"] == pytest.approx(3 * shape.area, rel=1e-6)
    ends = flat(mesh.triangles.astype(float) + mesh.origin)
    assert len(ends) == len(outline) - 2
    assert sum(t.area for t in ends) == pytest.approx(shape.area, rel=1e-6)
    assert shapely.union_all(ends).area == pytest.approx(shape.area, rel=1e-6)


def test_no_false_overlap(tmp_path: Path) -> None:
    """A star that lies on its side: its ends are cut by every slice."""
    vertices, faces = prism(STAR, 6.0)
    path = put(tmp_path, obj(vertices[:, [0, 2, 1]] * (1, -1, 1) * 3, faces), "a.obj")
    assert survey(read_mesh(path))["volume_mm3"] > 0
    for layer in models.slice_file(path, thickness=0.8):
        assert "overlap" not in str(layer.stats["flags"])
        assert layer.stats["part_area_exact"] is not None


def test_convex_polygons_are_fans() -> None:
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0.5, 0)])
    faces = fans(np.arange(5), np.array([5]))
    before = faces.copy()
    assert mend_fans(square, faces, np.array([5])) == 0
    assert (faces == before).all()


@given(st.integers(0, 2**32 - 1), st.integers(4, 30))
@settings(max_examples=150, deadline=None)
def test_random_polygons(seed: int, n: int) -> None:
    """Star-shaped polygons in any plane: as many triangles as corners less two, and the area is covered once."""
    rng = np.random.default_rng(seed)
    turn = np.sort(rng.random(n)) * 2 * np.pi
    xy = np.stack([np.cos(turn), np.sin(turn)], 1) * rng.uniform(0.2, 1, (n, 1))
    shape = shapely.Polygon(xy)
    if not shape.is_valid or np.ptp(np.diff(turn, append=turn[0] + 2 * np.pi)) > np.pi:
        return
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0][:2]
    faces = fans(np.arange(n), np.array([n]))
    assert mend_fans(xy @ axes + 5, faces, np.array([n])) == 0
    assert len(faces) == n - 2
    parts = [shapely.Polygon(xy[f]) for f in faces]
    assert sum(p.area for p in parts) == pytest.approx(shape.area, rel=1e-6)
    assert shapely.union_all(shapely.set_precision(parts, 1e-9)).area == pytest.approx(shape.area, rel=1e-5)


def test_what_crosses_itself_is_read(tmp_path: Path) -> None:
    bow = [(0, 0), (4, 4), (4, 0), (0, 4), (-3, 2)]
    assert len(read_mesh(put(tmp_path, obj(*prism(bow)))).triangles) == 16


@pytest.mark.parametrize("writer", ["ply", "ply, binary", "obj", "off"])
def test_polygons_that_stay_fans_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: str) -> None:
    monkeypatch.setattr(polygons, "_MOST_TESTS", 2)
    mesh = read_mesh(put(tmp_path, WRITERS[writer](*prism(L_SHAPE))))
    (note,) = mesh.notes
    assert note.endswith("2 polygons cross themselves or are too large to cut well; layers there may be flagged "
                         "overlap")  # fmt: skip
    assert survey(mesh)["volume_mm3"] == pytest.approx(3 * 20, rel=1e-6)


def test_the_search_for_ears_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    assert ears(np.array(L_SHAPE, float), [3]) is None
    assert ears(np.array(L_SHAPE, float), [100]) is not None
    monkeypatch.setattr(polygons, "_MOST_CORNERS", 5)
    vertices, faces = prism(L_SHAPE)
    size = np.array([len(f) for f in faces])
    assert mend_fans(vertices, fans(np.concatenate(faces), size), size) == 2


def test_mixed_polygons_of_off(tmp_path: Path) -> None:
    """Triangles, a quad and a pentagon in one file."""
    v, f = prism([(0, 0), (4, 0), (5, 3), (2, 5), (-1, 3)])
    f[2:] = [part for a, b, c, d in f[2:] for part in ((a, b, c), (a, c, d))]  # type: ignore[misc]
    report = survey(read_mesh(put(tmp_path, off(v, f), "a.off")))
    assert report["closed"] and report["facets"] == 16


BALL, BALL_FACES = meshfiles.ball()
TEXT = meshfiles.stl_text(BALL[BALL_FACES])
OBJ = obj(BALL, BALL_FACES.tolist())
WIDE = TEXT.decode().encode("utf-16")
CUBE = models.prism([models.rectangle(0, 0, 2, 2)], 0, 2).triangles()


def bad_normals(word: bytes) -> bytes:
    return TEXT.replace(b"normal 0 0 0", b"normal " + b" ".join([word] * 3))


READ = {
    "a BOM before solid": ("a.stl", b"\xef\xbb\xbf" + TEXT),
    "a comment before solid": ("a.stl", b"# made by hand\r\n\n  # and more\n" + TEXT),
    "a long comment before solid": ("a.stl", b"#" + b"x" * 3000 + b"\n" + TEXT),
    "comments between": ("a.stl", TEXT.replace(b"  facet", b"# facet\n  facet", 3)),
    "a BOM before ply": ("a.ply", b"\xef\xbb\xbf" + meshfiles.ply(BALL, BALL_FACES)),
    "PLY in capitals": ("a.ply", meshfiles.ply(BALL, BALL_FACES, order="<").replace(b"ply", b"PLY", 1)),
    "OBJ named stl": ("a.stl", OBJ),
    "OBJ of CR named stl": ("a.stl", OBJ.replace(b"\n", b"\r")),
    "a BOM before OBJ": ("a.obj", b"\xef\xbb\xbf" + OBJ),
    "OBJ lines that go on": ("a.obj", OBJ.replace(b"f 1 ", b"f 1 \\\n")),
    "OBJ from the end": ("a.obj", OBJ.split(b"f ")[0] + b"".join(
        b"f %d %d %d\n" % tuple(f - len(BALL)) for f in BALL_FACES)),
    "text after endsolid": ("a.stl", TEXT + b"exported by a program, in 3 s\n\nmore of it\n"),
    "text between solids": ("a.stl", b"solid a\nendsolid a\nby hand\n" + TEXT),
    "all on one line": ("a.stl", TEXT.replace(b"\n", b" ")),
    "all on one line, names of keywords": ("a.stl", TEXT.replace(b"a ball", b"facet of a vertex").replace(b"\n", b" ")),
    "solids on one line": ("a.stl", (meshfiles.stl_text(BALL[BALL_FACES[:60]]) +
                                     meshfiles.stl_text(BALL[BALL_FACES[60:]])).replace(b"\n", b" ")),
    "one line for each facet": ("a.stl", TEXT.replace(b"\n    ", b" ").replace(b"\n      ", b" ").replace(
        b"\n  endfacet", b" endfacet")),
    "normals -nan(ind)": ("a.stl", bad_normals(b"-nan(ind)")),
    "normals 1.#QNAN0": ("a.stl", bad_normals(b"-1.#QNAN0")),
}  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_text_as_programs_write_it(tmp_path: Path, name: str) -> None:
    file, data = READ[name]
    mesh = read_mesh(put(tmp_path, data, file))
    assert mesh.notes == ()
    want = BALL[BALL_FACES] - BALL.min(axis=0)
    np.testing.assert_allclose(mesh.triangles + mesh.origin - mesh.low, want, atol=1e-5)


REFUSED = {
    "UTF-16": ("a.stl", WIDE, ": is text of two bytes a character (UTF-16); save it as ASCII or UTF-8"),
    "UTF-16 without a mark": ("a.stl", WIDE[2:], ": is text of two bytes a character"),
    "UTF-16 PLY": ("a.ply", meshfiles.ply(BALL, BALL_FACES).decode().encode("utf-16"), ": is text of two bytes"),
    "a letter as STL": ("a.stl", b"Dear reader,\n" * 20, ": text that begins with 'Dear reader,'; an ASCII STL"),
    "few bytes": ("a.stl", bytes(84)[:80] + b"\7\0\0\0" + bytes(20), "holds 0; export the model again"),
    "cut in the first facet": ("a.stl", TEXT[:60], "cut short after 0 whole facets; export the model again"),
    "a keyword after the end": ("a.stl", TEXT + b"outer loop\n", ": expected facet, solid or endsolid, got 'outer'"),
    "vertices after the end": ("a.stl", TEXT + b"vertex 1 2 3\n", ": expected facet, solid or endsolid, got 'vertex'"),
    "PLY without room": ("a.ply", meshfiles.ply(BALL[:0], []).replace(b"face 0", b"face 9").replace(
        b"vertex 0", b"vertex 1"), "but the file has room for 0; export the model again"),
    "OBJ of a word": ("a.obj", b"v 1 2 x\n", ":1: a vertex must be 3 numbers, got '1 2 x'"),
    "OBJ of a facet 0": ("a.obj", OBJ + b"f 0 1 2\n", "the first vertex of an OBJ file is 1, got 0"),
    "OBJ of a facet x": ("a.obj", OBJ + b"f x 1 2\n", "expected a whole number, got 'x'"),
    "OBJ that goes on": ("a.obj", OBJ + b"f 1 2 \\", "the last line says that another one follows"),
    "OFF cut short": ("a.off", off(BALL, BALL_FACES.tolist())[:-30], "or use --lenient to slice what is whole"),
    "OFF of promises": ("a.off", b"OFF\n999999999 999999999 0\n0 0 0\n", "do not fit in"),
    "OFF, binary": ("a.off", b"OFF BINARY\n" + bytes(90), "binary OFF is not read; save it as ASCII OFF, STL or PLY"),
    "OFF of four": ("a.off", b"4OFF\n1 1 0\n", "has vertices of another dimension; save it with x, y and z"),
    "OFF of long facets": ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n9 0 1 2\n3 0 1 2\n",
                           ":6: a facet of 9 corners, but 3 numbers follow in its line; export the model again"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_text_that_cannot_be_read(tmp_path: Path, name: str) -> None:
    file, data, message = REFUSED[name]
    path = put(tmp_path, data, file)
    with pytest.raises(ModelError) as caught:
        read_mesh(path)
    text = str(caught.value)
    assert message in text and text.startswith(str(path)) and "\n" not in text
    assert ("--lenient" in text) == ("--lenient" in message), "recommended only where it would help"


def test_vertices_of_nan_words_are_dropped(tmp_path: Path) -> None:
    corners = BALL[BALL_FACES]
    many = np.concatenate([corners, corners + 20])
    text = meshfiles.stl_text(many)
    first = text.index(b"vertex")
    data = text[:first] + b"vertex -nan(ind) 1.#QNAN 0" + text[text.index(b"\n", first) :]
    mesh = read_mesh(put(tmp_path, data, "a.stl"))
    assert len(mesh.triangles) == len(many) - 1 and "1 of 240 facets" in mesh.notes[0]


def test_off_is_read_leniently(tmp_path: Path) -> None:
    data = off(BALL, BALL_FACES.tolist())
    mesh = read_mesh(put(tmp_path, data[: data.rindex(b"3 ")], "a.off"), lenient=True)
    assert len(mesh.triangles) == 119 and "119 of 120 facets are whole" in mesh.notes[0]


def test_a_long_line_is_read_in_blocks(tmp_path: Path) -> None:
    many = np.concatenate([BALL[BALL_FACES]] * 100)
    mesh = read_mesh(put(tmp_path, meshfiles.stl_text(many).replace(b"\n", b" "), "a.stl"))
    assert len(mesh.triangles) == 12_000 and mesh.notes == ()
