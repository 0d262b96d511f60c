"""Rehearsal of a run in control: the law drives the rig's model, and the limits are checked."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import closing, nullcontext
from math import floor, isfinite, tau
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import matrix_balance

from armrig_core.commands.commands import Rehearsal
from armrig_core.commands.rehearsal import (
    PART_SAMPLES,
    Ends,
    RigModel,
    check_ends,
    interval_ends,
    rig_model,
)
from armrig_core.control import monitor
from armrig_core.control.control_law import ControlLaw
from armrig_core.control.evaluation import (
    Latch,
    LawCommand,
    LawState,
    Program,
    begin,
    decide,
    observe,
)
from armrig_core.errors import InputError
from armrig_core.process.printable import plural
from armrig_core.rig.channels import COUNTS, HALF_COUNTS, RAIL_COUNTS
from armrig_core.rig.description import Output
from armrig_core.rig.volts import code_of, device_code, volts_of

if TYPE_CHECKING:
    from armrig_core.rig.arm import ArmParameters
    from armrig_core.rig.description import Description

_Array = NDArray[np.float64]
_EQUATIONS_S = 30  # longest processor time of own equations, which are asked for each sample
_MAX_LOOP_STATES = 1500  # the eigenvalues of such a loop take 5 s
_EDGE = 1e-9  # distance from the stability limit that counts as unstable
_FREE_GROWTH = 1e-6  # growth per sample, by rounding, of a mode that is not fed back
_NOT_FED_BACK = 1e-7  # share of a mode in v, or of v in a mode, that is rounding
_WAY_OUT = "r[{}], {:.3g} s; change the reference or the law"


def rehearse_control(
    law: ControlLaw,
    reference: ArrayLike,
    described: Description,
    *,
    parameters: ArmParameters | None = None,
    arm_removed: bool = False,
    start_rad: float | None = None,
    latch: Latch | None = None,
    adc_bits: int = 10,
    unstable: bool = False,
) -> Rehearsal:
    """Return the response of a described rig under a law, from its values at rest.

    The law is evaluated as in a run, from the readings of a converter without noise: with its
    steps, and with the dead band of a turning output. A dead time is rounded to whole samples, and
    own equations are simulated only at the samples.

    Parameters
    ----------
    law : ControlLaw
        Law, for this rig (`ControlLaw.check_rig`).
    reference : array_like, shape (N,)
        Reference at each sample, in the unit of the law, N >= 1 (`ControlLaw.check_reference`).
    described : Description
        Rig with a model; its outputs have the limits of the run.
    parameters, arm_removed, start_rad
        As in `rehearse_outputs`. Without `start_rad`, a turning shaft of an arm begins in the
        middle of its potentiometer's track.
    latch : Latch, optional
        Rest, resolution and limits of the codes; by default the rest of the rig, a duty of 10 bits,
        and no limits other than those of the law.
    adc_bits : int, default 10
        Resolution of the converter, in bits.
    unstable : bool, default False
        True to allow an unstable closed loop, and a run that the law ends early.

    Raises
    ------
    InputError
        An output leaves its limits, the closed loop is unstable, or the law ends the run early. The
        model may also lack an output of the law, or have another sampling time.
    OperationError
        Own equations took too long.
    """
    Ts, program = law.Ts_us / 1e6, law.program(described)
    latch = latch or Latch(code_of(described.input.rest_v), pwm_bits=10)
    model = rig_model(described, parameters, arm_removed=arm_removed, cpu_s=_EQUATIONS_S)
    with closing(model.process) if model.process is not None else nullcontext():
        if model.Ts is not None and abs(model.Ts - Ts) > 1e-9:
            raise InputError(
                f"the law has Ts = {Ts:g} s, and the model in {model.file} has Ts = {model.Ts:g} "
                "s: design the law for the model's Ts, or identify a model at the law's"
            )
        names = [*described.outputs]
        if missing := [names[i] for i in program.channels if i >= len(model.C)]:
            raise InputError(f"the law uses {missing[0]}, and the rig's model has no {missing[0]}")
        if not unstable and (text := _instability(program, model, Ts)):
            raise InputError(
                f"the closed loop of the law and the rig's model is unstable: {text}; design the "
                "law with less gain. An unstable loop runs only with unstable=True (--unstable), "
                "inside the limits of the outputs"
            )
        sensors = [*zip(described.outputs.values(), model.rest.tolist(), strict=False)]
        if model.is_arm:
            sensors = [
                (output, _start(output, start_rad) if output.turning else rest_y)
                for output, rest_y in sensors
            ]
        r = np.asarray(reference, dtype=np.float64)
        ends = _simulate_loop(
            program, r, Ts, latch, model, sensors, adc_bits=adc_bits, may_end=unstable
        )
        return check_ends(model, ends, Ts, start_rad, _WAY_OUT)


def _start(output: Output, start_rad: float | None) -> float:
    """Return the angle at which a turning shaft starts, in rad."""
    return output.value(HALF_COUNTS) if start_rad is None else start_rad


def _simulate_loop(
    law: Program,
    reference: _Array,
    Ts: float,
    latch: Latch,
    model: RigModel,
    sensors: Sequence[tuple[Output, float]],
    *,
    adc_bits: int,
    may_end: bool,
) -> Iterator[Ends]:
    """Yield the ends of a run in control, part by part; raise InputError if the law ends it.

    `sensors` are the outputs with their values at the start. If `may_end` is True, the law may end
    the run by one of its bounds.
    """
    n, rest_v = len(model.A), volts_of(latch.rest_code)
    step, m = model.step(Ts, reference.size)
    transition = np.linalg.matrix_power(step, m)
    Phi, Gamma = transition[:n, :n], transition[:n, n]
    underway = deque([rest_v - model.origin_v] * round(model.delay_s / Ts))
    r = reference.tolist()
    state, x, y = begin(law), np.zeros(n), np.zeros(len(model.C))
    for begin_k in range(0, len(r), PART_SAMPLES):
        most = min(PART_SAMPLES, len(r) - begin_k)
        states, v, outputs = np.empty((most + 1, n)), np.empty(most), np.empty((most, len(y)))
        states[0] = x
        size, end = 0, ""
        for k in range(begin_k, begin_k + most):
            state, command = decide(law, state, k, r, latch)
            if end := _end_by_code(law, state, command):
                break
            underway.append(volts_of(device_code(command.code, latch.pwm_bits)) - model.origin_v)
            v[size] = now_v = underway.popleft()
            changes = y.tolist()
            values = [
                _reading(output, start + change, adc_bits)
                for (output, start), change in zip(sensors, changes, strict=True)
            ]
            state = observe(law, state, k, values, r, latch)
            if model.process is None:
                states[size + 1] = x = Phi @ x + Gamma * now_v
                y = model.C @ x
            else:
                outputs[size] = y = model.process.run([now_v], Ts)[-1]
            size += 1
            if end := _end_by_sample(law, state):
                break
        if size and model.process is None:
            yield interval_ends(model.C, step, m, states[: size + 1], v[:size])
        elif size:
            yield outputs[:size], outputs[:size], outputs[size - 1]
        if end and not (may_end and isfinite(command.v) and state.is_finite):
            raise InputError(f"the rehearsal ends at {_WAY_OUT.format(k, k * Ts)}: {end}")
        if end:
            return


def _end_by_code(law: Program, state: LawState, command: LawCommand) -> str:
    """Return why a run ends instead of applying a code; empty if it goes on."""
    if not isfinite(command.v):
        return f"the law computes the voltage {command.v}"
    if law.most_limited and state.limited >= law.most_limited:
        return f"the voltage is at a limit in {plural(state.limited, 'sample')} in a row"
    return ""


def _end_by_sample(law: Program, state: LawState) -> str:
    """Return why a run ends after a sample; empty if it goes on."""
    if not state.is_finite:
        return "the law's states are not finite"
    if law.monitor and state.monitor and (alarm := monitor.alarm(law.monitor, state.monitor)):
        return (
            f"{alarm.name} differs from the law's monitor (its {alarm.gate} gate), because the "
            "monitor has another model than the rig's description"
        )
    if (
        law.monitor
        and state.monitor
        and (name := monitor.find_lost_output(law.monitor, state.monitor))
    ):
        return f"{name} has no valid value for too long"
    if state.blind >= law.most_blind:
        return f"the law has no valid output in {plural(state.blind, 'sample')} in a row"
    if law.most_astray and state.astray >= law.most_astray:
        text = plural(state.astray, "sample")
        return f"the control error is above {law.most_error:g} in {text} in a row"
    return ""


def _reading(output: Output, value: float, adc_bits: int) -> float:
    """Return the value that the converter reads; NaN in a dead band or at an end of its range."""
    conversion, steps = output.conversion, 1 << adc_bits
    counts = conversion.counts(value)
    if output.turning:  # beyond the track, the converter reads an end of its range
        counts %= tau / abs(output.per_count)
    # The nearest step, as of the Uno's converter; a value that is not finite reads an end.
    step = floor(min(max(-1.0, counts / COUNTS), 2.0) * steps + 0.5)
    reading = min(max(step, 0), steps - 1) * (COUNTS // steps)
    if RAIL_COUNTS <= reading < COUNTS - RAIL_COUNTS:
        return conversion.value(reading)
    return conversion.value_at_rail(reading)


def _instability(law: Program, model: RigModel, Ts: float) -> str:
    """Return how the linear closed loop of law and model is unstable; empty if it is stable.

    A mode that is not fed back, such as the angle under a law of the speed, may keep its value: it
    has an eigenvalue of exactly 1.
    """
    M, b, c = _loop(law, model, Ts)
    # Scaled, so that a share of a state means the same for each state.
    M, (scale, _) = matrix_balance(M, permute=False, separate=True)
    b, c = b / scale, c * scale
    b, c = b / (np.linalg.norm(b) or 1.0), c / (np.linalg.norm(c) or 1.0)
    poles = np.linalg.eigvals(M)
    for pole in sorted(poles[np.abs(poles) > 1 - _EDGE], key=abs, reverse=True):
        shifted = M - pole * np.eye(len(M))
        # A mode is in v, and v in the mode, by the test of Popov, Belevitch and Hautus.
        rows, columns = np.vstack([shifted, c]), np.column_stack([shifted, b])
        share = min(np.linalg.svd(side, compute_uv=False)[-1] for side in (rows, columns))
        growth = abs(pole) - 1
        if growth <= _FREE_GROWTH and share <= _NOT_FED_BACK:
            continue
        mode = "a deviation"
        if abs(np.angle(pole)) > _EDGE:
            mode = f"an oscillation of {abs(np.angle(pole)) / Ts:.3g} rad/s"
        return f"{mode} grows by {growth:.2%} in each sample" if growth > _EDGE else f"{mode} stays"
    return ""


def _loop(law: Program, model: RigModel, Ts: float) -> tuple[_Array, _Array, _Array]:
    """Return M (N, N), b (N,) and c (N,) of the linear closed loop.

    z[k+1] = M z[k] + b e[k] and v[k] = c z[k], with e added to the voltage v of the law. The states
    z are those of the model and of the law, and the voltages of the last samples.
    """
    n, order = len(model.A), len(law.rows)
    step, m = model.step(Ts, 1)
    Phi, Gamma = (transition := np.linalg.matrix_power(step, m))[:n, :n], transition[:n, n]
    delays = {"model": round(model.delay_s / Ts), "law": law.input_delay}
    past = max(delays.values())
    size = n + order + past
    if size > _MAX_LOOP_STATES:
        raise InputError(
            f"the dead time of {delays['model'] * Ts:g} s is {delays['model']} samples, and the "
            f"stability of a loop is judged with at most {_MAX_LOOP_STATES} states: design the law "
            "with a longer Ts"
        )
    rows = np.array(law.rows).reshape(order, order + 2 + len(law.channels))
    M, b, c = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    M[:n, :n] = Phi
    M[n : n + order, n : n + order] = rows[:, :order]
    M[n : n + order, :n] = rows[:, order + 2 :] @ model.C[[*law.channels]]
    c[n : n + order] = law.v_row[:-1]
    # The voltage of d samples ago: that of the law for d = 0, otherwise a state.
    for place, column, delay in (
        (slice(0, n), Gamma, delays["model"]),
        (slice(n, n + order), rows[:, order + 1], delays["law"]),
    ):
        if delay:
            M[place, n + order + delay - 1] += column
        else:
            M[place] += np.outer(column, c)
            b[place] = column
    if past:
        M[n + order] = c
        b[n + order] = 1.0
        later = np.arange(n + order + 1, size)
        M[later, later - 1] = 1.0
    return M, b, c
