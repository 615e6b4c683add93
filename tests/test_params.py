"""The parameter file: every entry, every way to get it wrong, and the way back."""

import dataclasses
import math
from pathlib import Path

import pytest
from fakes import PARAMS as FAKE
from hypothesis import given
from hypothesis import strategies as st

from rasterslice.errors import UsageError
from rasterslice.params import Params, read_params, write_params

ENTRIES = [
    "1 [int]", "statue.stl", "0", "2", "1", "1e-4", "1.5 1.5 [mm]", "0.4", "45 [°]", "0 0 0 0",
    "1 -90 0 0 [°]", "0 0 0 0 [mm]", "0 1", "0 1", "1 1 1", "5 [mm]",
]  # fmt: skip


def write(folder: Path, entries: list[str], keys: str = "", end: str = "\n") -> Path:
    path = folder / "params.txt"
    path.write_bytes((end.join(entries) + end + keys).encode())
    return path


def changed(line: int, text: str) -> list[str]:
    return [text if i == line else entry for i, entry in enumerate(ENTRIES, 1)]


def error(path: Path) -> str:
    with pytest.raises(UsageError) as caught:
        read_params(path)
    message = str(caught.value)
    assert message.startswith(str(path)) and "\n" not in message
    return message.removeprefix(str(path) + ":")


def test_papers_own_file(tmp_path: Path) -> None:
    path = write(tmp_path, ENTRIES)
    p = read_params(path)
    assert p == Params((tmp_path / "statue.stl",), rotation=(-90, 0, 0))
    assert p.source == path and p.fill and p.scaffolding and p.scaling is None
    assert isinstance(p.scaffold_buffer, float) and isinstance(p.rotation, tuple)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("bom", [b"", b"\xef\xbb\xbf"])
def test_line_ends_comments_and_bom(tmp_path: Path, end: str, bom: bytes) -> None:
    lines = ["% title", "", "  # more", *(f"\t{e}  % x # y" for e in ENTRIES), " [note]", "pitch=0.1 # fine"]
    path = tmp_path / "p.txt"
    path.write_bytes(bom + end.join(lines).encode())
    assert read_params(path) == Params(tmp_path / "statue.stl", rotation=(-90, 0, 0), pitch=0.1)  # type: ignore[arg-type]


def test_names(tmp_path: Path) -> None:
    for text, name in (('"my statue #1.stl" % c', "my statue #1.stl"), ("a%b#[c].ply", "a%b#[c].ply"),
                       ("sub/Köpfe.stl", "sub/Köpfe.stl"), ("a=b.stl", "a=b.stl")):  # fmt: skip
        assert read_params(write(tmp_path, changed(2, text))).files == (tmp_path / name,)
    assert read_params(write(tmp_path, changed(2, "/abs/x.stl"))).files == (Path("/abs/x.stl"),)


def test_switches_and_keys(tmp_path: Path) -> None:
    switches = ["1 2 2 .5", "0 rubbish", "1 CENT orig -3"]
    entries = [*ENTRIES[:3], "1", "0", *ENTRIES[5:9], *switches, *ENTRIES[12:15], "0"]
    keys = (
        "fill_angles = 0, 45 90\nexport = sheet, svg\nmemory_mb = 300\nwinding = evenodd\n"
        "slice_position = 0\nscaffold_union = own\nfill_inset=.2\npart_layers_per_slice = 2\nmin_point_spacing = 0.1"
    )
    p = read_params(write(tmp_path, entries, keys))
    assert p.scaling == (2, 2, 0.5) and p.rotation is None and p.translation == ("cent", "orig", -3.0)
    assert not p.fill and not p.scaffolding and p.scaffold_buffer == 0
    assert p.fill_angles == (0, 45, 90) and p.export == ("sheet", "svg") and p.memory_mb == 300
    assert (p.winding, p.scaffold_union, p.slice_position) == ("evenodd", "own", 0)
    assert (p.fill_inset, p.min_point_spacing) == (0.2, 0.1)


