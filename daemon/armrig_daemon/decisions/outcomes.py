"""Outcomes of a decision, with the next state: follow-ups, and records for the service.

The modules of the core do not call one another. A follow-up is what must happen next, in the order
of the outcomes: `step.carry_out` passes each follow-up to one function.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

from armrig_core.commands.codes import OutcomeCode, RefusalCode
from armrig_core.process.printable import plural
from armrig_protocol.messages import HelloReply, Message
from armrig_protocol.messages import State as DeviceState

from armrig_daemon.decisions.faults import EMULATOR_REMEDY, Fault, remedy
from armrig_daemon.decisions.state import Action, DecisionState, Emit, RequestKind
from armrig_daemon.pipe import Answer, Log, Order, Run
from armrig_daemon.pipe import State as StateRecord

NO_DEVICE = "no device answers; check that the rig is on, or that its emulator runs: try again"
"""Refusal of an order that needs a device while no device answers."""
NOTICE_TRIES = 18
"""Number of unanswered HELLOs, 0.1 s apart, after which the daemon reports a silent device."""
_HELLOS_PER_SECOND, _HELLOS_PER_MINUTE = 10, 600


class Ask(NamedTuple):
    """Send a request to the device; the order, if any, is answered when it takes effect."""

    want: RequestKind
    order: Order | None = None
    ts_us: int = 0
    scheduled: bool = False
    tries: int = 1


class Transmit(NamedTuple):
    """Send messages whose effect is not awaited; each gets the next seq."""

    messages: tuple[Message, ...]


class Trip(NamedTuple):
    """Stop the motor, and latch the fault."""

    fault: Fault


class Halt(NamedTuple):
    """Stop the motor without a fault; `outcome` and `code` are those of the run."""

    outcome: str
    order: Order | None = None
    code: OutcomeCode = OutcomeCode.STOPPED


class GiveUp(NamedTuple):
    """Cancel the pending request because of this error."""

    error: str


class Then(Enum):
    """Follow-up without a parameter; its value says what is done."""

    FORGET = "the pending request and the outcome of the run are forgotten"
    LEAVE = "the daemon ends"
    REPORT = "the state of the core is reported"
    REPORT_SILENCE = "a device that does not answer HELLO is reported"


class EndRun(NamedTuple):
    """Report the end of the run; a `complete` run has ended with its last sample."""

    complete: bool = False


class Fill(NamedTuple):
    """Begin to fill the device's queue for this run."""

    order: Run


class NoteState(NamedTuple):
    """Handle the state that the device reports; `ended` is true after the last sample of a run."""

    reported: int
    ended: bool = False


Outcome = Ask | Transmit | Trip | Halt | GiveUp | Fill | NoteState | EndRun | Then | Action
Step = tuple[DecisionState, Sequence[Outcome]]
"""Result of a function of the core: the next state, then its outcomes in their order."""


def log(now_ns: int, level: str, message: str, **fields: str) -> Action:
    """Return a record for the log: a line for a person, and the fields of the line."""
    return Emit(Log(t_host_ns=now_ns, level=level, message=message, fields=fields))


def answer(order: Order | None, body: dict[str, object]) -> list[Action]:
    """Return the answer to an order; [] if the order is None."""
    return [] if order is None else [Emit(Answer(order=order.order, body=body))]


def refuse(
    order: Order | None,
    error: str,
    code: RefusalCode = RefusalCode.NOT_ALLOWED,
    **parameters: str | int | float,
) -> list[Action]:
    """Return the refusal of an order; [] if the order is None."""
    if order is None:
        return []
    return [Emit(Answer(order=order.order, error=error, code=code, parameters=parameters))]


def device_facts(device: HelloReply | None) -> dict[str, object]:
    """Return the properties of the device in its HELLO_R, by name; identifiers are hexadecimal."""
    if device is None:
        return {}
    facts: dict[str, object] = dict(device._asdict())
    for name in ("state", "seq", "token", "cause"):
        del facts[name]
    for name in ("uid", "boot_id", "schema", "firmware"):
        facts[name] = f"{facts[name]:x}"
    return facts


def motor(state: DecisionState) -> str:
    """Return the state of the motor, as text for a person."""
    watchdog = f"its watchdog stops it within {state.rules.watchdog_ms} ms"
    if state.device is None or state.link is None:
        return f"not known: the device does not answer; {watchdog}"
    if state.device_state != DeviceState.RUN:
        return f"at {state.rules.rest}, as the device reports"
    if state.asked is not None and state.asked.want is RequestKind.STOP:
        return "stop sent, not confirmed yet"
    return f"stop sent, but not confirmed; {watchdog}" if state.fault else "driven"


def silence_cause(state: DecisionState) -> str:
    """Return the reason why no device answers HELLO, and a remedy; "" if there is no problem."""
    link = state.link
    if link is None:
        plugged = "the rig is plugged in, and that this is its port"
        runs = "its emulator runs (`armrigd emulate`), or start `armrig lab` again"
        waits = "no rig is connected, and the daemon waits for one: check that "
        return waits + (runs if state.is_emulated else plugged)
    asked, rx, baud = state.asked, link.came, state.rules.baud
    if asked is None or asked.want is not RequestKind.HELLO or asked.tries < NOTICE_TRIES:
        return ""
    if state.is_emulated:
        return f"the emulator does not answer: {EMULATOR_REMEDY}"
    if rx.frames:
        observation = (
            f"{plural(rx.frames, 'frame')} came, but no answer to HELLO; check that its firmware "
            "speaks this version of the wire, and that nothing else is on this port"
        )
    elif rx.bytes:
        observation = (
            f"{plural(rx.bytes, 'byte')} came at {baud} baud, but no frame; check the [device] "
            "baud and "
            "the port; another sketch may run on the board: `armrig flash` writes armrig's firmware"
        )
    else:
        observation = (
            f"{plural(asked.tries, 'request')} at {baud} baud had no answer; check that the device "
            "has power, that this is its port, and that it contains the firmware"
        )
    return f"the device does not answer: {observation}"


def report_state(state: DecisionState, now_ns: int) -> Action:
    """Return the record of the state, with the sampling time."""
    paces_itself = state.scheduled and state.device_state == DeviceState.RUN
    return Emit(
        StateRecord(
            t_host_ns=now_ns,
            phase=state.phase,
            reason=state.reason,
            owner=state.lease.owner if state.lease else "",
            ts_us=state.ts_us if paces_itself else state.pace_us,
            device=device_facts(state.device),
            fault=state.fault.id if state.fault else "",
            motor=motor(state),
            remedy=remedy(state.fault.id, is_emulated=state.is_emulated) if state.fault else "",
            line=silence_cause(state),
            owner_checked=state.lease.owner_checked if state.lease else "",
            device_cause=state.fault.device_cause if state.fault else 0,
        )
    )


def silence(state: DecisionState, now_ns: int) -> list[Action]:
    """Return the reports about a silent device: a state each second, a log line each minute."""
    text, tries = silence_cause(state), state.asked.tries if state.asked else 0
    if not text or (tries - NOTICE_TRIES) % _HELLOS_PER_SECOND:
        return []
    notice: list[Action] = [report_state(state, now_ns)]
    if (tries - NOTICE_TRIES) % _HELLOS_PER_MINUTE == 0:
        notice.insert(0, log(now_ns, "warning", text))
    return notice
