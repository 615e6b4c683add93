"""From parameters to a complete folder, or to the folder that was there before."""

from __future__ import annotations

import csv
import errno
import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes import FakeSlicing, install, params_file, polygon_area, tree

import rasterslice
from rasterslice import export, folder, job, manifest
from rasterslice.errors import ModelError, RasterSliceError, UsageError
from rasterslice.params import Params, read_params
from rasterslice.paths import COLUMNS


@pytest.fixture
def params(tmp_path: Path) -> Params:
    return read_params(params_file(tmp_path))


def test_cells_that_nothing_is_known_of_are_blank() -> None:
    stats: dict[str, Any] = {"layer": 3, "z": 0.25, "part_area": -1e-9, "part_area_exact": None, "flags": "open"}
    stats["lost_area"] = float("nan")
    cells = dict(zip(COLUMNS, manifest.csv_row(stats).split(","), strict=True))
    assert cells == dict.fromkeys(COLUMNS, "") | {"layer": "3", "z": "0.2500", "part_area": "0.0000", "flags": "open"}


def test_what_a_run_worked_with_is_held_for_who_asks(params: Params, monkeypatch: pytest.MonkeyPatch) -> None:
    fakes, held = install(monkeypatch), list[object]()
    job.run(params, held=held)
    assert held == fakes


def everything(params: Params) -> Params:
    """Ask for every export that can be made here; the report holds times, so it is not the same twice."""
    here = list(export.FORMATS)
    return replace(params, export=tuple(name for name in here if name != "report"))


