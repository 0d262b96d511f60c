"""The emulator as a program, on a real pseudo-terminal opened by pyserial as hardware is."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from select import EPOLLHUP, EPOLLIN, EPOLLOUT
from typing import Any, TypeVar

import pytest
import serial
from armrig_core.errors import OperationError
from armrig_daemon.emulator.line import Line, Terminal, _watch
from armrig_daemon.emulator.real_time import emulate
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol import decoder, frame
from armrig_protocol.frame import Spoilt, Unknown
from armrig_protocol.messages import (
    SCHEMA_HASH,
    VERSION,
    Ack,
    Arm,
    Code,
    Config,
    ConfigReply,
    Event,
    Exchange,
    Hello,
    HelloReply,
    Keepalive,
    Message,
    Mode,
    Sample,
    Start,
    State,
    Stop,
)

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
M = TypeVar("M", bound=Message)


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


class Port:
    """A host on the port, opened as the daemon opens it."""

    def __init__(self, emulator: Emulator) -> None:
        """Open it and send HELLO until it is answered, because the device is in BOOT first."""
        self.serial = serial.Serial(str(emulator.link), baudrate=BAUD, exclusive=True, timeout=0.05)
        self.pending, self.seq, self.waiting = b"", 0, list[Message]()
        end_s = time.monotonic() + PATIENCE_S
        self.hello: HelloReply | None = None
        while self.hello is None:
            assert time.monotonic() < end_s
            self.send(Hello, version=VERSION, schema=SCHEMA_HASH)
            self.hello = self.find(HelloReply, 0.1)

    def send(self, kind: type[Message], **fields: Any) -> None:
        """Send with the next seq."""
        self.seq += 1
        self.serial.write(frame.encode(kind(0, self.seq, **fields)))

    def find(self, kind: type[M], patience_s: float) -> M | None:
        """Return the next message of this kind, None after a timeout."""
        end_s = time.monotonic() + patience_s
        while time.monotonic() < end_s:
            while self.waiting:
                message = self.waiting.pop(0)
                if isinstance(message, kind):
                    return message
            data = self.serial.read(max(1, self.serial.in_waiting))
            self.pending, received = decoder.feed(self.pending, data)
            self.waiting += [m for m in received if not isinstance(m, (Spoilt, Unknown))]
        return None

    def ask(self, kind: type[Message], answer: type[M], **fields: Any) -> M:
        self.send(kind, **fields)
        found = self.find(answer, PATIENCE_S)
        assert found is not None
        return found

    def run(self, *, ts_us: int = 10_000, mode: int = Mode.EXCHANGE, k_stop: int = 0) -> None:
        """Go from IDLE to RUN."""
        config = self.ask(
            Config,
            ConfigReply,
            ts_us=ts_us,
            u_min=0,
            u_max=65535,
            u_rest=0,
            slew=0,
            watchdog_ms=250,
            mode=mode,
            underrun=0,
            hold=0,
            oversampling=1,
            rail_ticks=0,
            turns=0,
        )
        assert config.code == Code.OK
        boot_id, config_crc, nonce = self.hello.boot_id, config.config_crc, config.nonce
        armed = self.ask(Arm, Ack, boot_id=boot_id, config_crc=config_crc, nonce=nonce)
        assert armed.code == Code.OK
        assert self.ask(Start, Ack, k_stop=k_stop, nonce=nonce).code == Code.OK


@pytest.mark.real_time
def test_a_host_takes_the_rig_through_a_run(emulator: Emulator) -> None:
    port = Port(emulator)
    port.run()

    samples = [port.ask(Exchange, Sample, k=k, u=k * 6553) for k in range(1, 6)]
    port.ask(Stop, Ack)
    event = port.find(Event, PATIENCE_S)

    port.serial.close()
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
        port = Port(emulator)
        assert port.hello.state == State.IDLE
        boot_ids.add(port.hello.boot_id)
        port.run()
        port.ask(Exchange, Sample, k=1, u=65535)
        port.serial.close()

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
    """1500 samples, twice the capacity of the terminal."""
    came, idle_ns = _read_late(emulator)

    assert came == list(range(1500))
    assert idle_ns < 20_000_000


def _read_late(emulator: Emulator) -> tuple[list[int], int]:
    """Let 1500 samples be taken, and read none; return them, and what waiting cost then."""
    port = Port(emulator)
    port.run(ts_us=1000, mode=Mode.SCHEDULED, k_stop=1500)
    for _ in range(20):
        time.sleep(0.1)
        port.send(Keepalive)
    stat = Path(f"/proc/{emulator.process.pid}/schedstat")
    before_ns = int(stat.read_text().split()[0])
    time.sleep(0.5)
    idle_ns = int(stat.read_text().split()[0]) - before_ns

    came: list[int] = []
    while len(came) < 1500 and (sample := port.find(Sample, 1.0)) is not None:
        came.append(sample.k)
    return came, idle_ns


@pytest.mark.parametrize("number", sampled([signal.SIGTERM, signal.SIGINT]))
def test_a_signal_ends_it_and_takes_the_link_away(emulator: Emulator, number: int) -> None:
    assert emulator.stop(number) == 0
    assert not emulator.link.is_symlink()


def test_a_remaining_link_is_taken_over(tmp_path: Path) -> None:
    (tmp_path / "rig").symlink_to("/dev/pts/none")
    # The link is there from the start: wait until it points elsewhere.
    running = Emulator(tmp_path)
    end_s = time.monotonic() + PATIENCE_S
    while not running.link.exists() and time.monotonic() < end_s:
        time.sleep(0.01)
    assert Port(running).hello is not None
    assert running.stop() == 0


def test_a_file_is_not_taken_over(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")

    with (
        ExitStack() as stack,
        pytest.raises(OperationError, match=r"file: exists and is not a link; choose another"),
    ):
        Terminal(stack).offer(tmp_path / "file", stack)

    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("then", [EPOLLIN, EPOLLOUT, EPOLLIN | EPOLLOUT])
def test_a_port_whose_closing_was_reported_once_is_read_to_its_end(then: int) -> None:
    reader, writer = os.pipe()
    line = Line()
    line.fd, line.connected = reader, True
    os.write(writer, b"ab")
    os.close(writer)

    line.note_ready(EPOLLIN | EPOLLHUP)
    line.note_ready(then)

    assert (line.read(), line.has_input, line.connected) == (b"ab", True, True)
    assert (line.read(), line.has_input, line.connected) == (b"", False, False)
    os.close(reader)


def test_the_link_of_a_later_emulator_is_left_alone(tmp_path: Path) -> None:
    port = tmp_path / "rig"
    with ExitStack() as later_stack:
        with ExitStack() as stack:
            Terminal(stack).offer(port, stack)
            later = Terminal(later_stack)
            later.offer(port, later_stack)

        assert port.readlink() == later.slave

    assert list(tmp_path.iterdir()) == []


def test_a_port_that_cannot_be_watched_says_why(tmp_path: Path) -> None:
    before = {*Path("/proc/self/fd").iterdir()}

    with pytest.raises(OperationError, match=r"gone: inotify: No such file or directory"):
        _watch(tmp_path / "gone")

    assert {*Path("/proc/self/fd").iterdir()} <= before


def test_a_port_or_trace_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    settings = EmulatorSettings()

    with pytest.raises(OperationError, match=r"absent/rig: No such file"):
        emulate(tmp_path / "absent" / "rig", settings)
    with pytest.raises(OperationError, match=r"absent/trace: No such file"):
        emulate(tmp_path / "rig", settings, trace=tmp_path / "absent" / "trace")

    assert list(tmp_path.iterdir()) == []
