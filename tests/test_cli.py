"""What the command line prints, where, and with which exit code."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from fakes import install, params_file, tree

import rasterslice
from rasterslice.cli import main
from rasterslice.errors import DeviceError, ModelError, UsageError


@pytest.fixture
def job(tmp_path: Path) -> Path:
    return params_file(tmp_path)


def one_error(capsys: pytest.CaptureFixture[str]) -> str:
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("rasterslice: error: ")
    assert err.count("\n") == 1
    return err


def test_a_run_says_where_the_pictures_are(
    job: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch)
    assert main([str(job), "--export", "svg,sheet"]) == 0
    out, err = capsys.readouterr()
    folder = job.parent / "job.slices"
    assert "6 layers of 128 x 128 px in" in out
    assert f"{folder / 'sheet.png'}\n" in out
    assert f"{folder / 'svg'}/ (6 files)\n" in out
    assert err == "rasterslice: warning: cube.stl: a warning\n"
    assert len(rasterslice.open(folder)) == 6


def test_json_is_the_manifest_and_quiet_is_quiet(
    job: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch)
    assert main([str(job), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads((job.parent / "job.slices/manifest.json").read_text())
    assert main([str(job), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_options_beat_keys(job: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    given = install(monkeypatch)
    job.write_text(job.read_text() + "pitch = 0.25\nexport = svg\n")
    assert main([str(job), "--pitch", "0.125", "--export", "", "-o", str(tmp_path / "o"), "--quiet"]) == 0
    assert (given[0].params.pitch, given[0].params.export, given[0].regions) == (0.125, (), False)
    assert main([str(job), "--quiet"]) == 0
    assert (given[1].params.pitch, given[1].params.export, given[1].regions) == (0.25, ("svg",), True)


def test_dry_run_writes_nothing(job: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    install(monkeypatch)
    before = tree(job.parent)
    assert main([str(job), "--dry-run"]) == 0
    assert "grid      128 x 128 px of 0.2 mm\nlayers    6, 2 at a time\n" in capsys.readouterr().out
    assert main([str(job), "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["layers"] == 6
    assert tree(job.parent) == before


def test_export_of_a_finished_folder(
    job: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch)
    folder = job.parent / "job.slices"
    assert main([str(job), "--quiet"]) == 0
    assert main(["export", str(folder), "--to", "sheet"]) == 2
    assert "slice again with --export sheet" in one_error(capsys)
    assert main([str(job), "--quiet", "--export", "svg"]) == 0
    assert main(["export", str(folder), "--to", "sheet"]) == 0
    assert capsys.readouterr().out == f"{folder / 'sheet.png'}\n"  # and not what was there before
    assert (folder / "sheet.png").exists()
    assert main(["export", str(folder), "--to", ""]) == 2
    assert "names no export" in one_error(capsys)


def test_devices(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    fake: Any = ModuleType("rasterslice.platforms")
    one = {"name": "A", "platform": "P", "kind": "cpu", "driver": "1", "memory_mb": 5, "usable": True}
    fake.list_devices = lambda: [one, {**one, "name": "B", "usable": False}]
    monkeypatch.setitem(sys.modules, "rasterslice.platforms", fake)
    monkeypatch.setattr(rasterslice, "platforms", fake, raising=False)
    assert main(["devices"]) == 0
    assert capsys.readouterr().out == "A  [cpu, P, 5 MB, 1]\nB  [cpu, P, 5 MB, 1]  not usable\n"
    assert main(["devices", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0] == one


REFUSED = {
    "no file": ([], "arguments are required"),
    "unknown option": (["{job}", "--frobnicate"], "unrecognized arguments: --frobnicate"),
    "an option of later": (["{job}", "--workers", "2"], "unrecognized arguments: --workers"),
    "short for an option": (["{job}", "--qui"], "unrecognized arguments: --qui"),
    "a command that is none": (["slize"], "slize: cannot read the parameter file"),
    "preview of nothing": (["preview"], "required: MESH|PARAMS.txt"),
    "preview of what is not there": (["preview", "none.txt"], "none.txt: cannot read the parameter file"),
    "preview into nowhere": (["preview", "{job}", "-o", "{folder}/no/x.png"], "must be a .png in a folder that exists"),
    "preview into a text": (["preview", "{job}", "-o", "{folder}/x.txt"], "must be a .png"),
    "pitch 0": (["{job}", "--pitch", "0"], "--pitch: must be > 0 mm, got 0"),
    "pitch nan": (["{job}", "--pitch", "nan"], "--pitch: must be > 0 mm, got nan"),
    "pitch word": (["{job}", "--pitch", "fine"], "--pitch: must be > 0 mm, got fine"),
    "coarse pitch": (["{job}", "--pitch", "5"], "pitch"),
    "export": (["{job}", "--export", "svg,shet"], "unknown export 'shet'; did you mean 'sheet'?"),
    "export, dry run": (["{job}", "--export", "shet", "--dry-run"], "unknown export 'shet'"),
    "missing file": (["nowhere.txt"], "nowhere.txt"),
    "a folder": (["{folder}"], "{folder}"),
    "output is a file": (["{job}", "-o", "{job}"], "this is a file"),
    "output is not ours": (["{job}", "-o", "{folder}"], "is not replaced"),
    "no parent": (["{job}", "-o", "{folder}/a/b"], "does not exist"),
    "export from nowhere": (["export", "{folder}/none", "--to", "svg"], "no such folder"),
    "export to nothing": (["export", "{folder}"], "required: --to"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_misuse_is_one_line_and_exit_2(
    job: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], case: str
) -> None:
    given = install(monkeypatch)
    monkeypatch.chdir(job.parent)
    argv, message = REFUSED[case]
    names = {"job": job, "folder": job.parent}
    before = tree(job.parent)
    assert main([word.format(**names) for word in argv]) == 2
    assert message.format(**names) in one_error(capsys)
    assert tree(job.parent) == before
    assert not given


def several(folder: Path) -> list[str]:
    """Return parameter files: a good one, one with a mistake, one that is not there, a good one."""
    first = params_file(folder)
    bad, last = folder / "bad.txt", folder / "last.txt"
    bad.write_text(first.read_text() + "pitch = -1\n")
    last.write_text(first.read_text())
    return [str(first), str(bad), str(folder / "none.txt"), str(last)]


def test_several_files_run_one_after_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = install(monkeypatch)
    files = several(tmp_path)
    assert main([*files, "--pitch", "0.15"]) == 2
    out, err = capsys.readouterr()
    assert len(given) == 2 and {p.name for p in tmp_path.glob("*.slices")} == {"job.slices", "last.slices"}
    assert "2 of 4 files done, 2 failed\n" in out
    assert f"  {files[2]}: failed with exit code 2\n  {files[3]}: done in " in out
    errors = [line for line in err.splitlines() if "error" in line]
    assert len(errors) == 2 and f"{files[1]}:17: pitch must be > 0 mm" in errors[0]


def test_several_files_as_json_and_below_one_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch)
    files = several(tmp_path)
    out = tmp_path / "all"
    assert main([*files, "--json", "-o", str(out)]) == 2
    found = json.loads(capsys.readouterr().out)
    assert found["exit_code"] == 2 and [run["exit_code"] for run in found["runs"]] == [0, 2, 2, 0]
    assert found["runs"][3]["folder"] == str(out / "last.slices") and found["runs"][3]["result"]["layers"] == 6
    assert "not_found" not in found and "No such file" in found["runs"][2]["error"]
    assert main([files[0], files[3], "--dry-run", "--json"]) == 0
    assert [run["result"]["layers"] for run in json.loads(capsys.readouterr().out)["runs"]] == [6, 6]
    assert main([files[0], files[3], "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_files_that_were_not_tried_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from rasterslice import job as jobs

    install(monkeypatch)
    files = several(tmp_path)

    def stop(*args: Any, **named: Any) -> None:
        raise KeyboardInterrupt

    assert main([files[1], files[0], "-o", str(tmp_path / "all")]) == 2
    assert (tmp_path / "all" / "job.slices").is_dir()
    capsys.readouterr()
    monkeypatch.setattr(jobs, "run", stop)
    assert main([files[1], files[0], files[3], files[2], "-o", str(tmp_path / "more")]) == 130
    assert "0 of 4 files done, 2 failed, 2 not tried\n" in capsys.readouterr().out
    assert not (tmp_path / "more").exists()  # nothing came into it


def test_a_folder_that_was_there_stays(tmp_path: Path) -> None:
    (tmp_path / "all").mkdir()
    for out in ("all", "none"):
        assert main([*several(tmp_path)[1:3], "-o", str(tmp_path / out), "--quiet"]) == 2
    assert (tmp_path / "all").is_dir() and not (tmp_path / "none").exists()


def test_two_of_one_name_do_not_replace_each_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch)
    (tmp_path / "sub").mkdir()
    files = [params_file(tmp_path), params_file(tmp_path / "sub")]
    assert main([*map(str, files), "-o", str(tmp_path / "all"), "--quiet"]) == 2
    assert f"{files[1]}: its output folder {tmp_path / 'all' / 'job.slices'} is that of {files[0]}" in one_error(capsys)
    assert main([*map(str, files), "--quiet"]) == 0
    capsys.readouterr()
    assert main([str(files[0]), str(files[0]), "--quiet"]) == 2
    assert f"{files[0]}: is named twice; name it once" in one_error(capsys)


@pytest.mark.parametrize(
    ("failures", "code"),
    [
        ([UsageError("a"), ModelError("b")], 3),
        ([ModelError("b"), DeviceError("c"), UsageError("a")], 5),
        ([DeviceError("c"), ZeroDivisionError()], 1),
        ([UsageError("a"), KeyboardInterrupt(), ModelError("b")], 130),
    ],
)
def test_the_exit_code_is_the_worst(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], failures: list[Any], code: int
) -> None:
    from rasterslice import job as jobs

    install(monkeypatch)
    left, files = iter(failures), []
    for i in range(len(failures)):
        files.append(params_file(tmp_path).rename(tmp_path / f"{i}.txt"))

    def run(*args: Any, **kwargs: Any) -> None:
        raise next(left)

    monkeypatch.setattr(jobs, "run", run)
    assert main([str(f) for f in files]) == code
    out, err = capsys.readouterr()
    assert "0 of " in out and err.count("rasterslice: error: ") == len(failures) - (code == 130)


def test_lenient_beats_the_key(job: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = install(monkeypatch)
    assert main([str(job), "--quiet"]) == main([str(job), "--quiet", "--lenient"]) == 0
    assert [s.params.lenient for s in given] == [False, True]


FAILURES: dict[str, tuple[BaseException, int, str]] = {
    "usage": (UsageError("too fine"), 2, "too fine"),
    "model": (ModelError("x.stl: bad\nreally"), 3, "x.stl: bad really"),
    "device": (DeviceError("none"), 5, "none"),
    "memory": (MemoryError(), 2, "out of memory; use a larger --pitch"),
    "interrupt": (KeyboardInterrupt(), 130, "interrupted"),
    "bug": (ZeroDivisionError("oops"), 1, "internal: ZeroDivisionError: oops; please report it; RASTERSLICE_DEBUG=1"),
}


@pytest.mark.parametrize("case", FAILURES)
def test_every_failure_is_one_line_with_its_exit_code(
    job: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], case: str
) -> None:
    failure, code, message = FAILURES[case]
    install(monkeypatch, fail_at=3, failure=failure)
    before = tree(job.parent)
    assert main([str(job)]) == code
    assert message in one_error(capsys)
    assert tree(job.parent) == before


def test_a_bug_shows_where_on_request(
    job: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch, fail_at=3, failure=ZeroDivisionError("oops"))
    monkeypatch.setenv("RASTERSLICE_DEBUG", "1")
    assert main([str(job)]) == 1
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(("failure", "code"), [(BrokenPipeError(), 0), (OSError(errno.ENOSPC, "No space left"), 2)])
def test_output_that_cannot_be_written(
    job: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], failure: OSError, code: int
) -> None:
    install(monkeypatch)

    class Full:
        encoding = "utf-8"

        def write(self, text: str) -> int:
            raise failure

        def fileno(self) -> int:
            raise ValueError

    monkeypatch.setattr(sys, "stdout", Full())
    assert main([str(job)]) == code
    assert ("standard output: cannot be written" in capsys.readouterr().err) == (code == 2)


def test_names_that_the_terminal_cannot_show(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch)
    job = params_file(tmp_path)
    with open(os.dup(1), "w", encoding="ascii") as narrow:
        monkeypatch.setattr(sys, "stdout", narrow)
        assert main([str(job), "-o", str(tmp_path / "gl\u00e4ser")]) == 0
    assert "gl\\xe4ser" in capfd.readouterr().out


def test_a_progress_bar_only_on_a_terminal(
    job: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert main([str(job)]) == 0
    assert "6/6" in capsys.readouterr().err
    assert main([str(job), "--no-progress"]) == 0
    assert "6/6" not in capsys.readouterr().err


def test_signals_are_restored(job: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)
    before = signal.getsignal(signal.SIGTERM)
    assert main([str(job), "--quiet"]) == 0
    assert signal.getsignal(signal.SIGTERM) is before


SLOW = """
import sys, time
sys.path.insert(0, {tests!r})
import pytest, fakes
from rasterslice.cli import main
class Slow(fakes.FakeSlicing):
    def layers(self, progress=None):
        for layer in super().layers(progress):
            print("layer", flush=True)
            time.sleep(0.2)
            yield layer
