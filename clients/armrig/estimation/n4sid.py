"""Subspace identification: a state-space model without an iterative search."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, get_args

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.finding import EstimateFinding, warning
from armrig.data.several_signals import accepts_signals
from armrig.data.treatment import INTEGRATING_OUTPUTS, integrating
from armrig.estimation.data_faults import NO_OPTION, data_faults
from armrig.estimation.prediction_error import with_integrator
from armrig.estimation.problem import PolynomialProblem, Solution
from armrig.estimation.stability import REFLECT, reflection_warnings, stabilised, unstable
from armrig.estimation.start_values import noise_start
from armrig.estimation.subspace import (
    projection,
    suggested_order,
    visible_states,
)
from armrig.estimation.subspace_horizon import (
    Poles,
    best_poles,
    delayed_signals,
    poles_at,
    usable_windows,
)
from armrig.models.innovations import Experiment, errors, prepared, regression
from armrig.models.structure import Structure
from armrig.models.structure_table import Focus, Weights
from armrig.models.subspace_fit import SubspaceFit
from armrig.numerics.checks import require_integers
from armrig.numerics.inference import infer
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array, filtered, reflected, without_integrator

_MAX_SUGGESTED_ORDER = 10
_MAX_DISTANCE_FROM_1 = 0.02  # a pole farther from 1 is not taken for an integrator
_NO_GAIN_TEXT = (
    "no steady Kalman gain was found, so C of the subspace model is A with its roots inside the "
    "unit circle"
)
_BOUND_TEXT = (
    "the standard deviations are a lower bound; the true standard deviations of a subspace "
    "estimate are larger"
)
_COLOURED_TEXT = (
    "the residuals are coloured, maybe only because a subspace estimate does not minimise the "
    "one-step errors: check whether the residuals of armax or bj are white"
)


@accepts_signals("armrig.estimation.multivariable.n4sid")
@takes_recordings
def n4sid(
    data: Dataset,
    order: int | None = None,
    weights: Weights = "cva",
    *,
    nk: int = 1,
    integrator: bool = False,
    horizon: int | None = None,
    focus: Focus = "prediction",
    stable: bool = False,
) -> SubspaceFit:
    """Estimate a state-space model x(t+1) = A x + B u + K e, y = C x + D u + e by projections.

    The future outputs are projected on past u and y, for given future u. The singular values of the
    weighted projection indicate the order. A and C are computed from the left singular vectors. K
    is computed from the residuals of a regression of the states. Least squares on the one-step
    errors then estimate B, D and the unknown past. A, C and K do not minimise the prediction error.
    The searches `armax`, `oe` and `bj` are therefore somewhat more accurate.

    Parameters
    ----------
    data : Dataset
        N samples. A window of 2 `horizon` samples with a missing sample is not used. The means of u
        and y are projected out. With an integrator, the ramp due to an offset of u is projected out
        too.
    order : int, optional
        Number of states, >= 1. By default MDL of the one-step errors selects the order.
    weights : {"cva", "moesp", "n4sid"}
        Weights of the projection: Larimore's canonical variates, Verhaegen's PO-MOESP, or N4SID
        of Van Overschee and De Moor.
    nk : int, default 1
        Number of samples before u reaches y; 0 means a direct term D.
    integrator : bool, default False
        Set the pole nearest 1 to exactly 1, and estimate the input offset too. The projection uses
        y, not the difference of y. Noise in the difference would hide the slow poles.
    horizon : int, optional
        Number of past and of future samples, at least order + 2. With a shorter horizon the noise
        model would be wrong. The default is the largest of 10, 2 (order + 1) and the order of an
        ARX model. AIC chooses the order of the ARX model, at most 30. For short data the default is
        smaller. If a horizon of order + 2 predicts the data better, order + 2 is the default. A
        long horizon suits white output noise. A short horizon suits noise with the poles of A.
    focus : {"prediction", "simulation"}
        Purpose of A and B. With "simulation" a search from the poles of the subspace model
        minimises the simulation error. For each candidate of A, least squares give B and the
        initial states. The result is an output-error model (`oe`) with a noise model. This model
        simulates better than the model of "prediction" if the system is not exactly linear or not
        exactly of this order. Its poles are always inside the unit circle.
    stable : bool, default False
        Reflect poles outside the unit circle into the circle, and estimate B again. A finding of
        the fit reports the reflection.

    Returns
    -------
    SubspaceFit
        `covariance` is the bound lambda (Psi^T Psi)^-1 that a search attains for the same
        polynomials. The covariance of the subspace estimate is larger and not known. In 200
        simulations of an ARMAX system of order 2 (N = 2000), the true standard deviations were 0.92
        to 1.06 times the bound. The test of `whiteness` assumes that the model minimises the
        one-step errors. The errors of a subspace estimate have a bias that does not decrease with
        N. Therefore the test rejects whiteness too often if the data are long. For a Box-Jenkins
        system of order 3 (N = 1000) the test at the level 5 % rejected whiteness in 10 of 100
        simulations.

    Raises
    ------
    ValueError
        There are too few samples, y is constant, or the data show fewer states than `order`.

    References
    ----------
    .. [1] P. Van Overschee, B. De Moor, *Subspace Identification for Linear Systems*, 1996.
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, section 10.6.

    Examples
    --------
    >>> import armrig
    >>> fit = armrig.n4sid(armrig.example_recording().dataset("alpha"))
    >>> fit.heading
    'N4SID(order=3, nk=1)'
    >>> fit.poles().values.round(2)
    array([0.91+0.16j, 0.91-0.16j, 0.69+0.j  ])
    """
    _require_known(weights, focus)
    require_integers(nk=(nk, 0), order=(1 if order is None else order, 1))
    signals = delayed_signals(data, nk)
    w = usable_windows(data, signals, order, horizon)
    found = projection(w, weights)
    canonical = found if weights == "cva" else projection(w, "cva")
    states = visible_states(w)
    most = min(_MAX_SUGGESTED_ORDER, w.future - 2, states)
    suggested = suggested_order(w, canonical, most)
    n = suggested if order is None else int(order)
    if n > states:
        raise InputError(f"order={n}: the data show {states} states; lower the order")
    if horizon is None:
        free = best_poles(signals, w, found, n, weights, integrator=integrator, direct=nk == 0)
    else:
        free = poles_at(w, found, n, integrator=integrator)
    structure = _structure(n, nk=nk, integrator=integrator)
    facts: dict[str, Any] = {"weights": weights, "suggested_order": suggested}
    facts["canonical_correlations"] = canonical.singular_values
    return _focused(data, structure, free, facts, focus, stable=stable)


def _require_known(weights: str, focus: str) -> None:
    if weights not in get_args(Weights):
        allowed = ", ".join(f'"{x}"' for x in get_args(Weights))
        raise InputError(f"weights={weights!r} must be one of {allowed}")
    if focus not in get_args(Focus):
        raise InputError(f'focus={focus!r} must be one of "prediction", "simulation"')


def _focused(
    data: Dataset,
    n: Structure,
    free: Poles,
    facts: dict[str, Any],
    focus: Focus,
    *,
    stable: bool,
) -> SubspaceFit:
    """Return the model with the subspace poles, or with the poles of least simulation error."""
    facts = {**facts, "horizon": free.horizon, "singular_values": free.singular_values}
    notes = [] if free.steady else [warning("no_gain", _NO_GAIN_TEXT)]
    if focus == "simulation":
        orders = f"order={n.nc}, nk={n.nk[0]}"
        A, B, C = simulating(data, n, free.A, free.C, orders=orders)
        return _fit(data, n, A, C, B, facts, tuple(notes))
    A = _stable(free.A, integrator=bool(n.integrator)) if stable else free.A
    notes += reflection_warnings(free.A, A)
    return _fit(data, n, A, free.C, None, facts, tuple(notes))


def _stable(A: Array, *, integrator: bool) -> Array:
    """Return A with all poles, except an integrator, reflected into the unit circle."""
    if not integrator:
        return stabilised(A)
    free = without_integrator(A)
    inside = stabilised(free)
    return A if inside is free else np.convolve([1.0, -1.0], inside)


def _structure(order: int, *, nk: int, integrator: bool) -> Structure:
    """Return the orders of an ARMAX model with `order` states."""
    return Structure(
        na=order - int(integrator),
        nb=(order + int(nk == 0),),
        nc=order,
        nf=(0,),
        nk=(nk,),
        integrator="a" if integrator else "",
    )


def _fit(
    data: Dataset,
    n: Structure,
    A: Array,
    C: Array,
    B: Array | None,
    facts: dict[str, Any],
    notes: tuple[EstimateFinding, ...],
) -> SubspaceFit:
    """Return the model; if B is None, B is estimated by least squares on the one-step errors."""
    free = without_integrator(A) if n.integrator else A
    one = np.ones(1)
    experiments = [prepared(part.u, part.y, n) for part in data.experiments()]
    given = [regression(x, n, A=free, C=C, D=one, F=[one]) for x in experiments]
    projected = [g.unknown.without(np.column_stack([g.X, g.y])) for g in given]
    whole = projected[0] if len(projected) == 1 else np.vstack(projected)
    if B is None:
        basis = orthonormal(whole[:, :-1])
        if basis.rank < n.nb[0]:
            raise InputError(
                f"u determines only {basis.rank} of {n.nb[0]} numerator coefficients; lower the "
                "order or excite with a richer input"
            )
        B = np.append(np.zeros(n.nk[0]), basis.coefficients(whole[:, -1]))
    parts = [
        errors(x, n, g, A=free, B=[B], C=C, D=one, F=[one])
        for x, g in zip(experiments, given, strict=True)
    ]
    blocks = [
        g.unknown.without(np.hstack([p.Psi[:, : n.na], g.X, p.Psi[:, n.na :]]))
        for g, p in zip(given, parts, strict=True)
    ]
    residuals = [np.where(x.rows, p.e, np.nan) for x, p in zip(experiments, parts, strict=True)]
    spans = [g.unknown.span for g in given]
    found = infer(residuals, blocks, score="correlated", spans=spans, y=data.y)
    found = found.transformed(with_integrator(n))
    return SubspaceFit(
        structure="n4sid",
        A=A,
        B=B,
        C=C,
        nk=n.nk[0],
        integrator=bool(n.integrator),
        offset=bool(n.trend),
        Ts=data.Ts,
        findings=(
            *notes,
            *_warnings(data, n, A, found.covariance),
            *([warning("coloured", _COLOURED_TEXT)] if found.white.coloured else []),
            *data_faults(data, residuals, way_out="" if n.trend else NO_OPTION),
        ),
        **found.quality(),
        **data.origin(),
        **facts,
    )


def _warnings(
    data: Dataset, n: Structure, A: Array, covariance: Array
) -> Iterator[EstimateFinding]:
    yield warning("bound", _BOUND_TEXT)
    z = np.roots(A)
    nearest = int(np.argmin(np.abs(z - 1)))
    off, std = float(np.abs(z[nearest] - 1)), _pole_std(A, z[nearest], covariance)
    integrates = (
        not n.integrator
        and z[nearest].imag == 0
        and off < min(3 * std + 1e-9, _MAX_DISTANCE_FROM_1)
    )
    if integrates:
        known = data.output in INTEGRATING_OUTPUTS
        then = f"{data.output} integrates, so" if known else f"if {data.output} integrates,"
        yield warning(
            "pole_at_1",
            f"a pole is 1 within its accuracy (distance {off:.1g}, standard deviation {std:.1g}): "
            f"{then} set the option integrator, or simulations drift",
            "integrator",
            off=off,
            std=std,
        )
    elif not n.integrator and _may_integrate(data, z[nearest]) and (found := integrating(data)):
        text = f"{found.text}, and a pole is {off:.1g} from 1: try the option integrator"
        yield warning("pole_near_1", text, off=off)
    others = np.abs(np.delete(z, nearest) if integrates else z)
    if np.any(others > 1 + 1e-9):
        yield unstable(float(others.max()), *REFLECT)


def _may_integrate(data: Dataset, z: complex) -> bool:
    """Return whether the pole z may be an integrator.

    If |z| > 1, y must also be known to integrate.
    """
    return abs(z - 1) < _MAX_DISTANCE_FROM_1 and (abs(z) <= 1 or data.output in INTEGRATING_OUTPUTS)


def _pole_std(A: Array, z: complex, covariance: Array) -> float:
    """Return the standard deviation of a real root z of A(q): dz = -sum da_k z^(n-k) / A'(z)."""
    n = A.size - 1
    slope = np.polyval(np.polyder(A), z)
    if slope == 0:
        return float("inf")
    by_a = np.real(-(z ** np.arange(n - 1, -1, -1)) / slope)
    return float(np.sqrt(max(by_a @ covariance[:n, :n] @ by_a, 0.0)))


