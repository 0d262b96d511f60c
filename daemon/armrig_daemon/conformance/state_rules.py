"""Rules of section 3: states, transitions, conditions of ARM and START, and ways out of FAULT."""

from __future__ import annotations

from re import sub
from typing import Any

from armrig_protocol import messages as wire
from armrig_protocol.messages import Capability, Cause, Code, Flag, Mode, State

from armrig_daemon.conformance.host import CONFIG, LineHost, only
from armrig_daemon.conformance.rule import Rule, codes, expect, kinds, rule

STATES = (State.IDLE, State.READY, State.ARMED, State.RUN, State.FAULT, State.ESTOP)
_FIELDS: dict[type[wire.Message], dict[str, Any]] = {
    wire.ClearFault: {"token": 1},
    wire.Config: dict(CONFIG),
    wire.Cal: {"channel": 0, "zero": 0, "n": 1},
    wire.Setpoints: {"k0": 0, "n": 1, "zero": 0, "u": (0,) * 24},
}
_NEEDED_CAPABILITY = {wire.Setpoints: Capability.SCHEDULED, wire.Cal: Capability.CAL}


@rule(3, "CONFIG leads to READY, ARM to ARMED, START to RUN: the answer first, then the EVENT")
def _way(host: LineHost) -> None:
    steps: tuple[tuple[type[wire.Message], type[wire.Message], State], ...] = (
        (wire.Config, wire.ConfigReply, State.READY),
        (wire.Arm, wire.Ack, State.ARMED),
        (wire.Start, wire.Ack, State.RUN),
        (wire.Stop, wire.Ack, State.IDLE),
    )
    was = State.IDLE
    for kind, answer, state in steps:
        messages = host.ask(kind, **(CONFIG if kind is wire.Config else {}))
        expect(kinds(messages) == [answer, wire.Event], messages)
        event = only(wire.Event, messages)
        reported = (event.was, event.state, event.cause)
        expect(reported == (was, state, Cause.REQUEST), messages)
        expect(all(m.state == state for m in messages) and host.state == state, messages)
        expect(messages[0].code == Code.OK, messages)  # type: ignore[union-attr]
        was = state


@rule(3, "STOP leads from READY, ARMED and RUN to IDLE, which has no configuration")
def _stop(host: LineHost) -> None:
    for state in (State.READY, State.ARMED, State.RUN):
        host.enter(state)
        answers = host.ask(wire.Stop)
        expect(codes(answers) == [Code.OK] and host.state == State.IDLE, answers)
        left = host.configure(ts_us=0)
        expect((left.config_crc, left.nonce, left.ts_us) == (0, 0, 0), [left])
    answers = host.ask(wire.Stop)
    expect(codes(answers) == [Code.OK] and len(answers) == 1, answers)


@rule(3, "HELLO, EXCHANGE, PING and KEEPALIVE are accepted in any state but BOOT")
def _everywhere(host: LineHost) -> None:
    for state in STATES:
        host.enter(state)
        host.hello()
        answers = host.ask(wire.Keepalive)
        expect(not [m for m in answers if not isinstance(m, wire.HelloReply)], answers)
        taken = host.exchange(0)
        expect(isinstance(taken, wire.Sample) and taken.state == state, [taken])
        expect(host.pong is not None and host.pong.state == state, [host.pong])


def _refuses(state: State, *refused: type[wire.Message]) -> Rule:
    """Return the rule that a state refuses these requests, named as on the wire (CLEAR_FAULT)."""
    names = (sub(r"(?<=[a-z])([A-Z])", r"_\1", kind.__name__).upper() for kind in refused)

    @rule(3, f"In {state.name}, these requests are answered WRONG_STATE: {', '.join(names)}")
    def check(host: LineHost) -> None:
        host.reach(state)
        for kind in refused:
            messages = host.ask(kind, **_FIELDS.get(kind, {}))
            needed = _NEEDED_CAPABILITY.get(kind)
            offered = needed is None or host.known.capabilities & needed
            code = Code.WRONG_STATE if offered else Code.UNSUPPORTED
            answers = [m.code for m in messages if isinstance(m, wire.Ack | wire.ConfigReply)]
            expect(answers == [code] and len(messages) == 1, messages)
            expect(host.state == state, f"state {host.state} after {kind.__name__}")

    return check


