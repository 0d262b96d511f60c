"""A rule of PROTOCOL.md that can be tried, and what becomes of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from armrig_protocol.messages import (
    Ack,
    Cause,
    Code,
    ConfigReply,
    Event,
    Message,
    Pong,
    Sample,
    State,
)

from armrig_daemon.conformance.conversation import Broken
from armrig_daemon.conformance.host import Host


class NotTried(Exception):  # noqa: N818 - it is no error
    """The rule cannot be tried here: the device does not offer it, or why else."""


Check = Callable[[Host], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One rule: where it stands, what it says, and how it is tried."""

    section: int
    """Of PROTOCOL.md."""
    sentence: str
    check: Check
    """Raises `Broken` where the device does otherwise, `NotTried` where it does not."""
    silent: bool = False
    """The host keeps silent in it, so that a silence is no sign of a stall."""


def rule(section: int, sentence: str, *, silent: bool = False) -> Callable[[Check], Rule]:
    """Return what makes a rule of the function that tries it."""

    def named(check: Check) -> Rule:
        return Rule(section=section, sentence=sentence, check=check, silent=silent)

    return named


class Result(NamedTuple):
    """What became of a rule."""

    section: int
    sentence: str
    outcome: str
    """`pass`, `FAIL` or `not tried`."""
    came: str
    """What the device did otherwise, or why it was not tried."""


def expect(holds: bool, came: object) -> None:
    """Raise `Broken` with what came, unless the rule holds."""
    if not holds:
        raise Broken(shown(came))


def shown(came: object) -> str:
    """Return what a person reads of what came."""
    if isinstance(came, str):
        return came
    if isinstance(came, list):
        return ", ".join(map(shown, came)) or "nothing"
    match came:
        case Ack():
            return f"ACK({_name(Code, came.code)})"
        case Event():
            states = f"{_name(State, came.was)} to {_name(State, came.state)}"
            return f"EVENT({states}, {_name(Cause, came.cause)})"
        case ConfigReply():
            return f"CONFIG_R({_name(Code, came.code)})"
        case Sample():
            return f"SAMPLE(k={came.k}, u_k={came.u_k}, flags=0x{came.flags:04x})"
        case Pong():
            return f"PONG in {_name(State, came.state)}"
    return repr(came) if not isinstance(came, tuple) else type(came).__name__


def _name(kind: type[Code | State | Cause], number: int) -> str:
    return kind(number).name if number in set(kind) else str(number)


def codes(came: Sequence[Message]) -> list[int]:
    """Return what the ACKs say."""
    return [m.code for m in came if isinstance(m, Ack)]


def kinds(came: Sequence[Message]) -> list[type[Message]]:
    """Return what came, by type."""
    return [type(m) for m in came]
