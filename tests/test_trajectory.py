"""Toolpaths: every wet millimetre is that of the layer, and the rules of the paper hold."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from fakes import layer, pack, ring, washer
from hypothesis import given, settings
from hypothesis import strategies as st

from rasterslice.errors import UsageError
from rasterslice.order import boxes_of, crosses, nearest_next
from rasterslice.paths import BOUNDARY, CLOSE, FILL, ICE, MOVE, OPEN, SCAFFOLD, TRAVEL, Layer, Paths, Toolpath
from rasterslice.profile import DEFAULT, Profile, read_profile
from rasterslice.runs import leads_of, split
from rasterslice.thin import thin
from rasterslice.trajectory import Planner

PROFILE = read_profile()
SPACING = PROFILE.spacing(12.5)


def plan(layers: list[Layer], profile: Profile = PROFILE, **settings: float) -> list[Toolpath]:
    return list(Planner(profile, 0.4, **settings).toolpaths(layers))


def square(side: float, n: int = 1) -> np.ndarray:
    corners = side / 2 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    t = np.linspace(0, 1, n, endpoint=False)[:, None]
    return np.concatenate([a + t * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])


@st.composite
def blobs(draw: st.DrawFn) -> np.ndarray:
    """A closed, star-shaped path with points some tenths of a millimetre apart."""
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    turn = np.linspace(0, 2 * np.pi, draw(st.integers(12, 160)), endpoint=False)
    radius = draw(st.floats(1.5, 30)) * (
        1 + sum(rng.uniform(0, 0.1) * np.cos(k * turn + rng.uniform(0, 6.3)) for k in range(2, 6))
    )
    radius *= 1 + draw(st.sampled_from([0.0, 0.01, 0.05])) * rng.uniform(-1, 1, len(turn))
    return radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], 1) + rng.uniform(-40, 40, 2)


def check_form(path: Toolpath, profile: Profile = PROFILE) -> None:
    """What must hold of any toolpath."""
    leads = leads_of(profile.nozzles[path.material], profile)
    for i in range(len(path)):
        a, b = path.offsets[i], path.offsets[i + 1]
        p, ops = path.points[a:b], path.ops[a:b].tolist()
        assert ops == [TRAVEL, MOVE, OPEN, *[MOVE] * (len(p) - 4), CLOSE]
        step = np.hypot(*np.diff(p, axis=0).T)
        assert step.min() >= leads.spacing * (1 - 1e-6)
        assert step[0] >= profile.lead(path.speed) - 1e-9
        assert step[-1] - path.close_distance >= profile.lead(path.speed) - 1e-9
        way = np.diff(p, axis=0) / step[:, None]
        turn = np.degrees(np.arccos(np.clip((way[1:] * way[:-1]).sum(axis=1), -1, 1)))
        assert turn.max() <= 45 + 1e-6
        assert turn[0] < 1e-4  # the lead-in runs along the tangent
    wet = path.wet()
    assert len(wet) == len(path)
    assert np.isfinite(wet.points).all()


@settings(max_examples=60, deadline=None)
@given(st.lists(blobs(), min_size=1, max_size=3))
def test_any_boundary_becomes_runs_that_cover_it(loops: list[np.ndarray]) -> None:
    planner = Planner(PROFILE, 0.4)
    paths = list(planner.toolpaths([layer(0, 0.2, part_boundary=pack(loops, True))]))
    for path in paths:
        check_form(path)
    assert len(paths) == 2 or planner.tally.lost_loops
    slack = planner.tally.deviation + SPACING / 2 + 0.02 + (planner.tally.short_mm > 0) * SPACING
    for path in paths:
        wet = shapely.MultiLineString(list(path.wet()))
        for loop in loops:
            line = shapely.LinearRing(loop)
            if planner.tally.lost_loops == 0:
                assert wet.buffer(slack).covers(line)
        assert shapely.union_all([shapely.LinearRing(k) for k in loops]).buffer(slack).covers(wet)


def test_a_square_is_split_at_its_corners_and_a_circle_is_not() -> None:
    item = layer(0, 0.2, part_boundary=pack([square(20, 8), ring(4, 60)], True))
    path = plan([item])[0]
    check_form(path)
    assert len(path) == 5
    length = np.sort(path.wet().lengths())
    assert np.allclose(length[:4], 20, atol=SPACING)
    circle = Paths(ring(4, 60), np.array([0, 60], np.uint32), True).lengths()[0]
    overlap = length[4] - circle
    assert PROFILE.path.overlap <= overlap <= PROFILE.path.overlap + 2 * SPACING


def test_fill_lines_stay_unlinked_and_are_laid_whole() -> None:
    lines = [[(-5, y), (5, y)] for y in np.arange(-4, 4, 1.5)]
    path = plan([layer(0, 0.2, part_fill=pack(lines, False), part_second_fill=pack(lines, False))])[0]
    check_form(path)
    assert path.kinds.tolist() == [FILL] * 6
    assert np.diff(path.offsets).tolist() == [4] * 6
    got = sorted(tuple(np.sort(np.round(p[[0, -1]], 6), axis=0).ravel()) for p in path.wet())
    assert got == sorted(tuple(np.sort(np.array(p, float), axis=0).ravel()) for p in lines)


def test_layers_interleave_by_height_and_the_fill_turns_on_each_ice_layer() -> None:
    across, along = pack([[(-5, 0), (5, 0)]], False), pack([[(0, -5), (0, 5)]], False)
    fills = [(across, along)] * 4
    stack = [
        replace(washer(k, 0.2 + 0.4 * k), part_fill=a, part_second_fill=b) for k, (a, b) in enumerate(fills)
    ]
    paths = plan(stack)
    order = [(p.layer, p.material, p.pass_, round(p.top, 6)) for p in paths]
    want = []
    for k in range(4):
        want += [(k, ICE, 0, 0.4 * k + 0.2), (k, SCAFFOLD, 0, 0.4 * k + 0.4), (k, ICE, 1, 0.4 * k + 0.4)]
    assert order == [(a, b, c, round(d, 6)) for a, b, c, d in want]
    heading = []
    for p in paths:
        if p.material == ICE:
            line = p.wet()[len(p) - 1]
            assert p.kinds[-1] == FILL
            heading.append(abs(line[-1, 0] - line[0, 0]) > abs(line[-1, 1] - line[0, 1]))
    assert all(a != b for a, b in zip(heading, heading[1:], strict=False))


def test_three_ice_layers_keep_the_turns_of_the_layers() -> None:
    across, along = pack([[(-5, 0), (5, 0)]], False), pack([[(0, -5), (0, 5)]], False)
    fills = [(across, along), (along, across)]
    stack = [layer(k, 0.3 + 0.6 * k, part_fill=a, part_second_fill=b) for k, (a, b) in enumerate(fills)]
    paths = list(Planner(PROFILE, 0.6, part_layers=3).toolpaths(stack))
    assert [round(p.top, 6) for p in paths] == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0, 1.2])
    wet = [p.wet()[0] for p in paths]
    assert [bool(abs(w[-1, 0] - w[0, 0]) > 1) for w in wet] == [True, False] * 3


def test_a_hold_every_n_slices() -> None:
    profile = replace(PROFILE, path=replace(PROFILE.path, hold_every=2))
    paths = plan([washer(k, 0.2 + 0.4 * k) for k in range(6)], profile)
    assert [p.layer for p in paths if p.hold] == [2, 4]


def test_travel_falls_by_half_against_the_order_of_the_file() -> None:
    lines = [[(-15, y), (15, y)] for y in np.arange(-14, 14, 1.5)]
    planner = Planner(PROFILE, 0.4)
    list(planner.toolpaths([layer(0, 0.2, part_boundary=pack([ring(15)], True), part_fill=pack(lines, False))]))
    assert planner.tally.travel < planner.tally.file_travel / 2


def test_lead_ins_keep_off_fresh_walls() -> None:
    # The inner ring lies close inside the outer one: most tangents of it would come through the outer wall.
    profile = replace(PROFILE, path=replace(PROFILE.path, lead_time=0.4))
    box = np.concatenate([square(12, 12)])
    planner = Planner(profile, 0.4)
    path = next(planner.toolpaths([layer(0, 0.2, part_boundary=pack([box, ring(5.2, 60)], True))]))
    assert planner.tally.through_walls == 0
    wet = list(path.wet())
    for i in range(1, len(path)):
        fresh = shapely.MultiLineString(wet[:i])
        lead = shapely.LineString([path.points[path.offsets[i]], wet[i][0]])
        assert lead.intersection(fresh).length < 1e-6
        assert lead.crosses(fresh) is False or lead.intersection(fresh).distance(shapely.Point(wet[i][0])) < 1e-6


def test_runs_too_short_for_the_valve_are_counted() -> None:
    planner = Planner(PROFILE, 0.4)
    fill = pack([[(0, 0), (0.3, 0)], [(0, 2), (5, 2)]], False)
    paths = list(planner.toolpaths([layer(0, 0.2, part_fill=fill)]))
    assert [len(p) for p in paths] == [1]
    assert (planner.tally.short, round(planner.tally.short_mm, 6)) == (1, 0.3)


def test_long_paths_are_split_where_the_valve_is_shut() -> None:
    profile = replace(PROFILE, path=replace(PROFILE.path, max_points=50))
    path = plan([layer(0, 0.2, part_boundary=pack([ring(30, 300)], True))], profile)[0]
    check_form(path, profile)
    assert len(path) > 5
    assert np.diff(path.offsets).max() <= 50 + 4
    assert path.wet().lengths().sum() == pytest.approx(2 * math.pi * 30, abs=len(path) * SPACING)


@settings(max_examples=50, deadline=None)
@given(blobs(), st.booleans(), st.floats(0.2, 3))
def test_thinned_paths_keep_their_spacing(points: np.ndarray, closed: bool, spacing: float) -> None:
    paths, deviation, _, lost = thin(pack([points], closed), spacing)
    if lost:
        assert not len(paths.points)
        return
    assert len(paths) == 1
    step = np.hypot(*(np.roll(paths.points, -1, axis=0) - paths.points).T)
    assert (step if closed else step[:-1]).min() >= spacing * (1 - 1e-6)
    if not closed:
        assert (paths.points[[0, -1]] == points[[0, -1]]).all()
    new = shapely.LinearRing(paths.points) if closed else shapely.LineString(paths.points)
    far = shapely.distance(shapely.points(points), new).max()
    assert far <= (deviation.max() if len(deviation) else 0) + 1e-9


def test_split_gives_every_segment_once() -> None:
    paths = pack([square(10, 5), ring(5, 40), square(3, 2)], True)
    loops, pieces, loop_owner, piece_owner = split(paths, math.radians(45), 1000)
    assert loop_owner.tolist() == [1]
    assert piece_owner.tolist() == [0] * 4 + [2] * 4
    assert loops.lengths().sum() + pieces.lengths().sum() == pytest.approx(paths.lengths().sum())


def test_nearest_next_turns_lines_round() -> None:
    entry = np.array([[(0.0, y), (10.0, y)] for y in range(5)])
    runs, backwards, at = nearest_next(entry, entry[:, ::-1], np.array([0.0, 0.0]))
    assert runs == [0, 1, 2, 3, 4]
    assert backwards == [0, 1, 0, 1, 0]
    assert at.tolist() == [10.0, 4.0]


def test_crossing() -> None:
    walls = np.array([[(0.0, 0.0), (10.0, 0.0)]])
    a = np.array([(5.0, -1.0), (5.0, 0.5), (20.0, -1.0)])
    assert crosses(a, a + (0, 2), walls, boxes_of(walls)).tolist() == [True, False, False]


def test_no_layers_no_toolpaths() -> None:
    assert plan([]) == []
    assert plan([layer(0, 0.2)]) == []
    assert plan([washer(0, 0.2)])[0].kinds[0] == BOUNDARY


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[nozzle.part]\nclose_delay = 0.5", "longer than the shortest motion"),
        ("[nozzle.part]\nspede = 3", "unknown key 'nozzle.part.spede'; did you mean 'nozzle.part.speed'"),
        ("[nozzle.part]\nspeed = 0", "must be > 0"),
        ("[nozzle.part]\nspeed = nan", "must be a number"),
        ("[robot]\nelbow = 0", "must be 1 or -1"),
        ("[robot]\nlinks = [1]", "must be 2 numbers"),
        ("[robot]\njoint_low = [106, 0, 0, 0]", "must be below joint_high"),
        ("[nozzle.part]\nvalve = 34", "both nozzles have valve 34"),
        ("[path]\nsegment_time = 0.01", "below one tick"),
        ("[files]\nmax_record = 500", "must be 32 to 72"),
        ('[path]\nscaffold_first = "yes"', "true or false"),
        ("name = \"\u00e9\"", "ASCII"),
        ("[robot", "not a TOML file"),
    ],
)
def test_bad_profiles(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "m.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=None) as caught:
        plan([washer(0, 0.2)], read_profile(file))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_profile_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot read the machine profile"):
        read_profile(tmp_path / "none.toml")


def test_an_edited_copy_keeps_the_rest(tmp_path: Path) -> None:
    file = tmp_path / "m.toml"
    file.write_text("[nozzle.part]\nspeed = 20\n")
    assert read_profile(file).part_nozzle == replace(PROFILE.part_nozzle, speed=20.0)
    file.write_bytes(DEFAULT.read_bytes())
    assert read_profile(file) == PROFILE
