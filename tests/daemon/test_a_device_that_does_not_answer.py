"""A wrong port or a wrong speed: the message names the received bytes and the remedy."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

import pytest
from armrig_daemon.config import Config
from armrig_daemon.decisions import step
from armrig_daemon.decisions.outcomes import silence_cause
from armrig_daemon.decisions.state import (
    Action,
    DecisionState,
    Emit,
    Event,
    LinkDown,
    LinkUp,
    Received,
    Tick,
    Wakeup,
)
from armrig_daemon.pipe import Log
from armrig_daemon.pipe import State as StateRecord
from armrig_protocol.frame import encode
from armrig_protocol.messages import Keepalive
from msgspec.structs import replace

from tests.daemon.decision_states import Decided, heard
from tests.daemon.virtual_bench import MS, Bench

WITHIN_MS = 2000
NOISE = Random(1)


class _Line:
    """The core on an open line, and its reports; `brings` gives the bytes of each 10 ms."""

    def __init__(self, brings: Callable[[], bytes] = lambda: b"", beats: bool = True) -> None:
        self.now = 0
        self.logs: list[Log] = []
        self.states: list[StateRecord] = []
        self._brings, self._beats = brings, beats
        self.state = step.start(Config().rules())
        self._step(LinkUp())

    def run_for(self, ms: int) -> None:
        """Let time pass: a tick each 10 ms, and a wakeup whenever the core has requested one."""
        for _ in range(ms // 10):
            self.now += 10 * MS
            self._step(Tick(self.now // (10 * MS), self.now))
            if data := self._brings():
                self._step(Received(data))
            if self._beats and self.now >= step.wake_ns(self.state):
                self._step(Wakeup())

    def _step(self, event: Event) -> None:
        self.state, actions = step.step(self.state, self.now, [event])
        self._take(actions)

    def _take(self, actions: list[Action]) -> None:
        records = [a.record for a in actions if isinstance(a, Emit)]
        self.logs += [r for r in records if isinstance(r, Log) and r.level != "debug"]
        self.states += [r for r in records if isinstance(r, StateRecord)]


@pytest.mark.parametrize(
    ("brings", "said"),
    [
        (
            lambda: b"",
            "18 requests at 500000 baud had no answer; check that the device has power, "
            "that this is its port, and that it contains the firmware",
        ),
        (
            lambda: NOISE.randbytes(10),
            "1690 bytes came at 500000 baud, but no frame; check the [device] baud and the port; "
            "another sketch may run on the board: `armrig flash` writes armrig's firmware",
        ),
        (
            lambda: b"\0" + encode(Keepalive(0, 7)),
            "169 frames came, but no answer to HELLO; check that its firmware "
            "speaks this version of the wire, and that nothing else is on this port",
        ),
    ],
    ids=["silent", "noise", "frames"],
)
def test_bytes_of_an_unanswering_device_are_reported_within_two_seconds(
    brings: Callable[[], bytes], said: str
) -> None:
    line = _Line(brings)

    line.run_for(1600)
    assert (line.logs, line.states) == ([], [])
    line.run_for(WITHIN_MS - 1600)

    (log,) = line.logs
    assert (log.level, log.message) == ("warning", f"the device does not answer: {said}")
    assert line.states[-1].line == log.message
    assert line.states[-1].phase == "init"


def test_later_bytes_are_in_the_state_after_a_second_and_logged_once_a_minute() -> None:
    data = [b""]
    line = _Line(lambda: data[0])
    line.run_for(WITHIN_MS)

    data[0] = b"x"
    line.run_for(1000)

    assert "69 bytes came" in line.states[-1].line
    line.run_for(57_000)
    assert len(line.logs) == 1
    line.run_for(WITHIN_MS)
    assert len(line.logs) == 2
    assert len(line.states) in (60, 61)


def test_a_noisy_line_does_not_delay_the_hello() -> None:
    line = _Line(lambda: NOISE.randbytes(500), beats=False)

    line.run_for(WITHIN_MS)

    assert "bytes came at 500000 baud, but no frame" in line.states[-1].line


def test_no_complaint_about_the_line_is_made_for_a_device_that_answers() -> None:
    bench = Bench()
    assert bench.of(StateRecord)[-1].line == ""
    silent = _silent(bench)

    met = heard(bench, bench.loop.state.device._replace(seq=1), silent)

    assert silence_cause(silent) != ""
    assert silence_cause(met.state) == ""
    again = Decided(replace(silent, asked=None, device=None), bench.ports.now, Tick(1 << 20, 0))
    assert again.state.link.came.bytes == 0
    assert again.state.asked is not None
    lost = Decided(silent, bench.ports.now, LinkDown("gone"))
    assert lost.told(StateRecord)[-1].line.startswith(
        "no rig is connected, and the daemon waits for one"
    )


def _silent(bench: Bench) -> DecisionState:
    """Return the state of a bench whose device has not answered for long, but brought bytes."""
    line = _Line(lambda: b"x")
    line.run_for(WITHIN_MS)
    assert line.state.link.came.bytes > 0
    return line.state
