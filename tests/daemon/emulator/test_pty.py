"""The emulator as a program, on a real pseudo-terminal opened by pyserial as hardware is."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from select import EPOLLHUP, EPOLLIN, EPOLLOUT

import pytest
from armrig_core.errors import OperationError
from armrig_daemon.conformance.host import LineHost, only
from armrig_daemon.conformance.serial_line import SerialLine
from armrig_daemon.emulator.line import EmulatedLine, Terminal, _watch
from armrig_daemon.emulator.real_time import emulate
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol.messages import Event, Keepalive, Mode, Sample, Start, State, Stop

from tests.sampling import sampled

BAUD = 1_000_000
PATIENCE_S = 30.0
PROGRAM = """
import sys
from pathlib import Path
from armrig_daemon.emulator.real_time import emulate
from armrig_daemon.emulator.settings import EmulatorSettings
settings = EmulatorSettings(baud=1_000_000, boot_ms=5.0)
sys.exit(emulate(Path(sys.argv[1]), settings, trace=Path(sys.argv[2])))
"""


class Emulator:
    """The program, its link and its trace."""

    def __init__(self, folder: Path) -> None:
        """Start it, and wait until its link is there."""
        self.link, self.trace = folder / "rig", folder / "trace.csv"
        paths = os.pathsep.join(p for p in sys.path if p)
        self.process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(self.link), str(self.trace)],
            env={**os.environ, "PYTHONPATH": paths},
        )
        end_s = time.monotonic() + PATIENCE_S
        while not self.link.is_symlink():
            assert self.process.poll() is None
            assert time.monotonic() < end_s
            time.sleep(0.01)

    def stop(self, number: int = signal.SIGTERM) -> int:
        """Send a signal and return the exit code."""
        self.process.send_signal(number)
        return self.process.wait(PATIENCE_S)


@contextmanager
def _running(folder: Path) -> Iterator[Emulator]:
    running = Emulator(folder)
    yield running
    running.process.kill()
    running.process.wait()


@pytest.fixture
def emulator(tmp_path: Path) -> Iterator[Emulator]:
    """Run an emulator for one test."""
    with _running(tmp_path) as running:
        yield running


@contextmanager
def _host(emulator: Emulator) -> Iterator[LineHost]:
    """Open the port as the daemon does; the device is in BOOT first."""
    with closing(SerialLine(str(emulator.link), BAUD)) as line:
        host = LineHost(line, BAUD)
        host.hello(PATIENCE_S * 1000)
        yield host


@pytest.mark.real_time
def test_a_host_completes_a_run_over_the_pseudo_terminal(emulator: Emulator) -> None:
    with _host(emulator) as host:
        host.reach(State.RUN)
        samples = [host.sample(k * 6553) for k in range(1, 6)]
        event = only(Event, host.ask(Stop))

    assert emulator.stop() == 0
    assert [s.k for s in samples] == [1, 2, 3, 4, 5]
    assert [s.state for s in samples] == [State.RUN] * 5
    assert [s.u_km1 for s in samples[1:]] == [s.u_k for s in samples[:-1]]
    assert samples[-1].y0 > samples[0].y0
    assert event.state == State.IDLE
    lines = [line.split(",") for line in emulator.trace.read_text().splitlines()]
    # Ten bits: k * 6553 is 102.4 k steps of 5/1024 V.
    steps = [round(float(volts) * 1024 / 5) for _, volts, _, _ in lines]
    assert steps == [0, 102, 205, 307, 410, 512, 0]
    assert [state for _, _, state, _ in lines] == ["BOOT", *["RUN"] * 5, "IDLE"]
    assert [int(t) for t, _, _, _ in lines] == sorted(int(t) for t, _, _, _ in lines)


@pytest.mark.real_time
def test_opening_the_port_resets_the_device(emulator: Emulator) -> None:
    boot_ids = set()
    for _ in range(5):
        with _host(emulator) as host:
            assert host.state == State.IDLE
            boot_ids.add(host.known.boot_id)
            host.reach(State.RUN)
            host.sample(65535)

    assert len(boot_ids) == 5


def test_a_port_that_is_open_already_is_not_opened_again() -> None:
    with ExitStack() as stack:
        line = Terminal(stack)
        owner = os.open(line.slave, os.O_RDWR | os.O_NOCTTY)
        assert line.was_opened()

        other = os.open(line.slave, os.O_RDWR | os.O_NOCTTY)

        assert not line.was_opened()
        os.close(other)
        os.close(owner)


@pytest.mark.real_time
def test_a_reader_that_stalls_loses_nothing_at_first(emulator: Emulator) -> None:
    """1500 samples, twice the capacity of the terminal; waiting for the reader costs no time."""
    stat = Path(f"/proc/{emulator.process.pid}/schedstat")
    with _host(emulator) as host:
        host.reach(State.ARMED, ts_us=1000, mode=Mode.SCHEDULED)
        host.put(Start, k_stop=1500)
        for _ in range(20):
            time.sleep(0.1)
            host.put(Keepalive)
        before_ns = int(stat.read_text().split()[0])
        time.sleep(0.5)
        idle_ns = int(stat.read_text().split()[0]) - before_ns

        came = host.until(lambda m: isinstance(m, Sample) and m.k == 1499, "samples", 30_000)

    assert [m.k for m in came if isinstance(m, Sample)] == list(range(1500))
    assert idle_ns < 20_000_000


@pytest.mark.parametrize("number", sampled([signal.SIGTERM, signal.SIGINT]))
def test_a_signal_ends_the_emulator_and_removes_its_link(emulator: Emulator, number: int) -> None:
    assert emulator.stop(number) == 0
    assert not emulator.link.is_symlink()


def test_a_stale_link_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "rig").symlink_to("/dev/pts/none")
    # The link is there from the start: wait until it points elsewhere.
    running = Emulator(tmp_path)
    end_s = time.monotonic() + PATIENCE_S
    while not running.link.exists() and time.monotonic() < end_s:
        time.sleep(0.01)
    with _host(running) as host:
        assert host.known
    assert running.stop() == 0


@pytest.mark.parametrize("kind", ["file", "link to a file", "link to nothing"])
def test_only_an_emulator_s_link_is_replaced(kind: str, tmp_path: Path) -> None:
    port, mine = tmp_path / "port", tmp_path / "mine"
    mine.write_text("mine")
    if kind == "file":
        mine.rename(port)
    else:
        port.symlink_to(mine if kind == "link to a file" else tmp_path / "nothing")
    before = port.is_symlink() and port.readlink()

    with (
        ExitStack() as stack,
        pytest.raises(OperationError, match=r"port: exists and is no emulator's link; choose"),
    ):
        Terminal(stack).offer(port, stack)

    assert (port.is_symlink() and port.readlink()) == before
    assert mine.exists() or port.read_text() == "mine"


@pytest.mark.parametrize("then", [EPOLLIN, EPOLLOUT, EPOLLIN | EPOLLOUT])
def test_a_port_whose_closing_was_reported_once_is_read_to_its_end(then: int) -> None:
    reader, writer = os.pipe()
    line = EmulatedLine()
    line.fd, line.connected = reader, True
    os.write(writer, b"ab")
    os.close(writer)

    line.note_ready(EPOLLIN | EPOLLHUP)
    line.note_ready(then)

    assert (line.read(), line.has_input, line.connected) == (b"ab", True, True)
    assert (line.read(), line.has_input, line.connected) == (b"", False, False)
    os.close(reader)


def test_the_link_of_a_later_emulator_is_not_removed(tmp_path: Path) -> None:
    port = tmp_path / "rig"
    with ExitStack() as later_stack:
        with ExitStack() as stack:
            Terminal(stack).offer(port, stack)
            later = Terminal(later_stack)
            later.offer(port, later_stack)

        assert port.readlink() == later.slave

    assert list(tmp_path.iterdir()) == []


def test_a_port_that_cannot_be_watched_is_reported_with_the_reason(tmp_path: Path) -> None:
    before = {*Path("/proc/self/fd").iterdir()}

    with pytest.raises(OperationError, match=r"gone: inotify: No such file or directory"):
        _watch(tmp_path / "gone")

    assert {*Path("/proc/self/fd").iterdir()} <= before


def test_an_error_names_the_port_or_trace_that_cannot_be_created(tmp_path: Path) -> None:
    settings = EmulatorSettings()

    with pytest.raises(OperationError, match=r"absent/rig: No such file"):
        emulate(tmp_path / "absent" / "rig", settings)
    with pytest.raises(OperationError, match=r"absent/trace: No such file"):
        emulate(tmp_path / "rig", settings, trace=tmp_path / "absent" / "trace")

    assert list(tmp_path.iterdir()) == []