BAD_ENTRIES = [
    (1, "0", "number of files must be a whole number > 0, in digits, got 0"),
    (1, "one", "number of files must be a whole number > 0, in digits, got 'one'"),
    (1, "1e9", "number of files must be a whole number > 0, in digits, got 1e+09"),
    (1, "1.5", "whole number > 0"),
    (1, "1 1", "number of files: expected 1 value, got 2"),
    (2, "a.stl b.stl", "1 file promised, 2 named"),
    (3, "2", "inexact must be 0 to 1, got 2"),
    (3, "yes", "inexact must be a whole number, got 'yes'"),
    (4, "0", "slicing option must be 1 to 3, got 0"),
    (4, "4", "slicing option must be 1 to 3, got 4"),
    (5, "-1", "scaffolding must be 0 to 1, got -1"),
    (6, "0", "tolerance must be > 0 mm, got 0"),
    (6, "1×10^{-4}", "tolerance must be a number, got '1×10^{-4}'"),
    (7, "1.5", "path widths: expected 2 values, got 1"),
    (7, "1.5 1.5 1.5", "path widths: expected 2 values, got 3"),
    (7, "0 1.5", "part path width must be > 0 mm, got 0"),
    (7, "1.5 -2", "support path width must be > 0 mm, got -2"),
    (7, "0.3 1.5", "pitch 0.2 mm is too coarse for a part path width of 0.3 mm; use a pitch of 0.15 mm"),
    (7, "1.5 0.3", "pitch 0.2 mm is too coarse for a support path width of 0.3 mm"),
    (7, "1e7 1", "part path width must be 0.001 to 1e+06 mm, got 1e+07"),
    (8, "-0.4", "slice thickness must be > 0 mm, got -0.4"),
    (8, "nan", "slice thickness must be a number, got nan"),
    (8, "inf", "slice thickness must be 0.001 to 1e+06 mm, got inf"),
    (8, "1e999", "got inf"),
    (8, "9" * 299, "slice thickness must be 0.001 to 1e+06 mm, got 1e+299"),
    (8, "9" * 400, "slice thickness must be 0.001 to 1e+06 mm, got inf"),
    (8, "1_0", "slice thickness must be a number, got '1_0'"),
    (8, "0.4 mm", "slice thickness: expected 1 value, got 2"),
    (8, "0,4", "slice thickness must be a number, got '0,4'"),
    (8, "1e-9", "slice thickness must be 0.001 to"),
    (9, "0", "smooth angle must be > 0 degrees, got 0"),
    (9, "181", "smooth angle must be 1e-12 to 180 degrees, got 181"),
    (10, "1 1 1", "scale factor takes 3 values, got 2"),
    (10, "1 1 0 1", "scale factor must be > 0, got 0"),
    (10, "1 1 -1 1", "scale factor must be > 0, got -1"),
    (10, "2 1 1 1", "scaling must begin with 0 (off) or 1 (on), got 2"),
    (11, "1 a 0 0", "rotation must be a number, got 'a'"),
    (11, "1 0 0 361", "rotation must be -360 to 360 degrees, got 361"),
    (11, "on 0 0 0", "rotation must begin with 0 (off) or 1 (on), got 'on'"),
    (12, "1 center 0 0", "translation must be a number, cent or orig, got 'center'"),
    (12, "1 0 0", "translation takes 3 values, got 2"),
    (12, "1 1e7 0 0", "translation must be -1e+06 to 1e+06 mm, got 1e+07"),
    (13, "0", "part fraction: expected 2 values, got 1"),
    (13, "0 1.1", "part fraction must be 0 to 1, got 1.1"),
    (13, "1 0", "part fraction must be min < max, got 1 0"),
    (14, "-1 1", "scaffolding subset must be 0 to 1, got -1"),
    (14, "0.5 0.5", "scaffolding subset must be min < max, got 0.5 0.5"),
    (15, "1 1", "copies: expected 3 values, got 2"),
    (15, "1 1 0", "number of copies must be 1 to 1000, got 0"),
    (15, "1 1001 1", "number of copies must be 1 to 1000, got 1001"),
    (15, "1 1 1.0", "number of copies must be a whole number, got 1"),
    (15, "2 2 5", "5 copies do not fit in a grid of 2 x 2; use at most 4"),
    (16, "-1", "scaffolding buffer must be 0 to 1e+06 mm, got -1"),
    (16, "pitch = 0.2", "expected scaffolding buffer, got 'pitch = 0.2'; key = value lines come after"),
    (16, "", "entry 16 of 16, scaffolding buffer, is missing"),
]


@pytest.mark.parametrize(("line", "text", "message"), BAD_ENTRIES)
def test_bad_entry(tmp_path: Path, line: int, text: str, message: str) -> None:
    found = error(write(tmp_path, changed(line, text)))
    assert message in found
    assert found.startswith(f"{line if text else 15}: ")


def test_all_of_table_1(tmp_path: Path) -> None:
    entries = ["2", 'a.stl "b c.ply"', "1", "3", *ENTRIES[4:12], "0 0.5", "0.1 1", "3 2 5", "0"]
    p = read_params(write(tmp_path, entries, "copy_gap = 2\nunits = inch\nlenient = 1"))
    assert p.files == (tmp_path / "a.stl", tmp_path / "b c.ply")
    assert (p.inexact, p.option, p.fill, p.part_fraction) == (True, 3, True, (0, 0.5))
    assert (p.scaffold_subset, p.copies, p.scaffold_buffer) == ((0.1, 1), (3, 2, 5), 0)
    assert (p.copy_gap, p.units, p.lenient) == (2, "inch", True)


