"""Modules that are loaded when something is asked of them: in processes of their own; pytest has loaded them."""

import subprocess
import sys
import tomllib
from pathlib import Path

START = """
import sys, threading, time
from rasterslice import lazily
lazily.begin()
lazy = lambda name: type(sys.modules[name]).__name__ == "_Lazy"
"""


def run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", START + code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_a_module_is_loaded_when_it_is_asked() -> None:
    code = """
import platform
print(lazy("platform"))
print(platform.python_version() == sys.version.split()[0], lazy("platform"))
print(platform.__spec__.loader is platform.__loader__, type(platform.__loader__).__name__)
import platform as again
print(again is platform, platform.__name__, hasattr(platform, "no such name"))
"""
    assert run(code).splitlines() == [
        "True", "True False", "True SourceFileLoader", "True platform False",
    ]  # fmt: skip


def test_numpy_and_archives_work() -> None:
    code = """
import numpy, shutil, pathlib, pickle, logging, traceback
print(lazy("shutil"), shutil.which("no such program"), lazy("shutil"))
print([name for name in ("numpy._core._add_newdocs", "bz2", "lzma", "pickle", "traceback") if lazy(name)])
print(pickle.loads(pickle.dumps(numpy.arange(3))).tolist(), traceback.format_exception_only(KeyError("k")))
import bz2, lzma, ipaddress, zipfile
print(bz2.decompress(bz2.compress(b"a")), lzma.decompress(lzma.compress(b"b")), ipaddress.ip_address("::1"))
print(numpy.arange(3).sum(), zipfile.is_zipfile(__import__("io").BytesIO(b"")))
"""
    archives, first, *others = run(code).splitlines()
    assert archives == "True None False"
    assert first == "['numpy._core._add_newdocs', 'bz2', 'lzma', 'pickle', 'traceback']"
    assert others == ["[0, 1, 2] [\"KeyError: 'k'\\n\"]", "b'a' b'b' ::1", "3 False"]


def test_types_have_stand_ins_until_others_are_asked_for() -> None:
    code = """
import numpy
from numpy.typing import ArrayLike, DTypeLike, NDArray
Alias = dict[str, NDArray[numpy.float64] | ArrayLike | None]
print(lazy("numpy.typing"), lazy("numpy._typing"), numpy.linalg.eigh([[1.0, 0.0], [0.0, 2.0]]).eigenvalues)
from numpy.typing import NBitBase
import numpy.typing
print(lazy("numpy.typing"), lazy("numpy._typing"), numpy.typing.NDArray[numpy.float64])
import numpy._typing._array_like
from numpy._typing import NDArray as real
print(real is numpy.typing.NDArray)
"""
    lines = run(code).splitlines()
    assert lines[0] == "True True [1. 2.]"
    assert lines[1].startswith("False False numpy.ndarray[")
    assert lines[2] == "True"


def test_some_who_ask_get_answers_and_others_the_module() -> None:
    code = """
from concurrent.futures import Future
from pathlib import Path
import numpy, inspect, logging, urllib.parse
print(lazy("inspect"), lazy("logging"), numpy.arange(2).sum())
print(Path("/a b").as_uri(), lazily._quote_from_bytes(b"/a b"), urllib.parse.unquote("a%20b"))
done = Future()
done.set_result(1)
sys.stderr = sys.stdout
done.add_done_callback(lambda _: 1 / 0)
print(lazy("logging"), inspect.cleandoc("a\\n    b"), inspect.signature(numpy.take) is not None)
"""
    lines = run(code).splitlines()
    assert lines[:2] == ["True True 1", "file:///a%20b /a%20b a b"]
    assert lines[2].startswith("exception calling callback") and lines[-3] == "ZeroDivisionError: division by zero"
    assert lines[-2:] == ["False a", "b True"]


def test_threads_that_ask_at_once_find_all_of_a_module() -> None:
    code = """
import platform
held = object.__getattribute__(platform, "__dict__")
loader = held["_loader"]
class Slow:
    def exec_module(self, module):
        time.sleep(0.2)
        loader.exec_module(module)
held["_loader"] = Slow()
found = []
threads = [threading.Thread(target=lambda: found.append(platform.system())) for _ in range(8)]
for thread in threads: thread.start()
for thread in threads: thread.join()
print(len(found), len(set(found)))
"""
    assert run(code) == "8 1"


def test_one_thread_imports_what_another_loads() -> None:
    """`shutil` imports `bz2` as it is loaded, while another thread is making that."""
    code = """
import os, shutil
create = lazily._Loader.create_module
def slowly(self, spec):
    module = create(self, spec)
    if spec.name == "bz2":
        begun.set()
        time.sleep(0.3)
    return module
lazily._Loader.create_module = slowly
begun = threading.Event()
def ask():
    begun.wait()
    found.append(shutil.which("no such program"))
found = []
targets = ask, lambda: __import__("zipfile")
threads = [threading.Thread(target=target, daemon=True) for target in targets]
for thread in threads: thread.start()
for thread in threads: thread.join(20)
print(found, [thread.is_alive() for thread in threads], sys.modules["zipfile"].bz2.compress is not None, flush=True)
os._exit(0)
"""
    assert run(code) == "[None] [False, False] True"


def test_submodules_may_be_imported_first() -> None:
    """Packages that are lazy, and the one that may not be."""
    code = """
import json.decoder, logging.handlers
print(json.decoder.JSONDecoder is json.JSONDecoder, logging.handlers.logging is logging, json.loads("[1]"))
"""
    assert run(code) == "True True [1]"


def test_a_module_that_cannot_be_loaded_says_so_when_it_is_asked() -> None:
    code = """
import bz2
class Broken:
    def exec_module(self, module):
        raise ImportError("no bz2 here")
object.__getattribute__(bz2, "__dict__")["_loader"] = Broken()
for _ in range(2):
    try:
        bz2.compress
    except ImportError as error:
        print(error)
"""
    assert run(code).splitlines() == ["no bz2 here"] * 2


def test_what_is_set_stays_and_a_module_can_be_loaded_again() -> None:
    code = """
import importlib, platform, traceback
platform.system = lambda: "set"
print(platform.system(), lazy("platform"))
traceback.extract_tb, old = None, traceback.extract_tb
importlib.reload(traceback)
print(traceback.extract_tb is not None, "_loader" in vars(traceback))
"""
    assert run(code).splitlines() == ["set False", "True False"]


def test_the_command_is_the_one_that_loads_lazily() -> None:
    code = """
import runpy, sys
sys.argv = ["rasterslice", "--version"]
try:
    runpy.run_module("rasterslice", run_name="__main__")
finally:
    print(sys.modules["rasterslice.lazily"]._Finder in sys.meta_path, flush=True)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.startswith("rasterslice ") and done.stdout.endswith("\nTrue\n"), done.stderr
    about = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
    assert about["project"]["scripts"] == {"rasterslice": "rasterslice.__main__:main"}


def test_others_load_as_ever() -> None:
    code = "import rasterslice.cli, shutil, bz2; print(type(bz2).__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "module"
