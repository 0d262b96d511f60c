"""Devices that break a rule of states, arming, configuration and watchdog (sections 3, 4 and 7)."""

from __future__ import annotations

from functools import partial
from typing import Any

from armrig_daemon.emulator import firmware, requests, transitions
from armrig_daemon.emulator.firmware import Firmware
from armrig_protocol import messages as wire
from armrig_protocol.messages import TYPES, Cause, Code, State

from tests.daemon.conformance.spoiling import (
    Patch,
    SpoiltDevice,
    any_value,
    changed_answers,
    other_handler,
)


def _hello_feeds(patch: Patch) -> None:
    def feeding(hello: Any) -> Any:
        def handler(fw: Firmware, now_ns: int, m: wire.Hello) -> list[wire.Message]:
            fw.feed(now_ns)
            return hello(fw, now_ns, m)

        return handler

    other_handler(patch, wire.Hello, feeding)


def _ready_runs_out(patch: Patch) -> None:
    feed = Firmware.feed

    def idle_after_a_silence(self: Firmware, now_ns: int) -> None:
        if self.state is State.READY and now_ns - self.fed_ns > 50_000_000:
            self.state = State.IDLE
        feed(self, now_ns)

    patch.setattr(Firmware, "feed", idle_after_a_silence)


def _shifted_watchdog(patch: Patch, by_ns: int) -> None:
    set_watchdog = Firmware._set_watchdog

    def shifted(self: Firmware) -> None:
        set_watchdog(self)
        if self.watchdog_ns != firmware.NEVER:
            self.watchdog_ns += by_ns

    patch.setattr(Firmware, "_set_watchdog", shifted)


def _watchdog_in_run_only(patch: Patch) -> None:
    set_watchdog = Firmware._set_watchdog

    def run_only(self: Firmware) -> None:
        set_watchdog(self)
        if self.state is State.ARMED:
            self.watchdog_ns = firmware.NEVER

    patch.setattr(Firmware, "_set_watchdog", run_only)


def _one_nonce(patch: Patch) -> None:
    accept = Firmware.accept

    def same(self: Firmware, config: wire.Config) -> None:
        accept(self, config)
        self.nonce = 77

    patch.setattr(Firmware, "accept", same)


def _one_token(patch: Patch) -> None:
    enter = Firmware.enter

    def same(self: Firmware, now_ns: int, state: State, cause: Cause, *, detail: int = 0) -> Any:
        event = enter(self, now_ns, state, cause, detail=detail)
        self.token = 77 if self.token else 0
        return event._replace(token=self.token)

    patch.setattr(Firmware, "enter", same)


def _config_stays(patch: Patch) -> None:
    enter = Firmware.enter

    def keeping(self: Firmware, now_ns: int, state: State, cause: Cause, *, detail: int = 0) -> Any:
        kept = self.config, self.config_crc, self.nonce
        event = enter(self, now_ns, state, cause, detail=detail)
        self.config, self.config_crc, self.nonce = kept
        return event

    patch.setattr(Firmware, "enter", keeping)


def _wrong_config_crc(patch: Patch) -> None:
    changed_answers(
        patch, lambda m: m._replace(config_crc=1) if isinstance(m, wire.ConfigReply) else m
    )


def _stop_in_fault(patch: Patch) -> None:
    def quiet(fw: Firmware, now_ns: int, m: wire.Stop) -> list[wire.Message]:
        if fw.state in (State.FAULT, State.ESTOP):
            return [fw.answer(TYPES[wire.Stop], m.seq, Code.OK)]
        return transitions.stop(fw, now_ns, m)

    patch.setitem(requests._HANDLERS, wire.Stop, quiet)


def _clamps(patch: Patch) -> None:
    def clamped(old: Any) -> Any:
        def handler(fw: Firmware, now_ns: int, m: wire.Exchange) -> list[wire.Message]:
            if fw.config is not None:
                m = m._replace(u=min(max(m.u, fw.config.u_min), fw.config.u_max))
            return old(fw, now_ns, m)

        return handler

    other_handler(patch, wire.Exchange, clamped)


def _slew_by_duty(patch: Patch) -> None:
    def rounded(old: Any) -> Any:
        def handler(fw: Firmware, now_ns: int, m: wire.Exchange) -> list[wire.Message]:
            fw.u = fw.board.code
            return old(fw, now_ns, m)

        return handler

    other_handler(patch, wire.Exchange, rounded)


SPOILT: dict[str, SpoiltDevice] = {
    "HELLO feeds the watchdog": SpoiltDevice(_hello_feeds, "do not feed the watchdog"),
    "the watchdog is 2 ms late": SpoiltDevice(
        partial(_shifted_watchdog, by_ns=2_000_000), "silence of the host"
    ),
    "the watchdog is 0.2 ms early": SpoiltDevice(
        partial(_shifted_watchdog, by_ns=-200_000), "silence of the host"
    ),
    "READY goes to IDLE in a silence": SpoiltDevice(_ready_runs_out, "the watchdog is off"),
    "no watchdog in ARMED": SpoiltDevice(_watchdog_in_run_only, "silence of the host"),
    "ARM of another boot arms": SpoiltDevice(
        partial(any_value, of=(wire.Arm,), name="boot_id"), "ARM with a wrong boot_id"
    ),
    "any nonce arms": SpoiltDevice(
        partial(any_value, of=(wire.Arm, wire.Start), name="nonce"), "do not arm again"
    ),
    "one nonce for all": SpoiltDevice(_one_nonce, "has a new nonce"),
    "any token clears": SpoiltDevice(
        partial(any_value, of=(wire.ClearFault,), name="token"), "Only CLEAR_FAULT"
    ),
    "one token for all": SpoiltDevice(_one_token, "with a token"),
    "a code is clamped": SpoiltDevice(_clamps, "leads to FAULT(RANGE); only an EVENT"),
    "slew looks at the rounded duty": SpoiltDevice(_slew_by_duty, "A change above `slew` from the"),
    "the configuration outlives STOP": SpoiltDevice(_config_stays, "STOP leads from"),
    "config_crc is not that of CONFIG": SpoiltDevice(_wrong_config_crc, "their CRC-32"),
    "STOP is OK in FAULT": SpoiltDevice(_stop_in_fault, "In FAULT, these requests"),
}
