"""ESTOP to a device, on a real pseudo-terminal with the emulated device."""

from __future__ import annotations

import fcntl
import os
import select
import threading
import time
from types import SimpleNamespace

import pytest
from armrig_daemon.command_line import _has_failed
from armrig_daemon.loop import estop as estop_module
from armrig_daemon.loop.estop import WITHIN_S, estop
from armrig_daemon.loop.link import Link, NoPortError, TakenPortError
from armrig_protocol.decoder import feed
from armrig_protocol.frame import Spoilt, encode
from armrig_protocol.messages import TYPES, Ack, Cause, Code, Estop, Event
from armrig_protocol.messages import State as DeviceState

BAUD = 115_200
BOOTED = Event(DeviceState.IDLE, 0, 1, DeviceState.BOOT, Cause.POWER_ON, 0, 0, 0)


def _patient(terminal: tuple[int, str]) -> bool:
    """Send ESTOP, and wait longer for the port and for an answer than the command does."""
    return estop(terminal[1], BAUD, within_s=30.0, port_wait_s=30.0)


class Device:
    """Device that reads the bytes after `pending`, and answers the n-th frame.

    If `boots`, it reports after the third frame that it has booted.
    """

    def __init__(
        self, master: int, answered: int, pending: bytes = b"", *, boots: bool = False
    ) -> None:
        self.heard: list[object] = []
        self._master, self._answered, self._pending = master, answered, pending
        self._boots = boots
        self._thread = threading.Thread(target=self._run)
        self._ended = threading.Event()

    def __enter__(self) -> Device:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        pending = self._pending
        while not self._ended.is_set() or select.select([self._master], [], [], 0)[0]:
            if not select.select([self._master], [], [], 0.01)[0]:
                continue
            pending, messages = feed(pending, os.read(self._master, 1000))
            for message in messages:
                self.heard.append(message)
                if len(self.heard) == self._answered:
                    of = (TYPES[Estop], Code.OK, self._answered - 1)
                    os.write(self._master, encode(Ack(DeviceState.ESTOP, 0, *of)))
                if self._boots and len(self.heard) == 3:
                    os.write(self._master, b"\0" + encode(BOOTED))


@pytest.mark.parametrize("answered", [1, 3])
def test_estop_is_sent_three_times_and_requires_one_answer(
    terminal: tuple[int, str], answered: int
) -> None:
    """The first two may be lost."""
    with Device(terminal[0], answered) as device:
        assert _patient(terminal)

    assert device.heard == [Estop(0, 0), Estop(0, 1), Estop(0, 2)]


def test_an_incomplete_frame_of_a_killed_daemon_does_not_spoil_an_estop(
    terminal: tuple[int, str],
) -> None:
    with Device(terminal[0], answered=2, pending=encode(Estop(0, 9))[:4]) as device:
        assert _patient(terminal)

    spoilt, *sound = device.heard
    assert isinstance(spoilt, Spoilt)
    assert sound == [Estop(0, 0), Estop(0, 1), Estop(0, 2)]


def test_estop_gives_up_without_an_answer(terminal: tuple[int, str]) -> None:
    before = time.monotonic()
    with Device(terminal[0], answered=0) as device:
        assert not estop(terminal[1], BAUD)

    assert len(device.heard) == 3
    assert time.monotonic() - before >= WITHIN_S


def test_estop_is_sent_again_to_a_device_that_has_restarted(terminal: tuple[int, str]) -> None:
    """Opening the port reset the device, and it discarded what came before it was ready."""
    with Device(terminal[0], answered=4, boots=True) as device:
        assert _patient(terminal)

    assert len(device.heard) == 6


def test_an_answer_with_another_state_does_not_confirm_the_estop(terminal: tuple[int, str]) -> None:
    with Device(terminal[0], answered=0):
        os.write(terminal[0], b"\0" + encode(Ack(DeviceState.RUN, 0, TYPES[Estop], Code.OK, 0)))

        assert not estop(terminal[1], BAUD)


def test_estop_sends_nothing_to_a_port_in_use(terminal: tuple[int, str]) -> None:
    daemon = Link(terminal[1], BAUD)
    os.write(terminal[0], b"for the daemon")

    with pytest.raises(TakenPortError, match="in use by another program"):
        estop(terminal[1], BAUD)

    assert not select.select([terminal[0]], [], [], 0)[0]
    assert daemon.read() == b"for the daemon"
    daemon.close()


def test_estop_waits_for_a_dying_daemon(terminal: tuple[int, str]) -> None:
    """The daemon gives its port back a moment after systemd calls `armrigd estop`."""
    holder = os.open(terminal[1], os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(holder, fcntl.LOCK_EX)
    threading.Timer(0.05, os.close, [holder]).start()

    with Device(terminal[0], answered=1):
        assert _patient(terminal)


def test_a_missing_port_is_reported() -> None:
    with pytest.raises(NoPortError, match="it is not there"):
        estop("/dev/no-such-port", BAUD)


@pytest.mark.parametrize(
    ("environ", "failed"),
    [
        ({}, True),
        ({"SERVICE_RESULT": "success", "EXIT_CODE": "exited", "EXIT_STATUS": "0"}, False),
        ({"SERVICE_RESULT": "exit-code", "EXIT_CODE": "exited", "EXIT_STATUS": "78"}, False),
        ({"SERVICE_RESULT": "exit-code", "EXIT_CODE": "exited", "EXIT_STATUS": "1"}, True),
        ({"SERVICE_RESULT": "signal", "EXIT_CODE": "killed", "EXIT_STATUS": "KILL"}, True),
        ({"SERVICE_RESULT": "watchdog", "EXIT_CODE": "dumped", "EXIT_STATUS": "ABRT"}, True),
    ],
)
def test_the_exit_result_of_the_service_decides_on_the_estop(
    environ: dict[str, str], failed: bool
) -> None:
    assert _has_failed(environ) is failed


def test_estop_gives_up_on_a_port_in_use_after_a_fifth_of_a_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The whole command takes less than a second, as its help says."""
    now_s = 50.0

    def sleep(seconds: float) -> None:
        nonlocal now_s
        now_s += seconds

    def taken(port: str, baud: int) -> None:
        raise TakenPortError(f"{port} at {baud} is in use")

    clock = SimpleNamespace(monotonic=lambda: now_s, sleep=sleep)
    monkeypatch.setattr(estop_module, "time", clock)
    monkeypatch.setattr(estop_module, "open_link", taken)

    with pytest.raises(TakenPortError, match="/dev/odd at 9600 is in use"):
        estop("/dev/odd", 9600)

    assert now_s - 50.0 == pytest.approx(0.2, abs=0.011)
