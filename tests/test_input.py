"""Every format and variant of a mesh file reads back bit-equal; dirt is dropped, reported, or refused."""

from __future__ import annotations

import io
import itertools
import random
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import meshfiles
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from rasterslice.errors import ModelError
from rasterslice.intake import read_mesh, read_meshes
from rasterslice.mesh import Mesh
from rasterslice.numbertext import NotANumber, parse, words_of
from rasterslice.streams import BLOCK, Block, blocks, line_of

VERTICES, FACES = meshfiles.ball()
CORNERS = VERTICES[FACES]


def put(folder: Path, data: bytes, name: str = "mesh") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def placed(mesh: Mesh) -> np.ndarray:
    """Return the corners as the file has them; origins are float32 where the file's numbers are."""
    return (mesh.triangles.astype(np.float64) + mesh.origin).astype(np.float32)


def refused(path: Path, lenient: bool = False) -> str:
    with pytest.raises(ModelError) as caught:
        read_mesh(path, lenient=lenient)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
    return str(caught.value).removeprefix(str(path))


# ---------------------------------------------------------------- every format, bit-equal


@pytest.mark.parametrize("name", meshfiles.variants())
def test_variants(tmp_path: Path, name: str) -> None:
    """The name of the file says nothing."""
    mesh = read_mesh(put(tmp_path, meshfiles.variants()[name], "mesh.xyz"))
    wanted = CORNERS
    if "polygons" in name or name == "text_crlf.ply":  # the last facet has a corner more
        wanted = CORNERS[:-1]
        assert len(np.unique(placed(mesh)[-2:].reshape(-1, 3), axis=0)) == 4
    np.testing.assert_array_equal(placed(mesh)[: len(wanted)], wanted)
    assert len(mesh.triangles) == len(wanted) + 2 * (wanted is not CORNERS)
    assert mesh.notes == ()


finite = st.floats(-1e5, 1e5, width=32)
meshes = st.integers(1, 12).flatmap(lambda n: arrays.arrays(np.float32, (n, 3, 3), elements=finite))


@given(corners=meshes, data=st.data())
@settings(max_examples=120, deadline=None)
def test_random_meshes_read_back_bit_equal(
    tmp_path_factory: pytest.TempPathFactory, corners: np.ndarray, data: Any
) -> None:
    end = data.draw(st.sampled_from(["\n", "\r\n", "\r"]))
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    order = data.draw(st.sampled_from(["", "<", ">"]))
    switch = {name: data.draw(st.booleans(), name) for name in ("colour", "first", "extra", "swap")}
    real, index = data.draw(st.sampled_from(["float", "double"])), data.draw(st.sampled_from(["int", "uint", "uchar"]))
    length = data.draw(st.sampled_from(["uchar", "int", "ushort"]))
    form = data.draw(st.sampled_from(["%.9g", "%.8e", "%r", "%.17g", "%+.10E"]))
    made = [
        meshfiles.stl(corners, data.draw(st.sampled_from([b"solid ", b"\xff" * 80, b""]))),
        meshfiles.stl_text(corners, end=end, form=form, upper=switch["swap"]),
        meshfiles.ply(corners.reshape(-1, 3), faces, order=order, end=end if not order else "\n", real=real,
                      index=index, length=length, **switch),
    ]  # fmt: skip
    for i, raw in enumerate(made):
        mesh = read_mesh(put(tmp_path_factory.getbasetemp(), raw, f"random{i}"))
        exact = placed(mesh) + np.float32(0)  # 0 and -0 are one number
        np.testing.assert_array_equal(exact, corners + np.float32(0), err_msg=str(i))


@pytest.mark.parametrize("suffix", ["obj", "off", "glb", "3mf"])
def test_formats_of_trimesh_are_known_by_their_content(tmp_path: Path, suffix: str) -> None:
    trimesh = pytest.importorskip("trimesh")
    if suffix == "3mf":
        pytest.importorskip("lxml")
    mesh = trimesh.Trimesh(VERTICES, FACES, process=False)
    raw = mesh.export(file_type=suffix)
    path = put(tmp_path, raw if isinstance(raw, bytes) else raw.encode(), "mesh.data")
    found = read_mesh(path)
    assert len(found.triangles) == len(FACES)
    np.testing.assert_allclose(found.high - found.low, VERTICES.max(0) - VERTICES.min(0), rtol=1e-6)


