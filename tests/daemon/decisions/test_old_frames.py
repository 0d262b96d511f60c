"""Frames of an earlier session that are played again while this one drives."""

from __future__ import annotations

import pytest
from armrig_core.rig.calibration import Calibration
from armrig_daemon.decisions import step
from armrig_daemon.decisions.state import (
    LinkState,
    PendingRequest,
    Phase,
    RequestKind,
    Rules,
    Send,
    Sent,
)
from armrig_protocol.decoder import feed
from armrig_protocol.messages import Ack, Code, Stop
from armrig_protocol.messages import State as DeviceState

from tests.daemon.decision_states import changed, device_sample, driven, rested

RULES = Rules(
    code_min=0,
    code_max=65_535,
    slew=0,
    ts_us=2_000,
    watchdog_ms=100,
    baud=500_000,
    turns=0,
    rail_ticks=0,
    calibration=Calibration(),
    stop_after=0,
)


@pytest.mark.parametrize(("received", "late"), [(100, 90), (100, 100), (3, 0xFFFE)])
def test_a_sample_that_was_sent_before_an_exchange_does_not_answer_it(
    received: int, late: int
) -> None:
    """S4: it answers the same frame of an old session, and the line has delayed it."""
    state = changed(driven().loop.state, device_seq=received, sent=())
    waiting = changed(state, sent=(Sent(9, state.k + 1, 5, 6, 0, device_seq=received),))
    sample = device_sample(waiting, k=state.k + 1)

    ignored, _ = step.handle_message(waiting, 7, sample._replace(seq=late))
    answered, _ = step.handle_message(waiting, 7, sample._replace(seq=received + 1))

    assert (ignored.link.sent, ignored.link.device_seq) == (waiting.link.sent, received)
    assert (answered.link.sent, answered.link.device_seq) == ((), received + 1)


def test_a_device_frame_with_a_larger_number_causes_only_a_hello() -> None:
    bench = rested()
    bench.loop.state = changed(bench.loop.state, device_seq=20_000)

    bench.run_for(200)

    assert bench.loop.state.phase is Phase.SAFE
    assert bench.loop.state.link.device_seq < 1000


def test_the_answer_to_hello_restarts_the_frame_numbers_of_the_device() -> None:
    state = changed(rested().loop.state, device_seq=500)

    after, _ = step.handle_message(state, 7, state.device._replace(seq=0))

    assert after.link.device_seq == 0


def test_a_driving_device_that_rejects_hello_is_stopped() -> None:
    """S2: old frames keep the device in RUN and make HELLO stale; STOP works with any seq."""
    asked = PendingRequest(RequestKind.HELLO, 0, 1, 1, 0, False, None)
    before = changed(step.start(RULES), phase=Phase.FAULT, link=LinkState(seq=2), asked=asked)
    stale = Ack(DeviceState.RUN, 9, 1, Code.STALE, 1)

    after, actions = step.handle_message(before, 5_000_000, stale)

    sent = b"".join(a.data for a in actions if isinstance(a, Send))
    assert [type(m) for m in feed(b"", sent)[1]] == [Stop]
    assert after.asked == asked  # and HELLO is sent again when it is due
    assert not step.handle_message(before, 5_000_000, stale._replace(state=DeviceState.IDLE))[1]
