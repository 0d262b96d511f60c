"""Covariances, quality and warnings of a grey-box estimate."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.columns import Matrix, Vector
from armrig.data.dataset import Dataset, Signals
from armrig.data.treatment.outliers import quantum, too_quiet
from armrig.models.state_space import read_only_copy
from armrig.numerics.curvature import curvature, doubts
from armrig.numerics.inference import Inference, OutputResiduals, infer
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.levenberg_marquardt import Optimum
from armrig.numerics.quantities import plural
from armrig.numerics.rounding import rounding_std
from armrig.physics.grey_box.fit import GreyFit
from armrig.physics.grey_box.physical_models import COULOMB, NAMES, SIGNED, Physics
from armrig.physics.grey_box.shooting import DERIVATIVE_ERROR, MAX_LOG_FACTOR, Shooting

_MIN_COMPONENT = 0.05  # least component of a parameter in a combination without effect
_MIN_INFLUENCE = 1e-9
_BOUND_SHARE = 0.98  # of the bound; a search halves its steps, so it ends just below the bound
_NO_MODEL = (
    "the fit is {:.1f} %, below 0: a constant explains the output better. Check the units and the "
    "calibration of the data, the model, and the fixed parameters"
)
MAX_SOLVER_SHARE = 0.01
"""Largest error of the solver, as a share of the noise's deviation."""
_AT_BOUND = (
    f"ended at its bound, a factor {np.exp(MAX_LOG_FACTOR):.0f} from its start: begin nearer, or "
    "check whether the data determine it"
)


def require_samples(data: Signals, names: Sequence[str], *, unknown: int) -> None:
    """Refuse too few samples; each experiment has a number of unknown initial values."""
    samples = int(np.count_nonzero(data.valid.any(axis=1)))
    experiments = tuple(data.experiments())
    count = len(experiments)
    needed = len(names) + unknown * count + 1
    if samples < needed or min(part.N for part in experiments) < 2:
        where = (
            f" in {plural(count, 'experiment')}, and two in each experiment" if count > 1 else ""
        )
        raise InputError(
            f"{plural(samples, 'sample is', 'samples are')} too few to estimate "
            f"{', '.join(names)}, which needs at least "
            f"{needed}{where}: record longer, or cut into fewer parts"
        )


def grey_fit(
    data: Signals,
    i: int,
    problem: Shooting,
    best: Optimum,
    start: Vector,
    *,
    fixed_std: Mapping[str, float],
    worse: Sequence[str] = (),
) -> GreyFit:
    """Return the result, whose loss, fit and whiteness are those of output i.

    `start` contains the coordinates at which the search began. A parameter at its bound has no
    standard deviation, unless all are. `worse` are warnings in addition to those of the model.
    """
    names, model, d = problem.names, problem.model, len(problem.names)
    values, e, z = problem.values(best.theta), problem.residuals(best.theta), best.theta
    of_rig = isinstance(model, Physics)
    held = tuple(x for x in NAMES if x not in names) if of_rig else ()
    derivatives, all_slopes, spans = problem.at(z, held)
    Psi, slopes = derivatives[:, :d], all_slopes[:d]
    if lost := [name for name, column in zip(names, Psi.T, strict=True) if not column.any()]:
        raise InputError(
            f"the data do not determine {', '.join(lost)}: no effect on the output; hold it fixed, "
            "excite the rig more, or start nearer"
        )
    stopped = np.abs(z[:d] - start) > _BOUND_SHARE * MAX_LOG_FACTOR
    stopped &= problem.coordinates.bounded
    free = np.flatnonzero(stopped.all() | ~stopped)
    basis = orthonormal(Psi[:, free], DERIVATIVE_ERROR)
    scaled = Psi[:, free] / np.linalg.norm(Psi[:, free], axis=0)
    if basis.rank < free.size:
        v = np.linalg.svd(scaled, full_matrices=False)[2][-1]
        alike = [names[j] for j, x in zip(free, v, strict=True) if abs(x) > _MIN_COMPONENT]
        raise InputError(
            f"the data determine only {basis.rank} of {free.size} parameters and cannot "
            f"distinguish {' and '.join(alike)}: hold one of them fixed"
        )
    stats = infer_coordinates(data, problem, e, Psi, spans, basis)
    influence = -basis.W @ (basis.Q.T @ derivatives[:, d:])
    added = influence * [fixed_std.get(name, 0.0) for name in held] / all_slopes[d:]
    added = added @ added.T

    def embed(part: Matrix) -> Matrix:
        covariance = np.full((d, d), np.nan)
        covariance[np.ix_(free, free)] = part
        return covariance * np.outer(slopes, slopes)

    covariance, robust = embed(stats.covariance + added), embed(stats.covariance_robust + added)
    std, quality = _std_by_name(names, covariance), stats.quality[i]
    datasets = [data.dataset(name, data.inputs[0]) for name in data.outputs]
    rounding = data.y.size * rounding_std(data.y / problem.std) ** 2
    converged = best.converged or best.cost <= rounding
    curved = 0.0 if best.cost <= rounding else _curvature(problem, z, free, stats)
    coloured = any(q.white.coloured for q in stats.quality)
    measured = int(np.isfinite(e).any(axis=1).sum())
    covariances = stats.covariance, stats.covariance_robust
    reasons = [text for _, text in doubts(curved, *covariances, N=measured, coloured=coloured)]
    noise = np.sqrt(np.nanmean(e**2, axis=0))
    error = problem.solver_error(z, MAX_SOLVER_SHARE * noise)[1][i]
    initial, offsets = problem.initial(z), np.zeros(len(problem.segments.rows))
    physics, fixed = model, problem.fixed | values
    if isinstance(model, Physics):
        initial, offsets = initial[:, :-1], initial[:, -1]
        physics = replace(model, outputs=(model.outputs[i],), friction=False)
    else:
        output = data.outputs[i]
        physics = replace(model, output=output, steps=problem.steps, solver_error=float(error))
    poorest = min(q.fit_percent for q in stats.quality)
    has_friction = not of_rig or bool({"b_1", COULOMB} & {*names})
    return GreyFit(
        names=names,
        values=values,
        std=std,
        std_noise=_std_by_name(names, embed(stats.covariance)),
        std_robust=_std_by_name(names, robust),
        covariance=read_only_copy(covariance),
        covariance_robust=read_only_copy(robust),
        condition=float(np.linalg.cond(scaled)),
        influence={
            names[j]: {
                k: float(x)
                for k, x in zip(held, row, strict=True)
                if abs(x) > _MIN_INFLUENCE and k not in SIGNED
            }
            for j, row in zip(free, influence, strict=True)
            if of_rig and names[j] not in SIGNED | {COULOMB}
        },
        fixed=model.all_values(fixed) if isinstance(model, Physics) else fixed,
        fixed_std=dict(fixed_std),
        initial=tuple(map(tuple, initial.tolist())),
        offset=tuple(offsets.tolist()),
        noise_variance=float(stats.noise_covariance[i, i]),
        loss=quality.loss,
        fit_percent=quality.fit_percent,
        whiteness=quality.white.p_value,
        whiteness_test=quality.white.test,
        quantum=quantum(datasets[i]),
        N=quality.N,
        Ts=datasets[i].Ts,
        converged=converged,
        physics=physics,
        by_output=dict(zip(data.outputs, stats.quality, strict=True)) if data.ny > 1 else {},
        warnings=(
            *([] if converged else [f"no convergence in {plural(best.iterations, 'step')}"]),
            *(f"the search for {names[j]} {_AT_BOUND}" for j in np.flatnonzero(stopped)),
            *([_NO_MODEL.format(poorest)] if poorest < 0 else []),
            *reasons,
            *worse,
            *physics.doubts(values, std, float(noise[i])),
            *_noise_warnings(datasets, stats, has_friction=has_friction),
        ),
        **datasets[i].origin() | {"digest": data.digest},
    )