def test_units(tmp_path: Path) -> None:
    path = put(tmp_path, meshfiles.stl(CORNERS))
    for units, mm in (("mm", 1), ("cm", 10), ("m", 1000), ("inch", 25.4)):
        mesh = read_mesh(path, units)
        np.testing.assert_allclose(mesh.high, CORNERS.max((0, 1)).astype(float) * mm, rtol=1e-6)
        assert len(np.unique(mesh.triangles.reshape(-1, 3), axis=0)) == len(VERTICES), "shared vertices stay shared"


def test_units_of_3mf_are_its_own(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("lxml")
    raw = trimesh.Trimesh(VERTICES, FACES, process=False).export(file_type="3mf")
    for unit, mm in (("millimeter", 1), ("inch", 25.4), ("centimeter", 10)):
        path = tmp_path / "a.3mf"
        with zipfile.ZipFile(io.BytesIO(raw)) as old, zipfile.ZipFile(path, "w") as new:
            for name in old.namelist():
                new.writestr(name, old.read(name).replace(b'"millimeter"', f'"{unit}"'.encode()))
        np.testing.assert_allclose(read_mesh(path, "m").high, VERTICES.max(0).astype(float) * mm, rtol=1e-6)


def test_obj_of_two_coordinates(tmp_path: Path) -> None:
    path = put(tmp_path, b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "a.obj")
    refused(path)


def test_several_files_are_one_mesh(tmp_path: Path) -> None:
    far = CORNERS.astype(np.float64) + 1e5
    a, b = put(tmp_path, meshfiles.stl(CORNERS), "a"), put(tmp_path, meshfiles.stl(CORNERS * np.float32(2)), "b")
    c = put(tmp_path, meshfiles.ply(far.reshape(-1, 3), np.arange(far.size // 3).reshape(-1, 3), real="double"), "c")
    mesh = read_meshes([a, b])
    np.testing.assert_array_equal(placed(mesh), np.concatenate([CORNERS, CORNERS * 2]))
    assert mesh.path == a and not mesh.origin.any()
    mesh = read_meshes([a, c])
    np.testing.assert_allclose(mesh.triangles + mesh.origin, np.concatenate([CORNERS, far]), atol=0.004)
    np.testing.assert_allclose(mesh.high, far.max((0, 1)), atol=1e-6)
    for half in np.split(mesh.triangles, 2):
        assert len(np.unique(half.reshape(-1, 3), axis=0)) == len(VERTICES)


# ---------------------------------------------------------------- odd ASCII STL

FACET = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
SOLID = f"solid\n{FACET}endsolid\n"


@pytest.mark.parametrize(
    "text",
    [
        SOLID, SOLID.upper(), "\n\n  " + SOLID, SOLID + "\n\n", SOLID.replace("\n", "\r"), SOLID.replace(" ", "\t "),
        SOLID.replace("endfacet", "endfacet here").replace("endloop", "endloop it is"), "solid x\nendsolid x\n" + SOLID,
        SOLID.replace("normal 0 0 1", "normal nan inf -nan(ind)"),
        SOLID.replace("solid\n", "solid endsolid facet vertex 1\n"),
        SOLID.replace(" normal 0 0 1", ""), SOLID.replace("1 0 0", "+1.E0 .0 -0e5"), SOLID.removesuffix("\n"),
        SOLID.replace("solid\n", "solid " + "x" * 300 + "\n"), "\ufeff".strip("\ufeff") + SOLID,
        SOLID.replace("normal 0 0 1\n", "normal 0 0 1 "), SOLID.replace("1 0 0", "1\t0 \t 0"),
        SOLID.replace("solid\n", "solid my endfacet part\n"), SOLID.replace("solid\n", "solid endsolid endfacet\n"),
        SOLID + "made by endfacet tools\nbye\n", SOLID + "endfacet\nbye\n", SOLID + "ENDFACET endfacet",
        SOLID + "facet count: 1\n", SOLID + "facets 1\nvertex 3\nfacet 7 of 9\nendfacet count 1\nbye\n",
        (SOLID + "facet count: 1\n").upper(),
    ],
)  # fmt: skip
def test_ascii_stl_as_programs_write_it(tmp_path: Path, text: str) -> None:
    mesh = read_mesh(put(tmp_path, text.encode()))
    np.testing.assert_array_equal(mesh.triangles, [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SOLID.replace("1 0 0", "1 0"), ":5: a vertex must be 3 numbers, got '1 0'"),
        (SOLID.replace("1 0 0", "1 0 O"), ":5: a vertex must be 3 numbers, got 'O'"),
        (SOLID.replace("1 0 0", "1,5 0 0"), ":5: a vertex must be 3 numbers, got '1,5'"),
        (SOLID.replace("1 0 0", "1_0 0 0"), ":5: a vertex must be 3 numbers, got '1_0'"),
        (SOLID.replace("1 0 0", "1 0 0\nvertex 5 5 5"), ":7: expected endloop, got 'vertex'"),
        (SOLID.replace("vertex 1 0 0\n", ""), ":6: expected vertex, got 'endloop'"),
        (SOLID.replace("outer", "inner"), ":3: expected outer, got 'inner'"),
        (SOLID.replace("endfacet", "endfacit"), ":8: expected endfacet, got 'endfacit'"),
        (SOLID.replace("endfacet\n", ""), ":8: expected endfacet, got 'endsolid'"),
        ("solid\nhello\n" + SOLID, ":2: expected facet, solid or endsolid, got 'hello'"),
        (
            SOLID.replace("vertex 1 0 0", "vertex 1 0 " + "9" * 50),
            ": a coordinate of 1e+50 is no length; the file is damaged",
        ),
        (f"solid\n{FACET}{FACET[:60]}", ": the file is cut short after 1 whole facet; export the model again, or use"),
        (f"solid\n{FACET}{FACET[:-5]}", ": the file is cut short after 1 whole facet"),
        (f"solid\n{FACET}endsol", ": the file is cut short after 1 whole facet"),
        (f"solid\n{FACET}", ": the file is cut short after 1 whole facet"),
        (f"solid endsolid\n{FACET}", ": the file is cut short after 1 whole facet"),
        (f"solid my endfacet part\n{FACET}{FACET[:50]}", ": the file is cut short after 1 whole facet"),
        (f"{SOLID}solid b\n{FACET[:50]}", ": the file is cut short after 1 whole facet"),
        (f"solid\n{FACET[:40]}", ": the file is cut short after 0 whole facets"),
        ("solid\n", ": holds no facets"),
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_damaged_ascii_stl(tmp_path: Path, text: str, message: str, end: str) -> None:
    path = put(tmp_path, text.replace("\n", end).encode(), "a.stl")
    assert refused(path).startswith(message)
    if "cut short after 1" in message:
        mesh = read_mesh(path, lenient=True)
        assert len(mesh.triangles) == 1
        assert mesh.notes == (f"{path}: the file is cut short; 1 whole facet sliced",)
    else:
        refused(path, lenient=True)


def test_an_error_far_down_names_its_line(tmp_path: Path) -> None:
    text = meshfiles.stl_text(np.tile(CORNERS, (90, 1, 1)), end="\r\n")
    assert len(text) > 1.5 * BLOCK
    for share in (0.1, 0.5, 0.99):
        at = text.index(b"vertex", int(share * len(text)))
        path = put(tmp_path, text[:at] + b"vortex" + text[at + 6 :])
        line = text[:at].count(b"\n") + 1
        assert refused(path).startswith(f":{line}: expected vertex, got 'vortex'")
    np.testing.assert_array_equal(placed(read_mesh(put(tmp_path, text))), np.tile(CORNERS, (90, 1, 1)))


@pytest.mark.parametrize("name", ["my endfacet part", "endsolid endfacet", "endfacet"])
@pytest.mark.parametrize("end", ["\n", "\r\n", " "])
def test_keywords_in_names_of_long_files(tmp_path: Path, name: str, end: str) -> None:
    """Wherever blocks are cut: many solids of such names, text after the end, on lines or on one."""
    one = meshfiles.stl_text(CORNERS, name=name if end != " " else "a", end=end)
    many = one * (BLOCK // len(one) + 3)
    after = b"facet count 7\nendfacet of all\nbye\n" * (0 if end == " " else 4000)
    assert len(many) > BLOCK
    mesh = read_mesh(put(tmp_path, many + after))
    np.testing.assert_array_equal(placed(mesh), np.tile(CORNERS, (BLOCK // len(one) + 3, 1, 1)))
    assert mesh.notes == ()
    path = put(tmp_path, many[: -len(f"endsolid {name}{end}")] if end != " " else many[: -len("endsolid a ")])
    assert "cut short after" in refused(path)


# ---------------------------------------------------------------- dirt


def test_binary_stl_cut_short(tmp_path: Path) -> None:
    raw = meshfiles.stl(CORNERS)
    path = put(tmp_path, raw[:-51], "a.stl")
    held = len(CORNERS) - 2
    assert f"promises {len(CORNERS)} facets (0.0 MB) but the file holds {held}" in refused(path)
    mesh = read_mesh(path, lenient=True)
    np.testing.assert_array_equal(placed(mesh), CORNERS[:held])
    assert mesh.notes[0].endswith(f"the file holds {held}, sliced")


def test_trailing_bytes_warn(tmp_path: Path) -> None:
    for raw in (meshfiles.stl(CORNERS), meshfiles.ply(VERTICES, FACES, order="<")):
        path = put(tmp_path, raw + b"\0" * 7, "a.stl")
        mesh = read_mesh(path)
        np.testing.assert_array_equal(placed(mesh), CORNERS)
        assert mesh.notes[0].startswith(f"{path}: 7 bytes after the ")


def test_a_header_that_promises_too_few_facets(tmp_path: Path) -> None:
    for fewer, extra, said in ((4, 0, "200 bytes after the 116 facets that the header promises, just as many as 4 "),
                               (1, 0, ", just as many as 1 facet more would take: ignored"),
                               (4, 3, "203 bytes after the 116 facets that the header promises: ignored")):  # fmt: skip
        path = put(tmp_path, meshfiles.stl(CORNERS, count=len(CORNERS) - fewer) + b"x" * extra, "a.stl")
        mesh = read_mesh(path)
        assert len(mesh.triangles) == len(CORNERS) - fewer and said in mesh.notes[0]


def test_strips_are_refused_by_name(tmp_path: Path) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    path = put(tmp_path, (head + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n").encode(), "a.ply")
    assert "triangle strips (element tristrips), which are not read; export single facets" in refused(path)


@pytest.mark.parametrize("order", ["", "<", ">"])
def test_ply_cut_short(tmp_path: Path, order: str) -> None:
    raw = meshfiles.ply(VERTICES, FACES, order=order)
    path = put(tmp_path, raw[: -20 if order else -12])
    assert "face elements but the file holds" in refused(path)
    mesh = read_mesh(path, lenient=True)
    whole = len(mesh.triangles)
    assert 0 < len(FACES) - whole <= 3
    np.testing.assert_array_equal(placed(mesh), CORNERS[:whole])
    assert f"{whole} of {len(FACES)} facets are whole" in mesh.notes[0]
    path = put(tmp_path, raw[: len(raw) // 4])
    refused(path, lenient=True)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("real", ["stl", "float", "double"])
def test_few_facets_that_are_not_finite_are_dropped(tmp_path: Path, value: float, real: str) -> None:
    corners = np.tile(CORNERS, (3, 1, 1))
    corners[[5, 77], 1, 2] = value
    faces = np.arange(corners.size // 3).reshape(-1, 3)
    raw = (
        meshfiles.stl(corners) if real == "stl" else meshfiles.ply(corners.reshape(-1, 3), faces, order="<", real=real)
    )
    path = put(tmp_path, raw)
    mesh = read_mesh(path)
    np.testing.assert_array_equal(placed(mesh), np.delete(corners, [5, 77], axis=0))
    what = f"2 of {len(corners)} facets, the first is number 5, have a vertex that is NaN or infinite"
    assert mesh.notes == (f"{path}: {what}; they are dropped",)
    corners[:10, 0, 0] = value
    assert "more than 1% cannot be dropped" in refused(put(tmp_path, meshfiles.stl(corners)))


def test_no_memory_for_what_a_header_promises(tmp_path: Path) -> None:
    """4 GB of facets in 84 bytes; the process may have little."""
    paths = [put(tmp_path, meshfiles.stl(CORNERS[:1], count=2**32 - 1), "a.stl"),
             put(tmp_path, meshfiles.ply(VERTICES, FACES, order="<").replace(b"face 1", b"face 99999999991"), "b.ply"),
             put(tmp_path, meshfiles.ply(VERTICES, FACES).replace(b"vertex ", b"vertex 9999999"), "c.ply")]  # fmt: skip
    code = (
        "import sys, resource; from rasterslice.intake import read_mesh; from rasterslice.errors import ModelError\n"
        "import pathlib; size = int(pathlib.Path('/proc/self/statm').read_text().split()[0]) * 4096 + (64 << 20)\n"
        "resource.setrlimit(resource.RLIMIT_AS, (size, size))\n"
        "for path in sys.argv[1:]:\n"
        "    for lenient in (0, 1):\n"
        "        try: print(len(read_mesh(path, lenient=lenient).triangles))\n"
        "        except ModelError as error: print(error)\n"
    )
    command = [sys.executable, "-c", code, *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path(__file__).parents[1])
    said = done.stdout.splitlines()
    assert len(said) == 6 and said[1] == "1" and all("promises" in said[i] for i in (0, 2, 4, 5))


# ---------------------------------------------------------------- numbers, blocks

number = st.floats(allow_nan=False).map(repr) | st.integers(-(10**18), 10**18).map(str) | st.from_regex(
    r"[+-]?([0-9]{1,12}\.?[0-9]{0,12}|\.[0-9]{1,8})([eE][+-]?[0-9]{1,3})?", fullmatch=True
)  # fmt: skip


@given(st.lists(number, min_size=1, max_size=30))
@settings(max_examples=300)
def test_numbers_have_the_bits_of_float(words: list[str]) -> None:
    text = np.frombuffer("\t".join(words).encode(), np.uint8)
    np.testing.assert_array_equal(
        parse(text, *words_of(text)).view(np.int64), np.array([float(w) for w in words]).view("i8")
    )


@given(st.lists(number, max_size=5), st.text("0123456789+-.eE_xnaif", min_size=1, max_size=30))
@settings(max_examples=300)
def test_what_float_refuses_is_refused(words: list[str], odd: str) -> None:
    text = np.frombuffer(" ".join([*words, odd]).encode(), np.uint8)
    try:
        wanted = float("x" if "_" in odd else odd)
    except ValueError:
        with pytest.raises(NotANumber) as caught:
            parse(text, *words_of(text))
        assert (caught.value.index, caught.value.word) == (len(words), odd)
    else:
        np.testing.assert_array_equal(parse(text, *words_of(text))[-1], wanted)


@given(st.lists(st.sampled_from([b"a\n", b"b\r\n", b"c\r", b"\r\n", b"endfacet", b"x" * 40_000, b"\n"]), max_size=80),
       st.sampled_from([None, re.compile(b"endfacet[\r\n]*")]))  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_blocks_are_the_file(
    tmp_path_factory: pytest.TempPathFactory, parts: list[bytes], after: re.Pattern[bytes] | None
) -> None:
    raw = b"".join(parts)
    path = put(tmp_path_factory.getbasetemp(), raw, "blocks")
    with path.open("rb") as file:
        found: list[Block] = list(blocks(file, after))
    assert b"".join(b.text for b in found) == raw
    assert [b.last for b in found] == [False] * (len(found) - 1) + [True]
    assert [b.start for b in found] == [0, *itertools.accumulate(len(b.text) for b in found[:-1])]
    for at in random.Random(len(raw)).choices(range(len(raw) + 1), k=5):
        assert line_of(path, at) == len((raw[:at] + b"x").replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n"))


# ---------------------------------------------------------------- random damage


@given(st.sampled_from(list(meshfiles.variants())), st.booleans(), st.randoms(use_true_random=False), st.integers(1, 3))
@settings(max_examples=400, deadline=None)
def test_damage_never_surprises(
    tmp_path_factory: pytest.TempPathFactory, name: str, lenient: bool, rng: random.Random, count: int
) -> None:
    """Flipped, cut, inserted, repeated: a finite mesh or one line comes back; ``bench/fuzz.py`` does it more."""
    raw = bytearray(meshfiles.variants()[name])
    for _ in range(count):
        at, size = rng.randrange(len(raw)), rng.randint(1, 300)
        match rng.randrange(5):
            case 0:
                raw[at] = rng.randrange(256)
            case 1:
                del raw[at : at + size]
            case 2:
                raw[at:at] = rng.randbytes(size)
            case 3:
                raw[at:at] = raw[at : at + size] * 2
            case _ if at:
                del raw[at:]
    path = put(tmp_path_factory.getbasetemp(), bytes(raw), f"damaged-{name}")
    try:
        mesh = read_mesh(path, lenient=lenient)
    except ModelError as error:
        assert str(error).startswith(str(path)) and "\n" not in str(error)
    else:
        assert len(mesh.triangles) and np.isfinite(mesh.triangles).all()
