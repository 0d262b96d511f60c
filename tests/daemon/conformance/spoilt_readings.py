"""Devices that break a rule of samples, CAL, oversampling, guards and STATUS (sections 5 and 7)."""

from __future__ import annotations

from typing import Any

from armrig_daemon.emulator import converter, device, guards, transitions
from armrig_daemon.emulator.firmware import Firmware
from armrig_protocol.messages import Exchange, Sample, State

from tests.daemon.conformance.spoiling import Patch, SpoiltDevice, changed_answers, other_handler


def _t_us_of_the_answer(patch: Patch) -> None:
    changed_answers(
        patch,
        lambda m: m._replace(t_us=(m.t_us + 400) & 0xFFFFFFFF) if isinstance(m, Sample) else m,
    )


def _raw_code(patch: Patch) -> None:
    latch = converter.latch

    def raw(fw: Firmware, now_ns: int) -> None:
        latch(fw, now_ns)
        if fw.state is State.RUN and fw.pending[0].u is not None:
            fw.board.code = fw.pending[0].u

    patch.setattr(converter, "latch", raw)


def _exchange_during_cal(patch: Patch) -> None:
    other_handler(
        patch, Exchange, lambda old: lambda fw, t, m: [] if fw.cal is not None else old(fw, t, m)
    )


def _m_means_nothing(patch: Patch) -> None:
    patch.setattr(Firmware, "conversions", property(lambda self: 2))


def _ts_min_of_one(patch: Patch) -> None:
    check = transitions.check_config
    patch.setattr(
        transitions,
        "check_config",
        lambda m, *, ts_min_us, skew_us: check(m, ts_min_us=ts_min_us, skew_us=0),
    )


def _three_wait(patch: Patch) -> None:
    patch.setattr(device, "MOST_PENDING", 3)


def _rail_one_early(patch: Patch) -> None:
    def early(g: Any, y0: int, y1: int, *, rail_ticks: int, turns: int) -> Any:
        return guards.watch(g, y0, y1, rail_ticks=max(1, rail_ticks - 1), turns=turns)

    patch.setattr(converter, "watch", early)


def _rail_without_being_asked(patch: Patch) -> None:
    def always(g: Any, y0: int, y1: int, *, rail_ticks: int, turns: int) -> Any:
        return guards.watch(g, y0, y1, rail_ticks=rail_ticks or 5, turns=turns)

    patch.setattr(converter, "watch", always)


def _slow_status(patch: Patch) -> None:
    patch.setattr(device, "STATUS_NS", 1_200_000_000)


def _latches_after_the_run(patch: Patch) -> None:
    latch = converter.latch

    def late(fw: Firmware, now_ns: int) -> None:
        latch(fw, now_ns)
        if not fw.pending[0].drives and fw.pending[0].u:
            fw.board.code = fw.pending[0].u

    patch.setattr(converter, "latch", late)


SPOILT: dict[str, SpoiltDevice] = {
    "t_us is not the trigger": SpoiltDevice(_t_us_of_the_answer, "EXCHANGE triggers alpha"),
    "u_k is not what the duty gives": SpoiltDevice(_raw_code, "code of the applied duty"),
    "EXCHANGE is not answered in CAL": SpoiltDevice(_exchange_during_cal, "During CAL"),
    "oversampling is accepted, and not done": SpoiltDevice(_m_means_nothing, "(2 m - 1)"),
    "any Ts with oversampling": SpoiltDevice(_ts_min_of_one, "2 (m - 1)"),
    "three EXCHANGEs wait": SpoiltDevice(_three_wait, "a third"),
    "the rail's guard is one early": SpoiltDevice(_rail_one_early, "consecutive samples at a rail"),
    "a guard that is off trips": SpoiltDevice(
        _rail_without_being_asked, "no reading leads to FAULT"
    ),
    "STATUS is slow": SpoiltDevice(_slow_status, "once a second"),
    "a waiting u is latched after the run": SpoiltDevice(_latches_after_the_run, "RUN ends before"),
}
