"""Devices of the emulator that each break one rule of PROTOCOL.md, by a patched function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace as dataclass_replace
from typing import Any, NamedTuple

import pytest
from armrig_daemon.emulator import (
    cal,
    configuration,
    converter,
    device,
    firmware,
    guards,
    queue,
    reception,
    requests,
    sampling,
    setpoints,
    timer,
    transitions,
    transmission,
)
from armrig_daemon.emulator.firmware import Firmware, Hardware
from armrig_daemon.emulator.queue import SetpointQueue
from armrig_protocol import decoder
from armrig_protocol.frame import Spoilt
from armrig_protocol.messages import (
    TYPES,
    Ack,
    Arm,
    CalReply,
    Cause,
    ClearFault,
    Code,
    Config,
    ConfigReply,
    Event,
    Exchange,
    Flag,
    Hello,
    HelloReply,
    Keepalive,
    Message,
    Pong,
    Sample,
    Setpoints,
    Start,
    State,
    Status,
    Stop,
)

Patch = pytest.MonkeyPatch
UNPLUGGED: dict[str, Any] = {"arm": {"R_m": 1e9}}
"""The motor does not turn the arm, whatever the code."""
AT_A_RAIL: dict[str, Any] = {"theta_1_zero_deg": 356.0, **UNPLUGGED}
"""theta_1 stands in its dead band, so that the guard over the rails can be tried."""


class SpoiltDevice(NamedTuple):
    """What is done to the emulator, and a rule that must find it."""

    spoil: Callable[[Patch], None]
    found_by: str
    """Part of the rule's sentence."""


def _handler(patch: Patch, kind: type[Message], make: Callable[[Any], Any]) -> None:
    """Put another handler of a type in the place of its own."""
    patch.setitem(requests._HANDLERS, kind, make(requests._HANDLERS[kind]))


def _answers(patch: Patch, change: Callable[[Message], Message | None]) -> None:
    """Let each frame to the host be another one, or none."""
    send = transmission.Transmission.send

    def changed(
        self: transmission.Transmission, fw: Firmware, t_ns: int, messages: list[Message]
    ) -> None:
        kept = [new for m in messages if (new := change(m)) is not None]
        send(self, fw, t_ns, kept)

    patch.setattr(transmission.Transmission, "send", changed)


def _no_crc(patch: Patch) -> None:
    decode = decoder.decode

    def lenient(stuffed: bytes) -> Any:
        found = decode(stuffed)
        if isinstance(found, Spoilt) and found.reason == "crc":
            return Keepalive(0, 0)
        return found

    patch.setattr(reception.decoder, "decode", lenient)


def _stale_is_taken(patch: Patch) -> None:
    patch.setattr(requests, "is_newer", lambda number, last, mask: True)


def _half_is_newer(patch: Patch) -> None:
    def wide(number: int, last: int | None, mask: int) -> bool:
        return last is None or 1 <= (number - last) & mask <= mask // 2 + 1

    patch.setattr(requests, "is_newer", wide)


def _hello_feeds(patch: Patch) -> None:
    def feeding(hello: Any) -> Any:
        def handler(fw: Firmware, now_ns: int, m: Hello) -> list[Message]:
            fw.feed(now_ns)
            return hello(fw, now_ns, m)  # type: ignore[no-any-return]

        return handler

    _handler(patch, Hello, feeding)


def _spoilt_feeds(patch: Patch) -> None:
    handle = requests.handle

    def feeding(fw: Firmware, now_ns: int, received: Any) -> list[Message]:
        if isinstance(received, Spoilt):
            fw.feed(now_ns)
        return handle(fw, now_ns, received)

    patch.setattr(device, "handle", feeding)


def _late_watchdog(patch: Patch) -> None:
    set_watchdog = Firmware._set_watchdog

    def late(self: Firmware) -> None:
        set_watchdog(self)
        if self.watchdog_ns != firmware.NEVER:
            self.watchdog_ns += 2_000_000

    patch.setattr(Firmware, "_set_watchdog", late)


def _watchdog_in_run_only(patch: Patch) -> None:
    set_watchdog = Firmware._set_watchdog

    def run_only(self: Firmware) -> None:
        set_watchdog(self)
        if self.state is State.ARMED:
            self.watchdog_ns = firmware.NEVER

    patch.setattr(Firmware, "_set_watchdog", run_only)


def _any_boot(patch: Patch) -> None:
    _handler(patch, Arm, lambda arm: lambda fw, t, m: arm(fw, t, m._replace(boot_id=fw.boot_id)))


