"""Export, checks and simulator: what goes in as a toolpath comes out as a bead."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes import layer, pack, ring, tree, washer
from hypothesis import given, settings
from test_trajectory import blobs

import rasterslice
from rasterslice.cli import main
from rasterslice.cobra import kinematics as kin
from rasterslice.cobra import program
from rasterslice.cobra.beads import compare
from rasterslice.cobra.bundle import read_bundle, verify, write_bundle
from rasterslice.cobra.checks import Checker
from rasterslice.cobra.command import simulation
from rasterslice.cobra.records import base_name
from rasterslice.cobra.simulate import prepare, simulate
from rasterslice.cobra.vplus import Program
from rasterslice.cobra.watch import Deposit
from rasterslice.errors import UsageError
from rasterslice.paths import Layer
from rasterslice.profile import Profile, read_profile
from rasterslice.trajectory import Planner

PROFILE = read_profile()
WIDTHS = (1.5, 1.5)


def disc(index: int, radius: float = 10.0, at: tuple[float, float] = (0.0, 0.0)) -> Layer:
    """A disc, filled, with beads of 1.5 mm."""
    inside = radius - 0.75
    y = np.arange(-int(inside / 1.5) + 0.5, int(inside / 1.5)) * 1.5
    half = np.sqrt(inside**2 - y**2)
    lines = np.stack([np.stack([-half, y], 1), np.stack([half, y], 1)], 1) + at
    turned = (lines - at)[..., ::-1] + at
    return replace(
        layer(index, 0.2 + 0.4 * index, part=pack([ring(radius, 200) + at], True),
              part_boundary=pack([ring(inside, 200) + at], True), part_fill=pack(list(lines), False)),
        part_second_fill=pack(list(turned), False),
    )  # fmt: skip


def bundle_of(folder: Path, layers: list[Layer], profile: Profile = PROFILE) -> Any:
    write_bundle(layers, folder / "job.cobra", Planner(profile, 0.4), "job", WIDTHS)
    return read_bundle(folder / "job.cobra")


def played(folder: Path, layers: list[Layer], profile: Profile = PROFILE) -> tuple[Any, list[Deposit]]:
    deposits: list[Deposit] = []
    return simulate(bundle_of(folder, layers, profile), deposits.append), deposits


@settings(max_examples=15, deadline=None)
@given(blobs(), blobs())
def test_commanded_beads_are_those_of_the_toolpath(
    tmp_path_factory: pytest.TempPathFactory, part: np.ndarray, scaffold: np.ndarray
) -> None:
    lines = [[(-5, y), (9, y + 1)] for y in range(5)]
    layers = [
        layer(k, 0.2 + 0.4 * k, part_boundary=pack([part + k], True), scaffold_boundary=pack([scaffold], True),
              part_fill=pack(lines, False)) for k in range(2)
    ]  # fmt: skip
    paths = list(Planner(PROFILE, 0.4).toolpaths(layers))
    result, deposits = played(tmp_path_factory.mktemp("job"), layers)
    assert result.faults == []
    assert [d.tool for d in deposits] == [p.material for p in paths]
    for d, p in zip(deposits, paths, strict=True):
        assert d.z == pytest.approx(p.top + 0.3, abs=1e-9)
        want = p.wet()
        assert len(d.commanded) == len(want)
        for got, wet, laid in zip(d.commanded, want, d.laid, strict=True):
            inner, all_points = got[1:-1], wet[1:-1]
            far = np.abs(inner[:, None] - all_points[None]).sum(axis=2)
            assert (far.min(axis=1) < 0.01).all()
            assert np.abs(got[[0, -1]] - wet[[0, -1]]).max() < 0.01
            # Beads: signals at most a tick late, corners cut by no more than predicted.
            for bead, line in ((laid[0], wet[0]), (laid[-1], wet[-1])):
                assert np.hypot(*(bead - line)) <= 12.5 * 0.016 + 0.01
            from shapely import LineString, Point

            path = LineString(np.concatenate([wet, [wet[-1] + (wet[-1] - wet[-2]) * 2]]))
            assert max(path.distance(Point(q)) for q in laid) <= result.rounding + 0.01
    assert result.valve_error <= 12.5 * 0.016 + 1e-6
    assert result.rounding <= 12.5**2 * np.sin(np.radians(22.5)) ** 2 / 2000 * 1.01  # records are rounded
    late = 12.5 * 0.016 * sum(len(p) for p in paths)
    assert sum(result.wet) == pytest.approx(sum(p.wet().lengths().sum() for p in paths), abs=late)


def test_a_disc_is_covered_and_nothing_lies_outside(tmp_path: Path) -> None:
    layers = [disc(k) for k in range(3)]
    bundle = bundle_of(tmp_path, layers)
    deposits: list[Deposit] = []
    result = simulate(bundle, deposits.append)
    rows = list(compare(bundle, layers, deposits))
    assert [(r.layer, r.pass_) for r in rows] == [(k, i) for k in range(3) for i in range(2)]
    for r in rows:
        assert r.region == pytest.approx(np.pi * 100, rel=1e-3)
        assert r.uncovered < 0.02 * r.region
        assert r.outside < 0.002 * r.region
    assert 6 * np.pi * 100 < result.wet[0] * 1.5 < 6 * np.pi * 100 * 1.2  # beads overlap where lines meet the wall
    missing = list(compare(bundle, layers, [d for d in deposits if d.z > 0.6]))
    assert missing[0].uncovered == pytest.approx(missing[0].region, rel=0.02)


def test_time_and_estimate_agree(tmp_path: Path) -> None:
    bundle = bundle_of(tmp_path, [washer(k, 0.2 + 0.4 * k) for k in range(6)])
    result = simulate(bundle)
    assert result.seconds == pytest.approx(bundle.manifest["estimated_seconds"], rel=0.1)
    up = PROFILE.motion.clearance - PROFILE.motion.lift  # at the very end
    assert result.travel == pytest.approx(bundle.manifest["travel_mm"] + up, abs=0.1)
    wet = bundle.manifest["wet_mm"]
    assert sum(result.wet) == pytest.approx(wet["part"] + wet["scaffold"], rel=0.05)
    assert result.paths == bundle.manifest["paths"]
    assert result.points == bundle.manifest["points"]


@pytest.mark.parametrize("hold", [0, 2])
def test_travel_is_the_same_in_manifest_and_simulator(tmp_path: Path, hold: int) -> None:
    """Ways by purge and park places, lifts and the jump from tip to tip included; the way from run to run is less."""
    profile = replace(PROFILE, path=replace(PROFILE.path, hold_every=hold))
    bundle = bundle_of(tmp_path, [washer(k, 0.2 + 0.4 * k) for k in range(5)], profile)
    report, m = simulation(bundle, beads=False), bundle.manifest
    assert report["travel_mm"] == pytest.approx(m["travel_mm"], abs=4)
    assert m["estimated_seconds"] == pytest.approx(report["build_seconds"], rel=0.05)
    assert 0 < m["trajectory"]["run_to_run_mm"] < m["travel_mm"] / 2
    assert "travel" not in m["trajectory"]


def test_bytes_repeat_and_sums_are_right(tmp_path: Path) -> None:
    trees = []
    for name in "ab":
        (tmp_path / name).mkdir()
        trees.append(tree(bundle_of(tmp_path / name, [washer(k, 0.2 + 0.4 * k) for k in range(3)]).folder))
    assert trees[0] == trees[1]
    data = next(v for k, v in trees[0].items() if k.endswith(".RSD"))
    lines = data.split(b"\r\n")
    assert lines[-1] == b""
    assert lines[-2] == b"Z"
    head = lines[0].split()
    assert [head[0], head[1], head[4]] == [b"RSD", b"1", b"JOB"]
    assert int(head[3]) == len(lines) - 2
    total = points = 0
    for line in lines[1:-1]:
        if line[:1] == b"C":
            assert int(line[2:]) == total % 65536
            total = 0
        elif line[:1] == b"L":
            total = 0
        else:
            total += sum(line) + 23
        if line[:1] == b"P":
            points = int(line.split()[3])
        elif line[:1] in b"TMVW":
            points -= 1
            _, x, y = line.split(b" ")
            assert len(x.partition(b".")[2]) == len(y.partition(b".")[2]) == 3
        elif line == b"E":
            assert points == 0
        assert len(line) <= 72


def test_numbers_are_written_as_they_are() -> None:
    from rasterslice.cobra.records import _digits

    values = np.array([0, -0.0004, 0.0005001, -0.001, 1, -9.9996, 9999.999, -9999.999, 123.4565, 10, 100.05])
    rows, used = np.full((len(values), 9), 32, np.uint8), np.ones((len(values), 9), bool)
    _digits(values, rows, used)
    got = [rows[i][used[i]].tobytes().decode() for i in range(len(values))]
    assert got == [f"{v / 1000:.3f}" for v in np.rint(values * 1000).astype(int)]


@pytest.mark.parametrize(
    ("stem", "name"),
    [("lucy", "LUCY"), ("james mcgill", "JAMESMCG"), ("3d", "P3D"), ("\u00e9", "PART"), ("rscfg", "PRSCFG"),
     ("a.b", "AB")],
)
def test_base_names(stem: str, name: str) -> None:
    assert base_name(stem) == name


def test_kinematics_come_back() -> None:
    rng = np.random.default_rng(1)
    w = rng.uniform((250, -150), (510, 150), (200, 2))
    angle = np.radians(kin.joints(w, PROFILE))
    a, b = PROFILE.robot.links
    both = angle[:, 0] + angle[:, 1]
    x = a * np.cos(angle[:, 0]) + b * np.cos(both)
    y = a * np.sin(angle[:, 0]) + b * np.sin(both)
    assert np.abs(np.stack([x, y], 1) - w).max() < 1e-9
    v = rng.uniform(-100, 100, (200, 2))
    rate = kin.joint_speeds(w, v, PROFILE)
    moved = kin.joints(w + v * 1e-6, PROFILE)
    assert np.abs((moved - kin.joints(w, PROFILE))[:, :2] / 1e-6 - rate[:, :2]).max() < 1e-2
    assert kin.radii(PROFILE)[0] == pytest.approx(162.63, abs=0.01)


BAD = {
    "too far": (dict(at=(240, 0)), {}, ("reach", "move it", "cent")),
    "too high": (dict(index=520), {}, ("envelope z",)),
    "too long": (dict(radius=160), {}, ("envelope", "scale it by")),
    "below the stroke": ({}, {"part": {"frame": (360.0, 0.0, 20.0)}}, ("J3 range", "part.frame")),
    "no room to speed up": ({}, {"path": {"speed_tolerance": 0.0}}, ("dip of the wet speed", "smooth angle")),
    "travel too fast": ({}, {"robot": {"joint_speed": (1.0, 672.0, 1100.0, 1200.0)}}, ("J1 speed", "travel_speed")),
    "J4": ({}, {"robot": {"joint_high": (105.0, 150.0, 210.0, -300.0)}}, ("J4 range",)),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_the_arm_cannot_do_is_refused(tmp_path: Path, name: str) -> None:
    shape, change, words = BAD[name]
    profile = PROFILE
    for section, values in change.items():
        profile = replace(profile, **{section: replace(getattr(profile, section), **values)})
    with pytest.raises(UsageError) as caught:
        bundle_of(tmp_path, [disc(**{"index": 0, **shape})] if name != "too high" else [disc(0), disc(520)], profile)
    text = str(caught.value)
    assert all(word in text for word in words), text
    assert "\n" not in text
    assert not list(tmp_path.iterdir())


def test_what_is_not_finite_is_refused() -> None:
    path = next(Planner(PROFILE, 0.4).toolpaths([disc(0)]))
    path.points[7, 0] = np.nan
    with pytest.raises(UsageError, match=r"layer 0, part 0, path 0, point 7: a coordinate is not a finite"):
        Checker(PROFILE).add(path)


def test_a_valve_that_stays_open_is_refused() -> None:
    path = next(Planner(PROFILE, 0.4).toolpaths([disc(0)]))
    path.ops[int(path.offsets[1]) - 1] = 1
    with pytest.raises(UsageError, match="does not open once and shut once"):
        Checker(PROFILE).add(path)


def test_the_player_is_within_the_limits_of_the_controller() -> None:
    text = program.PLAYER.read_bytes()
    assert text.isascii()
    lines = text.decode().split("\r\n")
    assert "\n" not in "".join(lines)
    program.text(lines[:-1], PROFILE.files)


def test_the_player_powers_and_starts_nothing(tmp_path: Path) -> None:
    bundle = bundle_of(tmp_path, [washer(0, 0.2)])
    for file in ("RSPLAY.V2", "RSCFG.V2"):
        lines = [line.partition(";")[0].upper() for line in (bundle.folder / file).read_text().splitlines()]
        assert not [x for x in lines if any(w in x for w in ("POWER", "CALIBRATE", "EXECUTE"))]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("ALTER 1", "keyword ALTER is not known"),
        ("x = SQRT(2)", "function SQRT is not known"),
        ("APPRO rs.part, 5", "keyword APPRO is not known"),
        ("MOVE rs.part", "the line ends too early"),
        ("IF 1 THEN", ".END does not fit"),
        ("END", "END without a beginning"),
        ("x = 1 +", "the line ends too early"),
        ("x = {1}", "not V+ as we write it"),
        ("x = 1 2", "not expected: 2"),
        ("SPEED 10 IPS ALWAYS", "expected MMPS, got IPS"),
    ],
)
def test_the_interpreter_knows_nothing_else(line: str, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        Program({"X.V2": f".PROGRAM a()\r\n        {line}\r\n.END\r\n"}, None)
    assert str(caught.value).startswith("X.V2:")
    assert message in str(caught.value)


def test_literal_programs_play_the_same(tmp_path: Path) -> None:
    profile = replace(PROFILE, files=replace(PROFILE.files, literal_steps=100_000))
    bundle = bundle_of(tmp_path, [washer(k, 0.2 + 0.4 * k) for k in range(3)], profile)
    files = {f.name: f.read_bytes().decode() for f in sorted(bundle.folder.glob("*.V2"))}
    assert {"RSLIT.V2", "RSL0000.V2"} <= files.keys()
    literal, records = prepare(bundle).play("rs.lit"), simulate(bundle)
    assert literal.faults == []
    assert literal.paths == records.paths
    assert literal.seconds == pytest.approx(records.seconds, rel=0.01)
    assert literal.wet == pytest.approx(records.wet, rel=1e-3)
    report = simulation(bundle, beads=False)
    assert report["faults"] == []
    assert report["literal"]["points"] == report["points"]
    config = bundle.folder / "RSL0000.V2"
    config.write_bytes(config.read_bytes().replace(b"MOVES rs.part:TRANS(-", b"MOVES rs.part:TRANS(-1", 1))
    assert "rs.lit: point " in "".join(simulation(replace(bundle, manifest=unsealed(bundle)), beads=False)["faults"])


def unsealed(bundle: Any) -> dict[str, Any]:
    """A manifest that knows no sums."""
    return {**bundle.manifest, "files": []}


@pytest.mark.parametrize("stop", [1, 5, 30])
def test_literal_programs_end_where_the_player_ends(tmp_path: Path, stop: int) -> None:
    """What ends the job ends it before the next run, hold or change of the tool: the side, or DO rs.go = 0."""
    profile = replace(PROFILE, files=replace(PROFILE.files, literal_steps=100_000))
    bundle = bundle_of(tmp_path, [washer(k, 0.2 + 0.4 * k) for k in range(3)], profile)
    counts = []
    for name in ("rs.run", "rs.lit"):
        simulator = prepare(bundle)
        arm, original = simulator.arm, simulator.arm.moves

        def moves(*args: Any, arm: Any = arm, original: Any = original, space: Any = simulator.program._space) -> None:
            original(*args)
            if arm._count == stop:
                space["v_rs__go"] = 0

        arm.moves = moves  # type: ignore[method-assign]
        result = simulator.play(name)
        assert arm.valves.shut
        counts.append((arm._count, result.paths, result.changes))
    assert counts[0] == counts[1]
    assert counts[0][2] == 1


def test_literal_programs_do_not_move_when_the_elbow_swings_over(tmp_path: Path) -> None:
    profile = replace(PROFILE, files=replace(PROFILE.files, literal_steps=100_000))
    simulator = prepare(bundle_of(tmp_path, [washer(0, 0.2)], profile))
    arm, original = simulator.arm, simulator.arm.move

    def move(*args: Any) -> None:
        original(*args)
        arm._joints[1] *= -1

    arm.move = move  # type: ignore[method-assign]
    result = simulator.play("rs.lit")
    assert "the elbow is on the other side" in result.messages[0]
    assert arm._count == 0
    assert arm.deposits == []


def mistyped(value: Any) -> Any:
    """Something else in the place of a value."""
    if isinstance(value, str):
        return 7
    return {"not": "this"} if isinstance(value, list) else [value, "no"] if isinstance(value, dict) else "none of ours"


def test_every_key_of_a_damaged_manifest(tmp_path: Path) -> None:
    """Deleted or of another type, at the top, in the profile and in the list of files: one clear error."""
    bundle = bundle_of(tmp_path, [washer(0, 0.2)])
    file = bundle.folder / "JOB.json"
    good = json.loads(file.read_text())
    places: list[tuple[Any, ...]] = [(key,) for key in good if key != "kind"]
    places += [("profile", key) for key in good["profile"]]
    places += [("profile", s, key) for s, v in good["profile"].items() if isinstance(v, dict) for key in v]
    places += [("files", k, key) for k in range(3) for key in good["files"][k]]
    assert len(places) > 90
    for place in places:
        for change in ("delete", "mistype"):
            bad = json.loads(file.read_text())
            at = bad
            for key in place[:-1]:
                at = at[key]
            if change == "delete":
                del at[place[-1]]
            else:
                at[place[-1]] = mistyped(at[place[-1]])
            other = tmp_path / "other.cobra"
            other.mkdir(exist_ok=True)
            (other / "JOB.json").write_text(json.dumps(bad))
            with pytest.raises(UsageError, match=r"JOB\.json: damaged \(.+\); export again") as caught:
                read_bundle(other)
            assert "\n" not in str(caught.value), place


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("records_file", "../../x", "records_file is not what was written: ../../x"),
        ("records_file", "OTHER.RSD", "files does not name OTHER.RSD"),
        ("files", [], "files does not name JOB.RSD"),
        ("copies", [], "copies is not"), ("copies", [[1]], "copies is not"),
        ("widths", [1.5, 0], "widths is not"), ("thickness", 0, "thickness is not"),
        ("records", -1, "records is not"), ("points", 1.5, "points is not"), ("part_layers", 0, "part_layers is not"),
        ("bottom", math.nan, "bottom is not"), ("wet_mm", {"part": 1}, "wet_mm is not"),
    ],
)  # fmt: skip
def test_values_of_a_damaged_manifest(tmp_path: Path, key: str, value: Any, message: str) -> None:
    bundle = bundle_of(tmp_path, [washer(0, 0.2)])
    file = bundle.folder / "JOB.json"
    file.write_text(json.dumps({**bundle.manifest, key: value}))
    with pytest.raises(UsageError) as caught:
        read_bundle(bundle.folder)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [("path", "tick", 0), ("motion", "lift", -1), ("motion", "accel", 10**400), ("robot", "links", [325.0])],
)
def test_profiles_of_a_damaged_manifest(tmp_path: Path, section: str, key: str, value: Any) -> None:
    bundle = bundle_of(tmp_path, [washer(0, 0.2)])
    file = bundle.folder / "JOB.json"
    bad = json.loads(file.read_text())
    bad["profile"][section][key] = value
    file.write_text(json.dumps(bad))
    with pytest.raises(UsageError, match=rf"damaged \(.*{key}.*\); export again|damaged \(int too large"):
        read_bundle(bundle.folder)


def test_damaged_records_are_noticed(tmp_path: Path) -> None:
    bundle = bundle_of(tmp_path, [washer(0, 0.2)])
    text = bundle.records.read_bytes()
    bundle.records.write_bytes(text.replace(b"\r\nM ", b"\r\nQ ", 1))
    with pytest.raises(UsageError, match=r"JOB\.RSD: is not the file that was exported"):
        verify(bundle)
    assert "record not known" in simulate(bundle).faults[0]
    lost = text.split(b"\r\n")
    del lost[8]
    bundle.records.write_bytes(b"\r\n".join(lost))
    assert "damaged" in simulate(bundle).faults[0]
    bundle.records.unlink()
    assert simulate(bundle).faults


def test_a_valve_open_on_travel_is_a_fault(tmp_path: Path) -> None:
    bundle = bundle_of(tmp_path, [washer(0, 0.2)])
    bundle.records.write_bytes(bundle.records.read_bytes().replace(b"\r\nW ", b"\r\nM ", 1))
    player = bundle.folder / "RSPLAY.V2"
    player.write_bytes(player.read_bytes().replace(b"        BREAK\r\n        SIGNAL -rs.vlv[rs.m]", b"        BREAK"))
    assert any("open" in f for f in simulate(bundle).faults)


def test_holds_and_changes(tmp_path: Path) -> None:
    profile = replace(PROFILE, path=replace(PROFILE.path, hold_every=2))
    result, _ = played(tmp_path, [washer(k, 0.2 + 0.4 * k) for k in range(5)], profile)
    assert (result.holds, result.changes) == (2, 11)
    assert result.faults == []


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bundle = bundle_of(tmp_path, [washer(0, 0.2)])
    trace = tmp_path / "trace.csv"
    assert main(["cobra", "simulate", str(bundle.folder), "--json", "--trace", str(trace)]) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["faults"] == []
    assert out["points"] == bundle.manifest["points"]
    rows = np.loadtxt(trace, delimiter=",", skiprows=1)
    assert trace.read_text().startswith("t,x,y,z,J1,J2,J3,J4,valve\n")
    assert (np.diff(rows[:, 0]) > 0).all()
    wet = (rows[:, 8] > 0).sum() * 0.016 * 12.5
    assert wet == pytest.approx(sum(out["wet_mm"].values()), rel=0.05)
    assert main(["cobra", "simulate", str(bundle.folder)]) == 0
    assert "not compared" in capsys.readouterr().out
    assert main(["cobra", "--help"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert all(word in said.out for word in ("simulate", "serve", "send", "rs.guard", "rs.safe", "DO rs.go = 0"))
    assert max(map(len, said.out.splitlines())) <= 120
    for argv, message in (
        (["cobra"], "takes simulate, serve or send"),
        (["cobra", "dance"], "got dance"),
        (["cobra", "simulate", str(tmp_path / "none")], "no such folder"),
        (["cobra", "simulate", str(bundle.folder), "--trace", str(trace), "--trace-layer", "9"], "slice 9 has no"),
        (["cobra", "simulate", str(bundle.folder), "--trace-layer", "0"], "--trace-layer 0 needs --trace FILE"),
        (["cobra", "serve", str(bundle.folder), "--port", "loop://", "--wait", "-1"], "--wait must be 0, for ever, to"),
        (["cobra", "serve", str(bundle.folder), "--port", "loop://", "--wait", "nan"], "--wait must be 0, for ever"),
        (["cobra", "send", str(bundle.folder), "--port", ""], "--port is empty; name a device"),
        (["cobra", "send", str(bundle.folder), "--port", "socket://bad"], "write it like socket://host:port"),
        (["cobra", "send", str(bundle.folder), "--port", "loop://", "--baud", "1"], "--baud must be"),
    ):
        assert main(argv) == 2
        assert message in capsys.readouterr().err


def test_from_a_parameter_file_to_the_simulator(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from models import write_params, write_stl
    from test_end_to_end import sphere

    mesh = write_stl(tmp_path / "ball.stl", sphere(8.0))
    params = write_params(tmp_path, mesh, translation=(1, "cent", "cent", 0))
    (tmp_path / "cell.toml").write_text("[path]\nhold_every = 10\n")
    with params.open("a") as file:
        file.write("machine = cell.toml\n")
    assert main([str(params), "--export", "cobra", "--quiet"]) == 0
    out = tmp_path / "params.slices"
    assert main(["cobra", "simulate", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["faults"] == []
    assert report["holds"] == 3
    part = report["beads"]["part"]
    assert part["region_mm2"] == pytest.approx(2 * 4 / 3 * np.pi * 8**3 / 0.4, rel=0.01)
    assert part["uncovered_mm2"] < 0.02 * part["region_mm2"]
    assert part["outside_mm2"] < 0.001 * part["region_mm2"]
    headings = []
    for path in Planner(read_profile(), 0.4).toolpaths(rasterslice.open(out)):
        if path.material == 0 and (path.kinds == 2).any():
            line = path.wet()[len(path) - 1]
            headings.append(abs(line[-1, 0] - line[0, 0]) > abs(line[-1, 1] - line[0, 1]))
    assert len(headings) > 60
    assert all(a != b for a, b in zip(headings, headings[1:], strict=False))
    # Warnings of an export are those of its last time; those of others stay.
    again = {"hold_every = 10", "chord_tolerance = 0.000001"}
    for text in sorted(again):
        (tmp_path / "cell.toml").write_text(f"[path]\n{text}\n")
        manifest = json.loads((out / "manifest.json").read_text())
        before = [t for t in manifest["warnings"] if not t.startswith("cobra: ")]
        (out / "manifest.json").write_text(json.dumps({**manifest, "warnings": [*before, "cobra: long ago", "x: y"]}))
        assert main(["export", str(out), "--to", "cobra"]) == 0
        warnings = json.loads((out / "manifest.json").read_text())["warnings"]
        assert warnings[: len(before)] == before
        assert "x: y" in warnings
        assert "cobra: long ago" not in warnings
        assert any("chord_tolerance is 1e-06" in t for t in warnings) == text.startswith("chord")
    capsys.readouterr()
    (tmp_path / "cell.toml").write_text("[path]\nhold_evry = 10\n")
    assert main(["export", str(out), "--to", "cobra"]) == 2
    assert "did you mean 'path.hold_every'" in capsys.readouterr().err
    assert (out / "params.cobra" / "PARAMS.RSD").is_file()


def test_copies_from_a_parameter_file_to_the_simulator(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from models import write_params, write_stl
    from test_end_to_end import sphere

    mesh = write_stl(tmp_path / "ball.stl", sphere(4.0))
    params = write_params(tmp_path, mesh, copies=(2, 1, 2), translation=(1, -20.0, -4.0, 0))
    assert main([str(params), "--export", "cobra", "--quiet"]) == 0
    assert main(["cobra", "simulate", str(tmp_path / "params.slices"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["faults"] == []
    part = report["beads"]["part"]
    assert part["region_mm2"] == pytest.approx(2 * 2 * 4 / 3 * np.pi * 4**3 / 0.4, rel=0.02)
    assert part["uncovered_mm2"] < 0.04 * part["region_mm2"]
    assert part["outside_mm2"] < 0.002 * part["region_mm2"]
    before = tree(tmp_path)
    crowd = write_params(tmp_path, mesh, copies=(40, 1, 40), translation=(1, "cent", "cent", 0))
    assert main([str(crowd), "-o", str(tmp_path / "crowd"), "--export", "cobra", "--quiet"]) == 2
    said = capsys.readouterr().err
    found = re.search(r"40 copies of (\S+) x .* like this: use copies (\d+) 3 40, then", said)
    assert found, said
    size, across = float(found[1]), int(found[2])
    assert size * across <= 300 < (size + 6) * (across + 1)
    assert tree(tmp_path).keys() == before.keys()
