"""The grey-box estimate: physical parameters that fit the simulated output best."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from armrig_core.arm import ArmParameters, require_parameters
from armrig_core.errors import InputError
from armrig_core.telemetry import THETA_1
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.quantisation import quantum, too_quiet
from armrig.numerics.criteria import fit_percent
from armrig.numerics.inference import Inference, infer
from armrig.numerics.levenberg_marquardt import Optimum, levenberg_marquardt
from armrig.physics.grey_box.fit import GreyFit, below_zero
from armrig.physics.grey_box.least_squares_problem import GreyBox, GreyBoxWithFriction, bipolar
from armrig.physics.grey_box.parameters import (
    COULOMB,
    NAMES,
    SIGNED,
    Friction,
    checked_fixed_std,
    free_names,
    require_output,
)
from armrig.physics.grey_box.sampled_model import Model, Physics
from armrig.physics.grey_box.uncertainty import (
    by_experiment,
    determined,
    named_influence,
    named_std,
    scales,
)
from armrig.physics.systems import chassis

Vector = NDArray[np.float64]

RATE = "theta_1_rate"
ROUNDING = 1e-18  # share of |y|² below which |e|² is rounding noise
_UNSEEN = 1e-7  # share of a derivative below which the free response explains all of it
FURTHEST = 12.0
"""Logarithm of the factor by which a parameter may move from its start; e^12 is 160 000."""
_AT_BOUND = 0.98  # share of it from which on a search has ended there: its steps are halved
_CLEARLY = 10.0  # N ln of the ratio of two costs above which one is worse by more than chance
_TINY = 1e-300


@takes_recordings
def greybox(
    data: Dataset,
    model: Model = chassis,
    free: Sequence[str] = ("J_1",),
    fixed: ArmParameters | None = None,
    output: str = THETA_1,
    *,
    fixed_std: Mapping[str, float] | None = None,
    friction: Friction | None = None,
) -> GreyFit:
    """Estimate physical parameters by minimising the error of the simulated output.

    The model is sampled exactly for the held input, and its derivatives with it. Initial state and
    input offset u0 of each experiment are estimated along; missing outputs cost their own rows.
    The chassis alone, with a = N K_m / R_m and d = (N K_m)² / R_m ::

        J_1 theta_1'' = a (u - u0) - (d + b_1) theta_1' - T_c sign theta_1'

    Parameters
    ----------
    data : Dataset
        u in V and the output that `output` names.
    model : callable, default `armrig.chassis`
        `ArmParameters` -> control.StateSpace, continuous, one input; `armrig.arm` and your own too.
    free : sequence of str, default ("J_1",)
        Parameters to estimate, fields of `ArmParameters`; the search starts at their values in
        `fixed`.
    fixed : ArmParameters, optional
        Values of all others; the handout's by default.
    output : str, default "theta_1"
        Label of the model's output that was measured.
    fixed_std : mapping of str to float, optional
        Standard deviations of parameters that are held fixed; carried into those of the estimates.
    friction : {"viscous", "coulomb", "both"}, optional
        Estimate the friction of the chassis too: b_1 in Nms/rad, T_c in Nm, or both. The handout
        says that it may be neglected, which is the default, and shifts J_1 where there is any
        (Coulomb friction only where the chassis stops: without, u0 takes it). With T_c the offset
        of an experiment is estimated where its input is bipolar, and held at 0 where it is not:
        on an input of one sign the two stand in for each other.

    Returns
    -------
    GreyFit
        `covariance` is lambda (Psi^T Psi)^-1 with the free responses marginalised, and on top what
        `fixed_std` adds; `covariance_robust` the same with the sandwich form.

    Raises
    ------
    ValueError
        A name is unknown or given twice, the model lacks what is needed, there are too few
        samples, or the data do not determine the parameters.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 4.3 (tailor-made models),
       7.2 and 9.4.
    .. [2] G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432 (linear parameters
       projected out).
    """
    p = ArmParameters() if fixed is None else fixed
    require_parameters(p)
    names = free_names(free, friction)
    given = checked_fixed_std(fixed_std or {}, names)
    physics = Physics(model=model, fixed=p, output=output)
    physics.check()
    require_output(data, output)
    experiments = tuple(data.experiments())
    _require_samples(data, experiments, names, states=len(physics.labels()[1]))
    plain = GreyBox(
        physics=physics, names=tuple(x for x in names if x != COULOMB), experiments=experiments
    )
    eta = plain.coordinates({name: getattr(p, name) for name in plain.names})
    best = _search(plain, eta)
    if COULOMB not in names:
        return _fit(data, plain, best, eta, names, given)
    problem = GreyBoxWithFriction(plain=plain, speed=_speed(physics))
    start = problem.start(best.theta)
    without, best = best, _search(problem, start)
    worse = worse_with_friction(data, without.cost, best.cost)
    return _fit(data, problem, best, start, names, given, worse)


def _require_samples(
    data: Dataset, experiments: Sequence[Dataset], names: Sequence[str], *, states: int
) -> None:
    samples = data.N - data.missing
    needed = len(names) + (states + 1) * len(experiments) + 1
    if samples < needed or min(part.N for part in experiments) < 2:
        where = f" in {len(experiments)} experiments, two in each" if len(experiments) > 1 else ""
        raise InputError(
            f"{samples} samples came, to estimate {', '.join(names)} at least {needed} are "
            f"needed{where}: record longer, or cut into fewer parts"
        )


def _search(problem: GreyBox | GreyBoxWithFriction, start: Vector) -> Optimum:
    """Return the minimum near a start; no logarithm is searched further off than `FURTHEST`."""
    plain = problem if isinstance(problem, GreyBox) else problem.plain
    logarithms = np.flatnonzero([name not in SIGNED for name in plain.names])

    def admissible(eta: Vector) -> bool:
        return bool(np.all(np.abs(eta - start)[logarithms] < FURTHEST))

    # A model that explodes has no finite cost, and is passed over.
    with np.errstate(over="ignore", invalid="ignore"):
        return levenberg_marquardt(problem.linearise, start, admissible=admissible)


def _speed(physics: Physics) -> int:
    states = physics.labels()[1]
    if RATE not in states:
        raise InputError(f"Coulomb friction needs a state {RATE!r}, the model has {states}")
    return states.index(RATE)


def _fit(
    data: Dataset,
    problem: GreyBox | GreyBoxWithFriction,
    best: Optimum,
    start: Vector,
    names: tuple[str, ...],
    fixed_std: dict[str, float],
    worse: tuple[str, ...] = (),
) -> GreyFit:
    plain = problem if isinstance(problem, GreyBox) else problem.plain
    at = problem.at(best.theta)
    values = plain.values(best.theta[: len(plain.names)])
    if COULOMB in names:
        values[COULOMB] = float(best.theta[len(plain.names)])
    _require_seen(names, np.linalg.norm(at.Psi, axis=0) > _UNSEEN * at.size)
    valid_y = data.y[data.valid]
    rounding = ROUNDING * float(valid_y @ valid_y)
    converged = best.converged or best.cost <= rounding
    held = tuple(x for x in NAMES if x not in names)
    basis = determined(at.Psi)
    residuals, blocks, spans = by_experiment(plain.experiments, at)
    found = infer(
        residuals,
        blocks,
        score="exogenous",
        spans=spans,
        y=data.y,
        basis=basis.spread(data.valid),
        rounding=rounding,
    )
    influence = -basis.W @ (basis.Q.T @ problem.at(best.theta, held).Psi)
    scale_held = scales(held, {x: getattr(plain.physics.fixed, x) for x in held})
    carried = influence @ np.diag([fixed_std.get(x, 0.0) for x in held] / scale_held)
    scale = scales(names, values)
    noise, whole, robust = (
        part * np.outer(scale, scale)
        for part in (
            found.covariance,
            found.covariance + carried @ carried.T,
            found.covariance_robust + carried @ carried.T,
        )
    )
    std = named_std(names, whole)
    step = quantum(data)
    return GreyFit(
        method="output error",
        names=names,
        values=values,
        std=std,
        std_noise=named_std(names, noise),
        std_robust=named_std(names, robust),
        covariance=whole,
        covariance_robust=robust,
        condition=float(np.linalg.cond(at.Psi / np.linalg.norm(at.Psi, axis=0))),
        influence=named_influence(names, held, influence),
        fixed=plain.physics.parameters({k: v for k, v in values.items() if k != COULOMB}),
        fixed_std=fixed_std,
        initial=tuple(tuple(x[:-1].tolist()) for x in at.free),
        offset=tuple(float(x[-1]) for x in at.free),
        noise_variance=found.noise_variance,
        loss=found.loss,
        fit_percent=found.fit_percent,
        whiteness=found.white.p_value,
        whiteness_test=found.white.test,
        quantum=step,
        N=found.N,
        Ts=data.Ts,
        converged=converged,
        physics=plain.physics,
        warnings=(
            *([] if converged else [f"no convergence in {best.iterations} steps"]),
            *at_bound(plain.names, best.theta - start),
            *no_model(found.fit_percent),
            *worse,
            *below_zero(values, std),
            *noise_warnings(step, found, has_friction=bool({"b_1", COULOMB} & {*names})),
        ),
        **data.origin(),
    )


def _require_seen(names: tuple[str, ...], seen: NDArray[np.bool_]) -> None:
    lost = [name for name, there in zip(names, seen, strict=True) if not there]
    if lost:
        raise InputError(
            f"the data do not show {', '.join(lost)}: hold it fixed, or excite the rig more"
        )


def at_bound(names: Sequence[str], moved: NDArray[np.float64]) -> Iterator[str]:
    """Yield a warning for each parameter whose search ended at its bound.

    Parameters
    ----------
    names : sequence of str
        The free parameters.
    moved : ndarray (d,)
        How far each has moved from its start, as a logarithm unless it is signed; more may follow.
    """
    for name, by in zip(names, moved, strict=False):
        if name not in SIGNED and abs(float(by)) > _AT_BOUND * FURTHEST:
            yield (
                f"the search for {name} ended at its bound, a factor {np.exp(FURTHEST):.0f} from "
                "its start: begin nearer, with another `fixed`, or see whether the data show it"
            )


def no_model(fit: float) -> Iterator[str]:
    """Yield a warning where the model explains less than a constant does."""
    if fit < 0:
        yield (
            f"the fit is {fit:.1f} %, below 0: a constant explains the output better. See the "
            "units and the calibration of the data, the model, and the parameters held fixed"
        )


def noise_warnings(step: float, found: Inference, *, has_friction: bool) -> Iterator[str]:
    """Yield a warning where the output was read in steps, or the residuals are coloured."""
    if quiet := too_quiet(step, found.noise_variance):
        yield quiet
    if found.white.coloured:
        perhaps = "" if has_friction else " (friction?)"
        yield (
            f"the residuals are {found.white}: the model leaves something of the rig out"
            f"{perhaps}, or the noise is not white; prefer std_robust"
        )


def worse_with_friction(data: Dataset, without: float, best: float) -> tuple[str, ...]:
    """Return a warning where Coulomb friction has made the fit worse, by more than chance.

    `without` and `best` are |e|² without and with it.
    """
    samples = data.N - data.missing
    if not samples * np.log(max(best, _TINY) / max(without, _TINY)) > _CLEARLY:
        return ()
    y = data.y[data.valid]
    fits = [f"{fit_percent(y, cost):.1f} %" for cost in (best, without)]
    held = not all(bipolar(part.u) for part in data.experiments())
    way_out = (
        'the input has one sign and u0 is held at 0: take friction="viscous", or play an input of '
        "both signs"
        if held
        else "the search ended in a poorer minimum: begin nearer, with another `fixed`"
    )
    return (f"with Coulomb friction the fit is {fits[0]}, without it {fits[1]}: {way_out}",)
