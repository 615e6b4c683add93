"""Mesh files read whole or refused in one line; transforms against plain NumPy."""

import hashlib
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rasterslice.errors import ModelError, RasterSliceError, UsageError
from rasterslice.intake import read_mesh
from rasterslice.mesh import Mesh, bounds, file_sha256, transform

MODELS = Path(__file__).parents[2] / "shared" / "models"
ODD = sorted((MODELS / "odd").iterdir()) if (MODELS / "odd").is_dir() else []
needs_models = pytest.mark.skipif(not MODELS.is_dir(), reason="no ../shared/models beside the repository")

VERTICES = np.array([[0, 0, 0], [3, 0, 0], [0, 2, 0], [0.1, 0.2, 5]], np.float64)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)
CORNERS = VERTICES.astype(np.float32)[FACES]


def stl(path: Path, corners: NDArray[Any] = CORNERS, header: bytes = b"", count: int | None = None) -> Path:
    records = np.zeros(len(corners), [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    records["v"] = corners
    number = np.uint32(len(corners) if count is None else count).astype("<u4").tobytes()
    path.write_bytes(header.ljust(80, b" ") + number + records.tobytes())
    return path


def ply(
    path: Path, vertices: NDArray[Any] = VERTICES, faces: NDArray[Any] = FACES, *, order: str = "<",
    real: str = "float", index: str = "int", count: tuple[int, int] | None = None,
    extra: bool = False, end: str = "\n",
) -> Path:  # fmt: skip
    kinds = {"float": "f4", "double": "f8", "int": "i4", "uint": "u4", "ushort": "u2", "uchar": "u1"}
    v = np.zeros(len(vertices), [("q", "u1")] * extra + [("p", order + kinds[real], 3)])
    f = np.zeros(len(faces), [("n", "u1"), ("i", order + kinds[index], faces.shape[1:])] + [("c", "u1")] * extra)
    v["p"], f["n"], f["i"] = vertices, faces.shape[1], faces
    nv, nf = count or (len(v), len(f))
    name = {"<": "little", ">": "big"}[order]
    lines = ["ply", f"format binary_{name}_endian 1.0", "comment ours", f"element vertex {nv}",
             *["property uchar q"] * extra, *(f"property {real} {c}" for c in "xyz"),
             f"element face {nf}", f"property list uchar {index} vertex_indices",
             *["property uchar c"] * extra, "end_header", ""]  # fmt: skip
    path.write_bytes(end.join(lines).encode() + v.tobytes() + f.tobytes())
    return path


def ascii_stl(triangles: NDArray[Any], end: str = "\n", name: str = "a vertex 1 facet") -> bytes:
    lines = [f"solid {name}"]
    for t in triangles:
        corners = [f"  VERTEX {x:.9g} {y:.9g} {z:.9g}" for x, y, z in t]
        lines += ["facet normal 0 0 0", " outer loop", *corners, " endloop", "endfacet"]
    return end.join([*lines, f"endsolid {name}", ""]).encode()


def placed(mesh: Mesh) -> NDArray[np.float64]:
    return mesh.triangles + mesh.origin


def error(path: Path) -> str:
    with pytest.raises(ModelError) as caught:
        read_mesh(path)
    message = str(caught.value)
    assert re.match(re.escape(str(path)) + r"(:[0-9]+)?: ", message) and "\n" not in message
    return message.removeprefix(str(path)).removeprefix(": ")


# ---------------------------------------------------------------- reading


@pytest.mark.parametrize("header", [b"", b"solid facet vertex", b"\0" * 80])
def test_binary_stl(tmp_path: Path, header: bytes) -> None:
    mesh = read_mesh(stl(tmp_path / "a.bin", header=header))
    assert mesh.triangles.dtype == np.float32 and mesh.triangles.flags.c_contiguous
    np.testing.assert_array_equal(mesh.triangles, CORNERS)
    np.testing.assert_array_equal(mesh.origin, 0)
    np.testing.assert_array_equal(mesh.low, [0, 0, 0])
    np.testing.assert_array_equal(mesh.high, [3, 2, 5])
    assert mesh.low.dtype == np.float64


def test_stl_padding_is_not_a_facet(tmp_path: Path) -> None:
    path = stl(tmp_path / "a.stl")
    path.write_bytes(path.read_bytes() + b"\0" * 49)
    assert len(read_mesh(path).triangles) == 4


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("index", ["int", "uint", "ushort", "uchar"])
@pytest.mark.parametrize("extra", [False, True])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_binary_ply(tmp_path: Path, order: str, real: str, index: str, extra: bool, end: str) -> None:
    mesh = read_mesh(ply(tmp_path / "a.ply", order=order, real=real, index=index, extra=extra, end=end))
    assert mesh.triangles.dtype == np.dtype(np.float32) and mesh.triangles.dtype.isnative
    np.testing.assert_array_equal(placed(mesh).astype(np.float32), CORNERS)


def test_binary_formats_do_not_import_trimesh(tmp_path: Path) -> None:
    stl(tmp_path / "a.stl"), ply(tmp_path / "a.ply")
    code = "import sys; from rasterslice.intake import read_mesh; [read_mesh(f) for f in sys.argv[1:]]; "
    code += "sys.exit('trimesh' in sys.modules)"
    root = Path(__file__).parents[1]
    args = [sys.executable, "-c", code, str(tmp_path / "a.stl"), str(tmp_path / "a.ply")]
    assert os.spawnve(os.P_WAIT, sys.executable, args, {**os.environ, "PYTHONPATH": str(root)}) == 0


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_ascii_stl(tmp_path: Path, end: str) -> None:
    path = tmp_path / "a.stl"
    path.write_bytes(ascii_stl(CORNERS, end) + ascii_stl(CORNERS + 9, end, "zwei ü"))
    np.testing.assert_array_equal(placed(read_mesh(path)).astype(np.float32), np.concatenate([CORNERS, CORNERS + 9]))


@pytest.mark.parametrize("suffix", ["obj", "off", "ply", "glb"])
def test_other_formats(tmp_path: Path, suffix: str) -> None:
    trimesh = pytest.importorskip("trimesh")
    path = tmp_path / f"a.{suffix}"
    model = trimesh.Trimesh(VERTICES, FACES, process=False)
    model.export(path, **({"encoding": "ascii"} if suffix == "ply" else {}))
    np.testing.assert_allclose(placed(read_mesh(path)), CORNERS, atol=1e-7)


def test_polygons_of_ply(tmp_path: Path) -> None:
    quad = np.array([[0, 1, 2, 3]], np.int32)
    assert len(read_mesh(ply(tmp_path / "a.ply", faces=quad)).triangles) == 2


def test_three_dimensional_far_model_keeps_its_digits(tmp_path: Path) -> None:
    """Float64 is reduced before it is rounded; float32 loses nothing either."""
    far = np.array([1e5, -2e5, 3e5])
    near = read_mesh(ply(tmp_path / "a.ply", real="double"))
    mesh = read_mesh(ply(tmp_path / "b.ply", VERTICES + far, real="double"))
    np.testing.assert_array_equal(mesh.low, far)
    np.testing.assert_allclose(mesh.triangles, near.triangles, atol=1e-7)
    single = (VERTICES + far).astype(np.float32)
    mesh = read_mesh(ply(tmp_path / "c.ply", single))
    assert np.abs(mesh.triangles).max() < 10
    np.testing.assert_array_equal(placed(mesh), single[FACES].astype(np.float64))


def test_unused_vertices_do_not_count(tmp_path: Path) -> None:
    for real in ("float", "double"):
        more = np.concatenate([VERTICES, [[1e30, np.nan, np.inf]]])
        mesh = read_mesh(ply(tmp_path / "a.ply", more, real=real))
        np.testing.assert_allclose(mesh.high, [3, 2, 5], atol=1e-7)


def test_sha256(tmp_path: Path) -> None:
    path = stl(tmp_path / "a.stl")
    assert file_sha256(path) == hashlib.sha256(path.read_bytes()).hexdigest()
    with pytest.raises(ModelError, match="No such file"):
        file_sha256(tmp_path / "none")


@given(st.integers(1, 2500), st.randoms())
@hypothesis_settings(max_examples=20)
def test_bounds(count: int, random: Any) -> None:
    points = np.random.default_rng(random.randrange(2**32)).normal(size=(count, 3, 3)).astype(np.float32)
    low, high = bounds(points)
    np.testing.assert_array_equal(low, points.reshape(-1, 3).min(0))
    np.testing.assert_array_equal(high, points.reshape(-1, 3).max(0))


# ---------------------------------------------------------------- bad files


def test_no_file(tmp_path: Path) -> None:
    assert "No such file" in error(tmp_path / "none.stl")
    assert error(tmp_path) == "is a folder; name a mesh file"
    with pytest.raises(ModelError, match="null"):
        read_mesh("a\0b.stl")


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads everything")
def test_unreadable(tmp_path: Path) -> None:
    path = stl(tmp_path / "a.stl")
    path.chmod(0)
    assert "Permission denied" in error(path)


HEAD = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
FACE = b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.stl", b"", "the file is empty"),
        ("a.stl", b"\0" * 50, "50 bytes, an STL header alone has 84"),
        ("a.stl", b"x" * 80 + b"\0" * 4, "holds no facets (0 vertices); nothing to slice"),
        ("a.stl", b"x" * 80 + b"\xff" * 4, "4294967295 facets (214748.4 MB) but the file holds 0"),
        ("a.stl", b"x" * 80 + b"\0\0\0\0" + b"\0" * 100, "promises 0 facets (0.0 MB) but the file holds 2"),
        ("a.stl", b"solid a\nendsolid a\n", "holds no facets (0 vertices)"),
        ("a.stl", ascii_stl(CORNERS)[:-70], "the file is cut short"),
        ("a.stl", ascii_stl(CORNERS)[:-30], "the file is cut short"),
        ("a.stl", ascii_stl(CORNERS).replace(b"0.2", b"O.2"), ":13: a vertex must be 3 numbers, got 'O.200000003'"),
        ("a.stl", ascii_stl(CORNERS).replace(b"0.200000003", b"nan"), "NaN or infinite"),
        ("a.xyz", b"1 2 3\n", "unknown format; known are stl, ply, 3mf, glb, obj, off"),
        ("a", b"1 2 3\n", "unknown format"),
        ("a.ply", b"1 2 3\n", "does not begin with 'ply'"),
        ("a.ply", b"ply\nformat ascii 1.0\n", "the PLY header has no end"),
        ("a.ply", b"ply\nend_header\n", "names no format"),
        ("a.ply", b"ply\nformat ascii 1.0\nend_header\n", "holds no facets (0 vertices)"),
        ("a.ply", HEAD + b"end_header\n0 0 0\n1 0 0\n0 1 0\n", "holds no facets (3 vertices)"),
        ("a.ply", HEAD.replace(b" z", b" w") + FACE, "vertices have no property z"),
        ("a.ply", HEAD.replace(b"vertex 3", b"vertex -3") + FACE, ":3: a line of the PLY header is not"),
        ("a.ply", HEAD.replace(b"float z", b"quad z") + FACE, ":6: a line of the PLY header is not understood"),
        ("a.ply", HEAD.replace(b"vertex 3", b"vertex 999999999999") + FACE, "999999999999 vertex elements"),
        ("a.ply", HEAD + FACE + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "a facet names vertex 7 of 3"),
        ("a.ply", HEAD + FACE + b"0 0 0\n1 0 0\n0 1 0\n", "promises 1 face elements but the file holds 0"),
        ("a.ply", HEAD + FACE + b"0 0 0\n1 x 0\n0 1 0\n3 0 1 2\n", ":11: expected a number, got 'x'"),
        ("a.ply", HEAD + FACE + b"0 0 0\n1 0 0\n0 1 0\n3 0 1.5 2\n", "a corner that is no whole number"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\n", ""),
        ("a.obj", b"\xff\xfe\0", ""),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n", ""),
        ("a.glb", b"glTF junk", ""),
        ("a.3mf", b"PK junk", ""),
    ],
)  # fmt: skip
def test_bad_file(tmp_path: Path, name: str, data: bytes, message: str, capfd: Any) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    assert message in error(path)
    assert capfd.readouterr() == ("", "")


def test_truncated(tmp_path: Path) -> None:
    path = stl(tmp_path / "statue.stl")
    path.write_bytes(path.read_bytes()[:-51])
    assert error(path) == (
        "84-byte header promises 4 facets (0.0 MB) but the file holds 2; export the model again, or use --lenient "
        "to slice those"
    )
    for order in "<>":
        path = ply(tmp_path / "statue.ply", order=order)
        path.write_bytes(path.read_bytes()[:-1])
        assert (
            "header promises 4 face elements but the file holds 3; export the model again, or use --lenient"
            in error(path)
        )
    for lost in (60, 90):
        path = ply(tmp_path / "statue.ply")
        path.write_bytes(path.read_bytes()[:-lost])
        assert "header promises 4 " in error(path)
    path = ply(tmp_path / "quads.ply", faces=np.array([[0, 1, 2, 3], [3, 2, 1, 0]]))
    path.write_bytes(path.read_bytes()[:-9])
    error(path)


@pytest.mark.parametrize("count", [(2**59, 4), (4, 2**59), (5, 4), (4, 5)])
def test_ply_header_promises_too_much(tmp_path: Path, count: tuple[int, int]) -> None:
    path = ply(tmp_path / "a.ply", count=count)
    if count == (5, 4):  # facets are read as a vertex: nothing is wrong but what is left over
        assert read_mesh(path).notes == (f"{path}: 1 of 4 facets with fewer than 3 corners: left out",)
    else:
        assert "export the model again" in error(path)


@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 2e6, -1e30])
def test_bad_coordinates(tmp_path: Path, real: str, value: float) -> None:
    vertices = VERTICES.copy()
    vertices[3, 1] = value
    path = ply(tmp_path / "a.ply", vertices, real=real)
    if abs(value) < 1e9:
        assert read_mesh(path).notes == (f"{path}: a coordinate of 2e+06 mm is beyond 1e+06 mm; check its units",)
        return
    found = error(path)
    if np.isfinite(value):
        assert found == "a coordinate of 1e+30 mm is beyond 1e+09 mm; check its units"
    else:
        assert found.startswith("3 of 4 facets, the first is number 1, have a vertex that is NaN or infinite")


