"""Both transports over a pty, with every fault that a line has; and against C-Kermit where there is one."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import shutil
import socket
import subprocess
import sys
import threading
import tty
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fakes import washer
from wires import Far, Faults, controller, receive

from rasterslice.cli import main
from rasterslice.cobra.bundle import write_bundle
from rasterslice.cobra.kermit import Packets, check1, check3, packet, quote, serve, unquote
from rasterslice.cobra.port import Closed, open_port
from rasterslice.cobra.sender import frame, running_sums, send_file, sums
from rasterslice.cobra.vplus import Stop
from rasterslice.errors import UsageError
from rasterslice.profile import read_profile
from rasterslice.trajectory import Planner

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs a pty")


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("job") / "washer.cobra"
    layers = [washer(k, 0.2 + 0.4 * k) for k in range(5)]
    write_bundle(layers, folder, Planner(read_profile(), 0.4), "washer", (1.5, 1.5))
    return folder


@pytest.fixture
def disk(tmp_path: Path) -> Path:
    (tmp_path / "disk").mkdir()
    return tmp_path / "disk"


FAULTS = {
    "a sound line": lambda: Faults(),
    "64 flipped bits": lambda: Faults.spread("flip", 64, 20_000),
    "lost bytes": lambda: Faults.spread("lose", 24, 20_000),
    "doubled bytes": lambda: Faults.spread("double", 24, 20_000),
    "delays": lambda: Faults.spread("delay", 24, 20_000),
}


@pytest.mark.parametrize("name", FAULTS)
def test_send_through_faults(bundle: Path, disk: Path, name: str) -> None:
    file = bundle / "WASHER.RSD"
    with controller(receive(bundle, disk), FAULTS[name]()) as port, open_port(port, 9600, 2.0) as line:
        report = send_file(line, file, timeout=0.1, tries=10)
    assert (disk / file.name).read_bytes() == file.read_bytes()
    assert report["records"] == file.read_bytes().count(b"\r\n")
    assert (report["repeats"] > 0) == (name not in ("a sound line", "delays")) or name == "delays"


def test_send_goes_on_after_a_broken_line(bundle: Path, disk: Path) -> None:
    file = bundle / "WASHER.RSD"
    gone, here = threading.Event(), receive(bundle, disk)

    def unplug(number: int, total: int) -> None:
        if number == 40 and not gone.is_set():
            gone.set()
            raise Closed("unplugged")

    with controller(here) as port:
        with open_port(port, 9600, 2.0) as line, pytest.raises(Closed):
            send_file(line, file, 0.2, 5, False, unplug)
        with open_port(port, 9600, 2.0) as line:
            report = send_file(line, file, 0.2, 5, True)
    assert report["first"] == 41
    assert (disk / file.name).read_bytes() == file.read_bytes()


def test_resume_of_another_file_is_refused(bundle: Path, disk: Path, tmp_path: Path) -> None:
    other = tmp_path / "OTHER.RSD"
    other.write_bytes(b"RSD 1\r\n" * 60)

    def stop(number: int, total: int) -> None:
        if number == 40:
            raise Closed("unplugged")

    with controller(receive(bundle, disk)) as port:
        with open_port(port, 9600, 2.0) as line, pytest.raises(Closed):
            send_file(line, other, 0.2, 5, False, stop)
        with open_port(port, 9600, 2.0) as line, pytest.raises(UsageError, match="another file"):
            send_file(line, bundle / "WASHER.RSD", 0.2, 5, True)


def test_resume_of_another_export_of_the_same_name_is_refused(bundle: Path, disk: Path, tmp_path: Path) -> None:
    """The line at which the first broke off is the same in both; an earlier one is not, or two have changed places."""
    file = bundle / "WASHER.RSD"
    lines = file.read_bytes().split(b"\r\n")
    assert lines[10] != lines[11]
    digit = [*lines[:10], lines[10][:-1] + bytes([lines[10][-1] ^ 1]), *lines[11:]]
    swapped = [*lines[:10], lines[11], lines[10], *lines[12:]]

    def stop(number: int, total: int) -> None:
        if number == 40:
            raise Closed("unplugged")

    for k, changed in enumerate((digit, swapped)):
        assert changed[39] == lines[39]
        other = tmp_path / str(k) / file.name
        other.parent.mkdir()
        other.write_bytes(b"\r\n".join(changed))
        with controller(receive(bundle, disk)) as port:
            with open_port(port, 9600, 2.0) as line, pytest.raises(Closed):
                send_file(line, other, 0.2, 5, False, stop)
            with (
                open_port(port, 9600, 2.0) as line,
                pytest.raises(UsageError, match=r"holds 40 lines of another WASHER\.RSD; begin anew, without --resume"),
            ):
                send_file(line, file, 0.2, 5, True)


def test_resume_under_another_name_is_refused(bundle: Path, disk: Path, tmp_path: Path) -> None:
    other = tmp_path / "OTHER.RSD"
    other.write_bytes((bundle / "WASHER.RSD").read_bytes())

    def stop(number: int, total: int) -> None:
        if number == 40:
            raise Closed("unplugged")

    with controller(receive(bundle, disk)) as port:
        with open_port(port, 9600, 2.0) as line, pytest.raises(Closed):
            send_file(line, other, 0.2, 5, False, stop)
        with open_port(port, 9600, 2.0) as line, pytest.raises(UsageError, match=r"another file, OTHER\.RSD, 40 lines"):
            send_file(line, bundle / "WASHER.RSD", 0.2, 5, True)


def test_sums_of_the_receiver_stay_within_its_numbers() -> None:
    worst = [b"\x7f" * 72] * 3000
    assert 2 * (4_194_301 - 1) + sums(4_000_000, worst[0])[0] < 2**24
    assert running_sums(worst)[-1] < 4_194_301
    assert len(set(running_sums(worst))) > 2990


def test_a_line_that_closes(bundle: Path, disk: Path) -> None:
    with (
        controller(receive(bundle, disk), Faults(cut=3000)) as port,
        open_port(port, 9600, 2.0) as line,
        pytest.raises(UsageError, match=r"line was closed|no answer|not taken"),
    ):
        send_file(line, bundle / "WASHER.RSD", 0.1, 3)


def test_a_silent_line(bundle: Path) -> None:
    with (
        controller(lambda far: far.line() and None) as port,
        open_port(port, 9600, 2.0) as line,
        pytest.raises(UsageError, match=r"no answer after 2 tries.*rs\.recv running.*--resume"),
    ):
        send_file(line, bundle / "WASHER.RSD", 0.05, 2)


def test_a_client_that_never_calls(bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with controller(lambda far: None) as port:
        assert main(["cobra", "serve", str(bundle), "--port", port, "--wait", "0.2", "--timeout", "0.05"]) == 2
    assert "the line is silent for 0.2 s" in capsys.readouterr().err


def test_the_command_line_sends(bundle: Path, disk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with controller(receive(bundle, disk)) as port:
        assert main(["cobra", "send", str(bundle), "--port", port, "--baud", "38400"]) == 0
    said = capsys.readouterr()
    assert said.out.startswith("sent ")
    assert "records" in said.err
    assert (disk / "WASHER.RSD").read_bytes() == (bundle / "WASHER.RSD").read_bytes()


@pytest.mark.parametrize("name", ["64 flipped bits", "lost bytes", "doubled bytes"])
def test_the_command_line_sends_through_faults(
    bundle: Path, disk: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with controller(receive(bundle, disk), FAULTS[name]()) as port:
        argv = ["cobra", "send", str(bundle), "--port", port, "--timeout", "0.1", "--tries", "20", "--json"]
        assert main(argv) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["repeats"] > 0
    assert "error" not in said.err
    assert (disk / "WASHER.RSD").read_bytes() == (bundle / "WASHER.RSD").read_bytes()


def test_the_command_line_resumes(bundle: Path, disk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The line is dead from some byte on, and sound again for the second command; rs.recv ran all the time."""
    faults = Faults(dict.fromkeys(range(8000, 30_000), "lose"))
    with controller(receive(bundle, disk), faults) as port:
        argv = ["cobra", "send", str(bundle), "--port", port, "--timeout", "0.1", "--tries", "3"]
        assert main(argv) == 2
        error = capsys.readouterr().err.splitlines()[-1]
        assert "no answer after 3 tries of 0.1 s" in error
        assert "--resume" in error
        faults.at.clear()
        assert main([*argv, "--resume", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert 20 < report["first"] < report["records"]
    assert (disk / "WASHER.RSD").read_bytes() == (bundle / "WASHER.RSD").read_bytes()


def test_the_command_line_sends_to_a_device_server(bundle: Path, disk: Path) -> None:
    """A serial line behind a network box: any URL of pyserial will do."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def work() -> None:
            connection, _ = server.accept()
            with connection, contextlib.suppress(Stop):
                receive(bundle, disk)(Far(connection.fileno(), Faults()))

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        port = f"socket://127.0.0.1:{server.getsockname()[1]}"
        assert main(["cobra", "send", str(bundle), "--port", port, "--quiet"]) == 0
        thread.join(10)
    assert (disk / "WASHER.RSD").read_bytes() == (bundle / "WASHER.RSD").read_bytes()


def test_a_disk_that_cannot_be_written(bundle: Path, disk: Path) -> None:
    with (
        controller(receive(bundle, disk / "missing")) as port,
        open_port(port, 9600, 2.0) as line,
        pytest.raises(UsageError, match="cannot open the file, status -508"),
    ):
        send_file(line, bundle / "WASHER.RSD", 0.2, 2)


def test_two_flips_in_a_line_are_always_found() -> None:
    rng = np.random.default_rng(5)
    for _ in range(3000):
        good = frame(int(rng.integers(1, 9999)), bytes(rng.integers(32, 127, 20, np.uint8).tolist()))
        bad = bytearray(good)
        for at in rng.choice(len(good) - 1, 2, replace=False):
            bad[at] ^= 1 << int(rng.integers(0, 8))
        n, w, s, record = (bytes(bad).rstrip(b"\n").split(b":", 3) + [b""] * 4)[:4]
        if all(x.isdigit() for x in (n, w, s)) and bytes(bad) != good:
            assert frame(int(n), record) != b"%d:%d:%d:%s\n" % (int(n), int(w), int(s), record)


@pytest.mark.parametrize(
    ("port", "message"),
    [
        ("/dev/rasterslice-none", "no such port"),
        ("socket://127.0.0.1:1", "cannot be opened"),
        ("nonsense://x", "cannot be opened"),
    ],
)
def test_ports_that_cannot_be_opened(bundle: Path, port: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("send", "serve"):
        assert main(["cobra", command, str(bundle), "--port", port]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1


def test_a_port_that_is_busy(bundle: Path) -> None:
    with (
        controller(lambda far: None) as port,
        open_port(port, 9600, 1.0),
        pytest.raises(UsageError, match="busy"),
        open_port(port, 9600, 1.0),
    ):
        pass


class Client:
    """A Kermit client, as V+ has one: one packet at a time."""

    def __init__(self, far: Far, check: str) -> None:
        self._far, self._check, self.packets = far, check, Packets(far)

    def get(self, name: str) -> bytes:
        """Return a file; raises LookupError with the server's words."""
        init = bytes([94 + 32, 10 + 32, 32, 64, 13 + 32]) + b"#N" + self._check.encode()
        content, seq, tries = bytearray(), 0, 0
        self.packets.check = 1
        self.packets.send(0, "R", name.encode(), 1)
        while tries < 100:
            got = self.packets.receive(0.1)
            if got is None:
                tries += 1
                if not seq:
                    self.packets.send(0, "R", name.encode(), 1)
                else:
                    self.packets.send(seq % 64, "N")
                continue
            number, kind, data = got
            if kind == "E":
                raise LookupError(data.decode())
            if number == seq % 64 and kind in "SFDZB":
                self.packets.send(number, "Y", init if kind == "S" else b"", 1 if kind == "S" else None)
                self.packets.check = int(self._check)
                content += unquote(data) if kind == "D" else b""
                seq += 1
                if kind == "B":
                    return bytes(content)
            elif number == (seq - 1) % 64 and kind in "SFDZB":  # our answer was lost
                self.packets.send(number, "Y", init if kind == "S" else b"", 1 if kind == "S" else None)
        raise LookupError("silence")

    def finish(self) -> None:
        self.packets.check = 1
        for _ in range(20):
            self.packets.send(0, "G", b"F", 1)
            got = self.packets.receive(0.2)
            if got and got[1] == "Y":
                return


@pytest.mark.parametrize("check", ["1", "3"])
@pytest.mark.parametrize("name", FAULTS)
def test_serve_through_faults(bundle: Path, name: str, check: str) -> None:
    weak = check == "1" and name == "64 flipped bits"  # six bits of check: two flips in a packet may pass
    faults = Faults.spread("flip", 8, 20_000) if weak else FAULTS[name]()
    got: dict[str, bytes] = {}

    def client(far: Far) -> None:
        c = Client(far, check)
        got["WASHER.RSD"] = c.get("K>washer.rsd")
        c.finish()

    said: list[str] = []
    with controller(client, faults) as port, open_port(port, 9600, 2.0) as line:
        served = serve(line, bundle, said.append, True, 0.3)
    assert got["WASHER.RSD"] == (bundle / "WASHER.RSD").read_bytes()
    assert served == ["WASHER.RSD"]


def test_the_server_gives_nothing_else(bundle: Path) -> None:
    (bundle.parent / "secret").write_text("x")
    answers = []

    def client(far: Far) -> None:
        c = Client(far, "3")
        for name in ("../secret", "missing.v2", "/etc/passwd"):
            try:
                c.get(name)
            except LookupError as error:
                answers.append(str(error))
        c.packets.send(0, "S", b"~* @-#N1", 1)
        got = c.packets.receive(1.0)
        answers.append(got[2].decode() if got else "silence")
        c.finish()

    with controller(client) as port, open_port(port, 9600, 2.0) as line:
        assert serve(line, bundle, lambda text: None, True, 0.3) == []
    assert answers == ["no such file"] * 3 + ["this server only gives files"]


def test_checks_and_quoting() -> None:
    assert packet(0, "R", b"a") == b"\x01$ Ra" + check1(b"$ Ra") + b"\r"
    assert check3(b"") == b"   "
    every = bytes(range(256))
    assert unquote(b"".join(quote(every))) == every
    assert all(32 <= b & 0x7F < 127 for b in b"".join(quote(every)))


@contextlib.contextmanager
def bridge(faults: Faults) -> Iterator[tuple[str, str]]:
    """Two ptys with a wire between them."""
    a, near = pty.openpty()
    b, other = pty.openpty()
    for fd in (a, near, b, other):
        tty.setraw(fd)
    stop = threading.Event()

    def carry() -> None:
        import select

        while not stop.is_set():
            for fd in select.select([a, b], [], [], 0.02)[0]:
                os.write(b if fd == a else a, faults.through(os.read(fd, 4096)))

    thread = threading.Thread(target=carry, daemon=True)
    thread.start()
    try:
        yield os.ttyname(near), os.ttyname(other)
    finally:
        stop.set()
        thread.join(5)
        for fd in (a, b, near, other):
            os.close(fd)


@pytest.mark.skipif(shutil.which("kermit") is None, reason="C-Kermit is not installed")
@pytest.mark.parametrize("flips", [0, 64])
def test_c_kermit_takes_the_files(bundle: Path, disk: Path, flips: int) -> None:
    faults = Faults.spread("flip", flips, 15_000) if flips else Faults()
    with bridge(faults) as (near, other), open_port(near, 9600, 2.0) as line:
        server = threading.Thread(target=serve, args=(line, bundle, lambda text: None, True, 1.0), daemon=True)
        server.start()
        script = (
            f"set line {other}\nset carrier-watch off\nset flow none\nset parity none\nset file type binary\n"
            "set block-check 3\nset receive timeout 1\nset send timeout 1\nset retry 60\nset file collision overwrite\n"
            "get WASHER.RSD\nget RSPLAY.V2\nfinish\nexit\n"
        )
        (disk / "take.ksc").write_text(script)
        subprocess.run(["kermit", "take.ksc"], cwd=disk, timeout=120, stdin=subprocess.DEVNULL, capture_output=True,
                       check=False)  # fmt: skip
        server.join(5)
    for name in ("WASHER.RSD", "RSPLAY.V2"):
        found = next(f for f in disk.iterdir() if f.name.upper() == name)
        assert found.read_bytes() == (bundle / name).read_bytes()


@pytest.mark.skipif(shutil.which("kermit") is None, reason="C-Kermit is not installed")
@pytest.mark.parametrize("check", [1, 3])
def test_the_command_line_serves_c_kermit(
    bundle: Path, disk: Path, check: int, capsys: pytest.CaptureFixture[str]
) -> None:
    names = sorted(f.name for f in bundle.iterdir())
    with bridge(Faults()) as (near, other):
        argv = ["cobra", "serve", str(bundle), "--port", near, "--wait", "30", "--timeout", "1"]
        codes: list[int] = []
        server = threading.Thread(target=lambda: codes.append(main(argv)), daemon=True)
        server.start()
        script = f"set line {other}\nset carrier-watch off\nset flow none\nset parity none\nset block-check {check}\n"
        script += "set file type binary\nset file collision overwrite\nset receive timeout 1\nset retry 60\n"
        script += "".join(f"get {name}\n" for name in [*names, "MISSING.RSD"]) + "finish\nexit\n"
        (disk / "take.ksc").write_text(script)
        subprocess.run(["kermit", "take.ksc"], cwd=disk, timeout=120, stdin=subprocess.DEVNULL, capture_output=True,
                       check=False)  # fmt: skip
        server.join(20)
    assert codes == [0]
    said = capsys.readouterr()
    assert said.out == f"served {', '.join(names)}\n"
    assert "MISSING.RSD: asked for, not there" in said.err
    taken = {f.name.upper(): f.read_bytes() for f in disk.iterdir()}
    for name in names:
        assert taken[name.upper()] == (bundle / name).read_bytes()
