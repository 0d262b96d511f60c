"""Devices that break a rule of states, arming, configuration and watchdog (sections 3, 4 and 7)."""

from __future__ import annotations

from typing import Any

from armrig_daemon.emulator.firmware import NEVER, Firmware
from armrig_protocol import messages as wire
from armrig_protocol.messages import TYPES, Cause, Code, State

from tests.daemon.conformance.spoiling import Patch, SpoiltDevices, any_value, other_function

SPOILT = SpoiltDevices()


@SPOILT.handler("HELLO feeds the watchdog", "do not feed the watchdog", wire.Hello)
def _hello_feeds(hello: Any, fw: Firmware, now_ns: int, m: wire.Hello) -> Any:
    fw.feed(now_ns)
    return hello(fw, now_ns, m)


def _shifted_watchdog(patch: Patch, by_ns: int) -> None:
    def shifted(set_watchdog: Any, fw: Firmware) -> None:
        set_watchdog(fw)
        if fw.watchdog_ns != NEVER:
            fw.watchdog_ns += by_ns

    other_function(patch, Firmware, "_set_watchdog", shifted)


SPOILT.add("the watchdog is 2 ms late", "silence of the host", _shifted_watchdog, 2_000_000)
SPOILT.add("the watchdog is 0.2 ms early", "silence of the host", _shifted_watchdog, -200_000)


@SPOILT.function("READY goes to IDLE in a silence", "the watchdog is off", Firmware, "feed")
def _ready_runs_out(feed: Any, fw: Firmware, now_ns: int) -> None:
    if fw.state is State.READY and now_ns - fw.fed_ns > 50_000_000:
        fw.state = State.IDLE
    feed(fw, now_ns)


@SPOILT.function("no watchdog in ARMED", "silence of the host", Firmware, "_set_watchdog")
def _watchdog_in_run_only(set_watchdog: Any, fw: Firmware) -> None:
    set_watchdog(fw)
    if fw.state is State.ARMED:
        fw.watchdog_ns = NEVER


SPOILT.add("ARM of another boot arms", "ARM with a wrong boot_id", any_value, "boot_id", wire.Arm)
SPOILT.add("any nonce arms", "do not arm again", any_value, "nonce", wire.Arm, wire.Start)
SPOILT.add("any token clears", "Only CLEAR_FAULT", any_value, "token", wire.ClearFault)


@SPOILT.function("one nonce for all", "has a new nonce", Firmware, "accept")
def _one_nonce(accept: Any, fw: Firmware, config: wire.Config) -> None:
    accept(fw, config)
    fw.nonce = 77


@SPOILT.function("one token for all", "with a token", Firmware, "enter")
def _one_token(enter: Any, fw: Firmware, now_ns: int, state: State, cause: Cause, **of: int) -> Any:
    event = enter(fw, now_ns, state, cause, **of)
    fw.token = 77 if fw.token else 0
    return event._replace(token=fw.token)


@SPOILT.handler("a code is clamped", "leads to FAULT(RANGE); only an EVENT", wire.Exchange)
def _clamps(exchange: Any, fw: Firmware, now_ns: int, m: wire.Exchange) -> Any:
    if fw.config is not None:
        m = m._replace(u=min(max(m.u, fw.config.u_min), fw.config.u_max))
    return exchange(fw, now_ns, m)


@SPOILT.handler("slew looks at the rounded duty", "A change above `slew` from the", wire.Exchange)
def _slew_by_duty(exchange: Any, fw: Firmware, now_ns: int, m: wire.Exchange) -> Any:
    fw.u = fw.board.code
    return exchange(fw, now_ns, m)


@SPOILT.function("the configuration outlives STOP", "STOP leads from", Firmware, "enter")
def _config_stays(enter: Any, fw: Firmware, *args: Any, **of: int) -> Any:
    kept = fw.config, fw.config_crc, fw.nonce
    event = enter(fw, *args, **of)
    fw.config, fw.config_crc, fw.nonce = kept
    return event


SPOILT.answer(
    "config_crc is not that of CONFIG",
    "their CRC-32",
    wire.ConfigReply,
    lambda m: {"config_crc": 1},
)


@SPOILT.handler("STOP is OK in FAULT", "In FAULT, these requests", wire.Stop)
def _stop_in_fault(stop: Any, fw: Firmware, now_ns: int, m: wire.Stop) -> Any:
    if fw.state in (State.FAULT, State.ESTOP):
        return [fw.answer(TYPES[wire.Stop], m.seq, Code.OK)]
    return stop(fw, now_ns, m)
