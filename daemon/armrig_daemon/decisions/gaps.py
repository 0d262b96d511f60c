"""Samples and their gaps, up to the end of a run.

Each sample is either published, or reported as missing with the voltage that was held. This is
invariant L2 of ARCHITECTURE.md.
"""

from __future__ import annotations

from armrig_core.commands.codes import GapCode, OutcomeCode, RefusalCode
from armrig_core.rig.volts import device_code, volts_of
from armrig_protocol.messages import Sample as DeviceSample
from msgspec.structs import replace

from armrig_daemon.decisions.outcomes import refuse
from armrig_daemon.decisions.state import (
    Action,
    ActiveRun,
    Arrived,
    DecisionState,
    Emit,
    PendingGap,
    Phase,
    Publish,
    Sent,
    SetPeriod,
)
from armrig_daemon.pipe import Gap, RunEnded

MAX_MISSING_PIECES = 1000  # most gaps of one outage; all samples before these are one more gap


def note(state: DecisionState, absent: PendingGap) -> DecisionState:
    """Remember missing samples until the next sample arrives."""
    return replace(state, absent=(*state.absent[1 - MAX_MISSING_PIECES :], absent))


def missing(
    k: int, n: int, reason: GapCode, code: int | None, t_from_ns: int, t_to_ns: int
) -> PendingGap:
    """Return a `PendingGap` with the sentence that belongs to its reason."""
    return PendingGap(k, n, reason.sentence, code, t_from_ns, t_to_ns, reason)


def frame_loss(sent: Sent, now_ns: int) -> PendingGap:
    """Return the missing sample of an unanswered EXCHANGE; its input is the commanded code."""
    return missing(sent.k, 1, GapCode.FRAME_LOST, sent.code, sent.sent_ns, now_ns)


def report_missing(
    state: DecisionState, end: int, now_ns: int, u_before: int | None = None
) -> tuple[DecisionState, list[Action]]:
    """Report the missing samples between the last reported sample and `end`.

    Parameters
    ----------
    end : int
        Number of the sample that has arrived, or of the first sample after a run.
    u_before : int, optional
        Code in force just before sample `end`, as this sample reports it (u_km1).
    """
    first = state.last_reported_k + 1
    if first == end and not state.absent:
        return state, []  # nothing is missing, as at nearly every tick
    # Later ticks may have been skipped while sample `end` was still on its way.
    later = tuple(a for a in state.absent if a.k + a.n > end)
    if state.last_reported_k < 0 or first >= end:
        return replace(state, last_reported_k=max(state.last_reported_k, end - 1), absent=later), []
    pieces = list(_pieces(state, first, end, now_ns))
    done: list[Action] = []
    code = state.applied
    for i, piece in enumerate(pieces):
        code = code if piece.code is None else piece.code
        if i == len(pieces) - 1 and u_before is not None and (piece.n == 1 or piece.code is None):
            code = u_before  # no code was latched in this gap, so `u_before` was held
        done.append(Emit(_gap(piece, code)))
    return replace(state, last_reported_k=end - 1, absent=later), done


def due_ns(state: DecisionState, k: int) -> int:
    """Return the time at which sample k was due, from the run's `t_zero_ns` or the last tick."""
    run = state.run
    if run is not None and run.scheduled and run.k_first >= 0:
        return run.t_zero_ns + (k - run.k_first) * state.ts_us * 1000
    return state.tick_ns - (state.k - k) * state.pace_us * 1000


def _no_answer(state: DecisionState, k: int, n: int, now_ns: int) -> PendingGap:
    return missing(k, n, GapCode.NO_ANSWER, None, due_ns(state, k), now_ns)


def _pieces(state: DecisionState, first: int, end: int, now_ns: int) -> list[PendingGap]:
    """Return the missing samples with the numbers `first` to `end` - 1, each with its reason."""
    pieces: list[PendingGap] = []
    k = first
    for a in sorted(state.absent):
        begin, past = max(a.k, k), min(a.k + a.n, end)
        if begin >= past:
            continue
        if begin > k:
            pieces.append(_no_answer(state, k, begin - k, now_ns))
        pieces.append(a._replace(k=begin, n=past - begin))
        k = past
    if k < end:
        pieces.append(_no_answer(state, k, end - k, now_ns))
    return pieces