fakes.FakeSlicing = Slow
fakes.install(pytest.MonkeyPatch(), n=500)
sys.exit(main([{job!r}]))
"""


@pytest.mark.skipif(os.name != "posix", reason="sends POSIX signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_with_130_and_leaves_nothing(job: Path, number: signal.Signals) -> None:
    before = tree(job.parent)
    code = SLOW.format(tests=str(Path(__file__).parent), job=str(job))
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with child:
        assert child.stdout is not None
        assert child.stderr is not None
        assert child.stdout.readline() == "layer\n"
        assert list(job.parent.glob(".job.slices.part-*"))
        child.send_signal(number)
        assert child.wait(20) == 130
        assert child.stderr.read() == "rasterslice: error: interrupted\n"
    assert tree(job.parent) == before
    assert not list(job.parent.glob(".*"))


@pytest.mark.skipif(os.name != "posix", reason="sends POSIX signals")
def test_signals_while_it_tidies_up_change_nothing(job: Path) -> None:
    before = tree(job.parent)
    slow = (
        "import rasterslice.folder as f\nold = f.shutil.rmtree\n"
        "def rmtree(*a, **k):\n    print('tidying', flush=True); time.sleep(0.3); old(*a, **k)\n"
        "f.shutil.rmtree = rmtree\nsys.argv[1:] = [{job!r}]\nsys.exit(main())\n"
    )
    code = SLOW.replace("sys.exit(main([{job!r}]))\n", slow).format(tests=str(Path(__file__).parent), job=str(job))
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with child:
        assert child.stdout is not None
        assert child.stderr is not None
        assert child.stdout.readline() == "layer\n"
        child.send_signal(signal.SIGINT)
        while child.stdout.readline() != "tidying\n":
            pass
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGINT):
            child.send_signal(number)
            time.sleep(0.02)
        assert child.wait(20) == 130
        assert child.stderr.read() == "rasterslice: error: interrupted\n"
    assert tree(job.parent) == before
    assert not list(job.parent.glob(".*"))


@pytest.mark.parametrize("argv", [["--help"], ["--version"], ["devices", "--help"], ["export", "--help"]])
def test_help_imports_nothing_heavy(argv: list[str]) -> None:
    heavy = "numpy", "cv2", "pyopencl", "rich", "trimesh", "skimage"
    code = (
        "import sys; from rasterslice.cli import main\n"
        f"try: main({argv!r})\n"
        f"except SystemExit as end: print('code', end.code, [m for m in {heavy!r} if m in sys.modules])"
    )
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("code 0 []\n")
    assert time.perf_counter() - start < 2


def test_python_dash_m_runs_it() -> None:
    command = [sys.executable, "-m", "rasterslice", "--version"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "rasterslice 0.1.0\n"
    done = subprocess.run([*command[:-1], "--nope", "x"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")


def test_public_names_are_there_and_lazy() -> None:
    assert rasterslice.open.__name__ == "open_result"
    with pytest.raises(AttributeError, match="no attribute 'nope'"):
        rasterslice.nope  # noqa: B018


@pytest.mark.parametrize(
    ("before", "ended"),
    [("", b""), ("import sys; sys.setprofile(lambda *a: None); ", b"at exit")],
    ids=["alone", "profiled"],
)
def test_the_process_ends_at_once_unless_somebody_looks(before: str, ended: bytes) -> None:
    """What was printed is there all the same, and the exit code."""
    code = f"{before}import atexit, sys; from rasterslice.cli import main; atexit.register(print, 'at exit'); "
    code += "print('first', flush=False); sys.argv = ['rasterslice', 'nothing.txt']; sys.exit(main())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, timeout=60)
    assert done.returncode == UsageError.exit_code
    assert done.stdout.splitlines() == [b"first", *[ended][: len(ended)]]
    assert done.stderr.startswith(b"rasterslice: error: nothing.txt")