def _any_nonce(patch: Patch) -> None:
    for kind in (Arm, Start):
        _handler(patch, kind, lambda old: lambda fw, t, m: old(fw, t, m._replace(nonce=fw.nonce)))


def _one_nonce(patch: Patch) -> None:
    accept = Firmware.accept

    def same(self: Firmware, config: Config) -> None:
        accept(self, config)
        self.nonce = 77

    patch.setattr(Firmware, "accept", same)


def _any_token(patch: Patch) -> None:
    _handler(patch, ClearFault, lambda old: lambda fw, t, m: old(fw, t, m._replace(token=fw.token)))


def _clamps(patch: Patch) -> None:
    def clamped(old: Any) -> Any:
        def handler(fw: Firmware, now_ns: int, m: Exchange) -> list[Message]:
            if fw.config is not None:
                m = m._replace(u=min(max(m.u, fw.config.u_min), fw.config.u_max))
            return old(fw, now_ns, m)  # type: ignore[no-any-return]

        return handler

    _handler(patch, Exchange, clamped)


def _slew_by_duty(patch: Patch) -> None:
    def rounded(old: Any) -> Any:
        def handler(fw: Firmware, now_ns: int, m: Exchange) -> list[Message]:
            fw.u = fw.board.code
            return old(fw, now_ns, m)  # type: ignore[no-any-return]

        return handler

    _handler(patch, Exchange, rounded)


def _drives_when_armed(patch: Patch) -> None:
    def reported(m: Message) -> Message:
        return m._replace(u_k=500) if isinstance(m, Sample) and m.state == State.ARMED else m

    _answers(patch, reported)


def _event_before_answer(patch: Patch) -> None:
    transition = transitions._transition
    patch.setattr(
        transitions, "_transition", lambda fw, t, m, state: transition(fw, t, m, state)[::-1]
    )


def _config_stays(patch: Patch) -> None:
    enter = Firmware.enter

    def keeping(self: Firmware, now_ns: int, state: State, cause: Cause, *, detail: int = 0) -> Any:
        kept = self.config, self.config_crc, self.nonce
        event = enter(self, now_ns, state, cause, detail=detail)
        self.config, self.config_crc, self.nonce = kept
        return event

    patch.setattr(Firmware, "enter", keeping)


def _wrong_config_crc(patch: Patch) -> None:
    _answers(patch, lambda m: m._replace(config_crc=1) if isinstance(m, ConfigReply) else m)


def _stale_echo(patch: Patch) -> None:
    _answers(
        patch, lambda m: m._replace(echo=(m.echo - 1) & 0xFFFF) if isinstance(m, Sample) else m
    )


def _t_us_of_the_answer(patch: Patch) -> None:
    _answers(
        patch,
        lambda m: m._replace(t_us=(m.t_us + 400) & 0xFFFFFFFF) if isinstance(m, Sample) else m,
    )


def _raw_code(patch: Patch) -> None:
    latch = sampling.latch

    def raw(fw: Firmware, now_ns: int) -> None:
        latch(fw, now_ns)
        if fw.state is State.RUN and fw.pending[0].u is not None:
            fw.board.code = fw.pending[0].u

    patch.setattr(converter, "latch", raw)


def _drifts(patch: Patch) -> None:
    due = timer.Timer.due_ns.fget  # type: ignore[attr-defined]
    patch.setattr(timer.Timer, "due_ns", property(lambda self: due(self) + self.k * 300))


def _one_late(patch: Patch) -> None:
    due = timer.Timer.due_ns.fget  # type: ignore[attr-defined]
    patch.setattr(timer.Timer, "due_ns", property(lambda self: due(self) + 5_000 * (self.k == 17)))


def _one_sample_late(patch: Patch) -> None:
    advance = SetpointQueue.advance

    def late(self: SetpointQueue) -> bool:
        before = self.in_force
        there = advance(self)
        self.in_force = before
        return there

    patch.setattr(SetpointQueue, "advance", late)


def _hold_is_zero(patch: Patch) -> None:
    advance = SetpointQueue.advance

    def rests(self: SetpointQueue) -> bool:
        there = advance(self)
        if not there:
            self.in_force = self._rest
        return there

    patch.setattr(SetpointQueue, "advance", rests)


def _overwrites(patch: Patch) -> None:
    add = SetpointQueue.add

    def taken(self: SetpointQueue, m: Setpoints) -> bool:
        add(self, m)
        return True

    patch.setattr(SetpointQueue, "add", taken)


