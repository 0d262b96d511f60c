"""Table of the requests to the device; ARCHITECTURE.md shows the table.

At most one request is pending. It is sent again until its effect is seen.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from armrig_protocol import messages as wire
from armrig_protocol.messages import SCHEMA_HASH, VERSION
from armrig_protocol.messages import State as DeviceState

from armrig_daemon.decisions import outcomes
from armrig_daemon.decisions.outcomes import Step
from armrig_daemon.decisions.state import DecisionState, PendingRequest, RequestKind
from armrig_daemon.decisions.transitions import (
    DRIVING_STATES,
    MAX_TRIES,
    handle_armed,
    handle_cleared,
    handle_config,
    handle_hello,
    handle_refusal,
    handle_refusal_of_hello,
    handle_refusal_of_stop,
    handle_started,
    handle_stopped,
    leave_to_watchdog,
    reconnect,
)


class Row(NamedTuple):
    """Row of the table of requests; the functions' first lines are its text."""

    message: type[Any]
    """Class of the message on the wire."""
    fields: Callable[[DecisionState, outcomes.Ask], tuple[Any, ...]]
    """Fields of the message after state and seq."""
    awaits: type[wire.Message] | frozenset[int]
    """Reply, or states of the device, by which the effect is seen."""
    effect: Callable[..., Step]
    """Handle the effect: (state, now_ns, request), and the reply if one is awaited."""
    refusal: Callable[[DecisionState, PendingRequest, wire.Ack], Step] = handle_refusal
    """Handle a refusal by the device."""
    failure: Callable[[DecisionState, int, str], Step] = reconnect
    """Handle the end of a request without effect; its order is refused."""
    retry_ns: int = 50_000_000
    """Time after which the request is sent again, in ns."""
    tries: int | None = MAX_TRIES
    """Number of times that the request is sent; None is no limit."""


def _of_configuration(state: DecisionState) -> tuple[int, int]:
    """Return CRC and nonce of the configuration in force; 0 and 0 without one."""
    in_force = state.configuration
    return (in_force.config_crc, in_force.nonce) if in_force else (0, 0)


REQUESTS: dict[RequestKind, Row] = {
    RequestKind.HELLO: Row(
        wire.Hello,
        lambda state, ask: (VERSION, SCHEMA_HASH),
        awaits=wire.HelloReply,
        effect=handle_hello,
        refusal=handle_refusal_of_hello,
        retry_ns=100_000_000,
        tries=None,
    ),
    RequestKind.CONFIGURE: Row(
        wire.Config,
        lambda state, ask: state.rules.config(ask.ts_us, 0, scheduled=ask.scheduled)[2:],
        awaits=wire.ConfigReply,
        effect=handle_config,
    ),
    RequestKind.ARM: Row(
        wire.Arm,
        lambda state, ask: (
            state.device.boot_id if state.device else 0,
            *_of_configuration(state),
        ),
        awaits=frozenset([DeviceState.ARMED]),
        effect=handle_armed,
    ),
    RequestKind.START: Row(
        wire.Start,
        lambda state, ask: (state.run.samples if state.run else 0, _of_configuration(state)[1]),
        awaits=frozenset([DeviceState.RUN]),
        effect=handle_started,
    ),
    RequestKind.STOP: Row(
        wire.Stop,
        lambda state, ask: (),
        # Any other state is without voltage, also one that the protocol does not define.
        awaits=frozenset(range(256)) - {*DRIVING_STATES},
        effect=handle_stopped,
        refusal=handle_refusal_of_stop,
        failure=leave_to_watchdog,
        retry_ns=20_000_000,
    ),
    RequestKind.CLEAR: Row(
        wire.ClearFault,
        lambda state, ask: (state.link.token if state.link else 0,),
        awaits=frozenset([DeviceState.IDLE]),
        effect=handle_cleared,
    ),
}
"""Requests to the device; ARCHITECTURE.md shows the table."""
