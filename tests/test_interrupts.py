"""A request to end waits where nothing may be broken off, and comes through at its end."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from fakes import params_file, tree

from rasterslice.interrupts import signals, unbroken

pytestmark = pytest.mark.skipif(os.name != "posix", reason="sends POSIX signals")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_waits_until_the_end_of_the_outermost_block(number):
    seen = []
    with signals(), pytest.raises(KeyboardInterrupt):
        with unbroken():
            with unbroken():
                os.kill(os.getpid(), number)
                seen.append("inner")
            seen.append("outer")
        seen.append("after")
    assert seen == ["inner", "outer"]


def test_a_signal_comes_at_once_elsewhere_and_once():
    with signals():
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGTERM)
        with unbroken():
            pass
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_other_threads_hold_nothing():
    entered, leave = threading.Event(), threading.Event()

    def held():
        with unbroken():
            entered.set()
            leave.wait(20)

    thread = threading.Thread(target=held)
    thread.start()
    assert entered.wait(20)
    with signals(), pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
    leave.set()
    thread.join()


AMID = """
import os, signal, sys
from rasterslice.cli import main
class Interrupter:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r} and self in sys.meta_path:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupter())
code = main([{job!r}])
print("whole" if {name!r} in sys.modules else "broken off")
sys.exit(code)
"""


OURS = ("opening", "params", "reading", "device", "job", "slicer")


@pytest.mark.parametrize("name", ["numpy", *(f"rasterslice.{name}" for name in OURS)])
def test_no_import_is_broken_off(tmp_path: Path, name):
    """An import that is broken off may hang, abort or be swallowed: another thread imports, too."""
    job = params_file(tmp_path)
    before = tree(tmp_path)
    command = [sys.executable, "-c", AMID.format(name=name, job=str(job))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (130, "whole\n"), done.stderr
    assert done.stderr.replace("1 error generated.\n", "") == "rasterslice: error: interrupted\n"
    assert tree(tmp_path) == before and not list(tmp_path.glob(".*"))