def _smaller_queue(patch: Patch) -> None:
    def smaller(self: SetpointQueue, config: Config, capacity: int) -> None:
        original(self, config, capacity - 1)

    original = SetpointQueue.__init__
    patch.setattr(SetpointQueue, "__init__", smaller)


def _queue_outlives_its_run(patch: Patch) -> None:
    class Kept(SetpointQueue):
        last: list[Any] = []  # noqa: RUF012 - of this test alone

        def __init__(self, config: Config, capacity: int) -> None:
            super().__init__(config, capacity)
            self._entries.extend(Kept.last)
            self._frames.extend([len(Kept.last)] if Kept.last else [])
            Kept.last = self._entries  # type: ignore[assignment]

    patch.setattr(transitions, "SetpointQueue", Kept)


def _setpoints_feed(patch: Patch) -> None:
    tick = Firmware.tick

    def feeding(self: Firmware, now_ns: int) -> list[Message]:
        self.feed(now_ns)
        return tick(self, now_ns)

    patch.setattr(Firmware, "tick", feeding)


def _padding_counts(patch: Patch) -> None:
    violation = SetpointQueue.violation

    def all_of_it(self: SetpointQueue, m: Setpoints) -> tuple[Cause, int]:
        return violation(self, m._replace(n=24))

    patch.setattr(SetpointQueue, "violation", all_of_it)


def _no_unknown(patch: Patch) -> None:
    _answers(
        patch,
        lambda m: None if isinstance(m, Ack) and m.code == Code.UNKNOWN_TYPE else m,
    )


def _answers_spoilt(patch: Patch) -> None:
    handle = requests.handle

    def answering(fw: Firmware, now_ns: int, received: Any) -> list[Message]:
        made = handle(fw, now_ns, received)
        if isinstance(received, Spoilt):
            made = [fw.answer(0, 0, Code.BAD_VALUE)]
        return made

    patch.setattr(device, "handle", answering)


def _fewer_readings(patch: Patch) -> None:
    patch.setattr(cal, "MOST_READINGS", 512)


def _variance_over_n(patch: Patch) -> None:
    _answers(
        patch,
        lambda m: m._replace(variance_256=7) if isinstance(m, CalReply) and m.n == 1 else m,
    )


def _exchange_during_cal(patch: Patch) -> None:
    def free(old: Any) -> Any:
        def handler(fw: Firmware, now_ns: int, m: Exchange) -> list[Message]:
            if fw.cal is not None:
                return []
            return old(fw, now_ns, m)  # type: ignore[no-any-return]

        return handler

    _handler(patch, Exchange, free)


def _m_means_nothing(patch: Patch) -> None:
    patch.setattr(Firmware, "conversions", property(lambda self: 2))


def _ts_min_of_one(patch: Patch) -> None:
    check = configuration.check_config
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

    patch.setattr(sampling, "watch", early)


def _rail_without_being_asked(patch: Patch) -> None:
    def always(g: Any, y0: int, y1: int, *, rail_ticks: int, turns: int) -> Any:
        return guards.watch(g, y0, y1, rail_ticks=rail_ticks or 5, turns=turns)

    patch.setattr(sampling, "watch", always)


def _flag_missing(patch: Patch) -> None:
    patch.setattr(sampling, "at_rail", lambda y: False)


def _vcc_flag(patch: Patch) -> None:
    _answers(
        patch,
        lambda m: m._replace(flags=m.flags | Flag.VCC_LOW) if isinstance(m, Sample) else m,
    )


def _slow_status(patch: Patch) -> None:
    patch.setattr(device, "STATUS_NS", 1_200_000_000)


def _no_stack(patch: Patch) -> None:
    _answers(patch, lambda m: m._replace(stack_free=90) if isinstance(m, Status) else m)


def _half_a_boot_id(patch: Patch) -> None:
    reset = device.Device.reset

    def same(self: device.Device, now_ns: int) -> None:
        low = self._fw.boot_id & 0xFFFF
        reset(self, now_ns)
        self._fw.boot_id = self._fw.boot_id & 0xFFFF_0000 | low

    patch.setattr(device.Device, "reset", same)


def _event_of_another_boot(patch: Patch) -> None:
    _answers(
        patch,
        lambda m: m._replace(boot=0) if isinstance(m, Event) else m,
    )


