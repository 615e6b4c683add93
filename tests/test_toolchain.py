"""What PoCL needs of the machine: a linker, libraries to link, a cache, a known processor."""

from __future__ import annotations

import importlib.util
import os
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from rasterslice import processor, toolchain
from rasterslice.errors import DeviceError

ROOT = Path(__file__).parents[1]
NOWHERE = "/proc/nonexistent"  # not even root can make this folder
ZIG = importlib.util.find_spec("ziglang") is not None
POCL = importlib.util.find_spec("pocl_binary_distribution") is not None

needs_pocl = pytest.mark.skipif(
    not POCL, reason="the PoCL wheel is not installed"
)
needs_zig = pytest.mark.skipif(not ZIG, reason="ziglang is not installed (pip install 'rasterslice[linker]')")
posix = pytest.mark.skipif(os.name != "posix", reason="linker scripts are for /bin/sh")

BUILD = """
from rasterslice import toolchain
toolchain.prepare_environment()
import numpy as np, pyopencl as cl
device = next(d for p in cl.get_platforms() if p.name == toolchain.POCL for d in p.get_devices())
toolchain.prepare_pocl(device.version, device.int_ptr)
queue = cl.CommandQueue(cl.Context([device]))
source = "__kernel void k(__global float16 *a) { int i = get_global_id(0); a[i] = fmax(a[i], sqrt((float16)(i))); }"
kernel = cl.Kernel(cl.Program(queue.context, source).build(), "k")
host = np.zeros((64, 16), np.float32)
buffer = cl.Buffer(queue.context, cl.mem_flags.COPY_HOST_PTR, hostbuf=host)
kernel(queue, (64,), None, buffer)
cl.enqueue_copy(queue, host, buffer)
assert np.allclose(host, np.sqrt(np.arange(64, dtype=np.float32))[:, None], rtol=1e-6)
print("built")
"""


