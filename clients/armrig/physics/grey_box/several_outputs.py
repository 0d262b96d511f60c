"""The grey-box estimate from several outputs of one experiment, such as theta_1 and alpha."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from armrig_core.arm import ArmParameters, require_parameters
from armrig_core.errors import InputError
from armrig_core.telemetry import THETA_1

from armrig.data.dataset import Signals
from armrig.data.treatment.wrong_samples import quantum
from armrig.numerics.inference import Inference, OutputResiduals, infer
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.levenberg_marquardt import Optimum
from armrig.numerics.polynomial import Array
from armrig.physics.grey_box.estimate import at_bound, no_model, searched
from armrig.physics.grey_box.fit import (
    GreyFit,
    below_zero,
    determined,
    named_influence,
    named_std,
    scales,
)
from armrig.physics.grey_box.least_squares_problem import GreyBox
from armrig.physics.grey_box.parameters import (
    COULOMB,
    NAMES,
    Friction,
    checked_fixed_std,
    free_names,
)
from armrig.physics.grey_box.response import linear_parts, sensitivity
from armrig.physics.grey_box.sampled_model import Model, Physics, Sampled
from armrig.physics.systems import arm

_MAX_ROUNDS = 8  # largest number of estimates of the outputs' noise
_SETTLED = 1e-4  # relative change of the noise's standard deviations at which the rounds end


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Linearised:
    """Residuals and derivatives at given coordinates; the outputs are stacked."""

    e: tuple[Array, ...]
    """Residuals (N, ny) of each experiment in units of y, NaN where y is missing."""
    white: Array
    """Weighted residuals of all measured values, (M,)."""
    Psi: Array
    """Weighted derivatives without their projection on the free responses, (M, d)."""
    free: tuple[Array, ...]
    """Initial state and input offset of each experiment."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Problem:
    """Problem min sum of |e_i|²/std_i² over the outputs i; the free responses are projected out.

    The outputs of an experiment have the same initial state and the same input offset.
    """

    plain: GreyBox
    """Problem of one output, used only for the names and the coordinates of the parameters."""
    physics: tuple[Physics, ...]
    """Model of each output."""
    experiments: tuple[Signals, ...]
    std: Array
    """Standard deviations of the noise of each output, (ny,)."""

    def linearise(self, eta: Array) -> tuple[Array, Array]:
        """Return weighted residuals and derivatives at the coordinates eta."""
        at = self.at(eta)
        return at.white, at.Psi

    def at(self, eta: Array, by: Sequence[str] | None = None) -> _Linearised:
        """Return residuals and derivatives with respect to the free parameters, or to `by`."""
        by = self.plain.names if by is None else by
        values, Ts = self.plain.values(eta), self.experiments[0].equidistant()
        models = [one.sampled(values, by, Ts) for one in self.physics]
        e, white, blocks, free = [], [], [], []
        for data in self.experiments:
            rest, basis, x = self._fitted(models, data)
            # The rows of the outputs are stacked as in `rest`.
            slopes = [sensitivity(model, data.u[:, 0], x[:-1], float(x[-1])) for model in models]
            Psi = np.vstack(
                [s[k] / std for s, k, std in zip(slopes, data.valid.T, self.std, strict=True)]
            )
            error = basis.without(rest)
            whole = np.full(data.y.shape, np.nan)
            whole.T[data.valid.T] = error * np.repeat(self.std, data.valid.sum(axis=0))
            e.append(whole)
            white.append(error)
            blocks.append(basis.without(Psi))
            free.append(x)
        return _Linearised(
            e=tuple(e), white=np.concatenate(white), Psi=np.vstack(blocks), free=tuple(free)
        )

    def _fitted(self, models: Sequence[Sampled], data: Signals) -> tuple[Array, Basis, Array]:
        """Return weighted errors, a basis of the free responses, and coefficients in this basis."""
        errors, columns = [], []
        for i, (model, std) in enumerate(zip(models, self.std, strict=True)):
            y, free = linear_parts(model, data.u[:, 0])
            known = data.valid[:, i]
            errors.append((data.y[:, i] - y)[known] / std)
            columns.append(free[known] / std)
        rest = np.concatenate(errors)
        basis = orthonormal(np.vstack(columns))
        return rest, basis, basis.coefficients(rest)


def greybox(
    data: Signals,
    model: Model = arm,
    free: Sequence[str] = ("J_1",),
    fixed: ArmParameters | None = None,
    output: str = THETA_1,
    *,
    fixed_std: Mapping[str, float] | None = None,
    friction: Friction | None = None,
) -> GreyFit:
    """Estimate physical parameters from several outputs together.

    The estimate minimises the sum of ``|e_i|²/std_i²`` over the outputs i. The standard deviations
    std_i of the noise are estimated again after each search. All outputs of an experiment share one
    initial state and one input offset.

    Parameters
    ----------
    data : Signals
        One input in V and the outputs, named as in the model: theta_1 and alpha.
    model, free, fixed, fixed_std
        As in `armrig.greybox` for one output; the default model is `armrig.arm`.
    output : str, default "theta_1"
        Output to which `plot`, `simulate` and the tests of the result refer.
    friction : {"viscous"}, optional
        Estimate b_1, too. For Coulomb friction, give data with the single output theta_1.

    Returns
    -------
    GreyFit
        `by_output` contains loss, fit and whiteness for each output.

    Raises
    ------
    ValueError
        There are several inputs, the model lacks an output, or the data do not determine the
        parameters.
    """
    p = ArmParameters() if fixed is None else fixed
    require_parameters(p, "fixed")
    names = free_names(free, friction)
    _require(data, names, output)
    given = checked_fixed_std(fixed_std or {}, names)
    physics = tuple(Physics(model=model, fixed=p, output=name) for name in data.outputs)
    for one in physics:
        one.check()
    plain = GreyBox(physics=physics[data.outputs.index(output)], names=names, experiments=())
    start = plain.coordinates({name: getattr(p, name) for name in names})
    problem = _Problem(
        plain=plain,
        physics=physics,
        experiments=tuple(data.experiments()),
        std=np.nanstd(np.where(data.valid, data.y, np.nan), axis=0),
    )
    problem, best = _minimised(problem, start)
    return _fit(data, problem, best, start, given)