_LATCHED = (wire.Config, wire.Arm, wire.Start, wire.Stop, wire.Setpoints, wire.Cal)
_in_idle = _refuses(State.IDLE, wire.Arm, wire.Start, wire.ClearFault, wire.Setpoints)
_in_ready = _refuses(State.READY, wire.Start, wire.ClearFault, wire.Setpoints)
_in_armed = _refuses(State.ARMED, wire.Config, wire.Arm, wire.ClearFault, wire.Setpoints, wire.Cal)
_in_run = _refuses(
    State.RUN, wire.Config, wire.Arm, wire.Start, wire.ClearFault, wire.Setpoints, wire.Cal
)
_in_fault = _refuses(State.FAULT, *_LATCHED)
_in_estop = _refuses(State.ESTOP, *_LATCHED)


@rule(
    3, "In every state but RUN, the code is 0, whatever EXCHANGE contains; the flags show the state"
)
def _zero_volts(host: LineHost) -> None:
    of_state = {
        State.ARMED: Flag.ARMED,
        State.RUN: Flag.ARMED | Flag.RUN,
        State.FAULT: Flag.RANGE,
        State.ESTOP: Flag.ESTOP,
    }
    state_flags = Flag.ARMED | Flag.RUN | Flag.ESTOP | Flag.RANGE | Flag.WATCHDOG | Flag.SLEW
    for state in STATES:
        host.enter(state)
        for _ in range(2):
            sample = host.sample(40_000)
            expect(state is State.RUN or sample.u_k == 0, [sample])
            expect(sample.flags & state_flags == of_state.get(state, 0), [sample])
        if state is State.RUN:
            expect(sample.u_k != 0, [sample])
            host.ask(wire.Stop)
            sample = host.sample(40_000)
            expect((sample.u_k, sample.u_km1, sample.u_seq) == (0, 0, 0), [sample])


@rule(3, "RUN begins with u_rest latched; u_rest other than 0 needs an enable line")
def _rest(host: LineHost) -> None:
    u_rest = 20_000 if host.known.capabilities & Capability.ENABLE_LINE else 0
    host.reach(State.RUN, u_rest=u_rest)
    sample = host.sample(u_rest)
    expect(sample.u_km1 == sample.u_k and (sample.u_km1 > 0) == (u_rest > 0), [sample])


@rule(3, "The time in an EVENT is between the times of the PONGs before and after it")
def _event_time(host: LineHost) -> None:
    host.fence()
    before = host.rx_us
    event = only(wire.Event, host.ask(wire.Estop))
    span = (host.rx_us - before) & 0xFFFF_FFFF
    is_between = (event.t_us - before) & 0xFFFF_FFFF <= span
    expect(is_between, f"t_us {event.t_us}, not from {before} to {host.rx_us}")


@rule(3, "PONG returns host_ns, and its two times are in order")
def _pong(host: LineHost) -> None:
    pong, last = None, host.rx_us
    for _ in range(20):
        host.fence()
        pong = host.pong
        expect(pong is not None and (pong.tx_us - pong.rx_us) & 0xFFFF_FFFF < 1 << 31, [pong])
        expect((host.rx_us - last) & 0xFFFF_FFFF < 1 << 31, [pong])
        last = host.rx_us
    expect(isinstance(pong, wire.Pong) and pong.host_ns > 0, [pong])


