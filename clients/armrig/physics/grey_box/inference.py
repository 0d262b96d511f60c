"""Covariances, quality and warnings of a grey-box estimate."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from armrig_core.errors import InputError

from armrig.data.columns import Matrix, Vector
from armrig.data.dataset import Signals
from armrig.data.treatment.wrong_samples import quantum, too_quiet
from armrig.numerics.inference import Inference, OutputResiduals, infer
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.levenberg_marquardt import Optimum
from armrig.numerics.stretches import Mask
from armrig.physics.grey_box.fit import GreyFit, PhysicalModel
from armrig.physics.grey_box.least_squares_problem import Linearised, by_experiment
from armrig.physics.grey_box.sampled_model import COULOMB, SIGNED

_ROUNDING_SHARE = 1e-18  # share of |y|²; a smaller |e|² is rounding error
_MIN_COMPONENT = 0.05  # least component of a parameter in a combination without effect
_MIN_INFLUENCE = 1e-9
_MIN_SEEN_SHARE = 1e-7  # least share of a derivative that the free responses do not explain
MAX_LOG_FACTOR = 12.0
"""Logarithm of the largest ratio of a parameter to its start value; e^12 is 160 000."""
_BOUND_SHARE = 0.98  # of the bound; a search halves its steps, so it ends just below the bound
_AT_BOUND = (
    f"ended at its bound, a factor {np.exp(MAX_LOG_FACTOR):.0f} from its start: begin nearer, or "
    "check whether the data determine it"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """Parameters that are not estimated, with their effect on the outputs."""

    values: Any
    """All parameters, as `GreyFit.fixed`."""
    names: tuple[str, ...] = ()
    Psi: Matrix | None = None
    """Derivatives of the outputs with respect to the coordinates of `names`, as in `Linearised`."""
    std: Mapping[str, float] = field(default_factory=dict)
    """Standard deviations by name, as given to the estimator."""
    coordinate_std: Vector = field(default_factory=lambda: np.zeros(0))
    """Standard deviations of the coordinates of `names`."""


def require_samples(data: Signals, names: Sequence[str], *, unknown: int) -> None:
    """Refuse too few samples; each experiment has a number of unknown initial values."""
    samples = int(np.count_nonzero(data.valid.any(axis=1)))
    experiments = tuple(data.experiments())
    count = len(experiments)
    needed = len(names) + unknown * count + 1
    if samples < needed or min(part.N for part in experiments) < 2:
        where = f" in {count} experiments, and two in each experiment" if count > 1 else ""
        raise InputError(
            f"{samples} samples are too few to estimate {', '.join(names)}, which needs at least "
            f"{needed}{where}: record longer, or cut into fewer parts"
        )


def grey_fit(
    data: Signals,
    i: int,
    weights: Vector,
    at: Linearised,
    best: Optimum,
    *,
    values: dict[str, float],
    slopes: Vector,
    moved: Vector,
    held: Held,
    physics: PhysicalModel,
    doubts: Callable[[Mapping[str, float]], Iterable[str]],
    has_friction: bool,
) -> GreyFit:
    """Return the result, whose loss, fit and whiteness are those of output i.

    `weights` are the deviations by which the residuals were divided. `slopes` are the derivatives
    of the parameters with respect to their coordinates, and `moved` the distances of the
    coordinates from the start, 0 without a bound. A parameter at its bound has no standard
    deviation, unless all are. `doubts` returns warnings from the standard deviations.
    """
    names = tuple(values)
    seen = np.linalg.norm(at.Psi, axis=0) > _MIN_SEEN_SHARE * at.size
    if lost := [name for name, there in zip(names, seen, strict=True) if not there]:
        raise InputError(
            f"the data do not determine {', '.join(lost)}: no effect on the output; hold it fixed, "
            "excite the rig more, or start nearer"
        )
    stopped = np.abs(moved) > _BOUND_SHARE * MAX_LOG_FACTOR
    free = np.flatnonzero(stopped.all() | ~stopped)
    basis = determined(at.Psi[:, free], [names[j] for j in free])
    found = inferred(tuple(data.experiments()), weights, at, basis)
    influence = np.zeros((free.size, 0))
    if held.Psi is not None:
        influence = -basis.W @ (basis.Q.T @ held.Psi)
    added = influence * held.coordinate_std
    added = added @ added.T

    def whole(part: Matrix) -> Matrix:
        covariance = np.full((len(names), len(names)), np.nan)
        covariance[np.ix_(free, free)] = part
        return covariance * np.outer(slopes, slopes)

    noise, covariance = whole(found.covariance), whole(found.covariance + added)
    robust = whole(found.covariance_robust + added)
    std, quality = _named_std(names, covariance), found.quality[i]
    own = [data.dataset(name, data.inputs[0]) for name in data.outputs]
    steps = [quantum(output) for output in own]
    rounding = _ROUNDING_SHARE * float(np.nansum((data.y / weights) ** 2))
    converged = best.converged or best.cost <= rounding
    return GreyFit(
        names=names,
        values=values,
        std=std,
        std_noise=_named_std(names, noise),
        std_robust=_named_std(names, robust),
        covariance=covariance,
        covariance_robust=robust,
        condition=float(np.linalg.cond(at.Psi[:, free] / np.linalg.norm(at.Psi[:, free], axis=0))),
        influence=_named_influence([names[j] for j in free], held.names, influence),
        fixed=held.values,
        fixed_std=dict(held.std),
        initial=tuple(tuple(x[:-1].tolist()) for x in at.free),
        offset=tuple(float(x[-1]) for x in at.free),
        noise_variance=float(found.noise_covariance[i, i]),
        loss=quality.loss,
        fit_percent=quality.fit_percent,
        whiteness=quality.white.p_value,
        whiteness_test=quality.white.test,
        quantum=steps[i],
        N=quality.N,
        Ts=own[i].Ts,
        converged=converged,
        physics=physics,
        by_output=dict(zip(data.outputs, found.quality, strict=True)) if data.ny > 1 else {},
        warnings=(
            *([] if converged else [f"no convergence in {best.iterations} steps"]),
            *(f"the search for {names[j]} {_AT_BOUND}" for j in np.flatnonzero(stopped)),
            *_no_model(min(q.fit_percent for q in found.quality)),
            *doubts(std),
            *_noise_warnings(data.outputs, steps, found, has_friction=has_friction),
        ),
        **own[i].origin() | {"digest": data.digest},
    )


def _named_std(names: tuple[str, ...], covariance: Matrix) -> dict[str, float]:
    """Return standard deviations by name."""
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return dict(zip(names, std.tolist(), strict=True))


def _named_influence(
    names: Sequence[str], held: Sequence[str], influence: Matrix
) -> dict[str, dict[str, float]]:
    """Return d ln(estimate)/d ln(fixed parameter) by both names, without the frictions."""
    if not held:
        return {}
    shown = [(j, k) for j, k in enumerate(held) if k not in SIGNED]
    return {
        name: {k: float(row[j]) for j, k in shown if abs(row[j]) > _MIN_INFLUENCE}
        for name, row in zip(names, influence, strict=True)
        if name not in SIGNED | {COULOMB}
    }


def inferred(parts: Sequence[Signals], weights: Vector, at: Linearised, basis: Basis) -> Inference:
    """Return covariances of the coordinates, and the quality for each output."""
    ny, begin, experiments = weights.size, 0, []
    for data, e, Z in zip(parts, by_experiment(at.e, parts, weights), at.spans, strict=True):
        outputs = []
        for i, std in enumerate(weights):
            known = data.valid[:, i]
            rows = slice(begin, begin + int(known.sum()))
            begin = rows.stop
            H = _spread(basis.Q[rows] / std, known)
            of_output = OutputResiduals(e=e[:, i], y=data.y[:, i], H=H)
            # The outputs share the free responses, so one output alone has no basis of them.
            if ny == 1:
                of_output = replace(of_output, Z=_spread(Z, known))
            else:
                of_output = replace(of_output, Psi=_spread(at.Psi[rows] * std, known))
            outputs.append(of_output)
        experiments.append(outputs)
    unknown = sum(x.size for x in at.free)
    each = None if ny == 1 else [(basis.W.shape[0] + unknown) / ny] * ny
    return infer(experiments, basis.W, score="exogenous", parameters=each)


def _spread(rows: Matrix, known: Mask) -> Matrix:
    """Return a matrix for all samples, with `rows` at the known samples and zeros elsewhere."""
    whole = np.zeros((known.size, rows.shape[1]))
    whole[known] = rows
    return whole


def determined(Psi: Matrix, names: Sequence[str]) -> Basis:
    """Return an orthonormal basis of the derivatives; refuse indistinguishable parameters."""
    basis = orthonormal(Psi)
    if basis.rank < Psi.shape[1]:
        _, _, Vt = np.linalg.svd(Psi / np.linalg.norm(Psi, axis=0), full_matrices=False)
        alike = [name for name, v in zip(names, Vt[-1], strict=True) if abs(v) > _MIN_COMPONENT]
        raise InputError(
            f"the data determine only {basis.rank} of {Psi.shape[1]} parameters and cannot "
            f"distinguish {' and '.join(alike)}: hold one of them fixed"
        )
    return basis


def _no_model(fit: float) -> Iterator[str]:
    """Yield a warning if the model explains the output less well than a constant."""
    if fit < 0:
        yield (
            f"the fit is {fit:.1f} %, below 0: a constant explains the output better. Check the "
            "units and the calibration of the data, the model, and the fixed parameters"
        )


def _noise_warnings(
    outputs: Sequence[str], steps: Sequence[float], found: Inference, *, has_friction: bool
) -> Iterator[str]:
    """Yield warnings of noise below a third of a converter step, and of coloured residuals."""
    variances = np.diag(found.noise_covariance).tolist()
    for name, step, variance, quality in zip(outputs, steps, variances, found.quality, strict=True):
        of_output = f"{name}: " if len(outputs) > 1 else ""
        if quiet := too_quiet(step, variance):
            yield f"{of_output}{quiet}"
        if quality.white.coloured:
            perhaps = "" if has_friction else " (friction?)"
            yield (
                f"{of_output}the residuals are {quality.white}: the model lacks a property of the "
                f"rig{perhaps}, or the noise is not white; prefer std_robust"
            )