def simulating(
    data: Dataset, n: Structure, A: Array, C: Array, *, orders: str
) -> tuple[Array, Array, Array]:
    """Return A and B of least simulation error, and C of least one-step loss for this A and B.

    For given A the simulation error y - (B u + x) / A is linear in B and the unknown state x. The
    search is therefore only over A. The search starts from the poles of the subspace model,
    reflected into the unit circle. C is the candidate with the least one-step loss for the
    estimated A and B. The first candidate is C of the subspace model. The second candidate is C by
    Hannan and Rissanen's regressions on A y - B u. The third candidate is C = A, which is correct
    for white output noise.

    Raises
    ------
    ValueError
        u determines fewer coefficients than B has.
    """
    output = Structure(nb=n.nb, nf=(n.na,), nk=n.nk, integrator="f" if n.integrator else "")
    experiments = tuple((prepared(part.u, part.y, output),) for part in data.experiments())
    problem = PolynomialProblem(experiments=experiments, rows=(output,))
    start = stabilised(without_integrator(A) if n.integrator else A)
    found = problem.minimise(start[1:])
    solution = problem.solve(found.theta)
    if solution.rank < n.nb[0]:
        raise InputError(
            f"{orders}: u determines only {solution.rank} of {n.nb[0]} numerator coefficients; "
            "lower the order or excite with a richer input"
        )
    free = stabilised(np.append(1.0, found.theta))
    B = np.append(np.zeros(n.nk[0]), solution.ab)
    whole = np.convolve([1.0, -1.0], free) if n.integrator else free
    noises = [C, _of_what_is_left(experiments, solution, whole, n.nc), reflected(whole)]
    one_step = [prepared(part.u, part.y, n) for part in data.experiments()]
    losses = [_one_step_loss(one_step, n, free, B, noise) for noise in noises]
    return whole, B, noises[int(np.argmin(losses))]


def _of_what_is_left(
    experiments: Sequence[tuple[Experiment, ...]], solution: Solution, A: Array, nc: int
) -> Array:
    """Return an estimate of C in C e = A (y - simulated y)."""
    v = []
    for (x,), (part,) in zip(experiments, solution.parts, strict=True):
        left = x.y - part.driven
        left[~x.rows] = np.nan
        left = filtered(A, [1.0], left) if np.isfinite(left).all() else _convolved(A, left)
        left[: A.size - 1] = np.nan
        v.append(left)
    C, _ = noise_start(v, nc=nc, nd=0)
    return C


def _convolved(A: Array, x: Array) -> Array:
    """Return x filtered by A; a sample that depends on a NaN is NaN."""
    return np.asarray(np.convolve(x, A)[: x.size])


def _one_step_loss(
    experiments: Sequence[Experiment], n: Structure, A: Array, B: Array, C: Array
) -> float:
    """Return the sum of squared one-step errors after the unknown past is fitted."""
    one, total = np.ones(1), 0.0
    for x in experiments:
        given = regression(x, n, A=A, C=C, D=one, F=[one])
        raw = given.y - given.X @ B[n.nk[0] :]
        total += float(np.sum(given.unknown.without(raw[:, None]) ** 2))
    return total