def _skips_a_seq(patch: Patch) -> None:
    send = transmission.Transmission.send

    def skipping(
        self: transmission.Transmission, fw: Firmware, t_ns: int, messages: list[Message]
    ) -> None:
        send(self, fw, t_ns, messages)
        self._seq = (self._seq + any(isinstance(m, HelloReply) for m in messages)) & 0xFFFF

    patch.setattr(transmission.Transmission, "send", skipping)


def _stop_must_be_new(patch: Patch) -> None:
    patch.setattr(requests, "Stop", Setpoints)


def _stop_in_fault(patch: Patch) -> None:
    def quiet(fw: Firmware, now_ns: int, m: Stop) -> list[Message]:
        if fw.state in (State.FAULT, State.ESTOP):
            return [fw.answer(TYPES[Stop], m.seq, Code.OK)]
        return transitions.stop(fw, now_ns, m)

    patch.setitem(requests._HANDLERS, Stop, quiet)


def _token_not_told(patch: Patch) -> None:
    _answers(patch, lambda m: m._replace(token=0) if isinstance(m, HelloReply) else m)


def _pong_time(patch: Patch) -> None:
    _answers(
        patch,
        lambda m: m._replace(rx_us=(m.rx_us + 30_000) & 0xFFFFFFFF) if isinstance(m, Pong) else m,
    )


def _k_not_reset(patch: Patch) -> None:
    def kept(old: Any) -> Any:
        def handler(fw: Firmware, now_ns: int, m: Hello) -> list[Message]:
            k = fw.k
            made = old(fw, now_ns, m)
            fw.k = k
            return made  # type: ignore[no-any-return]

        return handler

    _handler(patch, Hello, kept)


def _half_the_setpoint_frames(patch: Patch) -> None:
    patch.setattr(queue, "LEAST_A_FRAME", 16)


def _n_of_25(patch: Patch) -> None:
    patch.setattr(setpoints, "SETPOINTS_PER_FRAME", 300)


def _starts_at_once(patch: Patch) -> None:
    make = transitions._timer

    def short(fw: Firmware, now_ns: int, period_ns: int, k_stop: int) -> Any:
        made = make(fw, now_ns, period_ns, k_stop)
        return dataclass_replace(made, first_ns=made.first_ns - period_ns)

    patch.setattr(transitions, "_timer", short)


def _wrong_skew(patch: Patch) -> None:
    patch.setattr(Hardware, "skew_us", property(lambda self: 4_000))


def _spoilt_stops(patch: Patch) -> None:
    handle = requests.handle

    def stopping(fw: Firmware, now_ns: int, received: Any) -> list[Message]:
        made = handle(fw, now_ns, received)
        if isinstance(received, Spoilt) and fw.state is State.READY:
            fw.enter(now_ns, State.IDLE, Cause.NONE)
        return made

    patch.setattr(device, "handle", stopping)


def _latches_after_the_run(patch: Patch) -> None:
    latch = sampling.latch

    def late(fw: Firmware, now_ns: int) -> None:
        latch(fw, now_ns)
        if not fw.pending[0].drives and fw.pending[0].u:
            fw.board.code = fw.pending[0].u

    patch.setattr(converter, "latch", late)


def _small_ring(patch: Patch) -> None:
    patch.setattr(transmission, "RING_BYTES", 60)