@pytest.mark.parametrize(
    ("keys", "line", "message"),
    [
        ("17", 17, "expected key = value after the 16 entries, got '17'"),
        ("pich = 0.2", 17, "unknown key 'pich'; did you mean pitch?"),
        ("PITCH = 0.2", 17, "unknown key 'PITCH'; did you mean pitch?"),
        ("zzz = 1", 17, "unknown key 'zzz'; known are pitch, "),
        ("thickness = 1", 17, "unknown key 'thickness'"),
        ("= 1", 17, "unknown key ''"),
        ("\npitch = 0.2\npitch = 0.1", 19, "pitch is given twice, first in line 18; remove one"),
        ("pitch =", 17, "pitch needs a value"),
        ("pitch = % 0.2", 17, "pitch needs a value"),
        ("pitch = 0.1 0.2", 17, "pitch takes 1 value, got 2"),
        ("pitch = -1", 17, "pitch must be > 0 mm, got -1"),
        ("\n\npitch = 1", 19, "pitch 1 mm is too coarse for a part path width of 1.5 mm"),
        ("copy_gap = -5", 17, "copy_gap must be 0 to 1e+06 mm, got -5"),
        ("units = ft", 17, "units must be mm or cm or m or inch, got 'ft'"),
        ("lenient = yes", 17, "lenient must be a whole number, got 'yes'"),
        ("machine =", 17, "machine needs a value"),
        (
            "part_layers_per_slice = 3\nfill_angles = 0 60 120",
            17,
            "part_layers_per_slice = 3 with 3 fill angles is not built yet, because a slice holds two sets of fill "
            "lines; use two fill angles, or two ice layers",
        ),
        ("part_layers_per_slice = 2.0", 17, "must be a whole number"),
        ("winding = odd", 17, "winding must be nonzero or positive or evenodd, got 'odd'"),
        ("winding = 1", 17, "winding must be nonzero"),
        ("scaffold_union = below", 17, "scaffold_union must be above or own, got 'below'"),
        ("slice_position = 1.5", 17, "slice_position must be 0 to 1, got 1.5"),
        ("fill_angles = 0 x", 17, "fill angle must be a number, got 'x'"),
        ("fill_inset = -1", 17, "fill_inset must be 0 to"),
        ("min_point_spacing = 0", 17, "min_point_spacing must be > 0 mm, got 0"),
        ("memory_mb = 0", 17, "memory_mb must be 1 to"),
        ("memory_mb = none", 17, "memory_mb must be a whole number, got 'none'"),
    ],
)
def test_bad_key(tmp_path: Path, keys: str, line: int, message: str) -> None:
    found = error(write(tmp_path, ENTRIES, keys))
    assert found.startswith(f"{line}: ") and message in found


def test_too_few_entries(tmp_path: Path) -> None:
    assert error(write(tmp_path, ENTRIES[:7])) == "7: entry 8 of 16, slice thickness, is missing"
    assert error(write(tmp_path, [])) == "1: entry 1 of 16, number of files, is missing"


def test_unreadable_files(tmp_path: Path) -> None:
    assert "No such file" in error(tmp_path / "none.txt")
    assert "Is a directory" in error(tmp_path)
    path = tmp_path / "params.txt"
    path.write_bytes(b"1\n\0")
    assert "not a parameter file" in error(path)
    path.write_bytes(b"1\n" * 600_000)
    assert "text of at most 1000 kB" in error(path)
    path.write_bytes("1\nstatü.stl".encode("latin-1"))
    assert error(path) == "2: not UTF-8 text; save it as UTF-8"
    with pytest.raises(UsageError, match="null"):
        read_params("a\0b")


def test_support_width_matters_only_with_scaffolding() -> None:
    assert Params((Path("a"),), support_width=0.1, scaffolding=False).support_width == 0.1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pitch": -1}, "pitch must be > 0 mm, got -1"),
        ({"pitch": "0.2"}, "pitch must be a number, got '0.2'"),
        ({"pitch": None}, "pitch must be a number, got None"),
        ({"thickness": 10**400}, "got inf"),
        ({"copies": (2, 1, 3)}, "3 copies do not fit in a grid of 2 x 1"),
        ({"copies": 1}, "number of copies must be a sequence, got 1"),
        ({"units": None}, "units must be mm or cm or m or inch, got None"),
        ({"files": ()}, "no mesh file is named"),
        ({"files": None}, "files must be paths"),
        ({"fill_angles": ()}, "fill angle takes at least 1 values, got 0"),
        ({"translation": (0, "middle", 0)}, "translation must be a number, cent or orig"),
        ({"winding": math.pi}, "winding must be nonzero"),
    ],
)
def test_python_users_get_the_same_errors(change: dict[str, object], message: str) -> None:
    good = Params((Path("a.stl"),))
    with pytest.raises(UsageError) as caught:
        dataclasses.replace(good, **change)  # type: ignore[arg-type]
    assert message in str(caught.value)