def _gap(piece: PendingGap, code: int) -> Gap:
    return Gap(
        k_first=piece.k,
        count=piece.n,
        t_from_ns=piece.t_from_ns,
        t_to_ns=piece.t_to_ns,
        u_held_v=volts_of(code),
        reason=piece.reason,
        code=piece.reason_code,
    )


def publish(
    state: DecisionState, now_ns: int, m: DeviceSample, arrived: Arrived
) -> tuple[DecisionState, list[Action]]:
    """Publish the gaps before a sample, then the sample."""
    for sent in arrived.unanswered:
        state = note(state, frame_loss(sent, now_ns))
    if arrived.answered is None and state.run is not None:
        state = _note_missing(state, state.run, m.k, now_ns)
    sample = arrived.sample
    acting_code, flags = state.rules.acting_code, m.flags
    state, done = report_missing(state, sample.k, now_ns, acting_code(m.u_km1, flags))
    done.append(Publish(sample, m.queued if arrived.answered is None else -1))
    state = replace(
        state,
        link=arrived.link,
        run=arrived.run,
        sampled_ns=sample.t_host_ns,
        t_us=sample.t_device_us,
        applied=acting_code(m.u_k, flags),
        last_reported_k=sample.k,
    )
    return state, done


def end_run(
    state: DecisionState, now_ns: int, *, complete: bool = False
) -> tuple[DecisionState, list[Action]]:
    """Report the end of the run; call this when no further sample of the run can arrive.

    If the run is `complete`, the device has taken all samples: those that have not arrived are
    missing.
    """
    queue, run = state.queue, state.run
    if complete and run is not None:
        state = _note_missing(state, run, run.samples, now_ns)
        run = replace(run, due=run.samples)
        state = replace(state, run=run).ending_with("complete", OutcomeCode.COMPLETE)
    done = refuse(queue.order, state.outcome or "stopped", RefusalCode.OVERTAKEN) if queue else []
    state = replace(state.linked(beats=()), queue=None)
    if run is None:
        return replace(state, outcome="", outcome_code=None), done
    if run.k_first >= 0:
        end = run.k_first + min(run.due, run.samples)
        waiting = state.link.sent if state.link else ()
        for sent in (s for s in waiting if s.k < end):
            state = note(state, frame_loss(sent, now_ns))
        if run.scheduled and state.phase is Phase.FAULT:
            # Report the samples that the device would have taken by now without the fault.
            by_now = (now_ns - run.t_zero_ns) // (state.ts_us * 1000) + 1
            n = max(0, min(by_now, run.samples) - run.due)
            due = due_ns(state, end)
            held = state.outcome, state.rules.rest_code
            untaken = PendingGap(end, n, *held, due, now_ns, GapCode.FAULT)
            state = note(state, untaken)
            run, end = replace(run, due=run.due + n), end + n
        state, reports = report_missing(state, end, now_ns)
        done += reports
        state = state.linked(sent=tuple(s for s in waiting if s.k >= end))
    if run.scheduled and run.k_first >= 0:
        # The device has paced the samples: number the loop's next tick after the last sample.
        k = run.k_first + run.due - 1
        state = replace(state, k=k, pace_us=state.rules.ts_us)
        done.append(SetPeriod(state.rules.ts_us, k + 1))
    code, text = state.ending
    done.append(Emit(RunEnded(run_id=run.run_id, outcome=text, outcome_code=code)))
    return replace(state, run=None, outcome="", outcome_code=None), done


def _note_missing(state: DecisionState, run: ActiveRun, end: int, now_ns: int) -> DecisionState:
    """Store the missing samples of a run before `end`; their inputs are the setpoints' codes."""
    bits = state.device.pwm_bits if state.device else 16
    for i in range(max(run.due, end - MAX_MISSING_PIECES), end):
        code = device_code(run.code(i), bits)
        absent = missing(run.k_first + i, 1, GapCode.FRAME_LOST, code, now_ns, now_ns)
        state = note(state, absent)
    return state
