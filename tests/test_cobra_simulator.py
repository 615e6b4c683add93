"""The simulator notices what is wrong: in the player, in its settings, in the records; and never runs for ever."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fakes import washer
from test_cobra import PROFILE, bundle_of, disc

from rasterslice.cli import main
from rasterslice.cobra.beads import compare
from rasterslice.cobra.bundle import Bundle, read_bundle, write_bundle
from rasterslice.cobra.command import simulation
from rasterslice.cobra.fit import Site
from rasterslice.cobra.simulate import prepare, simulate
from rasterslice.cobra.vplus import Program
from rasterslice.errors import UsageError
from rasterslice.export.copies import Copied
from rasterslice.trajectory import Planner


@pytest.fixture
def bundle(tmp_path: Path) -> Bundle:
    return bundle_of(tmp_path, [washer(k, 0.2 + 0.4 * k) for k in range(2)])


def verdict(bundle: Bundle) -> str:
    """Everything that a simulation says is wrong."""
    try:
        return "\n".join(simulate(bundle).faults)
    except UsageError as error:
        return str(error)


def edit(bundle: Bundle, file: str, old: str, new: str, count: int = 1) -> None:
    path = bundle.folder / file
    data = path.read_bytes()
    before, after = (x.replace("\n", "\r\n").encode() for x in (old, new))
    assert before in data, old
    path.write_bytes(data.replace(before, after, count))


#: What is changed in the player, and a word of what the simulator must say of it.
PLAYER = {
    "the valve is shut too late": ("VALUE 87:\n                SIGNAL -rs.vlv[rs.m]", "VALUE 87:", "still open"),
    "the valve never opens": ("VALUE 86:\n                SIGNAL rs.vlv[rs.m]", "VALUE 86:", "not played"),
    "the valve opens one motion early": ("VALUE 86:", "VALUE 77:", "a valve opens while one is open"),
    "the wrong valve": ("SIGNAL rs.vlv[rs.m]", "SIGNAL rs.vlv[3-rs.m]", "the valve of the other nozzle opens"),
    "no lift between paths": ("rs.y[0], rs.z+rs.lift", "rs.y[0], rs.z", "not lifted"),
    "no lift after a path": ("rs.ly, rs.z+rs.lift", "rs.ly, rs.z", "not lifted"),
    "too high": (
        "MOVES rs.part:TRANS(rs.x[i], rs.y[i], rs.z,",
        "MOVES rs.part:TRANS(rs.x[i], rs.y[i], rs.z+1,",
        "the records say",
    ),
    "mirrored": ("TRANS(rs.x[i], rs.y[i]", "TRANS(rs.x[i], -rs.y[i]", "the records say"),
    "axes exchanged": ("rs.y[n] = VAL($r)", "rs.y[n] = rs.x[n]", "the records say"),
    "too fast": ("SPEED rs.v MMPS", "SPEED rs.v*2 MMPS", "25 mm/s; the records say"),
    "the last point is left out": (
        "FOR i = 1 TO n\n            MOVES",
        "FOR i = 1 TO n-1\n            MOVES",
        "still open",
    ),
    "the first point is left out": (
        "FOR i = 1 TO n\n            MOVES",
        "FOR i = 2 TO n\n            MOVES",
        "the records say",
    ),
    "no stop at the end of a path": (
        "        END\n        BREAK\n        SIGNAL -rs.vlv[rs.m]",
        "        END",
        "speed",
    ),
    "turned tool": (
        "rs.z, 0, 180, rs.roll)\n            CASE",
        "rs.z, 0, 180, rs.roll+1)\n            CASE",
        "turns the tool",
    ),
    "no purge": ("DELAY rs.purge[k]", "DELAY 0", "lasts 0.000 s, it should be 1"),
    "no stop while purging": (
        "BREAK ;DELAY is a motion: without this the valve would shut at once\n",
        "",
        "lasts 0.000 s",
    ),
    "purge with the other valve": ("SIGNAL rs.vlv[k]", "SIGNAL rs.vlv[3-k]", "before it is purged"),
    "no time to drip": ("        DELAY rs.drip\n", "", "moves 0 s after its purge"),
    "one tool": ("TOOL rs.tool[k]", "TOOL rs.tool[1]", "the records say"),
    "no lift at the start": ("            CALL rs.rise()\n", "", "not lifted"),
    "no look at the elbow": (
        "            CALL rs.look()\n            IF rs.go == 0",
        "            IF rs.gone == 0",
        "rs.gone",
    ),
    "swings before it lifts": ("MOVE #rs.high", "MOVE #rs.now", "not lifted"),
    "straight from wherever it stands": (
        "            MOVE rs.part:TRANS(rs.px, rs.py, z, 0, 180, rs.roll)\n",
        "",
        "does not go down from where the arm was lifted",
    ),
    "a layer is skipped": ("rs.z = VAL($t)", "rs.z = VAL($t)+0.4", "the records say"),
    "it never ends": ("VALUE 90: ;Z: done\n                    rs.go = 0", "VALUE 90:", "record not known"),
    "it really never ends": (
        "        WHILE rs.go DO\n",
        "        WHILE -1 DO\n            rs.go = -1\n        END\n        WHILE rs.go DO\n",
        "turns of its loops the program has not ended",
    ),
    "it counts for ever": (
        "        FOR i = 1 TO n\n            MOVES",
        "        FOR i = 1 TO 999999999\n            rs.q = i\n        END\n        FOR i = 1 TO n\n            MOVES",
        "has not ended",
    ),
    "programs that call each other": (
        ".PROGRAM rs.off() ;Shuts both valves\n",
        ".PROGRAM rs.off()\n        CALL rs.off()\n",
        "without end",
    ),
    "no such program": ("CALL rs.path(n)", "CALL rs.pth(n)", "rs.pth"),
    "too few arguments": ("CALL rs.path(n)", "CALL rs.path()", "V+:"),
    "division by nothing": ("rs.lx = rs.x[n]", "rs.lx = rs.x[n]/0", "division"),
    "an array that is too short": ("rs.lx = rs.x[n]", "rs.lx = rs.x[n+1]", "element"),
}


@pytest.mark.parametrize("name", PLAYER)
def test_what_is_wrong_in_the_player_is_found(bundle: Bundle, name: str) -> None:
    old, new, word = PLAYER[name]
    edit(bundle, "RSPLAY.V2", old, new)
    assert word in verdict(bundle)


#: What is changed in the records, and a word of what the simulator must say of it.
def _swap(lines: list[bytes], a: bytes, b: bytes) -> list[bytes]:
    k = next(i for i, line in enumerate(lines) if line.startswith(a))
    return [*lines[:k], b + lines[k][len(a) :], *lines[k + 1 :]]


def _first(lines: list[bytes], letter: bytes) -> int:
    return next(i for i, line in enumerate(lines) if line[:1] == letter)


RECORDS: dict[str, tuple[Callable[[list[bytes]], list[bytes]], str]] = {
    "a digit of a point": (lambda x: [*x[:5], x[5][:-1] + bytes([x[5][-1] ^ 1]), *x[6:]], "the sum of its layer is"),
    "a sum": (lambda x: _swap(x, b"C ", b"C 1"), "the sum of its layer is"),
    "no sum": (lambda x: [line for line in x if line[:1] != b"C"], "has no sum"),
    "a height": (lambda x: _swap(x, b"L 0 0.5", b"L 0 0.9"), "at no height of slice 0"),
    "a slice": (lambda x: _swap(x, b"L 1", b"L 7"), "at no height of slice 7"),
    "slices that go back": (lambda x: [y.replace(b"L 0 ", b"L 3 ") for y in x], "comes after slice 3"),
    "a material": (
        lambda x: [b" ".join([*y.split()[:3], b"3", b"9"]) if y[:1] == b"L" else y for y in x],
        "of an array",
    ),
    "a number of paths": (lambda x: [y[:-1] + b"9" if y[:1] == b"L" else y for y in x], "more paths than it has"),
    "a number of points": (lambda x: [y.replace(b" 4 12.500", b" 5 12.500") for y in x], "path is damaged"),
    "a number of a path": (lambda x: _swap(x, b"P 1 ", b"P 8 "), "expected path 1"),
    "a layer twice": (lambda x: x[:1] + x[1 : _first(x, b"C") + 1] + x[1:], "is not above"),
    "a path that is lost": (lambda x: x[: _first(x, b"P")] + x[_first(x, b"E") + 1 :], "more paths than it has"),
    "the end is lost": (lambda x: x[: len(x) // 2], "cut short"),
    "the last byte is lost": (lambda x: [*x[:-2], b""], "cut short"),
    "another letter": (lambda x: _swap(x, b"M ", b"Q "), "none of ours"),
    "no number": (lambda x: _swap(x, b"T ", b"T x"), "no number"),
    "the header": (lambda x: _swap(x, b"RSD 1 0", b"RSD 1 9"), "promises other counts"),
    "a valve that stays open": (lambda x: [b"M" + y[1:] if y[:1] == b"W" else y for y in x], "still open"),
    "a valve that does not open": (lambda x: [b"M" + y[1:] if y[:1] == b"V" else y for y in x], "the sum of its layer"),
    "a record too long": (lambda x: [*x[:1], b"H " + b"2" * 90, *x[1:]], "characters"),
}


@pytest.mark.parametrize("name", RECORDS)
def test_what_is_wrong_in_the_records_is_found(bundle: Bundle, name: str) -> None:
    change, word = RECORDS[name]
    lines = bundle.records.read_bytes().split(b"\r\n")
    changed = change(list(lines))
    assert changed != lines
    bundle.records.write_bytes(b"\r\n".join(changed))
    assert word in verdict(bundle)


#: What is changed in the settings, and a word of what the simulator must say of it.
SETTINGS = {
    "a frame out of reach": ("SET rs.part = TRANS(360, 0, 85,", "SET rs.part = TRANS(620, 0, 85,", "out of reach"),
    "a frame too low": ("SET rs.part = TRANS(360, 0, 85,", "SET rs.part = TRANS(360, 0, 5,", "J3 leaves its range"),
    "a frame beside the arm": (
        "SET rs.part = TRANS(360, 0, 85,",
        "SET rs.part = TRANS(-360, 0, 85,",
        "J1 leaves its range",
    ),
    "a turned frame": ("SET rs.part = TRANS(360, 0, 85, 0,", "SET rs.part = TRANS(360, 0, 85, 30,", "turned frames"),
    "a long idle nozzle": (
        "SET rs.tool[2] = TRANS(30, 0, 95,",
        "SET rs.tool[2] = TRANS(30, 0, 97,",
        "mount nozzle.scaffold",
    ),
    "acceleration": ("rs.acc = 100", "rs.acc = 150", "at most 100 percent"),
    "a setting that is missing": ("        rs.vlv[2] = 34\n", "", "rs.vlv[2] is never set"),
    "a file that is not there": ('"JOB.RSD"', '"ANY.RSD"', "cannot open the records -1"),
    "a lift downwards": ("rs.lift = 2", "rs.lift = -1", "RSCFG.V2: motion.lift must be > 0, got -1"),
    "no lift": ("rs.lift = 2", "rs.lift = 0", "motion.lift must be > 0, got 0"),
    "no clearance": ("rs.clear = 5", "rs.clear = 0", "motion.clearance must be > 0, got 0"),
    "clearance downwards": ("rs.clear = 5", "rs.clear = -1", "motion.clearance must be > 0, got -1"),
    "purging on the part": ("rs.py = -180", "rs.py = 0", "motion.purge_at (0, 0) is -"),
    "purging beside the part": ("rs.py = -180", "rs.py = -13", "the least is motion.keep_out 5 mm"),
    "parking on the part": ("rs.ky = 180", "rs.ky = 0", "motion.park_at (0, 0) is -"),
    "rising half": ("rs.j3 = 1\n", "rs.j3 = 100\n", "rs.j3 is 100 mm, so the arm rises less"),
    "rising out of the stroke": ("rs.j3 = 1\n", "rs.j3 = 300\n", "motion.rise_to must lie in the stroke of J3"),
    "starting too fast": ("rs.vj = 10\n", "rs.vj = 1000\n", "start_percent must be > 0 and at most 100, got 1000"),
    "a purge of less than no time": ("rs.purge[1] = 1", "rs.purge[1] = -1", "nozzle.part.purge must be 0 to"),
    "half a valve": ("rs.vlv[1] = 33", "rs.vlv[1] = 1.5", "nozzle.part.valve must be a whole number, got 1.5"),
    "one valve for both": ("rs.vlv[1] = 33", "rs.vlv[1] = 34", "both nozzles have valve 34"),
    "no side of the elbow": ("rs.elbow = 1", "rs.elbow = 0.5", "robot.elbow must be a whole number, got 0.5"),
    "no time to drip": ("rs.drip = 0.02", "rs.drip = 0", "after its purge, it drips"),
    "no speed": ("rs.vt = 200", "rs.vt = 0", "no speed"),
}


@pytest.mark.parametrize("name", SETTINGS)
def test_what_is_wrong_in_the_settings_is_found(bundle: Bundle, name: str) -> None:
    old, new, word = SETTINGS[name]
    edit(bundle, "RSCFG.V2", old, new)
    assert word in verdict(bundle)


DANGEROUS = [n for n, (_, _, word) in SETTINGS.items() if any(w in word for w in (" must be ", "motion.", "rs.j3"))]


@pytest.mark.parametrize("name", DANGEROUS)
def test_settings_that_are_dangerous_are_faults_of_the_command(
    bundle: Bundle, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new, word = SETTINGS[name]
    edit(bundle, "RSCFG.V2", old, new)
    assert main(["cobra", "simulate", str(bundle.folder)]) == 2
    said = capsys.readouterr().out
    assert any(word in line for line in said.splitlines() if line.startswith("FAULT"))


def test_the_frame_is_that_of_the_settings(bundle: Bundle) -> None:
    before = simulate(bundle)
    edit(bundle, "RSCFG.V2", "SET rs.part = TRANS(360, 0, 85,", "SET rs.part = TRANS(300, 40, 95,")
    edit(bundle, "RSCFG.V2", "rs.purge[1] = 1", "rs.purge[1] = 2")
    report = simulation(bundle, beads=False)
    assert report["faults"] == []
    assert report["edited"] == [
        "part.frame is 300 40 95 in RSCFG.V2, 360 0 85 in the export",
        "part_nozzle.purge is 2 in RSCFG.V2, 1 in the export",
    ]
    # A tip 10 mm higher is a stroke 10 mm shorter.
    assert report["joints"]["J3"][1] == pytest.approx(before.joints["J3"][1] - 10, abs=1e-3)
    assert report["joints"]["J2"][1] != pytest.approx(before.joints["J2"][1], abs=1)
    assert report["build_seconds"] > before.seconds + 3


def test_nozzles_of_different_speeds_make_no_false_faults(tmp_path: Path) -> None:
    slow = replace(PROFILE.scaffold_nozzle, speed=4.0)
    fast = replace(PROFILE.part_nozzle, speed=40.0)
    profile = replace(PROFILE, part_nozzle=fast, scaffold_nozzle=slow)
    layers = [washer(k, 0.2 + 0.4 * k) for k in range(4)]
    result = simulate(bundle_of(tmp_path, layers, profile))
    assert result.faults == []
    assert 4.0 * 0.016 < result.valve_error <= 40 * 0.016 * 1.001


def test_a_late_valve_of_a_slow_nozzle_is_a_fault_after_a_fast_one() -> None:
    from rasterslice.cobra.chains import Moves, time_moves
    from rasterslice.cobra.watch import Result, beads_of

    points = np.array([(x, 0.0, 0.0) for x in (0, 5, 10, 20, 30, 35)])
    result = Result()
    for speed, accel, first in ((40.0, 1000.0, 1), (4.0, 1000.0, 1), (4.0, 20.0, 0)):  # the last opens at rest
        assert result.faults == []
        profile = replace(PROFILE, part_nozzle=replace(PROFILE.part_nozzle, speed=speed))
        timed = time_moves(Moves(points, np.full(5, speed), np.array([4]), np.zeros(1), 0.004), accel, 0.016)
        beads_of(timed, np.array([(first, 3, 0)]), 0, profile, result)
    assert any("at 4 mm/s, one tick is 0.064 mm" in fault for fault in result.faults)


def test_copies_are_compared_with_copies(tmp_path: Path) -> None:
    layers, places = [disc(k, 8.0) for k in range(2)], np.array([(0.0, 0.0), (20.0, 0.0), (0.0, 20.0)])
    write_bundle(Copied(layers, places), tmp_path / "job.cobra", Planner(PROFILE, 0.4), "job", (1.5, 1.5), Site(places))
    bundle = read_bundle(tmp_path / "job.cobra")
    simulator = prepare(bundle)
    result = simulator.play()
    assert result.faults == []
    rows = list(compare(bundle, layers, simulator.arm.deposits))
    for row in rows:
        assert row.region == pytest.approx(3 * np.pi * 64, rel=1e-3)
        assert row.uncovered < 0.02 * row.region
        assert row.outside < 0.002 * row.region
    one = [replace(d, laid=type(d.laid).empty(False)) for d in simulator.arm.deposits]
    assert next(compare(bundle, layers, one)).uncovered == pytest.approx(3 * np.pi * 64, rel=0.03)


def test_steps_are_counted_over_the_whole_run() -> None:
    text = ".PROGRAM a()\r\n        FOR i = 1 TO 60\r\n            x = i\r\n        END\r\n.END\r\n"
    Program({"X.V2": text}, None, 60).call("a")
    with pytest.raises(UsageError, match=r"X\.V2:2: after 59 turns of its loops the program has not ended"):
        Program({"X.V2": text}, None, 59).call("a")