@pytest.mark.parametrize("index", [-1, 4, 2**31 - 1])
def test_bad_index(tmp_path: Path, index: int) -> None:
    faces = FACES.copy()
    faces[2, 1] = index
    assert error(ply(tmp_path / "a.ply", faces=faces)) == (f"a facet names vertex {index} of 4; the file is damaged")


@given(st.data())
@hypothesis_settings(max_examples=150, deadline=None)
def test_damage_never_surprises(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    """Whatever bytes change, a mesh comes back or one line does."""
    folder = tmp_path_factory.getbasetemp()
    makers: list[Callable[[Path], Path]] = [stl, ply, lambda p: (p.write_bytes(ascii_stl(CORNERS)), p)[1]]
    i = data.draw(st.integers(0, 2))
    path = makers[i](folder / f"damaged{i}.{('stl', 'ply', 'stl')[i]}")
    raw = bytearray(path.read_bytes())
    at = data.draw(st.integers(0, len(raw) - 1))
    raw[at : at + data.draw(st.integers(0, 9))] = data.draw(st.binary(max_size=9))
    path.write_bytes(raw)
    try:
        mesh = read_mesh(path)
        assert np.isfinite(mesh.triangles).all() and len(mesh.triangles)
    except RasterSliceError as caught:
        assert isinstance(caught, ModelError) and "\n" not in str(caught)


REFUSED = {
    "assimp__crash-30d6d0f7c529b3b66b4131700b7a4580cd7082df.ply", "assimp__issue623.ply", "trimesh__empty.stl",
    "trimesh__ply_empty_header.ply", "trimesh__ply_points_ascii.ply", "trimesh__points_emptyface.ply",
    "trimesh__stl_empty_ascii.stl", "trimesh__stl_empty_bin.stl",
}  # fmt: skip


@needs_models
@pytest.mark.parametrize("path", ODD, ids=lambda p: p.name)
def test_odd_files(path: Path, capfd: Any) -> None:
    if path.suffix == ".3MF":
        pytest.importorskip("lxml")
    if path.name in REFUSED:
        error(path)
    else:
        mesh = read_mesh(path)
        assert mesh.triangles.shape[1:] == (3, 3) and (mesh.high >= mesh.low).all()
    assert capfd.readouterr() == ("", "")


# ---------------------------------------------------------------- transforms


def oracle(points: NDArray[np.float64], scaling: Any, rotation: Any, translation: Any) -> NDArray[np.float64]:
    """Follow the design's table in plain steps on the points of a body."""
    before = (points.min(0) + points.max(0)) / 2
    if scaling or rotation:
        points = points - points.min(0)
    if rotation:
        a, b, c = np.radians(rotation)
        axes = np.eye(3)  # rows: the body's own axes, turned one after the other
        for axis, angle in enumerate((a, b, c)):
            k = axes[axis]
            cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
            turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross  # Rodrigues
            points, axes = points @ turn.T, axes @ turn.T
    if scaling:
        points = points * scaling
    low, high = points.min(0), points.max(0)
    if translation is None:
        return points - (0, 0, low[2])
    centre = (low + high) / 2
    shift = [{"cent": -centre[i], "orig": before[i] - centre[i]}[t] if isinstance(t, str) else t - low[i]
             for i, t in enumerate(translation)]  # fmt: skip
    return points + shift


@pytest.mark.parametrize("scaling", [None, (2.0, 0.5, 3.0), (1.0, 1.0, 1.0)])
@pytest.mark.parametrize("rotation", [None, (30.0, -50.0, 110.0), (-90.0, 0.0, 0.0), (0.0, 90.0, 45.0), (0, 0, 0)])
@pytest.mark.parametrize(
    "translation",
    [None, (1.0, -2.0, 3.0), ("cent", "orig", 0.5), ("orig", 7.0, "cent"), ("cent", "cent", "orig")],
)
def test_transform(tmp_path: Path, scaling: Any, rotation: Any, translation: Any) -> None:
    vertices = VERTICES + (7, -11, 13.5)
    for real in ("float", "double"):
        mesh = read_mesh(ply(tmp_path / "a.ply", vertices, real=real))
        moved = transform(mesh, scaling, rotation, translation)
        wanted = oracle(placed(mesh).reshape(-1, 3), scaling, rotation, translation)
        np.testing.assert_allclose(placed(moved).reshape(-1, 3), wanted, atol=2e-6)
        np.testing.assert_allclose(moved.low, wanted.min(0), atol=2e-6)
        np.testing.assert_allclose(moved.high, wanted.max(0), atol=2e-6)
        assert moved.path == mesh.path
        if translation is None:
            assert moved.low[2] == 0


def test_moving_rounds_nothing(tmp_path: Path) -> None:
    mesh = read_mesh(stl(tmp_path / "a.stl"))
    for moved in (transform(mesh, None, None, None), transform(mesh, None, None, (1e5, "cent", "orig")),
                  transform(mesh, (1, 1, 1), (0, 360, 0), None)):  # fmt: skip
        assert moved.vertices is mesh.vertices
    assert transform(mesh, None, None, (1e5, 0, 0)).low[0] == 1e5


def test_quarter_turns_are_exact(tmp_path: Path) -> None:
    """What is flat stays flat, bit for bit."""
    mesh = read_mesh(stl(tmp_path / "a.stl"))
    turned = transform(mesh, None, (-90, 0, 0), None)  # y to -z, z to y
    x, y, z = np.moveaxis(CORNERS, -1, 0)
    np.testing.assert_array_equal(placed(turned), np.stack([x, z, 2 - y], -1))
    back = transform(transform(mesh, None, (0, 180, 0), None), None, (0, -180, 0), (0, 0, 0))
    np.testing.assert_allclose(placed(back), CORNERS, atol=1e-6)


def test_shared_vertices_stay_shared() -> None:
    """One vertex gives the same bits wherever it stands in the array, across chunks too."""
    rng = np.random.default_rng(1)
    vertices = rng.normal(size=(50, 3)).astype(np.float32)
    faces = rng.integers(0, 50, (70_001, 3))
    mesh = Mesh(vertices[faces].reshape(-1, 3), None, np.zeros(3), Path("a"))
    moved = transform(mesh, (1.1, 0.9, 1.3), (10, 20, 30), None)
    assert len(np.unique(moved.triangles.reshape(-1, 3), axis=0)) == 50


def test_far_away_gives_the_same(tmp_path: Path) -> None:
    vertices = np.round(VERTICES * 1024) / 1024
    results = []
    for shift in (0, 1e5):
        mesh = read_mesh(ply(tmp_path / "a.ply", vertices + shift, real="double"))
        results.append(transform(mesh, (2, 2, 2), (30, 40, 50), ("cent", 5, 0)))
    np.testing.assert_array_equal(results[0].triangles, results[1].triangles)
    np.testing.assert_array_equal(results[0].low, results[1].low)


def test_transform_out_of_this_world(tmp_path: Path) -> None:
    mesh = read_mesh(stl(tmp_path / "a.stl"))
    with pytest.raises(
        UsageError, match=r"the part is 5e\+06 mm large, at 5e\+06 mm, after .*; the limit is 1e\+06 mm"
    ):
        transform(mesh, (1, 1, 1e6), None, None)
