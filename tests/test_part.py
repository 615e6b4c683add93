"""Table 1 in effect: several files, welding, fractions, option 3, the scaffolding subset, copies."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import meshfiles
import models
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rasterslice import reading, slicer
from rasterslice.cli import main
from rasterslice.errors import ModelError, UsageError
from rasterslice.params import Params, read_params
from rasterslice.part import copy_offsets, load_part, plan_slices
from rasterslice.slicer import prepare
from rasterslice.weld import components, vertex_ids, weld

BALL = meshfiles.ball()


def box(folder: Path, size: tuple[float, float, float], at: tuple[float, float, float], name: str) -> Path:
    ring = models.rectangle(at[0], at[1], at[0] + size[0], at[1] + size[1])
    return models.write_stl(folder / name, models.prism([ring], at[2], at[2] + size[2]).triangles())


def run(folder: Path, files: list[Path], **changes: Any) -> tuple[list[Any], Any]:
    """Slice files; return the layers, bottom-up, and the slicing."""
    slicing = prepare(
        Params(tuple(files), **{"scaffold_buffer": 2.0, "translation": ("orig", "orig", "orig")} | changes)
    )
    return list(slicing.layers())[::-1], slicing


# ---------------------------------------------------------------- several files


def test_overlapping_files_are_united(tmp_path: Path) -> None:
    a, b = box(tmp_path, (10, 10, 4), (0, 0, 0), "a.stl"), box(tmp_path, (10, 10, 2), (5, 5, 0), "b.stl")
    layers, slicing = run(tmp_path, [a, b])
    assert slicing.facets == 24 and len(layers) == 10
    assert [round(k.stats["part_area"]) for k in layers] == [175] * 5 + [100] * 5
    assert {k.stats["flags"] for k in layers[:5]} == {"overlap"}


def test_files_move_as_one_body(tmp_path: Path) -> None:
    files = [box(tmp_path, (10, 10, 4), (0, 0, 0), "a.stl"), box(tmp_path, (10, 10, 4), (30, 0, 6), "b.stl")]
    mesh, _ = load_part(Params(tuple(files), rotation=(0, 90, 0), scaling=(1, 2, 1), translation=("cent", 5, "orig")))
    np.testing.assert_allclose(mesh.high - mesh.low, [10, 20, 40], atol=1e-5)
    np.testing.assert_allclose((mesh.low[0] + mesh.high[0]) / 2, 0, atol=1e-5)
    np.testing.assert_allclose(mesh.low[1], 5)
    np.testing.assert_allclose((mesh.low[2] + mesh.high[2]) / 2, 5, atol=1e-5)  # where it was


def test_one_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"none\.stl: cannot read the mesh: No such file"):
        load_part(Params((box(tmp_path, (1, 1, 1), (0, 0, 0), "a.stl"), tmp_path / "none.stl")))


# ---------------------------------------------------------------- inexact


def shaken(seed: int, amount: float, shift: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    corners = (BALL[0][BALL[1]] + np.float32(shift)).astype(np.float32)
    step = rng.uniform(-amount, amount, corners.shape)
    return (corners + step).astype(np.float32)


@given(st.integers(0, 2**32 - 1), st.floats(-30, 30))
@settings(max_examples=60, deadline=None)
def test_vertices_within_the_tolerance_are_welded_at_any_offset(seed: int, shift: float) -> None:
    corners = shaken(seed, 0.004, shift)
    assert len(vertex_ids(corners)[1]) > 300
    welded, moved, lost = weld(corners, 0.02)
    ids, first = vertex_ids(welded)
    assert (len(first), lost) == (len(BALL[0]), 0) and moved > 250
    edges = np.sort(ids[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all(), "the ball is closed again"
    assert np.isin(welded.reshape(-1, 3).view("V12"), corners.reshape(-1, 3).view("V12")).all(), "no new vertex"


@given(st.integers(0, 2**32 - 1), st.integers(2, 60))
@settings(max_examples=60, deadline=None)
def test_weld_agrees_with_all_pairs(seed: int, count: int) -> None:
    """Points that a chain of steps within the tolerance joins, found the slow way."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 3, (3 * count, 3)).astype(np.float32)
    distance = np.linalg.norm(points[:, None].astype(float) - points[None], axis=-1)
    pairs = np.argwhere(distance <= 0.35).astype(np.int32)
    root = components(pairs, count=len(points))
    wanted = points[root].reshape(-1, 3, 3)
    kept = [len({*root[3 * i : 3 * i + 3].tolist()}) == 3 for i in range(count)]
    welded, _, lost = weld(points.reshape(-1, 3, 3).copy(), 0.35)
    np.testing.assert_array_equal(welded, wanted[kept])
    assert lost == count - sum(kept)


