"""Frames to the device: requests, whose effect is awaited, and frames without an answer."""

from __future__ import annotations

from armrig_core.commands.codes import RefusalCode
from armrig_protocol import messages as wire
from armrig_protocol.frame import encode
from msgspec.structs import replace

from armrig_daemon import pipe
from armrig_daemon.decisions import outcomes, transitions
from armrig_daemon.decisions.outcomes import Step, Then, answer, refuse
from armrig_daemon.decisions.request_table import REQUESTS
from armrig_daemon.decisions.state import (
    Action,
    DecisionState,
    PendingRequest,
    RequestKind,
    Send,
    Sent,
    Traffic,
    Unechoed,
)

MAX_REMEMBERED_FRAMES = 64  # frames without an echo; the fault STALE occurs with far fewer


def send(
    state: DecisionState, now_ns: int, data: bytes, exchange: Sent | None = None
) -> tuple[DecisionState, list[Action]]:
    """Send the frame with the next seq; remember an EXCHANGE until its SAMPLE arrives."""
    link, in_force = state.link, state.configuration
    if link is None:
        return state, []
    beats, sent = link.beats, link.sent
    if in_force is not None and in_force.scheduled:
        beats = (*beats[1 - MAX_REMEMBERED_FRAMES :], Unechoed(link.seq, now_ns))
    if exchange is not None:
        sent = (*sent, exchange)
    seq = (link.seq + 1) & 0xFFFF
    link = replace(link, seq=seq, last_send_ns=now_ns, beats=beats, sent=sent)
    return replace(state, link=link), [Send(data)]


def transmit(state: DecisionState, now_ns: int, messages: tuple[wire.Message, ...]) -> Step:
    """Send messages, each with the next seq."""
    done: list[Action] = []
    for message in messages:
        seq = state.link.seq if state.link else 0
        state, sending = send(state, now_ns, encode(message._replace(seq=seq)))
        done += sending
    return state, done


def ask(state: DecisionState, now_ns: int, asked: outcomes.Ask) -> Step:
    """Send a request to the device, and remember the request until it takes effect.

    The request replaces a pending request; the order of the pending request is answered.
    """
    want, order, ts_us, scheduled, tries = asked
    link = state.link
    if link is None:
        return replace(state, asked=None), refuse(order, "the link is down", RefusalCode.NO_LINK)
    seq = link.seq
    before = state.asked.order if state.asked else None
    overtaken = [] if before is order else _overtaken(before, want, state.outcome)
    if want is RequestKind.HELLO and tries == 1:
        state = state.linked(came=Traffic())
    row = REQUESTS[want]
    request = row.message(0, seq, *row.fields(state, asked))
    pending = PendingRequest(want, now_ns, seq, tries, ts_us, scheduled, order)
    # The line may hold noise before HELLO; a 00 ends the noise.
    lead = b"\0" if want is RequestKind.HELLO else b""
    state, sending = send(replace(state, asked=pending), now_ns, lead + encode(request))
    return state, [*overtaken, *sending]


def _overtaken(order: pipe.Order | None, want: RequestKind, outcome: str) -> list[Action]:
    """Return the answer to the replaced order: a stop is granted, any other order is refused."""
    if isinstance(order, pipe.Stop | pipe.Disarm):
        return answer(order, {"done": True})
    stopped = want is RequestKind.STOP and outcome
    text = f"not begun: {outcome}" if stopped else f"overtaken by {want}"
    return refuse(order, text, RefusalCode.OVERTAKEN)


def retry_ns(asked: PendingRequest) -> int:
    """Return the time at which a request without effect is sent again."""
    return asked.sent_ns + REQUESTS[asked.want].retry_ns


def retry(state: DecisionState, now_ns: int) -> Step:
    """Send the request again; after too many tries, cancel it and stop a motor that may turn."""
    asked = state.asked
    if asked is None or now_ns < retry_ns(asked):
        return state, []
    if not _is_last_try(asked):
        again = outcomes.Ask(asked.want, asked.order, asked.ts_us, asked.scheduled, asked.tries + 1)
        return state, [again, Then.REPORT_SILENCE]
    return give_up(state, now_ns, f"the device does not answer {asked.want}")


def _is_last_try(asked: PendingRequest) -> bool:
    tries = REQUESTS[asked.want].tries
    return tries is not None and asked.tries >= tries


def give_up(state: DecisionState, now_ns: int, error: str) -> Step:
    """Cancel the pending request, and refuse its order."""
    asked = state.asked
    done = refuse(asked.order if asked else None, error, RefusalCode.NO_EFFECT)
    failure = REQUESTS[asked.want].failure if asked else transitions.reconnect
    state, more = failure(replace(state, asked=None), now_ns, error)
    return state, [*done, *more]
