"""Devices that break a rule of samples, CAL, oversampling, guards and STATUS (sections 5 and 7)."""

from __future__ import annotations

from typing import Any

from armrig_daemon.emulator import converter, device, transitions
from armrig_daemon.emulator.firmware import Firmware
from armrig_protocol.messages import Exchange, Sample, State

from tests.daemon.conformance.spoiling import Patch, SpoiltDevices

SPOILT = SpoiltDevices()
SPOILT.answer(
    "t_us is not the trigger",
    "EXCHANGE triggers channel 1",
    Sample,
    lambda m: {"t_us": (m.t_us + 400) & 0xFFFFFFFF},
)


@SPOILT.function("u_k is not what the duty gives", "code of the applied duty", converter, "latch")
def _raw_code(latch: Any, fw: Firmware, now_ns: int) -> None:
    latch(fw, now_ns)
    if fw.state is State.RUN and fw.pending[0].u is not None:
        fw.board.code = fw.pending[0].u


@SPOILT.handler("EXCHANGE is not answered in CAL", "During CAL", Exchange)
def _exchange_during_cal(exchange: Any, fw: Firmware, now_ns: int, m: Exchange) -> Any:
    return [] if fw.cal is not None else exchange(fw, now_ns, m)


SPOILT.add(
    "oversampling is accepted, and not done",
    "(2 m - 1)",
    Patch.setattr,
    Firmware,
    "conversions",
    property(lambda fw: 2),
)


@SPOILT.function("any Ts with oversampling", "2 (m - 1)", transitions, "check_config")
def _ts_min_of_one(check: Any, m: Any, *, ts_min_us: int, skew_us: int) -> Any:
    return check(m, ts_min_us=ts_min_us, skew_us=0)


SPOILT.add("three EXCHANGEs wait", "a third", Patch.setattr, device, "MOST_PENDING", 3)


@SPOILT.function(
    "the rail's guard is one early", "consecutive samples at a rail", converter, "watch"
)
def _rail_one_early(watch: Any, *args: Any, rail_ticks: int, turns: int) -> Any:
    return watch(*args, rail_ticks=max(1, rail_ticks - 1), turns=turns)


@SPOILT.function("a guard that is off trips", "no reading leads to FAULT", converter, "watch")
def _rail_without_being_asked(watch: Any, *args: Any, rail_ticks: int, turns: int) -> Any:
    return watch(*args, rail_ticks=rail_ticks or 5, turns=turns)


SPOILT.add("STATUS is slow", "once a second", Patch.setattr, device, "STATUS_NS", 1_200_000_000)


@SPOILT.function("a waiting u is latched after the run", "RUN ends before", converter, "latch")
def _latches_after_the_run(latch: Any, fw: Firmware, now_ns: int) -> None:
    latch(fw, now_ns)
    if not fw.pending[0].drives and fw.pending[0].u:
        fw.board.code = fw.pending[0].u