@given(st.integers(0, 2**32 - 1), st.integers(1, 80), st.integers(0, 120))
def test_components(seed: int, count: int, links: int) -> None:
    pairs = np.random.default_rng(seed).integers(0, count, (links, 2)).astype(np.int32)
    label = list(range(count))
    for a, b in pairs.tolist():
        low, high = sorted((label[a], label[b]))
        label = [low if v == high else v for v in label]
    assert components(pairs, count=count).tolist() == label


def test_inexact_slices_what_was_open(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    path.write_bytes(meshfiles.stl(shaken(1, 0.004)))
    layers, _ = run(tmp_path, [path], tolerance=0.001)
    assert any("open" in k.stats["flags"] for k in layers)
    layers, slicing = run(tmp_path, [path], inexact=True, tolerance=0.02)
    assert not any("open" in k.stats["flags"] for k in layers)
    assert "vertices within 0.02 mm of others were welded, 0 facets vanished" in slicing.warnings[0]
    with pytest.raises(ModelError, match="facets are smaller than the tolerance of 50 mm; use a smaller one"):
        run(tmp_path, [path], inexact=True, tolerance=50.0)


def test_exact_vertices_are_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    path.write_bytes(meshfiles.stl(BALL[0][BALL[1]]))
    mesh, notes = load_part(Params((path,), inexact=True, translation=("orig", "orig", "orig")))
    np.testing.assert_array_equal(mesh.triangles, BALL[0][BALL[1]])
    assert len(notes) == 1 and "below the bed" in notes[0]


# ---------------------------------------------------------------- fractions, option 3, subset


def stepped(folder: Path) -> Path:
    return models.write_stl(folder / "steps.stl", models.body("stepped_pyramid").triangles())


def test_part_fraction(tmp_path: Path) -> None:
    path = stepped(tmp_path)
    every, slicing = run(tmp_path, [path])
    some, _ = run(tmp_path, [path], part_fraction=(0.25, 0.7))
    low, high = slicing.low[2], slicing.high[2]
    wanted = [k for k in every if low + 0.25 * (high - low) <= k.z < low + 0.7 * (high - low)]
    assert [k.z for k in some] == [k.z for k in wanted] and 1 < len(some) < len(every) - 1
    assert [k.index for k in some] == list(range(len(some)))
    np.testing.assert_array_equal(some[0].part_boundary.points, wanted[0].part_boundary.points)
    assert some[-1].stats["scaffold_area"] == 0, "nothing outside the fraction overhangs"
    with pytest.raises(UsageError, match=r"part fraction 0.5 0.51 of a part .* mm high holds no slice of 0.4 mm"):
        run(tmp_path, [path], part_fraction=(0.5, 0.51))


def test_scaffold_subset(tmp_path: Path) -> None:
    path = stepped(tmp_path)
    every, slicing = run(tmp_path, [path])
    some, _ = run(tmp_path, [path], scaffold_subset=(0.3, 0.8))
    low, size = slicing.low[2], slicing.high[2] - slicing.low[2]
    for a, b in zip(every, some, strict=True):
        np.testing.assert_array_equal(a.part_boundary.points, b.part_boundary.points)
        if low + 0.3 * size <= a.z < low + 0.8 * size:
            np.testing.assert_array_equal(a.scaffold_fill.points, b.scaffold_fill.points)
            assert a.stats == b.stats
        else:
            assert len(b.scaffold_boundary) == len(b.scaffold_fill) == b.stats["scaffold_area"] == 0


@pytest.mark.parametrize("union", ["above", "own"])
def test_option_3_copies_the_middle_slice(tmp_path: Path, union: str) -> None:
    path = stepped(tmp_path)
    every, _ = run(tmp_path, [path])
    flat, slicing = run(tmp_path, [path], option=3, scaffold_union=union)
    middle = every[len(every) // 2]
    assert [k.z for k in flat] == [k.z for k in every] == slicing.heights.tolist()
    assert [k.stats["layer"] for k in flat] == list(range(len(every)))
    for k in flat:
        np.testing.assert_array_equal(k.part_boundary.points, middle.part_boundary.points)
        np.testing.assert_array_equal(k.part_fill.points, flat[0].part_fill.points)
        assert k.stats["part_area"] == middle.stats["part_area"] and len(k.part_fill)
    scaffold = [k.stats["scaffold_area"] for k in flat]
    assert len(set(scaffold[:-1])) == 1 and scaffold[0] > 0
    assert scaffold[-1] == (scaffold[0] if union == "own" else 0), "nothing lies above the top"


def test_option_3_of_a_single_slice(tmp_path: Path) -> None:
    layers, _ = run(tmp_path, [box(tmp_path, (10, 10, 0.4), (0, 0, 0), "a.stl")], option=3)
    assert len(layers) == 1 and round(layers[0].stats["part_area"]) == 100


def test_scaffold_buffer_0(tmp_path: Path) -> None:
    stem, cap = box(tmp_path, (4, 4, 2), (3, 3, 0), "a.stl"), box(tmp_path, (10, 10, 2), (0, 0, 2), "b.stl")
    layers, _ = run(tmp_path, [stem, cap], scaffold_buffer=0.0)
    assert [k.stats["scaffold_area"] for k in layers] == pytest.approx([84] * 5 + [0] * 5, abs=1.5)


# ---------------------------------------------------------------- copies


@pytest.mark.parametrize(("scaffolding", "gap"), [(True, None), (True, 0.0), (False, 3.0)])
def test_copies_stand_clear_of_each_other(tmp_path: Path, scaffolding: bool, gap: float | None) -> None:
    path = box(tmp_path, (10, 6, 2), (0, 0, 0), "a.stl")
    layers, slicing = run(
        tmp_path, [path], copies=(3, 2, 5), copy_gap=gap, scaffolding=scaffolding, scaffold_union="own"
    )
    offsets = slicing.copies
    assert offsets.shape == (5, 2) and offsets[0].tolist() == [0, 0]
    step = offsets[4]
    assert [tuple(np.round(o / step).astype(int)) for o in offsets] == [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1)]
    reach = 4.0 if scaffolding else 0.0
    clear = step - (10 + reach, 6 + reach)
    wanted = 1.5 if gap is None else gap
    assert (clear >= wanted - 1e-9).all() and (clear < wanted + 0.2).all()
    np.testing.assert_allclose(np.round(step / 0.2), step / 0.2, atol=1e-9)
    every = np.concatenate([k.scaffold_boundary.points if scaffolding else k.part_boundary.points for k in layers])
    assert (np.ptp(every, axis=0) < step).all()


def test_copies_of_one(tmp_path: Path) -> None:
    p = Params((Path("a.stl"),), copies=(4, 4, 1))
    assert copy_offsets(p, np.zeros(3), np.ones(3)).tolist() == [[0, 0]]


# ---------------------------------------------------------------- warnings


@pytest.mark.parametrize(
    ("size", "changes", "message"),
    [
        (
            (10, 10, 300),
            {},
            "the part is 300 mm high, more than the 210 mm that a Cobra 600 reaches; lay it on its side",
        ),
        (
            (10, 10, 10),
            {"translation": (0, 0, -3)},
            "lies partly below the bed, from z = -3 to 7 mm; check the rotation",
        ),
        ((0.5, 0.5, 0.5), {}, "the model is 0.5 mm large; if its file is in metres or inches, write units = m or inch"),
        ((5000, 10, 10), {}, "the model is 5000 mm large; check the units of its file, or scale it"),
        ((10, 10, 10), {}, None),
    ],
)
def test_odd_places_and_sizes_are_reported(
    tmp_path: Path, size: tuple[float, float, float], changes: dict[str, Any], message: str | None
) -> None:
    path = box(tmp_path, size, (0, 0, 0), "a.stl")
    _, notes = load_part(Params((path,), **changes))
    assert len(notes) == (message is not None)
    if message:
        assert notes[0].startswith(f"{path}: ") and message in notes[0]


def test_a_flat_model_is_refused(tmp_path: Path) -> None:
    path = models.write_stl(tmp_path / "a.stl", np.array([[[0, 0, 0], [2, 0, 0], [0, 2, 0]]]))
    with pytest.raises(ModelError, match=r"a.stl: the part is flat, 2 x 2 x 0 mm; nothing to slice"):
        load_part(Params((path,)))


def test_too_many_slices_are_refused_before_memory_is(tmp_path: Path) -> None:
    with pytest.raises(
        UsageError, match=r"makes 1e\+07 slices of a part 10000 mm high; the limit is 1000000: use 0.01 mm"
    ):
        plan_slices(Params((Path("a"),), thickness=0.001), 0.0, 1e4)


def test_lenient_and_units_reach_the_mesh(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    path.write_bytes(meshfiles.stl(BALL[0][BALL[1]])[:-60])
    file = models.write_params(tmp_path, path, units="cm", lenient=1, part_fraction=(0, 0.5))
    mesh, notes = load_part(read_params(file))
    assert mesh.high[2] > 140 and "; the file holds " in notes[0]


# ---------------------------------------------------------------- errors of the lines of a parameter file


@pytest.mark.parametrize(
    ("settings", "argv", "line", "code", "message"),
    [
        ({"thickness": 50}, [], 8, 2, "slice thickness 50 mm leaves no slice in a part 10 mm high"),
        ({"part_fraction": "0.51 0.52"}, [], 13, 2, "part fraction 0.51 0.52 of a part 10 mm high holds no slice"),
        ({"pitch": 0.2, "export": "svgg"}, [], 18, 2, "unknown export 'svgg'; did you mean 'svg'?"),
        ({"export": "svg"}, ["--export", "svgg"], 0, 2, "unknown export 'svgg'; did you mean 'svg'?"),
        ({"memory_mb": 1, "pitch": 0.1}, [], 18, 2, "pitch 0.1 mm needs "),
        ({"memory_mb": 1}, [], 0, 2, "pitch 0.2 mm needs "),
        ({"memory_mb": 1, "pitch": 0.2}, ["--pitch", "0.1"], 0, 2, "pitch 0.1 mm needs "),
        ({"scaling": "1 1e6 1e6 1e6"}, [], 10, 2, "box.stl: the part is 1e+07 mm large"),
        ({"tolerance": 50, "inexact": 1}, [], 6, 3, "box.stl: all 12 facets are smaller than the tolerance of 50 mm"),
    ],
)
def test_an_error_names_the_line_of_the_parameter_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], settings: dict[str, Any], argv: list[str], line: int,
    code: int, message: str,
) -> None:  # fmt: skip
    mesh = box(tmp_path, (10, 10, 10), (0, 0, 0), "box.stl")
    path = models.write_params(tmp_path, mesh, **settings)
    where = f"{path}:{line}: " if line else f"{path}: "
    for more in ([], ["--dry-run"]):
        assert main([str(path), *argv, *more]) == code
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and err.replace(f"{tmp_path}/box.stl", "box.stl").startswith(
            f"rasterslice: error: {where}{message}"
        )