SPOILT: dict[str, SpoiltDevice] = {
    "a CRC is not looked at": SpoiltDevice(_no_crc, "wrong CRC"),
    "what is spoilt is answered": SpoiltDevice(_answers_spoilt, "wrong CRC"),
    "an unknown type is not answered": SpoiltDevice(_no_unknown, "unknown type"),
    "old frames are taken": SpoiltDevice(_stale_is_taken, "ACK(STALE)"),
    "32768 ahead is newer": SpoiltDevice(_half_is_newer, "ACK(STALE)"),
    "HELLO feeds the watchdog": SpoiltDevice(_hello_feeds, "feeds the watchdog"),
    "a spoilt frame feeds the watchdog": SpoiltDevice(_spoilt_feeds, "feeds the watchdog"),
    "the watchdog is 2 ms late": SpoiltDevice(_late_watchdog, "silence of `watchdog_ms`"),
    "no watchdog in ARMED": SpoiltDevice(_watchdog_in_run_only, "silence of `watchdog_ms`"),
    "ARM of another boot arms": SpoiltDevice(_any_boot, "ARM carries"),
    "any nonce arms": SpoiltDevice(_any_nonce, "do not arm again"),
    "one nonce for all": SpoiltDevice(_one_nonce, "draws a nonce"),
    "any token clears": SpoiltDevice(_any_token, "Only CLEAR_FAULT"),
    "the token is not in HELLO_R": SpoiltDevice(_token_not_told, "with a token"),
    "a code is clamped": SpoiltDevice(_clamps, "is FAULT(RANGE): the EVENT"),
    "slew looks at the rounded duty": SpoiltDevice(_slew_by_duty, "more than `slew` from the last"),
    "ARMED has a code": SpoiltDevice(_drives_when_armed, "every state but RUN"),
    "the EVENT comes before its answer": SpoiltDevice(_event_before_answer, "the answer first"),
    "the configuration outlives STOP": SpoiltDevice(_config_stays, "STOP leads from"),
    "config_crc is not that of CONFIG": SpoiltDevice(_wrong_config_crc, "CRC-32 of it"),
    "the echo is one behind": SpoiltDevice(_stale_echo, "`echo`"),
    "t_us is not the trigger": SpoiltDevice(_t_us_of_the_answer, "theta_1's trigger"),
    "u_k is not what the duty gives": SpoiltDevice(_raw_code, "duty stands for"),
    "the timer drifts": SpoiltDevice(_drifts, "to 1 us"),
    "one sample is 5 us late": SpoiltDevice(_one_late, "to 1 us"),
    "START samples at once": SpoiltDevice(_starts_at_once, "one Ts behind START"),
    "each u is one sample late": SpoiltDevice(_one_sample_late, "every u at its k"),
    "HOLD does not hold": SpoiltDevice(_hold_is_zero, "dry queue"),
    "what disagrees is taken": SpoiltDevice(_overwrites, "disagrees"),
    "the queue is one too small": SpoiltDevice(_smaller_queue, "what HELLO_R says"),
    "the queue outlives its run": SpoiltDevice(_queue_outlives_its_run, "gone with it"),
    "too few frames in the queue": SpoiltDevice(_half_the_setpoint_frames, "`queue`/8"),
    "n of 25 is taken": SpoiltDevice(_n_of_25, "n of 0 or above 24"),
    "queued setpoints feed": SpoiltDevice(_setpoints_feed, "do not feed"),
    "padding is looked at": SpoiltDevice(_padding_counts, "padding"),
    "CAL has less readings": SpoiltDevice(_fewer_readings, "n readings of one channel"),
    "one reading has a variance": SpoiltDevice(_variance_over_n, "n readings of one channel"),
    "EXCHANGE is not answered in CAL": SpoiltDevice(_exchange_during_cal, "During CAL"),
    "oversampling is accepted, and not done": SpoiltDevice(_m_means_nothing, "(2 m - 1)"),
    "any Ts with oversampling": SpoiltDevice(_ts_min_of_one, "2 (m - 1)"),
    "three EXCHANGEs wait": SpoiltDevice(_three_wait, "a third"),
    "the rail's guard is one early": SpoiltDevice(_rail_one_early, "behind the last of them"),
    "a guard that is off trips": SpoiltDevice(_rail_without_being_asked, "no reading is a fault"),
    "no flag of a rail": SpoiltDevice(_flag_missing, "behind the last of them"),
    "VCC_LOW with a good supply": SpoiltDevice(_vcc_flag, "VCC_LOW"),
    "STATUS is slow": SpoiltDevice(_slow_status, "once a second"),
    "no stack left": SpoiltDevice(_no_stack, "once a second"),
    "only the high half of boot_id is drawn": SpoiltDevice(_half_a_boot_id, "another low half"),
    "EVENT has another boot": SpoiltDevice(_event_of_another_boot, "low half of boot_id"),
    "the device skips a seq": SpoiltDevice(_skips_a_seq, "seq counts them"),
    "an old STOP is stale": SpoiltDevice(_stop_must_be_new, "whatever its seq"),
    "STOP is OK in FAULT": SpoiltDevice(_stop_in_fault, "In FAULT a request"),
    "PONG has a wrong time": SpoiltDevice(_pong_time, "in order"),
    "HELLO does not begin k anew": SpoiltDevice(_k_not_reset, "behind a HELLO it may be any"),
    "noise stops it": SpoiltDevice(_spoilt_stops, "Bytes at random"),
    "a waiting u is latched after the run": SpoiltDevice(_latches_after_the_run, "RUN ends before"),
    "PONG finds no room behind SAMPLE": SpoiltDevice(_small_ring, "At 1 kHz"),
    "HELLO_R has a wrong skew": SpoiltDevice(_wrong_skew, "`skew_us` behind alpha's"),
}