@rule(3, "SETPOINTS in ARMED of exchange mode is answered WRONG_STATE")
def _setpoints_mode(host: LineHost) -> None:
    host.reach(State.ARMED, mode=Mode.EXCHANGE)
    answers = host.ask(wire.Setpoints, **_FIELDS[wire.Setpoints])
    offered = host.known.capabilities & Capability.SCHEDULED
    expect(codes(answers) == [Code.WRONG_STATE if offered else Code.UNSUPPORTED], answers)


@rule(3, "ARM with a wrong boot_id, config_crc or nonce is answered WRONG_BOOT, _CONFIG or _NONCE")
def _arm(host: LineHost) -> None:
    host.reach(State.READY)
    boot_id, crc, nonce = host.known.boot_id, host.config_crc, host.nonce
    for fields, code in (
        ({"boot_id": boot_id ^ 1}, Code.WRONG_BOOT),
        ({"boot_id": 0}, Code.WRONG_BOOT),
        ({"config_crc": crc ^ 0x8000_0000}, Code.WRONG_CONFIG),
        ({"nonce": nonce ^ 1}, Code.WRONG_NONCE),
        ({"nonce": 0}, Code.WRONG_NONCE),
    ):
        answers = host.ask(wire.Arm, **fields)
        expect(codes(answers) == [code] and len(answers) == 1, answers)
        expect(host.state == State.READY, f"state {host.state} after a wrong ARM")


@rule(3, "START needs the nonce of the configuration, and k_stop = 0 in exchange mode")
def _start(host: LineHost) -> None:
    host.reach(State.ARMED)
    for fields, code in (
        ({"nonce": host.nonce ^ 1}, Code.WRONG_NONCE),
        ({"k_stop": 10}, Code.BAD_VALUE),
    ):
        answers = host.ask(wire.Start, **fields)
        expect(codes(answers) == [code] and host.state == State.ARMED, answers)


@rule(3, "The bytes of an earlier ARM do not arm again: each CONFIG has its own nonce")
def _old_arming(host: LineHost) -> None:
    host.reach(State.ARMED)
    old = host.nonce
    host.ask(wire.Stop)
    host.configure()
    answers = host.ask(wire.Arm, nonce=old)
    expect(codes(answers) == [Code.WRONG_NONCE] and host.state == State.READY, answers)
    host.ask(wire.Arm)
    answers = host.ask(wire.Start, nonce=old)
    expect(codes(answers) == [Code.WRONG_NONCE] and host.state == State.ARMED, answers)


@rule(3, "ESTOP leads from any state to ESTOP, with a token other than 0 in EVENT and HELLO_R")
def _estop(host: LineHost) -> None:
    for state in STATES[:-1]:
        host.enter(state)
        before = host.hello().token
        event = only(wire.Event, host.ask(wire.Estop))
        expect(
            (event.was, event.state, event.cause) == (state, State.ESTOP, Cause.REQUEST), [event]
        )
        expect(event.token not in (0, before), f"token {event.token} after {before}")
        expect(host.hello().token == event.token, f"token {host.known.token} in HELLO_R")


@rule(3, "ESTOP in ESTOP is answered OK, and changes nothing")
def _estop_again(host: LineHost) -> None:
    token = only(wire.Event, host.ask(wire.Estop)).token
    answers = host.ask(wire.Estop)
    expect(codes(answers) == [Code.OK] and len(answers) == 1, answers)
    expect(host.hello().token == token, "another token")


@rule(3, "Only CLEAR_FAULT with the right token leads from FAULT and ESTOP to IDLE")
def _clear(host: LineHost) -> None:
    for state in (State.FAULT, State.ESTOP):
        host.enter(state)
        token = host.hello().token
        for wrong in (0, token ^ 1, token ^ 0x8000_0000):
            answers = host.ask(wire.ClearFault, token=wrong)
            expect(codes(answers) == [Code.WRONG_TOKEN] and host.state == state, answers)
        answers = host.ask(wire.ClearFault, token=token)
        expect(codes(answers) == [Code.OK] and host.state == State.IDLE, answers)
        expect(host.hello().token == 0, f"token {host.known.token} in IDLE")
