"""The grey-box estimate: the physical parameters that minimise the simulation error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from armrig_core.rig.arm import ArmParameters, require_parameters
from armrig_core.rig.calibration import THETA_1
from armrig_core.rig.equations import Ode

from armrig.data.argument import takes_signals
from armrig.data.columns import Vector
from armrig.data.dataset import Signals
from armrig.numerics.criteria import fit_percent
from armrig.numerics.levenberg_marquardt import Optimum, levenberg_marquardt
from armrig.physics.grey_box.equations_estimate import estimated
from armrig.physics.grey_box.fit import GreyFit, below_zero, logarithmic, scales
from armrig.physics.grey_box.inference import MAX_LOG_FACTOR, Held, grey_fit, require_samples
from armrig.physics.grey_box.least_squares_problem import (
    GreyBox,
    GreyBoxWithFriction,
    bipolar,
    by_experiment,
)
from armrig.physics.grey_box.sampled_model import (
    COULOMB,
    NAMES,
    Friction,
    Model,
    Physics,
    checked_fixed_std,
    free_names,
    require_output,
)
from armrig.physics.systems import arm, chassis

SPEED_STATE = "theta_1_rate"
_MIN_LOG_RATIO = 10.0  # least N ln(ratio of two costs) of a significant difference
_MIN_COST = 1e-300
_MAX_ROUNDS = 8  # largest number of estimates of the outputs' noise
_SETTLED = 1e-4  # relative change of the noise's standard deviations at which the rounds end


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
        Function `ArmParameters` -> control.StateSpace, continuous with one input: `armrig.chassis`
        if the rotating part was removed, `armrig.arm` for the complete rig, or your own function.
        The default is `armrig.chassis` for one output, and `armrig.arm` for several.
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
    >>> fit = armrig.greybox(data, armrig.arm, free=("J_1", "K_lin"))
    >>> for name in fit.names:
    ...     print(f"{name} = {fit.values[name]:.2g} ± {100 * fit.relative_std[name]:.1f} %")
    J_1 = 0.0017 ± 0.1 %
    K_lin = 1.2 ± 0.1 %
    """
    if isinstance(model, Ode):
        held = {} if fixed is None else fixed
        if isinstance(held, ArmParameters):
            raise InputTypeError("fixed: give a mapping of names to values for own equations")
        return estimated(data, model, held, output if output in data.outputs else None)
    require_parameters(ArmParameters() if fixed is None else fixed, "fixed")
    p = fixed if isinstance(fixed, ArmParameters) else ArmParameters()
    names = free_names(free, friction)
    given = checked_fixed_std(fixed_std or {}, names)
    _require_channels(data, names, output)
    labels = (output,) if data.ny == 1 else data.outputs
    model = model or (chassis if data.ny == 1 else arm)
    physics = tuple(Physics(model=model, fixed=p, output=label) for label in labels)
    for one in physics:
        one.check()
    if data.ny == 1:
        require_output(data.outputs[0], output)
    experiments = tuple(data.experiments())
    require_samples(data, names, unknown=len(physics[0].labels()[1]) + 1)
    spread = np.nanstd(data.y, axis=0) if data.ny > 1 else np.ones(1)
    plain = GreyBox(
        physics=physics,
        names=tuple(x for x in names if x != COULOMB),
        experiments=experiments,
        std=spread,
    )
    eta = plain.coordinates({name: getattr(p, name) for name in plain.names})
    plain, best = minimised(plain, eta)
    if COULOMB not in names:
        return _fit(data, plain, best, eta, names, given, labels.index(output))
    states = physics[0].labels()[1]
    if SPEED_STATE not in states:
        raise InputError(f"Coulomb friction needs a state {SPEED_STATE!r}, the model has {states}")
    problem = GreyBoxWithFriction(plain=plain, speed=states.index(SPEED_STATE))
    start = problem.start(best.theta)
    without, best = best, searched(problem, start)
    worse = worse_with_friction(data, without.cost, best.cost)
    return _fit(data, problem, best, start, names, given, 0, worse)


def _require_channels(data: Signals, names: Sequence[str], output: str) -> None:
    """Refuse signals that do not fit the rig, and Coulomb friction of several outputs."""
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


def minimised(problem: GreyBox, start: Vector) -> tuple[GreyBox, Optimum]:
    """Return the problem with the estimated noise of several outputs, and its minimum."""
    best = searched(problem, start)
    for _ in range(_MAX_ROUNDS if problem.std.size > 1 else 0):
        e = np.vstack(by_experiment(problem.at(best.theta).e, problem.experiments, problem.std))
        std = np.maximum(np.sqrt(np.nanmean(e**2, axis=0)), 1e-12 * problem.std)
        change = float(np.max(np.abs(std / problem.std - 1)))
        problem = replace(problem, std=std)
        if change < _SETTLED:
            break
        best = searched(problem, best.theta, around=start)
    return problem, best


def searched(
    problem: GreyBox | GreyBoxWithFriction, start: Vector, around: Vector | None = None
) -> Optimum:
    """Return the minimum that a search from `start` finds.

    The logarithm of each parameter differs by at most `MAX_LOG_FACTOR` from its value in `around`.
    By default `around` is `start`.
    """
    plain = problem if isinstance(problem, GreyBox) else problem.plain
    logarithms = np.flatnonzero(logarithmic(plain.names))
    centre = start if around is None else around

    def admissible(eta: Vector) -> bool:
        return bool(np.all(np.abs(eta - centre)[logarithms] < MAX_LOG_FACTOR))

    # A model that overflows has no finite cost, and the search refuses the step.
    with np.errstate(over="ignore", invalid="ignore"):
        return levenberg_marquardt(problem.linearise, start, admissible=admissible)


def _fit(
    data: Signals,
    problem: GreyBox | GreyBoxWithFriction,
    best: Optimum,
    start: Vector,
    names: tuple[str, ...],
    fixed_std: dict[str, float],
    i: int,
    worse: tuple[str, ...] = (),
) -> GreyFit:
    """Return the result, whose loss, fit and whiteness are those of output i."""
    plain = problem if isinstance(problem, GreyBox) else problem.plain
    physics, at = plain.physics[i], problem.at(best.theta)
    values = plain.values(best.theta[: len(plain.names)])
    if COULOMB in names:
        values[COULOMB] = float(best.theta[len(plain.names)])
    held = tuple(x for x in NAMES if x not in names)
    return grey_fit(
        data,
        i,
        plain.std,
        at,
        best,
        values=values,
        slopes=scales(names, values),
        moved=np.where(logarithmic(names), (best.theta - start)[: len(names)], 0.0),
        held=Held(
            values=physics.parameters(values),
            names=held,
            Psi=problem.at(best.theta, held).Psi,
            std=fixed_std,
            coordinate_std=np.array([fixed_std.get(x, 0.0) for x in held])
            / scales(held, {x: getattr(physics.fixed, x) for x in held}),
        ),
        physics=physics,
        doubts=lambda std: [*worse, *below_zero(values, std)],
        has_friction=bool({"b_1", COULOMB} & {*names}),
    )


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
