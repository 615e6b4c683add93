"""What keeps arm and print whole: the start, the stop, the guard, and checks that refuse a job before it is written."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes import layer, pack, ring, washer
from hypothesis import given, settings
from hypothesis import strategies as st
from test_cobra import PROFILE, bundle_of, disc

from rasterslice.cobra import kinematics as kin
from rasterslice.cobra import program
from rasterslice.cobra.bundle import Bundle, write_bundle
from rasterslice.cobra.checks import Checker
from rasterslice.cobra.fit import ROTATIONS, Site, advice
from rasterslice.cobra.places import distance, idle_gaps
from rasterslice.cobra.simulate import prepare
from rasterslice.cobra.vplus import Program, Stop
from rasterslice.errors import UsageError
from rasterslice.mesh import Mesh, transform
from rasterslice.paths import OPEN, Toolpath
from rasterslice.profile import Profile, read_profile
from rasterslice.trajectory import Planner


@pytest.fixture
def bundle(tmp_path: Path) -> Bundle:
    return bundle_of(tmp_path, [washer(k, 0.2 + 0.4 * k) for k in range(2)])


def changed(profile: Profile = PROFILE, **sections: dict[str, Any]) -> Profile:
    return replace(profile, **{s: replace(getattr(profile, s), **values) for s, values in sections.items()})


class Signals:
    """A host that notes signals, for programs that move nothing."""

    def __init__(self, states: list[int]) -> None:
        self.states, self.log = states, list[tuple[int, tuple[float, ...]]]()

    def signal(self, *outputs: float) -> None:
        self.log.append((self.states[0], outputs))

    def task(self, what: int, number: int) -> int:
        assert (what, number) == (1, 0)
        return self.states[0]

    def pause(self, seconds: float) -> None:
        assert 0 < seconds <= 0.2
        self.states.pop(0)
        if not self.states:
            raise Stop


def programs(bundle: Bundle) -> dict[str, str]:
    return {n: (bundle.folder / n).read_bytes().decode("ascii") for n in ("RSPLAY.V2", "RSCFG.V2")}


# The start


@settings(max_examples=25, deadline=None)
@given(st.floats(-100, 100), st.floats(2, 145), st.floats(0, 210), st.floats(-350, 350))
def test_from_wherever_the_arm_stands_it_goes_up_first(
    tmp_path_factory: pytest.TempPathFactory, one: float, two: float, three: float, four: float
) -> None:
    folder = tmp_path_factory.getbasetemp() / "anywhere"
    if not folder.exists():
        folder.mkdir()
        bundle_of(folder, [disc(0, 5.0)])
    from rasterslice.cobra.bundle import read_bundle

    simulator = prepare(read_bundle(folder), (one, two, three, four))
    assert simulator.play().faults == []


def test_the_first_motions_are_up_level_and_down(bundle: Bundle) -> None:
    simulator = prepare(bundle, (-60.0, 100.0, 180.0, 30.0))
    arm, seen = simulator.arm, list[tuple[str, np.ndarray]]()
    for name in ("move_joints", "move", "moves"):
        original = getattr(arm, name)

        def noted(*args: Any, original: Any = original, name: str = name) -> None:
            original(*args)
            seen.append((name, np.array(arm._joints)))

        setattr(arm, name, noted)
    assert simulator.play().faults == []
    (first, up), (second, level) = seen[:2]
    assert (first, up.tolist()) == ("move_joints", [-60.0, 100.0, 1.0, 30.0])
    assert second == "move"
    assert level[2] == pytest.approx(1.0, abs=1e-9)
    tip = kin.tip(level, PROFILE.nozzles[0], PROFILE)
    assert tip[:2].tolist() == pytest.approx(PROFILE.motion.purge_at, abs=1e-9)


@pytest.mark.parametrize("elbow", [1, -1])
def test_the_wrong_elbow_is_refused_before_anything_is_laid(tmp_path: Path, elbow: int) -> None:
    bundle = bundle_of(tmp_path, [disc(0, 5.0)], changed(robot={"elbow": elbow}))
    right = prepare(bundle, (20.0, 60.0 * elbow, 150.0, 0.0)).play()
    assert right.faults == []
    simulator = prepare(bundle, (20.0, -60.0 * elbow, 150.0, 0.0))
    result = simulator.play()
    assert "the elbow is on the other side" in result.messages[0]
    assert simulator.arm.deposits == []
    assert result.changes == 0


@pytest.mark.parametrize("side", ["LEFTY", "RIGHTY", ""])
def test_the_side_is_told_before_the_first_swing(tmp_path: Path, side: str) -> None:
    bundle = bundle_of(tmp_path, [disc(0, 5.0)], changed(robot={"side": side}))
    settings = (bundle.folder / "RSCFG.V2").read_text()
    assert [word for word in ("LEFTY", "RIGHTY") if word in settings.split()] == [side] * bool(side)
    simulator = prepare(bundle)
    log: list[str] = []
    for name in ("side", "move_joints", "move", "moves"):
        original = getattr(simulator.arm, name)
        setattr(simulator.arm, name, lambda *args, n=name, o=original: (log.append(n), o(*args))[1])
    assert simulator.play().faults == []
    assert log[:4] == ["move_joints", *["side"] * bool(side), "move", "moves", "moves"][: 4]


def test_an_elbow_that_swings_over_ends_the_job(bundle: Bundle) -> None:
    simulator = prepare(bundle)
    arm, original = simulator.arm, simulator.arm.move

    def move(*args: Any) -> None:
        original(*args)
        arm._joints[1] *= -1  # an earlier program asked for the other side

    arm.move = move  # type: ignore[method-assign]
    result = simulator.play()
    assert "the elbow is on the other side" in result.messages[0]
    assert arm._count == 0
    assert arm.valves.shut


def test_nothing_moves_without_the_guard(bundle: Bundle) -> None:
    simulator = prepare(bundle)
    simulator.arm.desk.guarded = False
    result = simulator.play()
    assert result.messages == ["rasterslice: start rs.guard in task 1 first; TASK(1, 1) is 0"]
    assert simulator.arm.joints() == (20.0, 60.0, 150.0, 0.0)
    config = bundle.folder / "RSCFG.V2"
    config.write_bytes(config.read_bytes().replace(b"rs.grd = -1", b"rs.grd = 0"))
    simulator = prepare(bundle)
    simulator.arm.desk.guarded = False
    assert simulator.play().faults == []


def test_kinematics_forward_and_back() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        joints = rng.uniform((-100, 5, 0, -300), (100, 145, 210, 300))
        for nozzle in PROFILE.nozzles:
            tip = kin.tip(joints, nozzle, PROFILE)
            back = kin.joints(kin.wrist(tip[None, :2], nozzle, PROFILE), PROFILE)[0]
            assert back[:2].tolist() == pytest.approx(joints[:2].tolist(), abs=1e-6)
            assert float(kin.stroke(tip[2:], nozzle, PROFILE)[0]) == pytest.approx(joints[2])


@pytest.mark.parametrize(("standoff", "down"), [(6.0, 89.3), (30.0, 70.0), (0.3, 95.0), (5.0, 93.0)])
@pytest.mark.parametrize("which", ["part_nozzle", "scaffold_nozzle"])
@pytest.mark.parametrize("hold", [0, 1])
def test_nozzles_of_different_standoffs_are_lifted_at_a_change(
    tmp_path: Path, which: str, standoff: float, down: float, hold: int
) -> None:
    """The nozzle in use goes up from its own height, not from that of the layer to come."""
    offset = (30.0 * (which == "scaffold_nozzle"), 0.0, down)
    values = {which: {"standoff": standoff, "offset": offset}}
    if standoff > 1:  # the short nozzle has its tip high above the layer, the long one near to it
        other = "part_nozzle" if which == "scaffold_nozzle" else "scaffold_nozzle"
        values[other] = {"standoff": 0.5}
    profile = changed(path={"hold_every": hold}, files={"literal_steps": 100_000}, **values)
    bundle = bundle_of(tmp_path, [washer(k, 0.2 + 0.4 * k) for k in range(3)], profile)
    for name in ("rs.run", "rs.lit"):
        simulator = prepare(bundle)
        arm, original, tips = simulator.arm, simulator.arm.moves, list[float]()

        def moves(*args: Any, arm: Any = arm, original: Any = original, tips: list[float] = tips) -> None:
            original(*args)
            longest = max(n.offset[2] for n in profile.nozzles)
            tips.append(args[1][2] + profile.nozzles[arm._tool].offset[2] - longest)

        arm.moves = moves  # type: ignore[method-assign]
        assert simulator.play(name).faults == []
        assert min(tips) > 0.2  # neither tip ever comes nearer to the bed than the first layer is thick


def test_a_plunge_at_a_change_is_found(tmp_path: Path) -> None:
    profile = changed(scaffold_nozzle={"standoff": 6.0, "offset": (30.0, 0.0, 89.3)})
    bundle = bundle_of(tmp_path, [washer(k, 0.2 + 0.4 * k) for k in range(3)], profile)
    player = bundle.folder / "RSPLAY.V2"
    player.write_bytes(player.read_bytes().replace(b"rs.ly, rs.lz+rs.clear", b"rs.ly, rs.z+rs.clear"))
    assert any("the tip travels at" in f and "not lifted" in f for f in prepare(bundle).play().faults)


# The stop


@pytest.mark.parametrize("motion", [0, 1, 2, 3, 10, 25, 60])
def test_an_error_shuts_the_valves_brakes_and_ends_the_program(bundle: Bundle, motion: int) -> None:
    simulator = prepare(bundle, fail_at=motion)
    result = simulator.play()
    arm = simulator.arm
    assert arm.valves.shut
    assert result.brakes == 1
    assert result.messages == ["rasterslice: stopped on an error, valves shut"]
    assert "the program goes on after an error" not in result.faults
    assert arm._count == motion  # not one motion more


def test_a_stop_that_comes_back_never_plays_on(bundle: Bundle) -> None:
    player = bundle.folder / "RSPLAY.V2"
    player.write_bytes(player.read_bytes().replace(b"        HALT\r\n", b""))
    with pytest.raises(UsageError, match=r"RSPLAY\.V2:\d+: after \d+ turns of its loops"):
        prepare(bundle, fail_at=10).play()


def test_an_error_while_it_is_wet_leaves_no_valve_open(bundle: Bundle) -> None:
    lines = bundle.records.read_bytes().split(b"\r\n")
    # Straight motions before the first wet one: down to the purge place, to the run and down to it, then its points.
    wet = next(i for i, line in enumerate(lines) if line[:1] == b"V")
    first = next(i for i, line in enumerate(lines) if line[:1] == b"T")
    simulator = prepare(bundle, fail_at=3 + (wet - first) + 1)
    states = []
    original = simulator.arm.brake

    def brake() -> None:
        states.append(simulator.arm.valves.shut)
        original()

    simulator.arm.brake = brake  # type: ignore[method-assign]
    simulator.play()
    assert states == [True]  # shut before the arm is braked


def test_the_guard_shuts_the_valves_when_the_player_does_not_run(bundle: Bundle) -> None:
    host = Signals([0, 0, 4, 4, 4, 3, 3, 4])
    with pytest.raises(Stop):
        Program(programs(bundle), host).call("rs.guard")
    assert host.log == [(0, (-33, -34))] * 2 + [(3, (-33, -34))] * 2


def test_the_guard_calls_a_task_running_as_the_profile_says(tmp_path: Path) -> None:
    bundle = bundle_of(tmp_path, [disc(0, 5.0)], changed(program={"running": 7}))
    host = Signals([7, 4])
    with pytest.raises(Stop):
        Program(programs(bundle), host).call("rs.guard")
    assert host.log == [(4, (-33, -34))]
    assert prepare(bundle).play().faults == []


def test_after_an_abort_rs_safe_shuts_and_lifts(bundle: Bundle) -> None:
    simulator = prepare(bundle, (10.0, 80.0, 190.0, 5.0))
    signals = []
    original = simulator.arm.signal

    def noted(*outputs: float) -> None:
        signals.append((outputs, simulator.arm.joints()[2]))
        original(*outputs)

    simulator.arm.signal = noted  # type: ignore[method-assign]
    assert simulator.play("rs.safe").faults == []
    assert signals == [((-33, -34), 190.0)]  # before it moves
    assert simulator.arm.joints() == pytest.approx((10.0, 80.0, 1.0, 5.0))


def test_the_operator_ends_it_after_the_path(bundle: Bundle) -> None:
    simulator = prepare(bundle)
    arm, original = simulator.arm, simulator.arm.moves
    space = simulator.program._space

    def moves(*args: Any) -> None:
        original(*args)
        if arm._count == 20:
            space["v_rs__go"] = 0  # DO rs.go = 0

    arm.moves = moves  # type: ignore[method-assign]
    result = simulator.play()
    assert arm.valves.shut
    assert result.paths >= 1
    left = len(arm.desk.ledger.points) - arm.desk.ledger.done
    assert result.faults == [f"{left} points of the records are not played"]


def test_every_wait_of_the_player_is_a_whole_one() -> None:
    """A DELAY without a BREAK does not hold the program: signals after it would go out too soon."""
    lines = [line.partition(";")[0].split() for line in program.player().decode().splitlines()]
    for line, after in zip(lines, lines[1:], strict=False):
        if line[:1] == ["DELAY"]:
            assert after == ["BREAK"]


def test_the_player_has_the_controllers_line_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = program.PLAYER.read_bytes()
    assert data.count(b"\r\n") == data.count(b"\n") > 200
    copy = tmp_path / "RSPLAY.V2"
    copy.write_bytes(data.replace(b"\r\n", b"\n"))  # what a checkout with other settings would make of it
    monkeypatch.setattr(program, "PLAYER", copy)
    assert program.player() == data
    attributes = Path(__file__).resolve().parents[1] / ".gitattributes"
    assert "*.V2 -text" in attributes.read_text()


# The checks


def first_path(profile: Profile = PROFILE, item: Any = None) -> Toolpath:
    return next(Planner(profile, 0.4).toolpaths([item or disc(0)]))


def checked(path: Toolpath, profile: Profile = PROFILE) -> str:
    checker = Checker(profile)
    checker.add(path)
    with pytest.raises(UsageError) as caught:
        checker.finish()
    return str(caught.value)


def moved(path: Toolpath, point: int, by: tuple[float, float]) -> Toolpath:
    path.points[point] += by
    return path


def shortened(path: Toolpath, point: int) -> Toolpath:
    """A motion that is over in no time."""
    path.points[point] = path.points[point - 1] + 0.1 * (path.points[point] - path.points[point - 1])
    return path


#: For every check, what breaks it.
BROKEN: dict[str, Any] = {
    "reach": lambda: checked(first_path(item=disc(0, at=(240, 0)))),
    "least radius": lambda: checked(first_path(item=disc(0, 20, at=(-230, 0)))),
    "J1 range": lambda: checked(first_path(), changed(robot={"joint_low": (-10.0, -150.0, 0.0, -360.0)})),
    "J2 range": lambda: checked(first_path(), changed(robot={"joint_low": (-105.0, 120.0, 0.0, -360.0)})),
    "J3 range": lambda: checked(first_path(), changed(part={"frame": (360.0, 0.0, 20.0)})),
    "J4 range": lambda: checked(first_path(), changed(robot={"joint_high": (105.0, 150.0, 210.0, -300.0)})),
    "J1 speed": lambda: checked(first_path(), changed(robot={"joint_speed": (1.0, 672.0, 1100.0, 1200.0)})),
    "J2 speed": lambda: checked(first_path(), changed(robot={"joint_speed": (360.0, 1.0, 1100.0, 1200.0)})),
    "J4 speed": lambda: checked(first_path(), changed(robot={"joint_speed": (360.0, 672.0, 1100.0, 1.0)})),
    "envelope x": lambda: checked(first_path(), changed(part={"envelope": (10.0, 300.0, 200.0)})),
    "envelope y": lambda: checked(first_path(), changed(part={"envelope": (300.0, 10.0, 200.0)})),
    "envelope z": lambda: tall(),
    "segment time": lambda: checked(shortened(first_path(), 12)),
    "lead-in": lambda: checked(shortened(first_path(), 1)),
    "lead-out": lambda: checked(shortened(first_path(), int(first_path().offsets[1]) - 1)),
    "dip of the wet speed": lambda: checked(moved(first_path(), 12, (3.0, 3.0))),
    "blend": lambda: checked(first_path(), changed(motion={"accel": 15.0}, path={"lead_time": 0.0})),
    "points of a path": lambda: checked(first_path(), changed(path={"max_points": 20})),
    "ascending": lambda: twice(),
    "idle nozzle": lambda: lower(),
    "bed": lambda: checked(replace(first_path(), top=-2.6)),
    "rise": lambda: checked(first_path(), changed(motion={"rise_to": 206.0})),
    "purge place": lambda: checked(first_path(), changed(motion={"purge_at": (8.0, 0.0)})),
    "park place": lambda: checked(first_path(), changed(motion={"park_at": (0.0, -12.0)})),
}


def tall() -> str:
    checker = Checker(changed(part={"envelope": (300.0, 300.0, 0.1)}))
    for path in Planner(PROFILE, 0.4).toolpaths([disc(0)]):
        checker.add(path)
    with pytest.raises(UsageError) as caught:
        checker.finish()
    return str(caught.value)


def twice() -> str:
    checker = Checker(PROFILE)
    for top in (0.2, 0.1):
        checker.add(replace(first_path(), top=top))
    with pytest.raises(UsageError) as caught:
        checker.finish()
    return str(caught.value)


def lower() -> str:
    nozzle = replace(PROFILE.scaffold_nozzle, offset=(30.0, 0.0, 95.5))
    with pytest.raises(UsageError) as caught:
        Checker(replace(PROFILE, scaffold_nozzle=nozzle))
    return str(caught.value)


@pytest.mark.parametrize("code", BROKEN)
def test_every_check_refuses_what_breaks_it(code: str) -> None:
    text = BROKEN[code]()
    assert code in text
    assert "limit is" in text or "least is" in text
    assert "; " in text  # the remedy
    assert any(place in text for place in ("layer 0", "the part with", "the whole job", "while nozzle")), text


def test_no_check_is_without_its_test() -> None:
    checker = Checker(PROFILE)
    for path in Planner(PROFILE, 0.4).toolpaths([washer(0, 0.2)]):
        checker.add(path)
    codes = set(checker.finish())
    assert codes == set(BROKEN)


def test_names_and_lines_that_are_too_long_are_refused() -> None:
    with pytest.raises(UsageError, match=r"101 characters, the limit is 100"):
        program.settings(replace(PROFILE, name="x" * 100), "A.RSD")
    with pytest.raises(UsageError, match=r"V\+ name rs\.much\.too\.long: 16 characters, the limit is 15"):
        program.text(["rs.much.too.long = 1"], PROFILE.files)
    with pytest.raises(UsageError, match="ASCII"):
        program.text(["x = \u00e9"], PROFILE.files)


def test_coordinates_that_no_record_holds_are_refused(tmp_path: Path) -> None:
    from rasterslice.cobra.records import RecordWriter

    path = first_path()
    path.points[5, 0] = 12_345.0
    with (
        pytest.raises(UsageError, match=r"layer 0: a coordinate is beyond 9999\.999 mm; move the part"),
        RecordWriter(tmp_path / "X.RSD", "X", PROFILE) as writer,
    ):
        writer.add(path)


def test_idle_nozzles() -> None:
    assert idle_gaps(PROFILE) == pytest.approx((0.3, 0.3))
    text = lower()
    assert "while nozzle.part works, the tip of idle nozzle.scaffold is -0.2 mm above the layer" in text
    assert "the least is motion.idle_gap 0.1 mm (offsets 95 and 95.5 mm down, standoff 0.3 mm)" in text
    assert "mount nozzle.scaffold 0.3 mm higher, or raise nozzle.part.standoff" in text
    longer = replace(PROFILE.part_nozzle, offset=(0.0, 0.0, 95.3))
    with pytest.raises(UsageError, match=r"while nozzle\.scaffold works, the tip of idle nozzle\.part is 0 mm"):
        Checker(replace(PROFILE, part_nozzle=longer))
    nearly = replace(PROFILE.part_nozzle, offset=(0.0, 0.0, 95.15))  # as well as anybody can mount them
    Checker(replace(PROFILE, part_nozzle=nearly))


def test_places_on_or_under_the_part(tmp_path: Path) -> None:
    # An arch: the place is free at the bottom, and would be built over in layer 3.
    feet = [disc(k, 5.0, at=(-30, 0)) for k in range(3)]
    arch = [*feet, disc(3, 5.0, at=(20, 0))]
    profile = changed(motion={"purge_at": (21.0, 2.0)})
    bundle_of(tmp_path, feet, profile)
    with pytest.raises(UsageError) as caught:
        write_bundle(arch, tmp_path / "arch.cobra", Planner(profile, 0.4), "arch", (1.5, 1.5))
    text = str(caught.value)
    assert text.startswith("layer 3, part 0, motion.purge_at (21, 2): purge place is -")
    assert "the limit is 5" in text
    assert "move motion.purge_at out of x -40 to 30" in text
    assert "under it" in text


# Heights


def test_a_part_below_the_bed_is_refused(tmp_path: Path) -> None:
    """Translation 1 cent cent -3: the tip would go 2.5 mm below what was taught as the bed."""
    with pytest.raises(UsageError) as caught:
        bundle_of(tmp_path, [washer(k, 0.2 + 0.4 * k - 3.0) for k in range(12)])
    text = str(caught.value)
    assert text.startswith("layer 0, part 0, path 0, point 0: bed is -3 mm, the limit is -0.05; raise the part by 3.0")
    assert "translation with 0 as its third number" in text
    bundle_of(tmp_path, [washer(k, 0.2 + 0.4 * k - 0.04) for k in range(2)])  # rounded in some CAD


@pytest.mark.parametrize(("above", "warned"), [(60.0, True), (1.0, True), (0.4, False), (0.0, False)])
def test_a_part_in_the_air_is_warned_of(tmp_path: Path, above: float, warned: bool) -> None:
    bundle = bundle_of(tmp_path, [washer(k, 0.2 + 0.4 * k + above) for k in range(2)])
    text = "\n".join(bundle.manifest["warnings"])
    assert ("nothing lies under it" in text) == warned
    if warned:
        assert f"begins {above:.1f} mm above the bed" in text
        assert f"lower the part by {above:.1f} mm" in text
        assert "part fraction that begins with 0" in text


def test_remedies_name_what_is_wrong(tmp_path: Path) -> None:
    """A height is not mended by x and y, a place not by moving the part that is in the middle already."""
    with pytest.raises(UsageError) as high:
        bundle_of(tmp_path, [washer(k, 230.2 + 0.4 * k) for k in range(2)])
    assert "J3 range" in str(high.value)
    assert "lower the part by 230.0 mm" in str(high.value)
    assert "cent" not in str(high.value)
    with pytest.raises(UsageError) as aside:  # beside the middle and at a wrong height: the height is said
        bundle_of(tmp_path, [disc(600, 5.0, at=(30, 0))])
    assert "lower the part by 240.0 mm" in str(aside.value)
    for name in ("purge_at", "park_at"):
        with pytest.raises(UsageError) as astray:
            far = changed(motion={name: (400.0, 0.0)}, path={"hold_every": 1})
            bundle_of(tmp_path, [disc(0, 5.0), disc(1, 5.0)], far)
        assert f"motion.{name} (400, 0) is itself out of reach" in str(astray.value)
        with pytest.raises(UsageError) as under:
            bundle_of(tmp_path, [disc(0, 5.0, at=(8, 0))], changed(motion={name: (0.0, 0.0), "keep_out": 12.0}))
        assert f"move motion.{name} out of x" in str(under.value)
        assert "cent" not in str(under.value)  # there it would lie on the place, too


def test_distance_from_a_box() -> None:
    low, high = np.array([0.0, 0.0]), np.array([10.0, 4.0])
    assert distance((5, 2), low, high) == -2
    assert distance((13, 2), low, high) == 3
    assert distance((13, 8), low, high) == 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[motion]\naccel_percent = 120", "motion.accel_percent must be > 0 and at most 100, got 120"),
        ("[motion]\nstart_percent = 101", "motion.start_percent must be > 0 and at most 100, got 101"),
        ("[nozzle.part]\nspeed = 0.05", "nozzle.part.speed must be 0.1 to 1e+06, got 0.05"),
        ("[files]\nmax_line = 99", "files.max_line must be 100 to 140, got 99"),
        ("[motion]\nrise_to = 220", "motion.rise_to must lie in the stroke of J3, 0 to 210 mm, got 220"),
        ("[program]\nguard = 1", "program.guard must be true or false"),
        ("[program]\nrunning = 4.5", "program.running must be a whole number"),
        ('[robot]\nside = "LEFT"', "robot.side must be LEFTY, RIGHTY or empty, got 'LEFT'"),
        ("[motion]\nidle_gap = -1", "motion.idle_gap must be 0 to"),
    ],
)
def test_profiles_that_are_refused(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "m.toml"
    file.write_text(text)
    with pytest.raises(UsageError) as caught:
        read_profile(file)
    assert message in str(caught.value)


# Advice


def box(x: float, y: float, z: float, at: tuple[float, float] = (0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    low = np.array([at[0] - x / 2, at[1] - y / 2, 0.0])
    return low, low + (x, y, z)


@pytest.mark.parametrize(
    ("size", "envelope", "words"),
    [
        ((250, 200, 100), (300, 300, 200), "within the envelope"),
        ((350, 250, 100), (300, 400, 200), "turn it by 90 degrees about z (rotation 1 0 0 90)"),
        ((150, 150, 250), (300, 300, 200), "lay it on its side (rotation 1 90 0 0)"),
        ((150, 250, 250), (300, 300, 200), "lay it on its side (rotation 1 0 90 0)"),
        ((100, 350, 250), (400, 300, 200), "lay it on its side (rotation 1 90 0 90)"),
        ((350, 100, 250), (300, 400, 200), "lay it on its side (rotation 1 0 90 90)"),
        ((250, 250, 900), (300, 300, 200), "with rotation 1 "),
        ((600, 100, 100), (300, 300, 200), "as it lies, scale it by about 0.50 (an estimate"),
    ],
)
def test_advice_for_one_part(size: tuple[float, ...], envelope: tuple[float, ...], words: str) -> None:
    profile = changed(part={"envelope": tuple(map(float, envelope))})
    assert words in advice(*box(*size), profile, Site())


@pytest.mark.parametrize("order", ROTATIONS)
def test_the_rotations_of_the_advice_bring_axes_where_it_says(order: tuple[int, int, int]) -> None:
    corners = np.array([[(0, 0, 0), (1, 2, 3), (1, 0, 3)], [(0, 2, 0), (1, 2, 0), (0, 0, 3)]], np.float32)
    turned = transform(
        Mesh(corners.reshape(-1, 3), None, np.zeros(3), Path("x")),
        None, [float(v) for v in ROTATIONS[order].split()], None,
    )  # fmt: skip
    assert (turned.high - turned.low).tolist() == pytest.approx([float(order[i] + 1) for i in range(3)])


def test_advice_for_copies() -> None:
    places = np.array([(i * 110.0, j * 110.0) for j in range(2) for i in range(2)])
    low, high = np.array([-50.0, -50.0, 0.0]), np.array([160.0, 160.0, 80.0])
    text = advice(low, high, PROFILE, Site(places, (-48.0, -47.0)))
    assert "translation of 1 -103.0 -102.0 0" in text
    assert "cent is the first" in text
    assert "55.0 mm along x" in advice(low, high, PROFILE, Site(places)).replace("-", "")
    far = np.array([(i * 110.0, j * 110.0) for j in range(3) for i in range(4)])
    high = low + (100, 100, 80) + np.append(far.max(axis=0), 0)
    assert "12 copies of 100.0 x 100.0 x 80.0 mm do not fit" in (text := advice(low, high, PROFILE, Site(far)))
    assert "use copies 2 2 4 or fewer" in text
    row = np.array([(i * 110.0, 0.0) for i in range(4)])
    assert "use copies 2 2 4, then" in advice(low, low + (430, 100, 80), PROFILE, Site(row))
    large = advice(low, high + (250, 0, 0), PROFILE, Site(far))
    assert "each copy is 350.0 x 100.0 x 80.0 mm" in large


# The count of points off their tolerance


def test_points_that_the_spacing_forces_off_are_counted_and_placed(tmp_path: Path) -> None:
    turn = np.linspace(0, 2 * math.pi, 400, endpoint=False)
    wavy = (6 + 0.3 * np.cos(60 * turn))[:, None] * np.stack([np.cos(turn), np.sin(turn)], 1)
    layers = [layer(0, 0.2, part_boundary=pack([ring(9, 200)], True)), layer(1, 0.6, part_boundary=pack([wavy], True))]
    planner = Planner(PROFILE, 0.4)
    made = write_bundle(layers, tmp_path / "x.cobra", planner, "x", (1.5, 1.5))
    assert made["trajectory"]["coarse"] == planner.tally.coarse > 0
    text = next(t for t in made["warnings"] if "chord_tolerance" in t)
    assert f"{planner.tally.coarse} of {planner.tally.thinned} points" in text
    assert "worst in layer 1" in text
    slow = changed(part_nozzle={"speed": 2.0, "close_delay": 0.02}, path={"min_spacing": 0.05})
    fine = Planner(slow, 0.4)
    list(fine.toolpaths(layers))
    assert fine.tally.coarse == 0
    assert fine.tally.coarse_layer == -1


def test_fields_of_the_profile_are_all_in_the_file() -> None:
    from rasterslice.profile import DEFAULT

    text = DEFAULT.read_text()
    for section in dataclasses.fields(Profile):
        if dataclasses.is_dataclass(value := getattr(PROFILE, section.name)):
            for entry in dataclasses.fields(value):
                assert f"\n{entry.name} = " in text, entry.name
    assert OPEN == 2
