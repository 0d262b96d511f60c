"""Plants, laws and simulations that share no code with `armrig.control`."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import floor, nan
from typing import Any, NamedTuple

import armrig
import numpy as np
from armrig_core.control import monitor
from armrig_core.control.control_law import ControlLaw
from armrig_core.control.evaluation import Latch, begin, decide, observe
from armrig_core.control.sums import Rows, products
from armrig_core.rig.description import Description
from armrig_core.rig.volts import code_of, device_code, volts_of
from numpy.random import Generator
from numpy.typing import NDArray

_SUBSTEPS = 10
_TURN_COUNTS = 65536 * 360 / 352


def model(B: list[float], F: list[float], Ts: float = 0.05, **more: Any) -> armrig.Fit:
    """Return a model B/F in V, of which nothing was estimated."""
    nk = int(np.flatnonzero(B)[0])
    return armrig.Fit.of_channel(B=B, F=F, nk=nk, Ts=Ts, input_unit="V", **more)


def simulate(law: ControlLaw, model: armrig.Fit, r: Any) -> tuple[Any, Any]:
    """Return y (N, ny) and u (N,) of law and plant from their equations, term by term.

    u, y and the law begin at 0. An integrator adds differences, for a root at 1 is no exact root of
    rounded coefficients.
    """
    channels = [(fit.B, fit.denominator, fit.integrator) for _, _, fit in model.channels()]
    N = len(r)
    y, w, u, x = *np.zeros((2, N, len(channels))), np.zeros(N), np.zeros(law.order)
    A, B, C = np.array(law.A), np.array(law.B), np.array(law.C)
    for k in range(N):
        u[k] = C @ x + law.D * r[k]
        for i, (b, full, integrates) in enumerate(channels):
            f = np.cumsum(full)[:-1] if integrates else full
            w[k, i] = sum(b[j] * u[k - j] for j in range(1, len(b)) if k >= j)
            w[k, i] -= sum(f[j] * w[k - j, i] for j in range(1, len(f)) if k >= j)
            y[k, i] = w[k, i] + (y[k - 1, i] if integrates and k else 0.0)
        delayed = u[k - law.input_delay] if k >= law.input_delay else 0.0
        x = A @ x + B @ np.concatenate([[r[k], delayed], y[k]])
    return y, u


@dataclass(frozen=True, slots=True, kw_only=True)
class TruePlant:
    """Sampled plant: x[k+1] = rows (x[k], u[k-delay] - rest), y = outputs x + rest."""

    rows: Rows
    outputs: Rows
    rest: tuple[float, ...]
    noise: tuple[float, ...]
    """Deviation of the noise of each output."""
    delay: int = 0
    friction_v: float = 0.0
    """Coulomb friction at the motor, in V; rows are then those of a tenth of Ts."""
    fault_rows: Rows = ()
    """Rows from a fault "loose" on."""
    x0: tuple[float, ...] = ()
    """State at the beginning; rest by default."""


class Fault(NamedTuple):
    """Fault of a run, from sample k on."""

    kind: str = ""
    """"stuck", "railed", "reversed", "loose", or empty."""
    output: int = 0
    k: int = 0


NO_FAULT = Fault()


class LoopRun(NamedTuple):
    """Run of a law with a plant."""

    by: str
    """Gate or bound that ended the run; empty for a complete run."""
    y: NDArray[np.float64]
    """True outputs, (N, ny), up to the sample that ended the run."""
    codes: NDArray[np.int64]
    k_fault: int = 0
    """First sample with the fault; a sensor cannot stick at no reading."""


def play(
    law: ControlLaw,
    described: Description,
    plant: TruePlant,
    r: Sequence[float],
    rng: Generator,
    fault: Fault = NO_FAULT,
) -> LoopRun:
    """Return a run with noise, a converter of 10 bits, PWM of 8 bits, and the bounds of a run."""
    program, rest_v = law.program(described), described.input.rest_v
    latch = Latch(code_of(rest_v), pwm_bits=8)
    bounds = [*described.outputs.values()]
    state, outside = begin(program), [0] * len(bounds)
    x, start = plant.x0 or (0.0,) * len(plant.rows), float(rng.uniform(0, _TURN_COUNTS))
    underway, held = deque([0.0] * plant.delay), nan
    noise = (rng.standard_normal((len(r), len(plant.outputs))) * plant.noise).tolist()
    outputs, codes, by = [], [], ""
    for k in range(len(r)):
        state, command = decide(program, state, k, r, latch)
        codes.append(command.code)
        outputs.append(products(plant.outputs, x))
        values = [nan, nan]
        for i, change in enumerate(outputs[-1]):
            sign = -1 if fault.kind == "reversed" and i == fault.output and k >= fault.k else 1
            counts = bounds[i].conversion.counts(plant.rest[i] + sign * change + noise[k][i])
            if bounds[i].turning:
                counts = (counts + start) % _TURN_COUNTS
            step = min(max(floor(min(max(counts, -64.0), 65536.0) / 64 + 0.5), 0), 1023)
            convert = bounds[i].conversion
            values[i] = (
                convert.value(step * 64) if 0 < step < 1023 else convert.value_at_rail(step * 64)
            )
        if fault.kind in ("stuck", "railed") and k >= fault.k:
            if fault.kind == "stuck" and held != held:
                held, fault = values[fault.output], fault._replace(k=k)
            values[fault.output] = held
        state = observe(program, state, k, values, r, latch)
        for i, bound in enumerate(bounds):
            outside[i] = outside[i] + 1 if not bound.low <= values[i] <= bound.high else 0
            outside[i] *= values[i] == values[i]
            by = "limit" if outside[i] >= bound.samples else by
        by = "blind" if state.blind >= program.most_blind else by
        if program.monitor and state.monitor:
            alarm = monitor.alarm(program.monitor, state.monitor)
            by = f"{alarm.gate} of {alarm.name}" if alarm else by
            lost = monitor.find_lost_output(program.monitor, state.monitor)
            by = by or (f"{lost} lost" if lost else "")
        if by:
            break
        underway.append(volts_of(device_code(command.code, latch.pwm_bits)) - rest_v)
        is_loose = fault.kind == "loose" and k >= fault.k
        x = _next(plant, plant.fault_rows if is_loose else plant.rows, x, underway.popleft())
    return LoopRun(by, np.array(outputs) + plant.rest, np.array(codes), fault.k)


def _next(plant: TruePlant, rows: Rows, x: tuple[float, ...], u: float) -> tuple[float, ...]:
    """Return the state after a sample; the third state is the speed that friction brakes."""
    if not plant.friction_v:
        return products(rows, (*x, u))
    for _ in range(_SUBSTEPS):
        ahead = products(rows, (*x, u))
        sign = 1.0 if (x[2] or ahead[2]) > 0 else -1.0
        x = tuple(a - b[-1] * sign * plant.friction_v for a, b in zip(ahead, rows, strict=True))
        if x[2] * sign < 0:  # the motor stops
            x = (*x[:2], 0.0, *x[3:])
    return x