def _require(data: Signals, names: Sequence[str], output: str) -> None:
    """Refuse signals that do not fit the rig, and Coulomb friction, which needs a single output."""
    if data.nu != 1:
        raise InputError(
            f"the inputs are {', '.join(data.inputs)}; the rig has one, u: choose it with "
            "signals.channels(outputs, inputs)"
        )
    if output not in data.outputs:
        raise InputError(f"output={output!r} is none of the data's {', '.join(data.outputs)}")
    if COULOMB in names:
        raise InputError(
            'friction: Coulomb friction is estimated from one output; give friction="viscous", or '
            'signals.dataset("theta_1")'
        )
    needed = len(names) + 10
    if needed > data.N:
        raise InputError(f"{data.N} samples are too few, at least {needed} are needed")


def _minimised(problem: _Problem, start: Array) -> tuple[_Problem, Optimum]:
    """Return the problem with the estimated standard deviations of the noise, and its minimum."""
    best = searched(problem, start)
    for _ in range(_MAX_ROUNDS):
        e = np.vstack(problem.at(best.theta).e)
        std = np.sqrt(np.nanmean(e**2, axis=0))
        std = np.maximum(std, 1e-12 * problem.std)
        change = float(np.max(np.abs(std / problem.std - 1)))
        problem = replace(problem, std=std)
        if change < _SETTLED:
            break
        best = searched(problem, best.theta, around=start)
    return problem, best


def _fit(
    data: Signals,
    problem: _Problem,
    best: Optimum,
    start: Array,
    fixed_std: dict[str, float],
) -> GreyFit:
    plain = problem.plain
    names, at = plain.names, problem.at(best.theta)
    values = plain.values(best.theta)
    basis = determined(at.Psi)
    found = _inference(problem, at, basis)
    held = tuple(x for x in NAMES if x not in names)
    influence = -basis.W @ (basis.Q.T @ problem.at(best.theta, held).Psi)
    scale_held = scales(held, {x: getattr(plain.physics.fixed, x) for x in held})
    carried = influence * (np.array([fixed_std.get(x, 0.0) for x in held]) / scale_held)
    scale = np.outer(*(scales(names, values),) * 2)
    noise = found.covariance * scale
    whole, robust = (M * scale + carried @ carried.T * scale for M in _both(found))
    std = named_std(names, whole)
    i = data.outputs.index(plain.physics.output)
    quality = found.quality[i]
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
        fixed=plain.physics.parameters(values),
        fixed_std=fixed_std,
        initial=tuple(tuple(x[:-1].tolist()) for x in at.free),
        offset=tuple(float(x[-1]) for x in at.free),
        noise_variance=float(found.noise_covariance[i, i]),
        loss=quality.loss,
        fit_percent=quality.fit_percent,
        whiteness=quality.white.p_value,
        whiteness_test=quality.white.test,
        quantum=quantum(data.dataset(plain.physics.output)),
        N=quality.N,
        Ts=data.equidistant(),
        converged=best.converged,
        physics=plain.physics,
        by_output=dict(zip(data.outputs, found.quality, strict=True)),
        warnings=(
            *([] if best.converged else [f"no convergence in {best.iterations} steps"]),
            *at_bound(names, best.theta - start),
            *no_model(min(q.fit_percent for q in found.quality)),
            *below_zero(values, std),
        ),
        output=plain.physics.output,
        unit=data.units[i],
        input_unit=data.input_units[0],
        source=data.source,
        history=data.history,
        digest=data.digest,
    )


def _both(found: Inference) -> tuple[Array, Array]:
    return found.covariance, found.covariance_robust


def _inference(problem: _Problem, at: _Linearised, basis: Basis) -> Inference:
    """Return classic and robust covariance of the coordinates, and the quality for each output."""
    Q = basis.Q
    begin, experiments = 0, []
    for data, e in zip(problem.experiments, at.e, strict=True):
        outputs = []
        for i, std in enumerate(problem.std):
            known = data.valid[:, i]
            rows = slice(begin, begin + int(known.sum()))
            begin = rows.stop
            influence, Psi = np.zeros((2, data.N, Q.shape[1]))
            influence[known], Psi[known] = Q[rows] / std, at.Psi[rows] * std
            outputs.append(OutputResiduals(e=e[:, i], y=data.y[:, i], H=influence, Psi=Psi))
        experiments.append(outputs)
    ny = problem.std.size
    unknown = len(problem.experiments) * at.free[0].size
    each = (basis.W.shape[0] + unknown) / ny
    return infer(experiments, basis.W, parameters=[each] * ny, score="exogenous")