def test_a_mesh_that_cannot_be_read_names_the_line_that_names_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = models.write_params(tmp_path, tmp_path / "none.stl")
    assert main([str(path)]) == 3
    assert f"error: {path}:2: {tmp_path / 'none.stl'}: cannot read the mesh: No such" in capsys.readouterr().err


def test_a_mistake_of_units_is_named_where_the_grid_is_too_large(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh = box(tmp_path, (20, 10, 5), (0, 0, 0), "box.stl")
    path = models.write_params(tmp_path, mesh, units="m", pitch=0.2, memory_mb=1024)
    assert main([str(path)]) == 2
    err = capsys.readouterr().err
    assert f"{path}:18: pitch 0.2 mm needs 100064 x 50064 px" in err and "larger memory_mb; the model is 20000" in err
    assert "mm large; check the units of its file, or scale it (units = m)\n" in err


def test_the_height_is_that_of_the_machine(tmp_path: Path) -> None:
    mesh = box(tmp_path, (10, 10, 300), (0, 0, 0), "box.stl")
    for high, said in ((400, False), (250, True)):
        cell = tmp_path / "cell.toml"
        cell.write_text(f'name = "Gantry"\n[robot]\njoint_high = [105.0, 150.0, {high}.0, 360.0]\n')
        notes = load_part(Params((mesh,), machine=cell))[1]
        assert [f"300 mm high, more than the {high} mm that Gantry reaches" in note for note in notes] == [True] * said
    assert "210 mm that a Cobra 600 reaches" in load_part(Params((mesh,)))[1][0]
    cell.unlink()
    with pytest.raises(UsageError, match="cannot read the machine profile"):
        load_part(Params((mesh,), machine=cell))


def test_a_mesh_that_was_begun_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever else is prepared has its own."""
    read, times = reading._read, list[Params]()

    def watched(params: Params) -> Any:
        times.append(params)
        return read(params)

    monkeypatch.setattr(reading, "_read", watched)
    (tmp_path / "cube.stl").write_bytes(meshfiles.stl(models.triangles("cube")))
    first, other = (Params(files=(tmp_path / "cube.stl",), pitch=pitch) for pitch in (0.3, 0.4))
    reading.begin(first)
    assert slicer.prepare(first).facets == 12
    assert times == [first]
    reading.begin(first)
    assert slicer.prepare(other).params is other
    assert slicer.prepare(first).params is first
    assert times == [first, first, other, first]


def test_a_mesh_that_was_begun_in_vain_is_an_error_of_prepare(tmp_path: Path) -> None:
    params = Params(files=(tmp_path / "none.stl",))
    reading.begin(params)
    with pytest.raises(ModelError, match=r"none\.stl"):
        slicer.prepare(params)


def test_what_is_made_ahead_comes_in_order_and_ends_with_who_asks() -> None:
    begun = list[int]()

    def numbers() -> Iterator[int]:
        for i in range(100):
            begun.append(i)
            yield i

    assert list(slicer._ahead(numbers())) == list(range(100))
    begun.clear()
    ahead = slicer._ahead(numbers())
    assert next(ahead) == 0
    ahead.close()
    assert len(begun) <= 1 + slicer.AHEAD


def test_an_error_made_ahead_comes_in_its_turn() -> None:
    def numbers() -> Iterator[int]:
        yield 1
        raise ModelError("the second")

    ahead = slicer._ahead(numbers())
    assert next(ahead) == 1
    with pytest.raises(ModelError, match="the second"):
        next(ahead)
