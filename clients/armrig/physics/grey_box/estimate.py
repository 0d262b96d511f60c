"""The grey-box estimate: the physical parameters that minimise the simulation error."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from armrig_core.rig.arm import ArmParameters, require_parameters
from armrig_core.rig.calibration import THETA_1
from armrig_core.rig.equations import Ode
from armrig_core.telemetry.channels import ARM_OUTPUTS

from armrig.data.argument import takes_signals
from armrig.data.columns import Vector
from armrig.data.dataset import Signals
from armrig.numerics.criteria import fit_percent
from armrig.numerics.levenberg_marquardt import MAX_STEPS, Optimum
from armrig.numerics.quantities import plural
from armrig.numerics.whiteness import default_lags, join_residuals, ljung_box
from armrig.physics.grey_box.fit import GreyFit
from armrig.physics.grey_box.inference import MAX_SOLVER_SHARE, grey_fit, require_samples
from armrig.physics.grey_box.physical_models import (
    COULOMB,
    NAMES,
    Equations,
    Friction,
    Model,
    PhysicalModel,
    Physics,
    bipolar,
    free_names,
)
from armrig.physics.grey_box.shooting import Shooting
from armrig.physics.systems import SPEED, arm, chassis

WINDOW = 2000
"""Samples with which the search begins in a longer experiment."""
_MIN_LOG_RATIO = 10.0  # least N ln(ratio of two costs) of a significant difference
_MIN_COST = 1e-300
_MIN_START_V = 0.01  # least start value of the friction in a search
_MAX_ROUNDS = 8  # largest number of estimates of the outputs' noise
_SETTLED = 1e-4  # relative change of the noise's standard deviations at which the rounds end
_MIN_P = 1e-6  # p value of the test of whiteness above which no other start is tried
_EXACT_SHARE = 1e-5  # largest residual of data without noise, as a share of the deviation
_MAX_DRAWS = 8
_NEAR_MISFIT = 1.0  # largest difference from the lowest misfit at which more steps may help
_TRIAL_STEPS = 30  # of the search from each start
_TRIAL_SHARE = 0.1  # largest error of the solver there, as a share of the residuals' deviation
_DRAWN = 1.4  # largest change of a coordinate in a drawn start; e^1.4 is 4


@takes_signals
def greybox(
    data: Signals,
    model: Model | Ode | None = None,
    free: Sequence[str] = ("J_1",),
    fixed: ArmParameters | Mapping[str, float] | None = None,
    output: str = THETA_1,
    *,
    fixed_std: Mapping[str, float] | None = None,
    friction: Friction | None = None,
) -> GreyFit:
    """Estimate physical parameters, such as J_1, by minimising the error of the simulated output.

    The model and its derivatives are sampled exactly for the held input. Initial state and input
    offset u0 of each experiment are estimated too. A missing output removes only its own residual.
    If there are several outputs, the sum of ``|e_i|²/std_i²`` over the outputs i is minimised. The
    standard deviations std_i of the noise are estimated again after each search.
    For the chassis, with a = N K_m / R_m and d = (N K_m)² / R_m, the equation is ::

        J_1 theta_1'' = a (u - u0) - (d + b_1) theta_1' - T_c sign theta_1'

    Parameters
    ----------
    data : Dataset or Signals
        u in V and the output that `output` names. If Signals contain theta_1 and alpha, named as in
        the model, both outputs are used together.
    model : callable, optional
        Function `ArmParameters` -> control.StateSpace, continuous with one input:
        `armrig.physics.chassis` if the rotating part was removed, `armrig.physics.arm` for the
        complete rig, or your own function. The default is `armrig.physics.chassis` for one output,
        and `armrig.physics.arm` for several.
    free : sequence of str, default ("J_1",)
        Parameters to estimate, fields of `ArmParameters`. The search starts at their values in
        `fixed`.
    fixed : ArmParameters, optional
        Values of all other parameters; by default the values of the handout.
    output : str, default "theta_1"
        Label of the model's measured output. If there are several outputs, `plot`, `simulate` and
        the tests of the result refer to this output.
    fixed_std : mapping of str to float, optional
        Standard deviations of fixed parameters. The variances that result from these standard
        deviations are added to the variances of the estimates.
    friction : {"viscous", "coulomb", "both"}, optional
        Estimate the friction of the chassis too: b_1 in Nms/rad, T_c in Nm, or both. The default,
        as in the handout, neglects friction. Neglected viscous friction biases J_1. Neglected
        Coulomb friction biases J_1 if the chassis stops. If the chassis does not stop, u0 contains
        the Coulomb friction. If T_c is estimated, u0 is estimated only with a bipolar input. With
        an input of one sign, T_c and u0 cannot be distinguished, and u0 is 0. T_c needs data of one
        output.

    Returns
    -------
    GreyFit
        `covariance` is lambda (Psi^T Psi)^-1 plus the contribution of `fixed_std`. lambda is the
        variance of the noise. Psi contains the derivatives of the output, without the parts that a
        change of initial state and offset explains. `covariance_robust` is the sandwich form plus
        the contribution of `fixed_std`. For several outputs, `by_output` contains loss, fit and
        whiteness of each output.

    Raises
    ------
    ValueError
        A name is unknown or given twice, or the model lacks an output or a state. The data have
        several inputs or too few samples, or do not determine the parameters.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 4.3 (tailor-made models),
       7.2 and 9.4.
    .. [2] G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432 (linear parameters
       projected out).

    Examples
    --------
    >>> import armrig
    >>> data = armrig.example_recording().dataset("theta_1")
    >>> fit = armrig.greybox(data, armrig.physics.arm, free=("J_1", "K_lin"))
    >>> for name in fit.names:
    ...     print(f"{name} = {fit.values[name]:.2g} ± {100 * fit.relative_std[name]:.1f} %")
    J_1 = 0.0017 ± 0.1 %
    K_lin = 1.2 ± 0.1 %
    """
    if isinstance(model, Ode):
        held = {} if fixed is None else fixed
        if isinstance(held, ArmParameters):
            raise InputTypeError("fixed: give a mapping of names to values for own equations")
        return _equations(data, model, held, data.output(output) if output in data.outputs else 0)
    require_parameters(ArmParameters() if fixed is None else fixed, "fixed")
    p = fixed if isinstance(fixed, ArmParameters) else ArmParameters()
    names = free_names(free, friction)
    for name, std in (fixed_std or {}).items():
        if name not in NAMES or name in names:
            msg = f"fixed_std={name!r} is not a fixed parameter; the fixed parameters are "
            msg += ", ".join(x for x in NAMES if x not in names)
            raise InputError(msg)
        if not (np.isfinite(std) and std >= 0):
            raise InputError(f"fixed_std[{name!r}]={std!r} must be finite and >= 0")
    if data.nu != 1:
        raise InputError(
            f"the inputs are {', '.join(data.inputs)}; the rig has one, u: choose it with "
            "signals.channels(outputs, inputs)"
        )
    if data.ny > 1 and output not in data.outputs:
        raise InputError(f"output={output!r} is none of the data's {', '.join(data.outputs)}")
    if data.ny > 1 and COULOMB in names:
        raise InputError(
            'friction: Coulomb friction is estimated from one output; give friction="viscous", or '
            'signals.dataset("theta_1")'
        )
    physics = Physics(
        model=model or (chassis if data.ny == 1 else arm),
        fixed=p,
        outputs=(output,) if data.ny == 1 else data.outputs,
    )
    physics.check()
    if data.ny == 1:
        measured = data.outputs[0]
        if measured in ARM_OUTPUTS and measured != output:
            raise InputError(
                f"the data contain {measured}, the model's output is {output}; use "
                f"recording.dataset(output={output!r})"
            )
    if COULOMB in names and SPEED not in physics.states:
        raise InputError(
            f"Coulomb friction needs a state {SPEED!r}, the model has {physics.states[:-1]}"
        )
    require_samples(data, names, unknown=len(physics.states))
    experiments = tuple(data.experiments())
    worse: tuple[str, ...] = ()
    with np.errstate(all="ignore"):
        linear = tuple(name for name in names if name != COULOMB)
        problem, best, start = minimise(physics, linear, asdict(p), experiments)
        if COULOMB in names:
            without, values = best.cost, asdict(p) | problem.values(best.theta)
            # If u0 is not free with friction, T_c explains the u0 of the problem without friction.
            offsets = zip(problem.initial(best.theta)[:, -1], experiments, strict=True)
            taken = [u0 for u0, part in offsets if not bipolar(part.u[:, 0])]
            volts = max(float(np.mean(taken)) if taken else 0.0, _MIN_START_V)
            values[COULOMB] = volts * physics.all_values(values).torque_per_volt
            rubbing = replace(physics, friction=True)
            problem, best, start = minimise(rubbing, names, values, experiments)
            worse = worse_with_friction(data, without, best.cost)
        i = physics.outputs.index(output)
        return grey_fit(data, i, problem, best, start, fixed_std=fixed_std or {}, worse=worse)


def _equations(data: Signals, ode: Ode, fixed: Mapping[str, float], i: int) -> GreyFit:
    """Return the estimates of all parameters of own equations that are not fixed."""
    for name in fixed:
        if name not in ode.parameters:
            raise InputError(f"fixed={name!r} is none of {', '.join(ode.parameters)}")
    names = tuple(name for name in ode.parameters if name not in fixed)
    if not names:
        raise InputError("all parameters are fixed: there is nothing to estimate")
    require_samples(data, names, unknown=len(ode.states))
    with np.errstate(all="ignore"):
        returned = ode.simulate(data.u[:2], Ts=data.Ts, values=fixed, steps=1).shape[1]
        if returned != data.ny:
            raise InputError(
                f"output returns {plural(returned, 'value')}; the data have "
                f"{plural(data.ny, 'output')}, "
                f"{', '.join(data.outputs)}: choose them with signals.channels(outputs)"
            )
        minimum = minimise(
            Equations(model=ode),
            names,
            {**ode.values, **fixed},
            tuple(data.experiments()),
            draws=_MAX_DRAWS,
        )
        return grey_fit(data, i, *minimum, fixed_std={})


def minimise(
    model: PhysicalModel,
    names: tuple[str, ...],
    values: dict[str, float],
    experiments: tuple[Signals, ...],
    *,
    draws: int = 0,
) -> tuple[Shooting, Optimum, Vector]:
    """Return the problem, its minimum and the coordinates at which the search started.

    If the residuals are not white, the search is repeated from at most `draws` other starts.
    """
    problem = partial(Shooting.of, model, names, values)
    windows = tuple(map(liveliest, experiments))
    start = problem(windows).coordinates.of([values[name] for name in names])
    runs: list[tuple[float, Shooting, Optimum]] = []
    failed = InputError("no start leads to finite outputs")
    drawn = np.random.default_rng(0).uniform(-_DRAWN, _DRAWN, (draws, start.size))
    for at in [start, *(start + draw for draw in drawn)]:
        short = problem(windows)
        try:
            best = short.searched(short.solve_relaxed(at, short.start_states(at)), _TRIAL_STEPS)
            if not best.converged:
                seen = _effective(short, best, at)
                z = np.append(seen, best.theta[seen.size :])
                best = min(best, short.searched(z, _TRIAL_STEPS), key=lambda found: found.cost)
            trial = short, best
            if _misfit(*trial) < min((run[0] for run in runs), default=np.inf) + _NEAR_MISFIT:
                trial = _refine(*trial, _TRIAL_STEPS, _TRIAL_SHARE)
        except InputError as err:
            failed = err if at is start else failed
            continue
        runs.append((_misfit(*trial), *trial))
        if _is_white(*trial):
            break
    if not runs:
        raise failed
    _, shooting, best = min(runs, key=lambda trial: trial[0])
    if any(window.N < part.N for window, part in zip(windows, experiments, strict=True)):
        eta, short = _effective(shooting, best, start), shooting
        shooting = problem(experiments).changed(steps=short.steps, scale=short.scale)
        best = shooting.searched(shooting.solve_relaxed(eta, shooting.start_states(eta)))
    elif not best.converged:
        best = shooting.searched(best.theta)
    shooting, best = _refine(shooting, best)
    if shooting.std.size == 1:  # the inference of a single output takes errors in its unit
        best = replace(best, cost=best.cost * float(shooting.std[0]) ** 2)
        shooting = shooting.changed(std=np.ones(1))
    return shooting, best, start


def _effective(problem: Shooting, best: Optimum, start: Vector) -> Vector:
    """Return the coordinates, or those of the start where a factor e has no visible effect."""
    Psi, *_ = problem.at(best.theta)
    is_seen = np.sum(Psi**2, axis=0) > best.cost / Psi.shape[0]
    return np.where(is_seen, best.theta[: start.size], start)


def _misfit(problem: Shooting, best: Optimum) -> float:
    """Return the sum of the logarithms of the outputs' losses."""
    return float(np.sum(np.log(np.nanmean(problem.residuals(best.theta) ** 2, axis=0))))


