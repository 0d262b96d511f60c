"""Testable rules of PROTOCOL.md and their results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from armrig_protocol import messages as wire
from armrig_protocol.messages import Cause, Code, State

from armrig_daemon.conformance.host import Broken, LineHost, only


class NotTried(Exception):  # noqa: N818 - not an error
    """The rule cannot be tested, for example because the device does not have the function."""


Check = Callable[[LineHost], None]


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

    def make_rule(check: Check) -> Rule:
        return Rule(section=section, sentence=sentence, check=check, silent=silent)

    return make_rule


class Result(NamedTuple):
    """Result of a rule."""

    section: int
    sentence: str
    outcome: str
    """`pass`, `FAIL` or `not tried`."""
    came: str
    """Behaviour that breaks the rule, or the reason why the rule was not tested."""


def expect(holds: bool, behaviour: object) -> None:
    """Raise `Broken` with the device's behaviour unless the rule holds."""
    if not holds:
        raise Broken(behaviour_text(behaviour))


def expect_trip(messages: list[wire.Message], was: State, cause: Cause, detail: int) -> None:
    """Expect one message, the EVENT of a transition from `was` to FAULT."""
    expect(kinds(messages) == [wire.Event], messages)
    event = only(wire.Event, messages)
    reported = (event.was, event.state, event.cause, event.detail)
    expect(reported == (was, State.FAULT, cause, detail), f"{reported}")


def behaviour_text(behaviour: object) -> str:
    """Return received messages as text that a person can read."""
    if isinstance(behaviour, str):
        return behaviour
    if isinstance(behaviour, list):
        return ", ".join(map(behaviour_text, behaviour)) or "nothing"
    match behaviour:
        case wire.Ack():
            return f"ACK({_name(Code, behaviour.code)})"
        case wire.Event():
            states = f"{_name(State, behaviour.was)} to {_name(State, behaviour.state)}"
            return f"EVENT({states}, {_name(Cause, behaviour.cause)})"
        case wire.ConfigReply():
            return f"CONFIG_R({_name(Code, behaviour.code)})"
        case wire.Sample():
            return f"SAMPLE(k={behaviour.k}, u_k={behaviour.u_k}, flags=0x{behaviour.flags:04x})"
        case wire.Pong():
            return f"PONG in {_name(State, behaviour.state)}"
    return repr(behaviour) if not isinstance(behaviour, tuple) else type(behaviour).__name__


def _name(kind: type[Code | State | Cause], number: int) -> str:
    return kind(number).name if number in set(kind) else str(number)


def codes(messages: Sequence[wire.Message]) -> list[int]:
    """Return the codes of the ACKs."""
    return [m.code for m in messages if isinstance(m, wire.Ack)]


def kinds(messages: Sequence[wire.Message]) -> list[type[wire.Message]]:
    """Return the types of the messages."""
    return [type(m) for m in messages]
