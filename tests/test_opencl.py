"""The compiled module of pyopencl does alone, and gets along with the rest of it."""

import subprocess
import sys
from pathlib import Path

import meshfiles
import models
import pytest

from rasterslice import opencl
from rasterslice.errors import DeviceError

ROOT = Path(__file__).parent.parent

SLICE = """
import sys
from rasterslice import opencl, slicer
from rasterslice.params import Params
opencl.alone = {alone}
layers = list(slicer.slice(Params(({mesh!r},))))
print(len(layers), sorted(name for name in sys.modules if name.startswith(("pyopencl", "pytools"))))
"""
WHOLE = """
import numpy as np, pyopencl as cl
from rasterslice.device import Device
device, host = Device(), np.arange(4, dtype=np.int32)
buffer = cl.Buffer(device._context, cl.mem_flags.COPY_HOST_PTR, hostbuf=host)
source = "__kernel void twice(__global int *a, int b) { a[get_global_id(0)] *= b; }"
cl.Program(device._context, source).build(cache_dir=False).twice(device._queue, (4,), None, buffer, np.int32(3))
cl.enqueue_copy(device._queue, host, buffer)
print(host.tolist(), device._context.devices == [device._opened.device])
"""
BESIDE = """
import threading, time
found = []
def beside():
    time.sleep({delay})
    import pyopencl as cl
    (device, *_), *_ = [p.get_devices() for p in cl.get_platforms()]
    found.append(cl.Context([device]).devices == [device])
thread = threading.Thread(target=beside)
thread.start()
from rasterslice import slicer
from rasterslice.params import Params
layers = list(slicer.slice(Params(({mesh!r},))))
thread.join()
print(*found, len(layers) > 1)
"""
WRONG = """
import sys
from rasterslice import opencl, opening
opencl.alone = True
opening.compose = lambda: "__kernel void k(__global int *a) { a[0] = nothing; }"
try:
    opening.open_device().built.result()
except Exception as error:
    print(type(error).__name__, error)
"""
LACKING = """
import contextlib, sys, types
from rasterslice import opencl, opening
opencl.alone = True
@contextlib.contextmanager
def lacking():
    sys.modules["pyopencl"] = types.ModuleType("pyopencl")
    try:
        yield
    finally:
        used.append(sys.modules.pop("pyopencl").__name__)
used, opencl._stand_in = [], lacking
program = opening.open_device().built.result()
print(used, program.kernel("sum_rows").function_name.rsplit("_", 1)[0])
"""


def run(code: str) -> str:
    """Run Python in a process that has imported nothing; return what it prints."""
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert not done.returncode, done.stderr
    return done.stdout


@pytest.fixture
def mesh(tmp_path: Path) -> str:
    (tmp_path / "cube.stl").write_bytes(meshfiles.stl(models.triangles("cube")))
    return str(tmp_path / "cube.stl")


def test_the_command_line_imports_the_compiled_module_alone(mesh: str) -> None:
    count, modules = run(SLICE.format(mesh=mesh, alone=True)).split(" ", 1)
    assert int(count) > 1 and modules == "['pyopencl._cl']\n"


def test_in_a_process_of_somebody_else_pyopencl_is_imported_whole(mesh: str) -> None:
    _, modules = run(SLICE.format(mesh=mesh, alone=False)).split(" ", 1)
    assert "'pyopencl'," in modules and "'pytools'," in modules


def test_the_command_line_says_that_it_is_alone() -> None:
    code = "import sys; sys.argv[1:] = ['--version']\nfrom rasterslice import cli, opencl\nprint(opencl.alone)\n"
    code += "cli.leave = lambda code: print(opencl.alone)\ntry: cli.main()\nexcept SystemExit: print(opencl.alone)\n"
    assert run(code).splitlines()[0] == "False" and run(code).splitlines()[-1] == "True"


@pytest.mark.parametrize("delay", [0.0, 0.01, 0.02, 0.03, 0.04])
def test_another_thread_may_import_pyopencl_while_slicing_begins(mesh: str, delay: float) -> None:
    assert run(BESIDE.format(mesh=mesh, delay=delay)) == "True True\n"


def test_pyopencl_works_after_slicing_and_before(mesh: str) -> None:
    for alone in (True, False):
        slicing = SLICE.format(mesh=mesh, alone=alone)
        assert run(slicing + WHOLE).splitlines()[1:] == ["[0, 3, 6, 9] True"]
        assert run(WHOLE + slicing).startswith("[0, 3, 6, 9] True\n")


def test_the_compiler_is_quoted_though_pyopencl_was_not_imported() -> None:
    said = run(WRONG)
    assert said.startswith("DeviceError device ") and "cannot build the kernels" in said and "'nothing'" in said


def test_where_the_stand_in_does_not_do_pyopencl_makes_the_kernels() -> None:
    assert run(LACKING) == "['pyopencl'] sum_rows\n"


@pytest.mark.parametrize("where", ["_INNER", "_INNER_KERNEL"])
def test_a_module_that_is_not_known_is_refused(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opencl, where, ("_missing",))
    with pytest.raises(DeviceError, match=r"pyopencl 20.* has no _missing, which .* pip install 'pyopencl<2027'"):
        opencl.load()