def _is_white(problem: Shooting, best: Optimum) -> bool:
    """Return whether the residuals are noise, so that no other start leads to a lower minimum."""
    e, rows = problem.residuals(best.theta), problem.segments.rows
    lags = default_lags(min(part.stop - part.start for part in rows))
    for i, spread in enumerate(np.nanstd(problem.segments.y, axis=0)):
        of_output = join_residuals([e[part, i] for part in rows], lags)
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


def _refine(
    problem: Shooting, best: Optimum, most: int = MAX_STEPS, share: float = MAX_SOLVER_SHARE
) -> tuple[Shooting, Optimum]:
    """Return problem and minimum with the noise of several outputs, and with enough steps."""
    for _ in range(_MAX_ROUNDS):
        noise = np.sqrt(np.nanmean(problem.residuals(best.theta) ** 2, axis=0))
        steps, _ = problem.solver_error(best.theta, share * noise)
        finer = steps > problem.steps
        std = np.maximum(noise, 1e-12 * problem.std) if noise.size > 1 else problem.std
        settled = np.max(np.abs(std / problem.std - 1)) < _SETTLED
        if settled and not finer:
            break
        problem = problem.changed(std=std, steps=steps if finer else problem.steps)
        best = problem.searched(best.theta, most)
    return problem, best


def worse_with_friction(data: Signals, without: float, best: float) -> tuple[str, ...]:
    """Return a warning if the fit is significantly worse with Coulomb friction.

    `without` and `best` are |e|² without and with Coulomb friction.
    """
    samples = data.N - data.missing
    if not samples * np.log(max(best, _MIN_COST) / max(without, _MIN_COST)) > _MIN_LOG_RATIO:
        return ()
    y = data.y[data.valid]
    fits = [f"{fit_percent(y, cost):.1f} %" for cost in (best, without)]
    held = not all(bipolar(part.u) for part in data.experiments())
    way_out = (
        'the input has one sign and u0 is held at 0: use friction="viscous", or play an input of '
        "both signs"
        if held
        else "the search ended in a poorer minimum: begin nearer, with another `fixed`"
    )
    return (f"with Coulomb friction the fit is {fits[0]}, without it {fits[1]}: {way_out}",)
