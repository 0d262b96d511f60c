"""The estimate of the parameters of own equations."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.errors import InputError
from armrig_core.rig.equations import Ode, Parameter
from numpy.typing import ArrayLike

from armrig.data.columns import Matrix, Vector
from armrig.data.dataset import Signals
from armrig.numerics.levenberg_marquardt import MAX_STEPS, Optimum, levenberg_marquardt
from armrig.numerics.whiteness import default_lags, joined, ljung_box
from armrig.physics.grey_box.fit import GreyFit
from armrig.physics.grey_box.inference import MAX_LOG_FACTOR, Held, grey_fit, require_samples
from armrig.physics.grey_box.least_squares_problem import by_experiment
from armrig.physics.grey_box.shooting import (
    COLUMNS,
    MIN_SEGMENT,
    Box,
    Coordinates,
    Segments,
    Shooting,
)

if TYPE_CHECKING:
    import control

WINDOW = 2000
"""Samples with which the search begins in a longer experiment."""
_MAX_SOLVER_SHARE = 0.1  # largest error of the solver, as a share of the noise's deviation
_MAX_ROUNDS = 8
_MIN_P = 1e-6  # p value of the test of whiteness above which no other start is tried
_EXACT_SHARE = 1e-5  # largest residual of data without noise, as a share of the deviation
_MAX_DRAWS = 8
_NEAR_MISFIT = 1.0  # largest difference from the lowest misfit at which more steps may help
_TRIAL_STEPS = 30  # of the search from each start
_DRAWN = 1.4  # largest change of a coordinate in a drawn start; e^1.4 is 4
_SETTLED = 1e-4  # relative change of the noise's deviations at which the rounds end


@dataclass(frozen=True, slots=True, kw_only=True)
class Equations:
    """Physics of a `GreyFit`: own equations, and the precision of their integration."""

    model: Ode
    output: str
    steps: int
    """Runge-Kutta steps in each interval."""
    solver_error: float
    """Largest error of the output by the integration."""

    @property
    def units(self) -> dict[str, str]:
        """Units of the parameters."""
        return self.model.units

    def signed(self, name: str) -> bool:
        """Return whether a parameter may be negative."""
        p = self.model.parameters[name]
        return not (isinstance(p, Parameter) and p.low >= 0)

    def errors(self, values: Mapping[str, float], experiments: tuple[Signals, ...]) -> Matrix:
        """Return measured minus simulated outputs (N, ny); the initial states are estimated."""
        with np.errstate(all="ignore"):
            problem = _problem(self.model, (), {**self.model.values, **values}, experiments)
            nothing = np.zeros(0)
            z = problem.relaxed(nothing, problem.begun(nothing))
            return _residuals(problem, _searched(problem, z))

    def to_control(self, parameters: Any) -> control.StateSpace:
        """Refuse: own equations may be nonlinear."""
        raise InputError("own equations have no linear model; use fit.physics.simulate")

    def simulate(
        self, values: Mapping[str, float], u: ArrayLike, Ts: float, x0: ArrayLike | None = None
    ) -> Matrix:
        """Return the outputs (N, ny)."""
        return self.model.simulate(u, Ts=Ts, x0=x0, values=values, steps=self.steps)


def estimated(data: Signals, ode: Ode, fixed: Mapping[str, float], output: str | None) -> GreyFit:
    """Return the estimates of all parameters that are not fixed."""
    for name in fixed:
        if name not in ode.parameters:
            raise InputError(f"fixed={name!r} is none of {', '.join(ode.parameters)}")
    names = tuple(name for name in ode.parameters if name not in fixed)
    if not names:
        raise InputError("all parameters are fixed: there is nothing to estimate")
    experiments = tuple(data.experiments())
    require_samples(data, names, unknown=len(ode.states))
    with np.errstate(all="ignore"):
        returned = ode.simulate(data.u[:2], Ts=data.equidistant(), values=fixed, steps=1).shape[1]
        if returned != data.ny:
            raise InputError(
                f"output returns {returned} values; the data have {data.ny} outputs, "
                f"{', '.join(data.outputs)}: choose them with signals.channels(outputs)"
            )
        problem, best, start = _minimised(ode, names, {**ode.values, **fixed}, experiments)
        return _fit(data, problem, best, start, 0 if output is None else data.output(output))


def _problem(
    ode: Ode, names: tuple[str, ...], values: Mapping[str, float], parts: tuple[Signals, ...]
) -> Shooting:
    """Return the problem of experiments, in segments of a suitable length."""
    own = [ode.parameters[name] for name in names]
    space = Coordinates(parameters=tuple(p for p in own if isinstance(p, Parameter)))
    start = space.of([values[name] for name in names])
    reach = np.where(space.bounded(), MAX_LOG_FACTOR, np.inf)
    spread = np.nanstd(np.vstack([part.y for part in parts]), axis=0)
    columns, N = 1 + 2 * (len(names) + len(ode.states)), max(part.N for part in parts)
    count = int(np.clip(COLUMNS / columns, 1, max(N // MIN_SEGMENT, 1)))
    length = max(-(-(N - 1) // count), 1)
    return Shooting(
        ode=ode,
        names=names,
        fixed=dict(values),
        experiments=parts,
        std=np.where(spread > 0, spread, 1.0),
        spread=spread,
        length=length,
        scale=np.ones(len(ode.states)),
        box=Box(low=start - reach, high=start + reach),
        segments=tuple(Segments.of(part, length) for part in parts),
    )


def _minimised(
    ode: Ode, names: tuple[str, ...], values: Mapping[str, float], experiments: tuple[Signals, ...]
) -> tuple[Shooting, Optimum, Vector]:
    """Return the problem, its minimum and the coordinates at which the search started."""

    def problem(parts: tuple[Signals, ...]) -> Shooting:
        return _problem(ode, names, values, parts)

    windows = tuple(map(liveliest, experiments))
    start = problem(windows).coordinates.of([values[name] for name in names])
    found: list[tuple[float, Shooting, Optimum]] = []
    failed, lowest = InputError("no start leads to finite outputs"), np.inf
    draws = np.random.default_rng(0).uniform(-_DRAWN, _DRAWN, (_MAX_DRAWS, start.size))
    for at in [start, *(start + draw for draw in draws)]:
        short = problem(windows)
        try:
            z = short.relaxed(at, short.begun(at))
            trial = short, _searched(short, z, _TRIAL_STEPS)
            if _misfit(*trial) < lowest + _NEAR_MISFIT:
                trial = _refined(*trial, _TRIAL_STEPS)
        except InputError as err:
            failed = err if at is start else failed
            continue
        found.append((_misfit(*trial), *trial))
        lowest = min(misfit for misfit, *_ in found)
        if _is_white(*trial):
            break
    if not found:
        raise failed
    _, whole, best = min(found, key=lambda trial: trial[0])
    if any(window.N < part.N for window, part in zip(windows, experiments, strict=True)):
        whole, eta = problem(experiments), best.theta[: start.size]
        best = _searched(whole, whole.relaxed(eta, whole.begun(eta)))
    elif not best.converged:
        best = _searched(whole, best.theta)
    whole, best = _refined(whole, best)
    if whole.std.size == 1:  # the inference of a single output takes errors in its unit
        best = replace(best, cost=best.cost * float(whole.std[0]) ** 2)
        whole = whole.changed(std=np.ones(1))
    return whole, best, start


def _misfit(problem: Shooting, best: Optimum) -> float:
    """Return the sum of the logarithms of the outputs' losses."""
    return float(np.sum(np.log(np.nanmean(_residuals(problem, best) ** 2, axis=0))))