def test_a_run_writes_a_complete_folder(params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fakes, seen = install(monkeypatch), []
    result = job.run(params, progress=lambda done, total: seen.append((done, total)))
    out = tmp_path / "job.slices"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cube.stl", "job.slices", "job.txt"]
    assert sorted(tree(out)) == [
        "layers.csv", "layers/index.bin", "layers/offsets.u32", "layers/points.f64", "manifest.json", "report.html",
    ]  # fmt: skip
    assert json.loads((out / "manifest.json").read_text()) == result
    assert seen == [(i, 6) for i in range(1, 7)]
    assert [layer.index for layer in rasterslice.open(out)] == list(range(6))
    assert rasterslice.open(out)[0].part is None
    assert fakes[0].closed
    assert not fakes[0].regions


def test_the_manifest_tells_all(params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)
    result = job.run(everything(params))
    assert (result["program"], result["version"], result["name"]) == ("rasterslice", "0.1.0", "job")
    assert result["settings"]["thickness"] == 0.4
    assert result["settings"]["export"] == list(everything(params).export)
    assert {n: result["grid"][n] for n in ("width", "height", "pitch")} == {"width": 128, "height": 128, "pitch": 0.2}
    assert result["device"] == "fake"
    assert result["layers"] == 6
    assert result["warnings"] == ["cube.stl: a warning"]
    assert {"read", "write", "export", "report", "total"} == set(result["seconds"])
    assert result["peak_memory_mib"] is None or result["peak_memory_mib"] > 10
    assert result["exports"] == sorted(export.FORMATS[n].target.format(stem="job") for n in everything(params).export)
    assert result["flagged_layers"] == 0
    for entry, path in zip(result["inputs"], [params.source, *params.files], strict=True):
        assert entry["path"] == str(path)
        assert entry["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    files = tree(tmp_path / "job.slices", but=("manifest.json",))
    assert [entry["path"] for entry in result["files"]] == sorted(files, key=Path)
    for entry in result["files"]:
        assert entry["sha256"] == hashlib.sha256(files[entry["path"]]).hexdigest()
        assert entry["bytes"] == len(files[entry["path"]])
    area = sum(polygon_area(40, 8 * k) - polygon_area(40, 3 * k) for k in (1 - 0.02 * i for i in range(6)))
    assert result["totals"]["part_mm3"] == pytest.approx(area * 0.4, abs=1e-3)
    assert result["totals"]["part_fill_mm"] == pytest.approx(sum(4 * (1 - 0.02 * i) for i in range(6)), abs=1e-3)


def test_the_worst_layers_come_first() -> None:
    exact = [10, 8, 0, None, 9.9, 11, 10.5, 9]
    stats: list[dict[str, Any]] = [{"z": k, "part_area": 10.0, "part_area_exact": e} for k, e in enumerate(exact)]
    worst = manifest._worst(stats, "relative_error", manifest._relative_error)
    assert [entry["layer"] for entry in worst] == [1, 7, 5, 6, 4]
    assert worst[0] == {"layer": 1, "z": 1, "relative_error": 0.25}


def test_the_table_of_layers(params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)
    job.run(params)
    raw = (tmp_path / "job.slices/layers.csv").read_bytes()
    assert b"\r" not in raw
    rows = list(csv.DictReader(raw.decode().splitlines()))
    assert tuple(rows[0]) == COLUMNS
    assert [row["layer"] for row in rows] == [str(k) for k in range(6)]
    assert rows[0]["z"] == "0.2000"
    assert rows[0]["part_area"] == f"{polygon_area(40, 8) - polygon_area(40, 3):.4f}"
    assert rows[0]["part_area_exact"] == rows[0]["flags"] == ""
    assert rows[0]["part_contours"] == "2"


def test_cells_are_formatted_by_column() -> None:
    cells = [("z", 1, "1.0000"), ("lost_area", -1e-9, "0.0000"), ("flags", "a;b", "a;b"), ("open_rows", 3.0, "3")]
    assert [manifest._cell(name, value) for name, value, _ in cells[:3]] == [want for _, _, want in cells[:3]]
    assert manifest._cell("open_rows", 3) == "3"
    assert manifest._cell("part_area_exact", None) == ""


def test_two_runs_write_the_same_bytes(params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)
    for name in "ab":
        job.run(everything(params), out=tmp_path / name)
    a, b = (tree(tmp_path / name, but=("manifest.json", "report.html")) for name in "ab")
    assert a == b
    one, two = (json.loads((tmp_path / name / "manifest.json").read_text()) for name in "ab")
    for result in (one, two):
        for key in ("seconds", "peak_memory_mib", "device"):
            del result[key]
        result["files"] = [entry for entry in result["files"] if entry["path"] != "report.html"]  # it holds times
    assert one == two


def test_an_older_result_is_replaced_whole(params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)
    job.run(everything(params))
    job.run(params)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cube.stl", "job.slices", "job.txt"]
    assert not (tmp_path / "job.slices/svg").exists()


Setup = Callable[[Path], Any]
REFUSED: dict[str, tuple[Setup, str]] = {
    "not ours": (lambda out: (out.mkdir(), (out / "thesis.tex").write_text("x")), "is not replaced"),
    "empty": (lambda out: out.mkdir(), "is not replaced"),
    "another program": (
        lambda out: (out.mkdir(), (out / "manifest.json").write_text('{"program": "other"}')),
        "is not replaced",
    ),
    "no manifest": (lambda out: (out.mkdir(), (out / "manifest.json").write_text("{")), "is not replaced"),
    "a file": (lambda out: out.write_text("x"), "this is a file"),
    "a dangling link": (lambda out: out.symlink_to("nowhere/at/all"), "does not exist"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_ours_is_refused_before_computing(
    params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    fakes = install(monkeypatch)
    setup, message = REFUSED[case]
    setup(tmp_path / "out")
    before = tree(tmp_path)
    with pytest.raises(UsageError, match=message) as error:
        job.run(params, out=tmp_path / "out")
    assert "\n" not in str(error.value)
    assert tree(tmp_path) == before
    assert not fakes


def test_a_missing_parent_is_refused(params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fakes = install(monkeypatch)
    with pytest.raises(UsageError, match=r"the folder .*deep does not exist"):
        job.run(params, out=tmp_path / "deep" / "out")
    assert not fakes


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder that even root cannot write")
def test_an_unwritable_parent_is_refused_before_computing(params: Params, monkeypatch: pytest.MonkeyPatch) -> None:
    fakes = install(monkeypatch)
    with pytest.raises(UsageError, match=r"/proc/out: cannot be written: .*another folder with -o"):
        job.run(params, out=Path("/proc/out"))
    assert not fakes


def test_the_folder_of_the_input_is_never_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)
    (tmp_path / "job").mkdir()
    params = read_params(params_file(tmp_path / "job"))
    (tmp_path / "job/manifest.json").write_text('{"program": "rasterslice"}')
    with pytest.raises(UsageError, match="would delete the input"):
        job.run(params, out=tmp_path / "job")


def test_a_link_is_followed(params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)
    job.run(params, out=tmp_path / "real")
    (tmp_path / "link").symlink_to("real")
    job.run(params, out=tmp_path / "link")
    assert (tmp_path / "link").is_symlink()
    assert len(rasterslice.open(tmp_path / "real")) == 6


def test_unknown_exports_are_refused_before_computing(params: Params, monkeypatch: pytest.MonkeyPatch) -> None:
    fakes = install(monkeypatch)
    with pytest.raises(UsageError, match="unknown export 'sgv'; did you mean 'svg'\\? there are: sheet, svg"):
        job.run(replace(params, export=("sgv",)))
    with pytest.raises(UsageError, match="unknown export 'zzz'; there are"):
        job.dry_run(replace(params, export=("zzz",)))
    assert not fakes


FAILURES = [KeyboardInterrupt(), ModelError("cube.stl: bad"), MemoryError(), RuntimeError("bug")]


@pytest.mark.parametrize("failure", FAILURES, ids=repr)
@pytest.mark.parametrize("fail_at", [5, 2, 0])
@pytest.mark.parametrize("existing", [False, True])
def test_a_failure_while_slicing_leaves_what_was_there(
    params: Params,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    failure: BaseException,
    fail_at: int,
    existing: bool,
) -> None:
    if existing:
        install(monkeypatch)
        job.run(params)
    before = tree(tmp_path)
    fakes = install(monkeypatch, fail_at=fail_at, failure=failure)
    with pytest.raises(type(failure)):
        job.run(params)
    assert tree(tmp_path) == before
    assert not list(tmp_path.glob(".*"))
    assert fakes[0].closed


def test_what_is_sealed_is_not_sealed_again(tmp_path: Path) -> None:
    (tmp_path / "layers").mkdir()
    for name in ("layers.csv", "layers/b", "layers/a", "a", folder.MANIFEST):
        (tmp_path / name).write_text(name)
    early = folder.seal(tmp_path, "layers/*")
    assert [entry["path"] for entry in early] == ["layers/a", "layers/b"]
    whole = folder.seal(tmp_path)
    (tmp_path / "layers" / "a").write_text("another")
    assert folder.seal(tmp_path, sealed=early) == whole
    assert [entry["path"] for entry in whole] == ["a", "layers/a", "layers/b", "layers.csv"]


STEPS = {
    "prepare": "rasterslice.slicer.prepare",
    "spool": "rasterslice.spooling.SpoolWriter.append",
    "index": "rasterslice.spooling.SpoolWriter.close",
    "csv": "rasterslice.manifest.write_csv",
    "export": "rasterslice.export.write",
    "seal": "rasterslice.folder.seal",
    "manifest": "rasterslice.folder.write_manifest",
    "swap": "rasterslice.folder._swap",
    "sync": "rasterslice.folder._sync_folder",
}
NO_ROOM = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("failure", [KeyboardInterrupt(), NO_ROOM], ids=["interrupt", "disk full"])
def test_a_failure_of_any_step_leaves_a_whole_result(
    params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str, failure: BaseException
) -> None:
    install(monkeypatch)
    job.run(params)
    before = tree(tmp_path)

    def fail(*args: Any, **settings: Any) -> None:
        raise failure

    monkeypatch.setattr(STEPS[step], fail)
    # A device or mesh that cannot be read is not a failed write, and the slicer says so itself.
    kind = UsageError if failure is NO_ROOM and step != "prepare" else type(failure)
    with pytest.raises(kind) as error:
        job.run(params)
    if kind is UsageError:
        assert str(error.value).startswith(f"{tmp_path / 'job.slices'}: cannot be written: No space left")
    assert not list(tmp_path.glob(".*"))
    if step == "sync":  # the new result is already there
        assert len(rasterslice.open(tmp_path / "job.slices")) == 6
    else:
        assert tree(tmp_path) == before


@pytest.mark.parametrize("failing", [1, 2])
@pytest.mark.parametrize("after", [False, True])
def test_an_interrupted_swap_puts_the_old_result_back(
    params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int, after: bool
) -> None:
    install(monkeypatch)
    job.run(params)
    calls, rename = [], os.rename

    def interrupted(a: Path, b: Path) -> None:
        calls.append(a)
        if len(calls) != failing:
            rename(a, b)
            return
        if after:
            rename(a, b)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt):
        job.run(params)
    assert len(rasterslice.open(tmp_path / "job.slices")) == 6
    left = [p.name for p in tmp_path.glob(".*")]
    assert not [name for name in left if "part" in name]


def test_a_folder_that_appears_meanwhile_is_not_replaced(
    params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(monkeypatch)

    def progress(done: int, total: int) -> None:
        (tmp_path / "job.slices").mkdir(exist_ok=True)

    with pytest.raises(UsageError, match="is not replaced"):
        job.run(params, progress=progress)
    assert not list((tmp_path / "job.slices").iterdir())


def test_dry_run_computes_nothing_and_writes_nothing(
    params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(monkeypatch)
    before = tree(tmp_path)
    plan = job.dry_run(params)
    assert tree(tmp_path) == before
    assert (plan["layers"], plan["batch"], plan["facets"]) == (6, 2, 12)
    assert plan["grid"]["width"] == 128
    assert plan["memory_budget_mib"] == 256
    assert plan["estimated_seconds"] == 0.5


def test_parameters_without_a_file_need_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)
    (tmp_path / "cube.stl").write_bytes(b"solid")
    params = Params(files=(tmp_path / "cube.stl",))
    with pytest.raises(UsageError, match="no default output folder"):
        job.run(params)
    assert job.run(params, out=tmp_path / "out")["name"] == "cube"


def test_more_exports_later_give_what_a_run_gives(
    params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(monkeypatch)
    job.run(replace(params, export=("svg",)), out=tmp_path / "a")
    job.run(everything(params), out=tmp_path / "b")
    names = everything(params).export
    result = job.export_more(tmp_path / "a", names)
    assert result["exports"] == sorted(export.FORMATS[name].target.format(stem="job") for name in names)
    assert json.loads((tmp_path / "a/manifest.json").read_text()) == result
    a, b = (tree(tmp_path / name, but=("manifest.json", "report.html")) for name in "ab")
    assert a == b
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    ("box", "words"),
    [((16, 16, 305), "envelope z is 3"), ((400, 16, 20), "envelope x is 408.5 mm, the limit is 300")],
)
def test_what_cannot_fit_the_machine_is_refused_before_it_is_sliced(
    params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, box: tuple[float, ...], words: str
) -> None:
    high = np.array(box, float)
    fakes = install(monkeypatch, low=np.zeros(3), high=high, n=int(high[2] / params.thickness))
    monkeypatch.setattr(FakeSlicing, "layers", lambda *_: pytest.fail("was sliced"))
    for act in (lambda p: job.run(p, out=tmp_path / "a"), lambda p: job.dry_run(p, out=tmp_path / "a")):
        with pytest.raises(UsageError, match=words):
            act(replace(params, export=("csv", "cobra")))
    assert len(fakes) == 2
    assert not list(tmp_path.glob("*a*.part*"))
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(("stem", "name", "file"), [("layers", "csv", "layers.csv"), ("report", "html", "report.html")])
def test_a_name_of_the_run_is_not_taken(
    params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stem: str, name: str, file: str
) -> None:
    install(monkeypatch)
    assert params.source is not None
    params = replace(params, source=params.source.rename(tmp_path / f"{stem}.txt"))
    plain = job.run(replace(params, export=("svg",)), out=tmp_path / "plain")
    want = (tmp_path / "plain" / file).read_text()
    result = job.run(replace(params, export=(name,)), out=tmp_path / "a")
    later = job.export_more(tmp_path / "plain", [name])
    assert result["exports"] == [file.replace(".", "_.")]
    assert later["exports"] == sorted(["svg", *result["exports"]])
    assert plain["exports"] == ["svg"]
    assert (tmp_path / "plain" / file).read_text() == want
    assert (tmp_path / "a" / file).read_text()[:200] == want[:200]
    assert (tmp_path / "a" / file.replace(".", "_.")).read_bytes() == (
        tmp_path / "plain" / file.replace(".", "_.")
    ).read_bytes()


def test_a_later_export_says_what_is_missing(params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)
    job.run(params)
    with pytest.raises(UsageError, match="without regions, which svg draws; slice again with --export svg"):
        job.export_more(tmp_path / "job.slices", ["svg"])
    with pytest.raises(UsageError, match="no such folder"):
        job.export_more(tmp_path / "nowhere", ["svg"])
    with pytest.raises(UsageError, match="unknown export"):
        job.export_more(tmp_path / "job.slices", ["pdf"])


def test_a_failed_later_export_leaves_the_folder(
    params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(monkeypatch)
    job.run(replace(params, export=("svg",)))
    before = tree(tmp_path)

    def fail(*args: Any) -> None:
        raise NO_ROOM

    monkeypatch.setattr(folder, "write_manifest", fail)
    with pytest.raises(RasterSliceError, match="cannot be written"):
        job.export_more(tmp_path / "job.slices", ["sheet"])
    assert tree(tmp_path) == before
    assert not list(tmp_path.glob(".*"))
