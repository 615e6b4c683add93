"""The report of a mesh against damage that was put there; `info` and `init` as commands."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import meshfiles
import models
import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from rasterslice.cli import main
from rasterslice.errors import ModelError
from rasterslice.intake import read_mesh
from rasterslice.job import dry_run
from rasterslice.mesh import Mesh, size_notes
from rasterslice.nesting import within_any
from rasterslice.params import read_params
from rasterslice.starter import starter
from rasterslice.survey import brief, damage, report_lines, survey

COUNTS = ("open_edges", "nonmanifold_edges", "inconsistent_edges", "degenerate_facets", "duplicate_facets",
          "inverted_shells")  # fmt: skip


def report(triangles: Any) -> dict[str, Any]:
    return survey(Mesh(np.array(triangles, np.float32).reshape(-1, 3), None, np.zeros(3), Path("a")))


def cube(at: float = 0.0, size: float = 10.0) -> models.Body:
    return models.prism([models.rectangle(at, at, at + size, at + size)], at, at + size)


WING = [[[0, 0, 0], [10, 0, 0], [5, 0, -5]]]  # on an edge of the cube
DAMAGE: dict[str, tuple[Any, dict[str, int]]] = {
    "clean": (cube().triangles(), {}),
    "hole": (cube().without(3).triangles(), {"open_edges": 3}),
    "turned": (cube().flipped(3).triangles(), {"inconsistent_edges": 3}),
    "double": (np.concatenate([cube().triangles(), cube().triangles()[:1]]),
               {"nonmanifold_edges": 3, "duplicate_facets": 1}),
    "double, turned": (np.concatenate([cube().triangles(), cube().triangles()[:1, ::-1]]),
                       {"nonmanifold_edges": 3, "duplicate_facets": 1}),
    "wing": (np.concatenate([cube().triangles(), WING]), {"nonmanifold_edges": 1, "open_edges": 2}),
    "needle": (np.concatenate([cube().triangles(), [[[0, 0, 0], [0, 0, 0], [10, 0, 0]]]]), {"degenerate_facets": 1}),
    "sliver": (np.concatenate([cube().triangles(), [[[20, 0, 0], [21, 0, 0], [23, 0, 0]]]]),
               {"degenerate_facets": 1, "open_edges": 3}),
    "inside out": (cube().inverted().triangles(), {"inverted_shells": 1}),
    "cavity": (models.join(cube(), cube(2, 3).inverted()).triangles(), {}),
    "two, one inside out": (models.join(cube(), cube(20).inverted()).triangles(), {"inverted_shells": 1}),
    "minus zero": (np.concatenate([-cube().inverted().mirrored().triangles() * (1, -1, -1)]), {}),
}  # fmt: skip


@pytest.mark.parametrize("case", DAMAGE)
def test_damage_is_counted(case: str) -> None:
    triangles, wanted = DAMAGE[case]
    found = report(triangles)
    assert {name: found[name] for name in COUNTS if found[name]} == wanted
    assert found["closed"] == (not {"open_edges", "nonmanifold_edges", "inconsistent_edges"} & wanted.keys())


@pytest.mark.parametrize("count", [1, 40, 3000])
def test_boxes_within_others(count: int) -> None:
    rng = np.random.default_rng(count)
    low, outer_low = rng.normal(size=(2, count, 3)) * 3
    high, outer_high = low + rng.random((count, 3)) ** 4, outer_low + 10 ** rng.uniform(-3, 0.5, (count, 3))
    low[: count // 3] = outer_low[: count // 3]  # the same box lies within itself
    high[: count // 3] = outer_high[: count // 3]
    wanted = [((outer_low <= a) & (outer_high >= b)).all(axis=1).any() for a, b in zip(low, high, strict=True)]
    assert within_any(low, high, outer_low, outer_high).tolist() == wanted
    assert 0 < sum(wanted) < count or count == 1
    assert not within_any(low, high, outer_low[:0], outer_high[:0]).any()


def test_many_shells() -> None:
    """Among thousands of shells each is judged for itself: its box, its direction, and whether it is closed."""
    small = np.stack([cube(0, 1).triangles() + 3 * np.array(at) for at in np.ndindex(15, 15, 15)]).astype(np.float32)
    small[::3] = small[::3, :, ::-1]
    few = small.copy()
    few[::2] = small[::2, :1]  # every second one is open: a facet, twelve times
    turned = len(small[::3])
    assert (found := report(small.reshape(-1, 3, 3)))["shells"] == 3375 and found["inverted_shells"] == turned
    assert report(few.reshape(-1, 3, 3))["inverted_shells"] == len(range(3, 3375, 6))
    around = cube(-1, 100).triangles()
    assert report(np.concatenate([small.reshape(-1, 3, 3), around]))["inverted_shells"] == 0
    assert report(np.concatenate([small.reshape(-1, 3, 3), around[1:]]))["inverted_shells"] == turned


def test_an_open_shell_is_not_called_inside_out() -> None:
    """The sign of its volume depends on where the origin lies."""
    sheet = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    for triangles in (sheet, sheet[:, ::-1], cube().inverted().without(3).triangles()):
        for shift in (-50, 0, 50):
            assert report(np.concatenate([cube().triangles() + 500, triangles + shift]))["inverted_shells"] == 0
    rng = np.random.default_rng(3)
    found = report(rng.random((20_000, 3, 3)))
    assert (found["shells"], found["inverted_shells"], found["open_edges"]) == (20_000, 0, 60_000)


def test_shells_that_touch_along_an_edge_are_judged() -> None:
    two = models.join(models.box((0, 0, 0), (1, 1, 1)), models.box((1, 1, 0), (2, 2, 1)))
    assert report(two.triangles())["nonmanifold_edges"] == 1 and report(two.triangles())["inverted_shells"] == 0
    assert report(two.inverted().triangles())["inverted_shells"] == 1


def test_a_facet_and_its_back_enclose_nothing() -> None:
    facet = np.array([[[0.1, 0.2, 0.3], [7.7, 0.4, 0.9], [3.3, 9.1, 5.7]]], np.float32)
    for turn in range(3):
        pair = np.concatenate([facet, np.roll(facet[:, ::-1], turn, axis=1)])
        assert report(np.concatenate([cube(50).triangles(), pair]))["inverted_shells"] == 0


def test_measures() -> None:
    found = report(models.join(cube(), cube(20, 4)).triangles())
    assert (found["facets"], found["vertices"], found["shells"]) == (24, 16, 2)
    assert (found["low"], found["size"]) == ([0, 0, 0], [24, 24, 24])
    np.testing.assert_allclose(found["volume_mm3"], 1064)
    np.testing.assert_allclose(report(cube(20, 4).inverted().triangles())["volume_mm3"], -64)
    ball = report(models.body("ball_on_stem").triangles())
    assert ball["closed"] and ball["shells"] >= 1


def test_vertices_of_random_soup() -> None:
    rng = np.random.default_rng(5)
    for vertices, facets in ((3, 5), (40, 70_000), (20_000, 30_000)):
        points = rng.normal(size=(vertices, 3)).astype(np.float32)
        faces = rng.integers(0, vertices, (facets, 3))
        found = report(points[faces])
        assert found["vertices"] == len(np.unique(faces))
        real = faces[np.array([len(set(f)) == 3 for f in faces.tolist()])]
        edges = np.sort(real[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        count = np.unique(edges, axis=0, return_counts=True)[1]
        assert (found["open_edges"], found["nonmanifold_edges"]) == ((count == 1).sum(), (count > 2).sum())
        assert found["duplicate_facets"] == len(real) - len(np.unique(np.sort(real, axis=1), axis=0))


def test_what_costs_nothing(tmp_path: Path) -> None:
    mesh = read_mesh(models.write_stl(tmp_path / "a.stl", cube().triangles()))
    assert brief(mesh).items() <= survey(mesh).items()


# ---------------------------------------------------------------- info


def test_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = models.write_stl(tmp_path / "a.stl", cube().without(3).triangles())
    assert main(["info", str(path)]) == 0
    out, err = capsys.readouterr()
    first, second, third = out.splitlines()
    assert first == f"{path}: 11 facets, 8 vertices, 1 shell"
    assert second.startswith("  10 x 10 x 10 mm from (0, 0, 0), ") and third == "  not closed: 3 open edges"
    assert err == ""
    assert main(["info", str(path), "--json", "--units", "inch"]) == 0
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    found = run["result"]
    assert (run["file"], run["exit_code"], run["error"]) == (str(path), 0, None)
    assert (found["file"], found["size"], found["closed"], found["open_edges"]) == (str(path), [254] * 3, False, 3)


def test_info_of_several_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = models.write_stl(tmp_path / "a.stl", cube(0, 0.5).triangles())
    assert main(["info", str(tmp_path / "none"), str(path), "--json"]) == 3
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert [run["exit_code"] for run in found["runs"]] == [3, 0] and found["exit_code"] == 3
    assert found["runs"][1]["result"]["facets"] == 12
    assert err.splitlines() == [
        f"rasterslice: error: {tmp_path / 'none'}: cannot read the mesh: No such file or directory",
        f"rasterslice: warning: {path}: the model is 0.5 mm large; if its file is in metres or inches, "
        "write units = m or inch",
    ]


def test_info_of_one_that_fails_has_the_same_shape(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "none.stl"
    assert main(["info", str(path), "--json"]) == 3
    out, err = capsys.readouterr()
    found = json.loads(out)
    (run,) = found["runs"]
    assert found["exit_code"] == run["exit_code"] == 3 and run["error"] in err
    assert "cannot read the mesh" in run["error"] and "result" not in run
    assert main(["info", str(path)]) == 3
    assert capsys.readouterr().out == ""


def test_one_of_a_thing_is_said_so(tmp_path: Path) -> None:
    corners = np.concatenate([cube().triangles(), cube().triangles()[:1]])
    found = report(corners)
    assert damage({**found, "inverted_shells": 1}).split(", ") == [
        "3 edges of more than two facets", "1 facet in the place of another one", "1 shell turned inside out",
    ]  # fmt: skip
    lines = report_lines({**report(corners[:1]), "file": "a"})
    assert lines[0] == "a: 1 facet, 3 vertices, 1 shell"


# ---------------------------------------------------------------- init


@pytest.mark.parametrize(
    ("size", "guess"),
    [
        ((0.2, 0.3, 0.1), "units = m, because the model is 0.3 large, and in mm would be smaller than a bead"),
        ((1e5, 10, 1e4), "scaling by 0.0021, because the model is 100000 mm large and no machine is"),
        ((30, 20, 500), "rotation by -90 degrees about x, because the model is higher than the 210 mm"),
    ],
)
def test_init_says_what_it_guesses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], size: tuple[float, float, float], guess: str
) -> None:
    mesh = models.write_stl(tmp_path / "a.stl", cube(0, 1).triangles() * np.array(size, np.float32))
    assert main(["init", str(mesh)]) == 0
    target = tmp_path / "a.txt"
    assert f"rasterslice: warning: {target}: guessed: {guess}" in capsys.readouterr().err
    assert f"% Guessed: {guess}" in target.read_text()


def three_mf(path: Path, size: float) -> Path:
    body = trimesh.creation.box((size, size, size))
    path.write_bytes(body.export(file_type="3mf"))  # which names mm
    return path


def test_nothing_is_guessed_of_units_that_a_file_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh, target = three_mf(tmp_path / "tiny.3mf", 0.5), tmp_path / "tiny.txt"
    assert read_mesh(mesh).own_units and main(["info", str(mesh)]) == 0
    said = capsys.readouterr().err
    assert "0.5 mm large, in the units that its file names; scale it" in said and "units =" not in said
    assert main(["init", str(mesh)]) == 0
    assert "guessed" not in capsys.readouterr().err
    params = read_params(target)
    assert params.units == "mm" and params.scaling is None and params.thickness < 0.1
    assert main([str(target), "--json", "--no-progress"]) == 0
    out, err = capsys.readouterr()
    manifest = json.loads(out)
    assert manifest["mesh"]["size"] == [0.5, 0.5, 0.5] and manifest["totals"]["part_fill_mm"] > 0
    assert "inch" not in err
    large = read_mesh(three_mf(tmp_path / "large.3mf", 5000))
    assert size_notes(large) == ["the model is 5000 mm large, in the units that its file names; scale it"]


def test_units_that_are_given(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = models.write_stl(tmp_path / "a.stl", cube(0, 0.5).triangles())
    assert main(["init", str(mesh), "--units", "inch"]) == 0
    target = tmp_path / "a.txt"
    assert capsys.readouterr().err == "" and read_params(target).units == "inch"
    assert "12.7 x 12.7 x 12.7 mm as sliced" in target.read_text()
    assert main(["preview", str(mesh), "--units", "cm", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["thickness"] > 0.01  # of 5 mm, and not of 0.5
    assert main(["preview", str(target), "--units", "cm"]) == 2
    assert f"{target}: names the units of its meshes itself; write units = cm there" in capsys.readouterr().err
    assert main(["init", str(mesh), "--units", "miles"]) == 2


_LENGTH = st.floats(-6, 6).map(lambda power: 10.0**power)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.tuples(_LENGTH, _LENGTH, _LENGTH) | _LENGTH.map(lambda v: (v, v, v)), st.sampled_from([None, "mm", "m"]))
@example((1e-6, 1e-6, 1e-6), None)
@example((1e-4, 1e-4, 1e-4), "mm")
@example((1, 1, 5e-7), None)
@example((0.04, 0.04, 0.001), "mm")
@example((2000, 2000, 2000), None)
@example((100, 5e-7, 300), None)
@example((1e6, 1e6, 1e6), "m")
def test_what_init_writes_runs(tmp_path: Path, size: tuple[float, float, float], units: str | None) -> None:
    """Whatever the size of a part, it is refused by `init`, which names it, or what is written can be run."""
    mesh = models.write_stl(tmp_path / "a.stl", cube(0, 1).triangles() * np.array(size, np.float32))
    target = tmp_path / "a.txt"
    try:
        target.write_text(starter([mesh], target, units=units)[0])
    except ModelError as error:
        assert "x" in str(error) and ("must be" in str(error) or "scale factor" in str(error) or "check" in str(error))
        return
    plan = dry_run(read_params(target))
    assert plan["layers"] > 0 and plan["grid"]["width"] * plan["grid"]["height"] < 1e7


@pytest.mark.parametrize(
    ("size", "units", "said"),
    [
        ((1e-4, 1e-4, 1e-4), "mm", "0.0001 x 0.0001 x 0.0001 mm (with units = mm, scaled by 1); it must be 0.04 mm"),
        ((10, 10, 5e-4), None, "10 x 10 x 0.0005 mm (with units = mm, scaled by 1); it must be 0.001 mm high"),
        ((1e6, 1e6, 1e6), "m", "the least scale factor is 1e-06: scale the model, or name its units"),
    ],
)
def test_init_refuses_what_cannot_be_sliced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], size: tuple[float, float, float], units: str | None, said: str
) -> None:
    mesh = models.write_stl(tmp_path / "a.stl", cube(0, 1).triangles() * np.array(size, np.float32))
    assert main(["init", str(mesh), *(["--units", units] if units else [])]) == 3
    assert said in capsys.readouterr().err and not (tmp_path / "a.txt").exists()


def test_init_of_a_file_that_is_cut_short(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = tmp_path / "a.stl"
    mesh.write_bytes(meshfiles.stl((lambda v, f: v[f])(*meshfiles.ball()))[:-70])
    assert main(["init", str(mesh)]) == 3
    assert main(["init", str(mesh), "--lenient"]) == 0
    assert "the file holds 118, sliced" in capsys.readouterr().err
    assert read_params(tmp_path / "a.txt").lenient
    assert main([str(tmp_path / "a.txt"), "--quiet", "--pitch", "0.2"]) == 0


@pytest.mark.parametrize(
    "size", [(10, 10, 10), (30, 20, 500), (0.2, 0.3, 0.1), (1e5, 10, 1e4), (300, 300, 300), (8, 1, 1)]
)
def test_init_writes_what_reads_back(tmp_path: Path, size: tuple[float, float, float]) -> None:
    corners = cube(0, 1).triangles() * np.array(size, np.float32)
    mesh = models.write_stl(tmp_path / "my part.stl", corners)
    target = tmp_path / "a.txt"
    target.write_text(starter([mesh], target)[0])
    params = read_params(target)
    assert params.files == (mesh,) and params.option == 2
    assert '"my part.stl"' in target.read_text()


def test_init_runs_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [models.write_stl(tmp_path / f"{n}.stl", cube(n, 6).triangles()) for n in (0, 3)]
    assert main(["init", *map(str, paths)]) == 0
    target = tmp_path / "0.txt"
    assert capsys.readouterr().out == f"{target}\n"
    assert main([str(target), "--json", "--pitch", "0.15"]) == 0
    manifest = json.loads(capsys.readouterr().out)
    assert manifest["facets"] == 24 and manifest["mesh"]["size"] == [9, 9, 9] and manifest["warnings"] == []
    assert (tmp_path / "0.slices" / "sheet.png").exists()
    assert main(["init", str(paths[0])]) == 2
    assert f"{target}: exists and is not replaced" in capsys.readouterr().err
    assert main(["init", str(tmp_path / "none.stl"), "-o", str(tmp_path / "b.txt")]) == 3
    assert not (tmp_path / "b.txt").exists()


def test_the_manifest_holds_the_report_when_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = tmp_path / "a.stl"
    mesh.write_bytes(meshfiles.stl((lambda v, f: v[f][1:])(*meshfiles.ball())))
    file = models.write_params(tmp_path, mesh, report=1)
    assert main([str(file), "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["mesh"]["open_edges"] == 3
    assert f"rasterslice: warning: {mesh}: 3 open edges\n" in err