def _is_white(problem: Shooting, best: Optimum) -> bool:
    """Return whether the residuals are noise, so that no other start leads to a lower minimum."""
    e = by_experiment(problem.linearise(best.theta)[0], problem.experiments, problem.std)
    lags = default_lags(min(part.shape[0] for part in e))
    for i, spread in enumerate(problem.spread):
        of_output = joined([part[:, i] for part in e], lags)
        exact = np.nanmax(np.abs(of_output)) <= _EXACT_SHARE * spread
        if not (exact or ljung_box(of_output, lags) > _MIN_P):
            return False
    return True


def liveliest(data: Signals) -> Signals:
    """Return the window of at most `WINDOW` samples in which the outputs deviate most."""
    if data.N <= 2 * WINDOW:
        return data
    windows = [data[k : k + WINDOW] for k in range(0, data.N - WINDOW + 1, WINDOW // 2)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a window without a value is no window
        spreads = [np.nanmean(np.nanstd(part.y, axis=0)) for part in windows]
    return windows[int(np.nanargmax(spreads))]


def _searched(problem: Shooting, z: Vector, most: int = MAX_STEPS) -> Optimum:
    """Return the minimum that a search from z finds, inside the box of the problem."""
    free = np.full(z.size - problem.box.low.size, np.inf)
    walls = Box(low=np.append(problem.box.low, -free), high=np.append(problem.box.high, free))
    return levenberg_marquardt(
        problem.linearise, walls.inside(z, z), admissible=lambda _: True, most=most, walls=walls
    )


def _refined(problem: Shooting, best: Optimum, most: int = MAX_STEPS) -> tuple[Shooting, Optimum]:
    """Return problem and minimum with the noise of several outputs, and with enough steps."""
    for _ in range(_MAX_ROUNDS):
        e = _residuals(problem, best)
        noise = np.sqrt(np.nanmean(e**2, axis=0))
        steps, _ = problem.solver_error(best.theta, _MAX_SOLVER_SHARE * noise)
        finer = steps > problem.steps
        std = np.maximum(noise, 1e-12 * problem.std) if noise.size > 1 else problem.std
        settled = np.max(np.abs(std / problem.std - 1)) < _SETTLED
        if settled and not finer:
            break
        problem = problem.changed(std=std, steps=steps if finer else problem.steps)
        best = _searched(problem, best.theta, most)
    return problem, best


def _residuals(problem: Shooting, best: Optimum) -> Matrix:
    """Return the residuals (N, ny) of all experiments."""
    return np.vstack(
        by_experiment(problem.linearise(best.theta)[0], problem.experiments, problem.std)
    )


def _fit(data: Signals, problem: Shooting, best: Optimum, start: Vector, i: int) -> GreyFit:
    """Return the result, whose loss, fit and whiteness are those of output i."""
    d = len(problem.names)
    at, values = problem.at(best.theta), problem.values(best.theta)
    noise = np.sqrt(np.nanmean(_residuals(problem, best) ** 2, axis=0))
    allowed = _MAX_SOLVER_SHARE * noise
    error = problem.solver_error(best.theta, allowed)[1][i]
    doubts = [f"the integration is exact to {error:.1g}; the noise is {noise[i]:.1g}"]
    return grey_fit(
        data,
        i,
        problem.std,
        at,
        best,
        values=values,
        slopes=problem.coordinates.slopes(best.theta[:d]),
        moved=np.where(problem.coordinates.bounded(), best.theta[:d] - start, 0.0),
        held=Held(values={**problem.fixed, **values}),
        physics=Equations(
            model=problem.ode,
            output=data.outputs[i],
            steps=problem.steps,
            solver_error=float(error),
        ),
        doubts=lambda std: doubts if error > 2 * allowed[i] else [],
        has_friction=True,
    )
