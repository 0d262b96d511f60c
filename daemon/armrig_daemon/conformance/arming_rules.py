"""Rules of section 3: conditions of ARM and START, and the ways out of FAULT and ESTOP."""

from __future__ import annotations

from armrig_protocol.messages import (
    Arm,
    Cause,
    ClearFault,
    Code,
    Estop,
    Event,
    Start,
    State,
    Stop,
)

from armrig_daemon.conformance.conversation import only
from armrig_daemon.conformance.host import Host
from armrig_daemon.conformance.rule import codes, expect, rule
from armrig_daemon.conformance.state_rules import STATES


@rule(3, "ARM with a wrong boot_id, config_crc or nonce is answered WRONG_BOOT, _CONFIG or _NONCE")
def _arm(host: Host) -> None:
    host.reach(State.READY)
    boot_id, crc, nonce = host.known.boot_id, host.config_crc, host.nonce
    for fields, code in (
        ({"boot_id": boot_id ^ 1}, Code.WRONG_BOOT),
        ({"boot_id": 0}, Code.WRONG_BOOT),
        ({"config_crc": crc ^ 0x8000_0000}, Code.WRONG_CONFIG),
        ({"nonce": nonce ^ 1}, Code.WRONG_NONCE),
        ({"nonce": 0}, Code.WRONG_NONCE),
    ):
        came = host.ask(Arm, **fields)
        expect(codes(came) == [code] and len(came) == 1, came)
        expect(host.state == State.READY, f"state {host.state} after a wrong ARM")


@rule(3, "START needs the nonce of the configuration, and k_stop = 0 in exchange mode")
def _start(host: Host) -> None:
    host.reach(State.ARMED)
    for fields, code in (
        ({"nonce": host.nonce ^ 1}, Code.WRONG_NONCE),
        ({"k_stop": 10}, Code.BAD_VALUE),
    ):
        came = host.ask(Start, **fields)
        expect(codes(came) == [code] and host.state == State.ARMED, came)


@rule(3, "The bytes of an earlier ARM do not arm again: each CONFIG has its own nonce")
def _old_arming(host: Host) -> None:
    host.reach(State.ARMED)
    old = host.nonce
    host.ask(Stop)
    host.configure()
    came = host.ask(Arm, nonce=old)
    expect(codes(came) == [Code.WRONG_NONCE] and host.state == State.READY, came)
    host.ask(Arm)
    came = host.ask(Start, nonce=old)
    expect(codes(came) == [Code.WRONG_NONCE] and host.state == State.ARMED, came)


@rule(3, "ESTOP leads from any state to ESTOP, with a token other than 0 in EVENT and HELLO_R")
def _estop(host: Host) -> None:
    for state in STATES[:-1]:
        host.to_idle()
        host.reach(state)
        before = host.hello().token
        event = only(Event, host.ask(Estop))
        expect(
            (event.was, event.state, event.cause) == (state, State.ESTOP, Cause.REQUEST), [event]
        )
        expect(event.token not in (0, before), f"token {event.token} after {before}")
        expect(host.hello().token == event.token, f"token {host.known.token} in HELLO_R")


@rule(3, "ESTOP in ESTOP is answered OK, and changes nothing")
def _estop_again(host: Host) -> None:
    token = only(Event, host.ask(Estop)).token
    came = host.ask(Estop)
    expect(codes(came) == [Code.OK] and len(came) == 1, came)
    expect(host.hello().token == token, "another token")


@rule(3, "Only CLEAR_FAULT with the right token leads from FAULT and ESTOP to IDLE")
def _clear(host: Host) -> None:
    for state in (State.FAULT, State.ESTOP):
        host.to_idle()
        host.reach(state)
        token = host.hello().token
        for wrong in (0, token ^ 1, token ^ 0x8000_0000):
            came = host.ask(ClearFault, token=wrong)
            expect(codes(came) == [Code.WRONG_TOKEN] and host.state == state, came)
        came = host.ask(ClearFault, token=token)
        expect(codes(came) == [Code.OK] and host.state == State.IDLE, came)
        expect(host.hello().token == 0, f"token {host.known.token} in IDLE")


RULES = (
    _arm,
    _start,
    _old_arming,
    _estop,
    _estop_again,
    _clear,
)
