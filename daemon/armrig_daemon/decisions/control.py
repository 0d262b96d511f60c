"""Control by a law: its state after each sample, and its code at each tick (S5)."""

from __future__ import annotations

from math import isfinite

from armrig_core.commands.codes import OutcomeCode
from armrig_core.control import evaluation, monitor
from armrig_core.process.printable import plural
from armrig_core.rig.volts import volts_of
from armrig_core.telemetry.telemetry import Sample
from msgspec.structs import replace

from armrig_daemon import pipe
from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.outcomes import Halt, Outcome, Step, Trip
from armrig_daemon.decisions.state import ActiveRun, DecisionState, Emit, Phase, RunLaw

_COMPARED = {monitor.Gate.INNOVATION: "prediction", monitor.Gate.SIMULATION: "simulation"}


def observe(state: DecisionState, sample: Sample) -> Step:
    """Advance the law of the run by a sample, and by the missing samples before it.

    A sample whose code the law has not decided changes nothing: a sample before the run, or one at
    a tick after a stop that the device has not received.
    """
    run = state.run
    if run is None or not run.control or run.k_first < 0:
        return state, []
    control, i = run.control, sample.k - run.k_first
    if not control.state.k <= i < run.due:
        return state, []
    values = sample.value_0, sample.value_1
    after = evaluation.observe(control.law, control.state, i, values, control.values, control.latch)
    state = _with_law(state, run, control, after)
    if state.is_stopping or state.phase is not Phase.ACTIVE:
        return state, []
    return state, _consequences(control, after, values)


def _consequences(
    control: RunLaw, after: evaluation.LawState, values: tuple[float, float]
) -> list[Outcome]:
    """Return the end of the run if a bound of the law is exceeded; otherwise []."""
    law = control.law
    if not after.is_finite:
        return [Trip(Fault(Id.CONTROL, f"the law's state is not finite at sample {after.k}"))]
    if law.monitor and after.monitor and (alarm := monitor.alarm(law.monitor, after.monitor)):
        text = (
            f"{alarm.name} differs from the {_COMPARED[alarm.gate]} of the law's monitor in "
            f"{plural(monitor.IN_A_ROW, 'sample')} in a row"
        )
        value = values[law.channels[alarm.output]]
        return [Trip(Fault(Id(alarm.gate), text, output=alarm.name, value=value))]
    if (
        law.monitor
        and after.monitor
        and (name := monitor.find_lost_output(law.monitor, after.monitor))
    ):
        return [Halt(f"{name} had no valid value for too long", code=OutcomeCode.BLIND)]
    if after.blind >= law.most_blind:
        text = f"the law had no valid output in {plural(after.blind, 'sample')} in a row"
        return [Halt(text, code=OutcomeCode.BLIND)]
    if law.most_astray and after.astray >= law.most_astray:
        count = plural(after.astray, "sample")
        text = f"the control error was above {law.most_error:g} in {count} in a row"
        return [Halt(text, code=OutcomeCode.TRACKING)]
    return []


def decide(
    state: DecisionState, now_ns: int, run: ActiveRun, control: RunLaw, i: int
) -> tuple[DecisionState, int, list[Outcome]]:
    """Return the law's code for sample `i` of a run; the rest code if the run ends instead."""
    law, rest_code, reference = control.law, state.rules.rest_code, control.values
    before = control.state.codes[-1] if control.state.codes else rest_code
    after, command = evaluation.decide(law, control.state, i, reference, control.latch)
    if not isfinite(command.v):
        fault = Fault(Id.CONTROL, f"the law computed u[{i}] = {command.v}")
        return state, rest_code, [Trip(fault)]
    if not state.rules.allows(before, command.code):
        fault = Fault(Id.LIMITS, f"u[{i}] of the law is not within the limits")
        return state, rest_code, [Trip(fault)]
    if law.most_limited and after.limited >= law.most_limited:
        text = (
            f"the law was at a limit of the voltage in {plural(after.limited, 'sample')} in a row"
        )
        return state, rest_code, [Halt(text, code=OutcomeCode.AT_LIMIT)]
    blind = control.state.blind + command.predicted
    if blind > law.most_blind:
        text = f"the law had no valid output for {plural(blind, 'sample')}"
        return state, rest_code, [Halt(text, code=OutcomeCode.BLIND)]
    state = _with_law(state, replace(run, due=i + 1), control, after)
    record = pipe.Control(
        t_host_ns=now_ns,
        k=run.k_first + i,
        r=reference[i],
        v=command.v,
        u_v=volts_of(command.code),
        is_low=command.is_low,
        is_high=command.is_high,
        is_slewed=command.is_slewed,
        predicted=command.predicted,
        reference_n=control.reference_n,
    )
    return state, command.code, [Emit(record)]


def _with_law(
    state: DecisionState, run: ActiveRun, control: RunLaw, after: evaluation.LawState
) -> DecisionState:
    return replace(state, run=replace(run, control=replace(control, state=after)))
