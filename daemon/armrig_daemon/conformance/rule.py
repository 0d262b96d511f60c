"""Testable rules of PROTOCOL.md and their results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from armrig_protocol import messages as wire
from armrig_protocol.messages import Cause, Code, State

from armrig_daemon.conformance.host import Broken, Host, only


class NotTried(Exception):  # noqa: N818 - not an error
    """The rule cannot be tested, for example because the device does not have the function."""


Check = Callable[[Host], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """A rule: its section, its sentence and its test."""

    section: int
    """Section of PROTOCOL.md."""
    sentence: str
    check: Check
    """Test; raises `Broken` if the device breaks the rule, `NotTried` if the test is impossible."""
    silent: bool = False
    """True if the host must be silent during the test: its silence then does not mean a stall."""


def rule(section: int, sentence: str, *, silent: bool = False) -> Callable[[Check], Rule]:
    """Return a decorator that creates a rule from its test."""

    def named(check: Check) -> Rule:
        return Rule(section=section, sentence=sentence, check=check, silent=silent)

    return named


class Result(NamedTuple):
    """Result of a rule."""

    section: int
    sentence: str
    outcome: str
    """`pass`, `FAIL` or `not tried`."""
    came: str
    """Behaviour that breaks the rule, or the reason why the rule was not tested."""


def expect(holds: bool, came: object) -> None:
    """Raise `Broken` with the device's behaviour unless the rule holds."""
    if not holds:
        raise Broken(shown(came))


def expect_trip(came: list[wire.Message], was: State, cause: Cause, detail: int) -> None:
    """Expect one message, the EVENT of a transition from `was` to FAULT."""
    expect(kinds(came) == [wire.Event], came)
    event = only(wire.Event, came)
    reported = (event.was, event.state, event.cause, event.detail)
    expect(reported == (was, State.FAULT, cause, detail), f"{reported}")


def shown(came: object) -> str:
    """Return received messages as text that a person can read."""
    if isinstance(came, str):
        return came
    if isinstance(came, list):
        return ", ".join(map(shown, came)) or "nothing"
    match came:
        case wire.Ack():
            return f"ACK({_name(Code, came.code)})"
        case wire.Event():
            states = f"{_name(State, came.was)} to {_name(State, came.state)}"
            return f"EVENT({states}, {_name(Cause, came.cause)})"
        case wire.ConfigReply():
            return f"CONFIG_R({_name(Code, came.code)})"
        case wire.Sample():
            return f"SAMPLE(k={came.k}, u_k={came.u_k}, flags=0x{came.flags:04x})"
        case wire.Pong():
            return f"PONG in {_name(State, came.state)}"
    return repr(came) if not isinstance(came, tuple) else type(came).__name__


def _name(kind: type[Code | State | Cause], number: int) -> str:
    return kind(number).name if number in set(kind) else str(number)


def codes(came: Sequence[wire.Message]) -> list[int]:
    """Return the codes of the ACKs."""
    return [m.code for m in came if isinstance(m, wire.Ack)]


def kinds(came: Sequence[wire.Message]) -> list[type[wire.Message]]:
    """Return the types of the messages."""
    return [type(m) for m in came]