def _curvature(problem: Shooting, z: Vector, kept: NDArray[np.int_], stats: Inference) -> float:
    """Return the curvature of the loss in the `kept` coordinates, which initial states follow."""
    d = len(problem.names)
    index = np.append(kept, np.arange(d, z.size))
    e, J = problem.linearise(z)
    basis = orthonormal(J[:, index], DERIVATIVE_ERROR)
    variance = float(e @ e) / max(e.size - basis.rank, 1)

    def cost(at: Vector) -> float:
        moved = z.copy()
        moved[index] = at
        e, _ = problem.linearise(moved)
        return float(e @ e)

    return curvature(
        cost,
        z[index],
        variance * basis.W @ basis.W.T,
        variance,
        used=stats.covariance_robust if stats.quality[0].white.coloured else None,
        followers=slice(kept.size, None),
    )


def _std_by_name(names: tuple[str, ...], covariance: Matrix) -> dict[str, float]:
    """Return standard deviations by name."""
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return dict(zip(names, std.tolist(), strict=True))


def infer_coordinates(
    data: Signals,
    problem: Shooting,
    e: Matrix,
    Psi: Matrix,
    spans: Sequence[Matrix],
    basis: Basis,
) -> Inference:
    """Return covariances of the coordinates, and the quality for each output.

    e contains the residuals (N, ny). The rows of Psi, of the spans of the free responses and of the
    basis are those of the measured values.
    """
    finite, ny = np.isfinite(e), problem.std.size
    H, derivatives = (np.zeros((*e.shape, M.shape[1])) for M in (basis.Q, Psi))
    H[finite], derivatives[finite] = basis.Q, Psi
    experiments = []
    for rows, span in zip(problem.segments.rows, spans, strict=True):
        # The outputs share the free responses, so one output alone has no basis of them.
        Z = np.zeros((finite[rows].shape[0], span.shape[1]))
        if ny == 1:
            Z[finite[rows, 0]] = span
        experiments.append(
            [
                OutputResiduals(
                    e=e[rows, i],
                    y=data.y[rows, i],
                    H=H[rows, i] / std,
                    Psi=None if ny == 1 else derivatives[rows, i] * std,
                    Z=Z if ny == 1 else None,
                )
                for i, std in enumerate(problem.std)
            ]
        )
    unknown = len(problem.model.states) * len(experiments)
    each = None if ny == 1 else [(basis.d + unknown) / ny] * ny
    return infer(experiments, basis.W, score="exogenous", parameters=each)


def _noise_warnings(
    datasets: Sequence[Dataset], stats: Inference, *, has_friction: bool
) -> Iterator[str]:
    """Yield warnings of a coarse converter, and of coloured residuals."""
    variances = np.diag(stats.noise_covariance).tolist()
    for data, variance, quality in zip(datasets, variances, stats.quality, strict=True):
        of_output = f"{data.output}: " if len(datasets) > 1 else ""
        if quiet := too_quiet(data, variance):
            yield f"{of_output}{quiet}"
        if quality.white.coloured:
            perhaps = "" if has_friction else " (friction?)"
            yield (
                f"{of_output}the residuals are {quality.white}: the model lacks a property of the "
                f"rig{perhaps}, or the noise is not white; prefer std_robust"
            )