def run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python with nothing in its environment but what is given."""
    environment = {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1", **environment}
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code], env=environment, capture_output=True, text=True, timeout=120
    )


def program(folder: Path, name: str = "ld", text: str = "#!/bin/sh\nexit 0\n") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(text)
    path.chmod(0o755)
    return path


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[str], None]:
    """Give the process an empty PATH, no usual places, and caches of its own; the result sets PATH."""
    monkeypatch.setattr(toolchain, "USUAL_PLACES", ())
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    return lambda path: monkeypatch.setenv("PATH", path)


# ---------------------------------------------------------------- linker
@posix
def test_linker_on_path_is_called_with_stand_ins(bare: Callable[[str], None], tmp_path: Path) -> None:
    program(tmp_path / "bin", text='#!/bin/sh\necho real "$@"\n')
    bare(str(tmp_path / "bin"))
    script = toolchain.ensure_linker()
    said = subprocess.run([script, "-shared", "a b.o"], capture_output=True, text=True, check=True).stdout
    assert said == f"real -shared a b.o -L{script.parent}\n"
    assert {p.name for p in script.parent.iterdir()} == {"ld", "libc.a", "libgcc.a", "libgcc_s.a", "libm.a"}
    assert os.environ["PATH"].split(os.pathsep) == [str(script.parent), str(tmp_path / "bin")]


@posix
def test_second_call_changes_nothing(bare: Callable[[str], None], tmp_path: Path) -> None:
    program(tmp_path / "bin")
    bare(str(tmp_path / "bin"))
    script = toolchain.ensure_linker()
    path, written = os.environ["PATH"], script.stat().st_mtime_ns
    assert toolchain.ensure_linker() == script
    assert os.environ["PATH"] == path
    assert script.stat().st_mtime_ns == written


@posix
def test_linker_in_a_usual_place(bare: Callable[[str], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    real = program(tmp_path / "usual")
    monkeypatch.setattr(toolchain, "USUAL_PLACES", (str(tmp_path / "none"), str(tmp_path / "usual")))
    assert str(real) in toolchain.ensure_linker().read_text()


@posix
def test_names_with_blanks(bare: Callable[[str], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program(tmp_path / "my bin's", text="#!/bin/sh\necho $#\n")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "my cache's"))
    bare(str(tmp_path / "my bin's"))
    script = toolchain.ensure_linker()
    assert subprocess.run([script, "x"], capture_output=True, text=True, check=True).stdout == "2\n"


def test_no_linker_is_a_device_error_with_the_remedy(
    bare: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(DeviceError, match=r'no linker "ld" on PATH.*rasterslice\[linker\].*binutils') as caught:
        toolchain.ensure_linker()
    assert caught.value.exit_code == 5
    assert os.environ["PATH"] == ""


@posix
def test_ziglang_that_does_not_run_is_a_device_error(
    bare: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(sys, "executable", "/nonexistent/python")
    with pytest.raises(DeviceError, match=r"ziglang does not run.*binutils"):
        toolchain.ensure_linker()


@posix
def test_linker_is_taken_as_it_is_where_scripts_cannot_run(
    bare: Callable[[str], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    real = program(tmp_path / "usual", text="#!/bin/sh\nexit 1\n")
    monkeypatch.setattr(toolchain, "USUAL_PLACES", (str(tmp_path / "usual"),))
    assert toolchain.ensure_linker() == real
    assert os.environ["PATH"] == str(tmp_path / "usual")


@posix
@pytest.mark.skipif(toolchain._find_linker() is None, reason="no ld on this machine")
def test_real_linker_finds_the_libraries_of_a_compiler(bare: Callable[[str], None], tmp_path: Path) -> None:
    bare("/usr/bin:/bin:/usr/local/bin")
    script = toolchain.ensure_linker()
    asked = ["-lgcc", "--as-needed", "-lgcc_s", "--no-as-needed", "-lc"]
    subprocess.run([script, "-nostdlib", "-shared", "-o", tmp_path / "x.so", *asked], check=True)
    assert (tmp_path / "x.so").stat().st_size > 0


# ---------------------------------------------------------------- cache
def test_cache_that_works_is_left_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path / "pocl"))
    assert toolchain.ensure_cache() == tmp_path / ".cache"
    assert "XDG_CACHE_HOME" not in os.environ
    assert os.environ["POCL_CACHE_DIR"] == str(tmp_path / "pocl")


@posix
@pytest.mark.parametrize("name", ["HOME", "XDG_CACHE_HOME"])
def test_cache_that_cannot_be_written_is_replaced(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv(name, NOWHERE)
    monkeypatch.setenv("POCL_CACHE_DIR", NOWHERE)
    folder = toolchain.ensure_cache()
    assert folder.parent == tmp_path
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert os.environ["XDG_CACHE_HOME"] == str(folder)
    assert "POCL_CACHE_DIR" not in os.environ
    assert toolchain.ensure_cache() == folder


@posix
@pytest.mark.parametrize("taken", ["file", "link", "open to all"])
def test_private_folder_is_never_one_that_others_can_write(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, taken: str
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("POCL_CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", NOWHERE)
    name = tmp_path / f"rasterslice-cache-{os.getuid()}"
    if taken == "file":
        name.touch()
    elif taken == "link":
        (tmp_path / "elsewhere").mkdir()
        name.symlink_to(tmp_path / "elsewhere")
    else:
        name.mkdir()
        name.chmod(0o777)
    folder = toolchain.ensure_cache()
    assert folder != name
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


@posix
def test_no_folder_at_all_is_a_device_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", NOWHERE)
    monkeypatch.setenv("XDG_CACHE_HOME", NOWHERE)
    with pytest.raises(DeviceError, match=r"no folder for compiled kernels can be written.*set XDG_CACHE_HOME"):
        toolchain.ensure_cache()


# ---------------------------------------------------------------- processor
@pytest.mark.parametrize(
    "version",
    ["", "OpenCL 3.0 CUDA", "OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-znver3",
     "OpenCL 3.0 PoCL HSTR: pthread-aarch64-unknown-linux-gnu-generic"],
)  # fmt: skip
def test_known_processors_are_left_alone(version: str) -> None:
    assert processor.ensure_cpu(version, 8) is None


@pytest.mark.parametrize("handle", [0, 8, 2**63])
def test_record_that_is_none_is_a_device_error_and_no_crash(handle: int) -> None:
    with pytest.raises(DeviceError, match="PoCL does not know this processor"):
        processor.ensure_cpu("OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-generic", handle)


@pytest.mark.parametrize(
    ("flags", "name"),
    [
        ("avx512f avx512bw avx512cd avx512dq avx512vl avx2 avx sse4_1", "skylake-avx512"),
        ("avx2 fma f16c abm bmi1 bmi2 avx ssse3", "haswell"),
        ("avx sse4_1 ssse3", "sandybridge"),
        ("sse2", "x86-64"),
    ],
)
def test_processor_is_named_after_its_abilities(flags: str, name: str) -> None:
    assert processor._cpu_name(set(flags.split())) == name


# ---------------------------------------------------------------- PoCL itself, with nothing in the environment
@needs_pocl
@pytest.mark.skipif(toolchain._find_linker() is None, reason="no ld on this machine")
@pytest.mark.parametrize(
    "environment",
    [{"PATH": "", "HOME": NOWHERE}, {"PATH": NOWHERE, "XDG_CACHE_HOME": NOWHERE, "POCL_CACHE_DIR": NOWHERE}, {}],
    ids=["nothing", "nowhere", "unset"],
)
def test_kernel_is_built_with_nothing_in_the_environment(environment: dict[str, str], tmp_path: Path) -> None:
    done = run(BUILD, TMPDIR=str(tmp_path), **environment)
    assert (done.returncode, done.stdout) == (0, "built\n"), done.stderr


@needs_pocl
def test_no_linker_stops_before_pocl_kills_the_process(tmp_path: Path) -> None:
    hide = (
        "import importlib.util; from rasterslice import toolchain; toolchain.USUAL_PLACES = ()\n"
        "find = importlib.util.find_spec\n"
        "importlib.util.find_spec = lambda name, *a: None if name == 'ziglang' else find(name, *a)\n"
    )
    done = run(hide + BUILD, PATH="", XDG_CACHE_HOME=str(tmp_path))
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith('rasterslice.errors.DeviceError: no linker "ld" on PATH')


@needs_pocl
@needs_zig
def test_kernel_is_built_with_the_linker_of_ziglang(tmp_path: Path) -> None:
    hide = "from rasterslice import toolchain; toolchain.USUAL_PLACES = ()\n"
    done = run(hide + BUILD, PATH="", HOME=NOWHERE, TMPDIR=str(tmp_path))
    assert (done.returncode, done.stdout) == (0, "built\n"), done.stderr
    scripts = list(tmp_path.rglob("ld"))
    assert len(scripts) == 1
    assert "ziglang ld.lld" in scripts[0].read_text()


# ---------------------------------------------------------------- PoCL before it is needed
def test_pocl_is_loaded_beside_the_imports() -> None:
    code = "from rasterslice import toolchain; toolchain.load_pocl(); import sys; "
    code += "print('pyopencl' in sys.modules, sum('libpocl' in line for line in open('/proc/self/maps')) > 0)"
    assert run(code, PATH=os.environ["PATH"]).stdout.split() == ["False", str(POCL)]


@pytest.mark.parametrize("there", [True, False], ids=["no library", "no package"])
def test_what_cannot_be_loaded_waits_until_it_is_needed(
    there: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    if there:
        (tmp_path / "pyopencl" / ".libs").mkdir(parents=True)
        (tmp_path / "pyopencl" / ".libs" / "libpocl-0.so").write_text("no library")
    monkeypatch.setattr(sys, "path", [str(tmp_path), "", str(tmp_path / "none")])
    toolchain.load_pocl()


@posix
def test_the_linker_is_tried_once_and_its_stand_ins_are_always_there(
    bare: Callable[[str], None], tmp_path: Path
) -> None:
    log = tmp_path / "log"
    program(tmp_path / "bin", text=f'#!/bin/sh\necho called >> "{log}"\n')
    bare(str(tmp_path / "bin"))
    first = toolchain.ensure_linker()
    (first.parent / "libgcc.a").unlink()
    assert toolchain.ensure_linker() == first
    assert log.read_text() == "called\n"
    assert sorted(p.name for p in first.parent.iterdir()) == ["ld", "libc.a", "libgcc.a", "libgcc_s.a", "libm.a"]


@posix
def test_a_file_that_cannot_take_its_name_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "taken" / "inside").mkdir(parents=True)
    with pytest.raises(OSError, match="taken"):
        toolchain.write_whole(tmp_path / "taken", b"data", 0o600)
    assert [p.name for p in tmp_path.iterdir()] == ["taken"]