mm = st.floats(0.4, 1e6)
pair = st.floats(0, 360)
triple = st.tuples(pair, pair, pair)
place = st.one_of(st.floats(-1e6, 1e6), st.sampled_from(["cent", "orig"]))
name = st.text(st.characters(exclude_categories="CZ", exclude_characters='"/\\'), min_size=1, max_size=8)
fraction = st.tuples(st.floats(0, 0.49), st.floats(0.5, 1))
settings = st.builds(
    Params,
    files=st.tuples(st.builds(lambda a, b: Path("/models") / f"{a} {b}.stl", name, name)),
    option=st.sampled_from([1, 2, 3]), inexact=st.booleans(), scaffolding=st.booleans(), tolerance=st.floats(1e-12, 1),
    part_width=mm, support_width=mm, thickness=mm, smooth_angle=st.floats(1, 180),
    scaffold_buffer=st.floats(0, 50),
    scaling=st.none() | st.tuples(mm, mm, mm), rotation=st.none() | triple,
    translation=st.none() | st.tuples(place, place, place),
    pitch=st.floats(0.001, 0.2), slice_position=st.floats(0, 1), fill_inset=st.floats(0, 5),
    fill_angles=st.lists(pair, min_size=1, max_size=4),
    winding=st.sampled_from(["nonzero", "positive", "evenodd"]),
    scaffold_union=st.sampled_from(["above", "own"]), min_point_spacing=st.floats(0.01, 1),
    memory_mb=st.none() | st.integers(1, 10_000), copy_gap=st.none() | st.floats(0, 100), lenient=st.booleans(),
    part_fraction=fraction, scaffold_subset=fraction,
    copies=st.tuples(st.integers(3, 9), st.integers(3, 9), st.integers(1, 9)),
    units=st.sampled_from(["mm", "cm", "m", "inch"]), export=st.sampled_from([(), ("svg",), ("sheet", "svg")]),
)  # fmt: skip


@given(settings)
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, params: Params) -> None:
    path = tmp_path_factory.getbasetemp() / "round.txt"
    path.write_text(write_params(params), encoding="utf-8")
    assert read_params(path) == params


def test_written_names_are_relative_to_the_file(tmp_path: Path) -> None:
    p = read_params(write(tmp_path, changed(2, '"sub/a b.stl"')))
    assert '"sub/a b.stl"' in write_params(p) and str(tmp_path) not in write_params(p)
    assert str(Path.cwd() / "x.stl") in write_params(Params((Path("x.stl"),)))
    with pytest.raises(UsageError, match="cannot be written"):
        write_params(Params((Path("/a\nb.stl"),)))


def test_the_machine_profile_is_relative_to_the_file(tmp_path: Path) -> None:
    (tmp_path / "p.txt").write_text(FAKE + "machine = my cell.toml\n")
    (tmp_path / "my cell.toml").touch()  # the packaged one in all
    params = read_params(tmp_path / "p.txt")
    assert params.machine == tmp_path.resolve() / "my cell.toml"
    (tmp_path / "q.txt").write_text(write_params(params))
    assert read_params(tmp_path / "q.txt").machine == params.machine


@pytest.mark.parametrize(
    ("profile", "message"),
    [
        (None, "cannot read the machine profile: No such file or directory"),
        ("[robot", "not a TOML file"),
        ("[robot]\nlinkz = 1\n", "unknown key 'robot.linkz'; did you mean 'robot.links'?"),
        ("[motion]\naccel = 'fast'\n", "motion.accel must be a number, got 'fast'"),
    ],
)
def test_a_machine_profile_is_read_whether_or_not_it_is_needed(
    tmp_path: Path, profile: str | None, message: str
) -> None:
    if profile is not None:
        (tmp_path / "cell.toml").write_text(profile)
    path = write(tmp_path, ENTRIES, "pitch = 0.2\nmachine = cell.toml\n")
    assert error(path).startswith(f"18: {tmp_path.resolve() / 'cell.toml'}: {message}")


def test_fields_know_their_lines(tmp_path: Path) -> None:
    p = read_params(write(tmp_path, ["% title", *ENTRIES], "pitch = 0.1\n"))
    assert (p.at("pitch"), p.at("files"), p.at("thickness")) == tuple(f"{p.source}:{n}: " for n in (18, 3, 9))
    assert p.at("export") == p.at() == f"{p.source}: " and p.at("export", "part_width") == f"{p.source}:8: "
    assert Params((Path("a.stl"),)).at("pitch") == ""
    assert p == dataclasses.replace(p, lines={}) and hash(p) == hash(dataclasses.replace(p, lines={}))
