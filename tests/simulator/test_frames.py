"""Effects of an old frame that the checks permit."""

from __future__ import annotations

from armrig_protocol.frame import encode
from armrig_protocol.messages import Exchange, Message, Setpoints

from tests.simulator.frames import Frame, may_exchange, may_fill


def _frame(message: Message, *, grant: int = 1, stale: bool = False) -> Frame:
    return Frame(0, message.seq, 0, 1, grant, 0, 0, stale, True, encode(message), 0)


def _latched(frame: Frame, code: int = 500, k: int = 9, last_k: int = 8, slew: int = 0) -> str:
    return may_exchange(frame, code, k, last_k=last_k, last_code=0, slew=slew)


def test_an_old_exchange_is_latched_if_its_k_is_ahead_and_its_u_within_slew() -> None:
    frame = _frame(Exchange(0, 7, 9, 500))

    assert not _latched(frame)
    assert _latched(frame, code=501)
    assert _latched(frame, k=10)
    assert _latched(frame, last_k=9)
    assert _latched(frame, last_k=12)
    assert _latched(frame, slew=499)
    assert not _latched(frame, slew=500)
    assert _latched(_frame(Exchange(0, 7, 9, 500), grant=0))
    assert _latched(_frame(Exchange(0, 7, 9, 500), stale=True))
    assert _latched(_frame(Setpoints(0, 7, 9, 1, 0, (500,) + 23 * (0,))))


def test_old_setpoints_may_fill_only_their_samples() -> None:
    frame = _frame(Setpoints(0, 7, 24, 2, 0, (500, 600) + 22 * (0,)))

    assert not may_fill(frame, 500, 24)
    assert not may_fill(frame, 600, 25)
    assert may_fill(frame, 600, 24)
    assert may_fill(frame, 0, 26)
    assert may_fill(frame, 500, 23)
    assert may_fill(_frame(Exchange(0, 7, 24, 500)), 500, 24)
