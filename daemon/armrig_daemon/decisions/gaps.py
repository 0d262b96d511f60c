"""Every k is accounted for: published, or told as a gap with the voltage that was held (L2)."""

from __future__ import annotations

from armrig_core.volts import volts_of
from msgspec.structs import replace

from armrig_daemon.decisions.requests import Step
from armrig_daemon.decisions.state import Absent, Action, Emit, Sent, State
from armrig_daemon.pipe import Gap

NO_ANSWER = "no answer came"
MOST_ABSENT = 1000  # pieces of one outage that are told apart; the rest is one gap


def note(state: State, absent: Absent) -> State:
    """Remember samples that will not come, until the next one that does."""
    return replace(state, absent=(*state.absent[1 - MOST_ABSENT :], absent))


def lost(sent: Sent, now_ns: int) -> Absent:
    """Return the sample of an EXCHANGE that nothing answered; its input is as commanded."""
    return Absent(sent.k, 1, "a frame was lost", sent.code, sent.sent_ns, now_ns)


def tell_missing(state: State, end: int, now_ns: int, u_before: int | None = None) -> Step:
    """Tell all samples behind the last one and before `end` that were not published.

    Parameters
    ----------
    end : int
        Index of the sample that is there, or behind the last of a run.
    u_before : int, optional
        Code that was in force just before it, as that sample says (u_km1).
    """
    first = state.told + 1
    if first == end and not state.absent:
        return state, []  # nothing is missing, as at nearly every tick
    # Ticks may have been skipped already behind a sample that is still on its way.
    later = tuple(a for a in state.absent if a.k + a.n > end)
    if state.told < 0 or first >= end:
        return replace(state, told=max(state.told, end - 1), absent=later), []
    pieces = list(_pieces(state, first, end, now_ns))
    done: list[Action] = []
    code = state.applied
    for i, piece in enumerate(pieces):
        code = code if piece.code is None else piece.code
        if i == len(pieces) - 1 and u_before is not None and (piece.n == 1 or piece.code is None):
            code = u_before  # nothing was latched since: all of the piece was held at it
        done.append(Emit(_gap(piece, code)))
    return replace(state, told=end - 1, absent=later), done


def due_ns(state: State, k: int) -> int:
    """Return when sample k was due: by the run that the device paces, else by our last tick."""
    run = state.run
    if run is not None and run.scheduled and run.k_first >= 0:
        return run.t_zero_ns + (k - run.k_first) * state.ts_us * 1000
    return state.tick_ns - (state.k - k) * state.pace_us * 1000


def _unanswered(state: State, k: int, n: int, now_ns: int) -> Absent:
    return Absent(k, n, NO_ANSWER, None, due_ns(state, k), now_ns)


def _pieces(state: State, first: int, end: int, now_ns: int) -> list[Absent]:
    """Return what is known of first … end - 1, and the rest as unanswered, in order."""
    pieces: list[Absent] = []
    k = first
    for a in sorted(state.absent):
        begin, behind = max(a.k, k), min(a.k + a.n, end)
        if begin >= behind:
            continue
        if begin > k:
            pieces.append(_unanswered(state, k, begin - k, now_ns))
        pieces.append(a._replace(k=begin, n=behind - begin))
        k = behind
    if k < end:
        pieces.append(_unanswered(state, k, end - k, now_ns))
    return pieces


def _gap(piece: Absent, code: int) -> Gap:
    return Gap(
        k_first=piece.k,
        count=piece.n,
        t_from_ns=piece.t_from_ns,
        t_to_ns=piece.t_to_ns,
        u_held_v=volts_of(code),
        reason=piece.reason,
    )
