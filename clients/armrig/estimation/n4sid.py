"""Subspace identification: a state-space model without an iterative search."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import get_args

import numpy as np

from armrig.data.argument import takes_signals
from armrig.data.dataset import Dataset, Signals
from armrig.data.finding import Finding, warning
from armrig.data.treatment.integrating import integrates_by_name, integrating, may_be_one
from armrig.estimation.data_faults import NO_OPTION, data_faults, require_informative
from armrig.estimation.error_process import error_process
from armrig.estimation.estimated_outputs import origin
from armrig.estimation.fit_warnings import loop_warnings
from armrig.estimation.orders import as_text
from armrig.estimation.stability import REFLECT, instability, reflection_warnings, unstable
from armrig.estimation.state_space_fit import (
    Derivatives,
    derivatives,
    inference,
    influence,
    matrices,
)
from armrig.estimation.state_space_problem import (
    StateSpaceProblem,
    delays_of,
    directions,
    experiments_with_response,
    parts_of,
    scale_signals,
)
from armrig.estimation.subspace import Parts
from armrig.estimation.subspace_estimate import (
    MAX_PASSES,
    SubspaceEstimate,
    SubspaceOptions,
    estimate_subspace_model,
    for_simulation,
    weights_of,
)
from armrig.estimation.subspace_horizon import least_horizon, require_windows
from armrig.models.estimate import Form, Minimisation, PastProjection
from armrig.models.fit import Fit
from armrig.models.polynomials import Polynomials
from armrig.models.structure_table import Focus, Weights
from armrig.numerics.checks import require_integers, require_known
from armrig.numerics.inference import Inference, OutputQuality
from armrig.numerics.polynomial import Array
from armrig.numerics.quantities import digits

_REPLICATES = 100  # by default, for several outputs
_STEP = 1e-6  # change of a parameter for a numerical derivative
_RANK_TOLERANCE = 1e-8  # a smaller relative singular value belongs to a change of coordinates
_MAX_DISTANCE_FROM_1 = 0.02  # a pole farther from 1 is not taken for an integrator
_NO_GAIN_TEXT = (
    "no steady Kalman gain was found, so C of the subspace model is A with its roots inside the "
    "unit circle"
)
_UNSETTLED_TEXT = (
    f"the missing outputs were estimated {MAX_PASSES} times and did not settle: use ss"
)
_BOUND_TEXT = (
    "the standard deviations are a lower bound; the true standard deviations of a subspace "
    "estimate are larger"
)
_COLOURED_TEXT = (
    "the residuals are coloured, maybe only because a subspace estimate does not minimise the "
    "one-step errors: check whether the residuals of armax or bj are white"
)


@takes_signals
def n4sid(
    data: Signals,
    order: int | None = None,
    weights: Weights = "cva",
    *,
    nk: int | Sequence[int] = 1,
    integrator: bool = False,
    horizon: int | None = None,
    focus: Focus = "prediction",
    stable: bool = False,
    replicates: int | None = None,
    seed: int = 0,
) -> Fit:
    """Estimate a state-space model x(t+1) = A x + B u + K e, y = C x + D u + e by projections.

    The future outputs are projected on past u and y, for given future u. The singular values of the
    weighted projection indicate the order. A and C are computed from the left singular vectors. K
    is computed from the residuals of a regression of the states. Least squares on the one-step
    errors then estimate B, D and the initial states. A, C and K do not minimise the prediction
    error. The searches `ss`, `armax`, `oe` and `bj` are therefore somewhat more accurate.

    Parameters
    ----------
    data : Dataset or Signals
        N samples of nu inputs and ny outputs. The means of u and y are projected out. Missing
        outputs are replaced by the model's predictions, and the model is estimated again, until
        these values settle. After a missing output a Kalman filter computes the predictions.
        Windows with a gap of more than `horizon` samples are not used for the poles.
    order : int, optional
        Number of states, >= 1. By default MDL of the one-step errors selects the order.
    weights : {"cva", "moesp", "n4sid"}
        Weights of the projection: Larimore's canonical variates, Verhaegen's PO-MOESP, or N4SID
        of Van Overschee and De Moor.
    nk
        As in `ss`.
    integrator : bool, default False
        Set the pole nearest 1 to exactly 1, and estimate the input offset too. The projection uses
        y, not the difference of y. Noise in the difference would hide the slow poles.
    horizon : int, optional
        Number of past and of future samples, at least order / ny + 2. The default is the largest of
        10, 2 (order / ny + 1) and the order of an ARX model by AIC, at most 30, and less for short
        data. If a horizon of order + 2 or of order / ny + 2 predicts the data better, this horizon
        is the default. A long horizon suits white output noise. A short horizon suits noise with
        the poles of A.
    focus : {"prediction", "simulation"}
        Purpose of the model. With "simulation" B and D minimise the simulation error, and A is
        stable. For one output a search from the poles of the projection also minimises the
        simulation error over A. The result is an output-error model (`oe`) with a noise model. For
        several outputs the simulation error decides the horizon, and no search follows: for that,
        use `ss` with noise=False. The model simulates better than the model of "prediction" if the
        system is not exactly linear or not exactly of this order.
    stable : bool, default False
        As in `arx`.
    replicates : int, optional
        Number of replicates, from which the covariance is computed. For each replicate a data set
        is simulated by the model, and another model is estimated from this data set in the same
        way. The errors of the simulation are drawn from an autoregression of the model's one-step
        errors. With fewer than 2 replicates the covariance is the bound below. The default is 100
        for several outputs, and 0 for one output, for which the bound is nearly exact.
    seed : int, default 0
        Seed of the drawn errors.

    Returns
    -------
    Fit
        Without replicates, `covariance` is the bound that a search attains for the same model. In
        200 simulations of an ARMAX system of order 2 (N = 2000), the true standard deviations were
        0.92 to 1.06 times the bound. For six drawn systems of two inputs, two outputs and order 3
        (N = 500, 50 simulations each) they were on average 1.2 times the bound. The test of
        `whiteness` assumes that the model minimises the one-step errors, but the errors of a
        subspace estimate have a bias that does not decrease with N. For a Box-Jenkins system of
        order 3 (N = 1000) the test at the level 5 % rejected whiteness in 10 of 100 simulations.

    Raises
    ------
    ValueError
        There are too few samples, a signal is constant, the data show fewer states than `order`, or
        u does not determine B and D.

    References
    ----------
    .. [1] P. Van Overschee, B. De Moor, *Subspace Identification for Linear Systems*, 1996.
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, section 10.6.
    .. [3] P. Bühlmann, "Sieve bootstrap for time series", Bernoulli 3 (1997) 123-148.

    Examples
    --------
    >>> fit = armrig.n4sid(armrig.example_recording().dataset("alpha"))
    >>> fit.heading
    'N4SID(order=3, nk=1)'
    >>> fit.poles().values.round(2)
    array([0.91+0.16j, 0.91-0.16j, 0.69+0.j  ])
    """
    require_known(weights=(weights, get_args(Weights)), focus=(focus, get_args(Focus)))
    if replicates is None:
        replicates = 0 if data.ny == 1 else _REPLICATES
    require_integers(order=(1 if order is None else order, 1), replicates=(replicates, 0))
    delays = delays_of(nk, data)
    data = experiments_with_response(data, delays)
    require_windows(horizon or least_horizon(order, data.ny), data.nu + data.ny, data.N)
    require_informative(data)
    scaled, su, sy = scale_signals(data, delays)
    options = SubspaceOptions(
        order=order if order is None else int(order),
        weights=weights,
        horizon=horizon,
        integrator=integrator,
        stable=stable,
        direct=max(delays) == 0,
        simulated=focus == "simulation",
    )
    estimate = estimate_subspace_model(scaled, options)
    if focus == "simulation":
        estimate = for_simulation(scaled, estimate, options)
    single_output, Lambda = data.ny == 1, estimate.Lambda
    parts = estimate.parts
    if not single_output:
        parts = parts_of(scaled, weights_of(estimate) if Lambda is None else Lambda)
    problem = StateSpaceProblem(
        parts=parts,
        order=len(estimate.model.A),
        direct=options.direct,
        noise=True,
        level=integrator,
    )
    sensitive = problem if Lambda is None else replace(problem, parts=estimate.parts)
    V = directions(estimate.at.Abar, estimate.at.C)
    by = derivatives(problem, estimate.at, V)
    Psi, states = influence(sensitive, estimate.at, V, estimate.states if single_output else None)
    if integrator:
        fixed = by.at_fixed_pole(estimate.model.A)
        by, Psi = by.along(fixed), Psi @ fixed
    inferred = inference(data, problem, Psi, states, estimate.errors, sy)
    if replicates > 1:
        covariance = _replicate_covariance(scaled, estimate, by, options, replicates, seed)
        inferred = replace(inferred, covariance=covariance, covariance_robust=covariance)
    notes = [] if estimate.model.steady else [warning("no_gain", _NO_GAIN_TEXT)]
    notes += [] if estimate.settled else [warning("search", _UNSETTLED_TEXT, steps=MAX_PASSES)]
    if stable:
        both = (np.real(np.poly(A)) for A in (estimate.free, estimate.model.A))
        notes += reflection_warnings(*both)
    notes += [] if replicates > 1 else [warning("bound", _BOUND_TEXT)]
    return _fit(data, estimate, by, delays, options, inferred, notes, (su, sy))


def order_of(data: Signals, nk: int | Sequence[int] = 1) -> int:
    """Return the number of states that `n4sid` chooses."""
    delays = delays_of(nk, data)
    data = experiments_with_response(data, delays)
    require_informative(data)
    scaled, _, _ = scale_signals(data, delays)
    return len(estimate_subspace_model(scaled, SubspaceOptions(direct=max(delays) == 0)).model.A)


def _replicate_covariance(
    signals: Parts,
    estimate: SubspaceEstimate,
    by: Derivatives,
    options: SubspaceOptions,
    replicates: int,
    seed: int,
) -> Array:
    """Return the covariance of the parameters over estimates from data that the model simulates."""
    rng, at = np.random.default_rng(seed), estimate.at
    process = error_process(estimate.errors)
    same = replace(options, order=len(at.Abar), horizon=estimate.model.horizon)
    length = 2 * estimate.model.horizon
    samples = []
    for _ in range(replicates):
        data = [
            (u, np.where(np.isfinite(y), at.simulated(u, process.drawn(rng, len(u)), x0), np.nan))
            for (u, y), x0 in zip(signals, at.x0, strict=True)
        ]
        samples.append(estimate_subspace_model(data, same).at.impulses(length))
    # Impulse responses, unlike parameters, do not depend on the coordinates of each replicate.
    spread = np.array(samples) - np.mean(samples, axis=0)
    columns = [
        (by.moved(at, step).impulses(length) - by.moved(at, -step).impulses(length)) / (2 * _STEP)
        for step in _STEP * np.eye(len(by.A))
    ]
    theta = np.linalg.lstsq(np.column_stack(columns), spread.T, rcond=_RANK_TOLERANCE)[0]
    return np.asarray(theta @ theta.T / (replicates - 1))


def _fit(
    data: Signals,
    estimate: SubspaceEstimate,
    by: Derivatives,
    delays: tuple[int, ...],
    options: SubspaceOptions,
    inferred: Inference,
    notes: Sequence[Finding],
    scales: tuple[Array, Array],
) -> Fit:
    """Return the model: polynomials for one input and one output, otherwise matrices."""
    model, singular_values, specification = estimate.model, estimate.model.singular_values, ""
    single_channel, facts = data.nu == data.ny == 1, origin(data)
    form: Form
    if single_channel:
        (su,), (sy,) = scales
        form, T = _observer_form(estimate, by, delays[0], options, sy / su)
        inferred = inferred.transformed(T)
        dataset, facts = data.dataset(), origin(data.dataset())
        residuals = [e[:, 0] * sy for e in estimate.errors]
        way_out = "" if options.integrator else NO_OPTION
        coloured = inferred.quality[0].white.coloured
        notes = [
            *notes,
            *_warnings(dataset, form.A[0][0], inferred.covariance, integrator=options.integrator),
            *([warning("coloured", _COLOURED_TEXT)] if coloured else []),
            *data_faults(dataset, residuals, way_out=way_out),
        ]
        # Except for the weights "cva", the singular values have the unit of y.
        singular_values = singular_values * (sy if options.weights != "cva" else 1.0)
    else:
        form, T = matrices(estimate.at, by, *scales, delays)
        inferred = inferred.transformed(T)
        notes = [*notes, *instability(form), *_poor_fits(data, inferred.quality)]
        specification = as_text(order=len(form.A), nk=delays)
    fit = Fit(
        structure="n4sid",
        specification=specification,
        form=form,
        offset=single_channel and options.integrator,
        search=Minimisation(converged=estimate.settled),
        projection=PastProjection(
            weights=options.weights,
            horizon=model.horizon,
            singular_values=singular_values,
            canonical_correlations=estimate.canonical_correlations,
            suggested_order=estimate.suggested_order,
        ),
        findings=tuple(notes),
        **inferred.fields(),
        **facts,
    )
    return replace(fit, findings=(*loop_warnings(fit), *fit.findings))


def _observer_form(
    estimate: SubspaceEstimate, by: Derivatives, nk: int, options: SubspaceOptions, gain: float
) -> tuple[Polynomials, Array]:
    """Return A y = B u + C e from the observer form, and the derivatives of its theta."""
    at = estimate.at
    A, C = np.append(1.0, -estimate.model.A[:, 0]), np.append(1.0, -at.Abar[:, 0])
    D, by_a, by_D = at.D[0, 0], -by.A[:, :, 0], by.D[:, 0]
    b = at.B[:, 0] + A[1:] * D
    by_b = by.B[:, :, 0] + by_D * A[1:] + by_a * D
    if options.direct:
        b, by_b = np.append(D, b), np.hstack([by_D, by_b])
    B = np.append(np.zeros(nk), gain * b)
    form = Polynomials.of_channel(A=A, B=B, C=C, nk=nk, integrator=options.integrator)
    return form, np.hstack([by_a, gain * by_b, -by.Abar[:, :, 0]]).T


def _warnings(data: Dataset, A: Array, covariance: Array, *, integrator: bool) -> Iterator[Finding]:
    z = np.roots(A)
    nearest = int(np.argmin(np.abs(z - 1)))
    off, std = float(np.abs(z[nearest] - 1)), _pole_std(A, z[nearest], covariance)
    real = not integrator and z[nearest].imag == 0
    integrates = real and may_be_one(z[nearest].real, std, data.N)
    if integrates:
        certain = integrates_by_name(data.output)
        then = f"{data.output} integrates, so" if certain else f"if {data.output} integrates,"
        yield warning(
            "integrator",
            f"a pole is 1 within its accuracy (distance {digits(off, 1)}, standard deviation "
            f"{digits(std, 1)}): {then} set the option integrator, or simulations drift",
            "integrator",
            off=off,
            std=std,
        )
    elif not integrator and _may_integrate(data, z[nearest]) and (finding := integrating(data)):
        text = f"{finding.text}, and a pole is {digits(off, 1)} from 1: try the option integrator"
        yield warning("integrator", text, "integrator", off=off)
    others = np.abs(np.delete(z, nearest) if integrates else z)
    if np.any(others > 1 + 1e-9):
        yield unstable(float(others.max()), *REFLECT)


def _poor_fits(data: Signals, quality: Sequence[OutputQuality]) -> Iterator[Finding]:
    """Yield a warning for each output that the model predicts worse than a constant."""
    for name, output_quality in zip(data.outputs, quality, strict=True):
        if output_quality.fit_percent < 0:
            yield warning(
                "poor_fit",
                f"the model predicts {name} worse than the mean of {name} does "
                f"(fit {digits(output_quality.fit_percent, 2)} %): use another order, or ss",
                fit_percent=output_quality.fit_percent,
            )


def _may_integrate(data: Dataset, z: complex) -> bool:
    """Return whether the pole z may be an integrator; outside the circle y must integrate."""
    return abs(z - 1) < _MAX_DISTANCE_FROM_1 and (abs(z) <= 1 or integrates_by_name(data.output))


def _pole_std(A: Array, z: complex, covariance: Array) -> float:
    """Return the standard deviation of a real root z of A(q): dz = -sum da_k z^(n-k) / A'(z)."""
    n = A.size - 1
    slope = np.polyval(np.polyder(A), z)
    if slope == 0:
        return float("inf")
    by_a = np.real(-(z ** np.arange(n - 1, -1, -1)) / slope)
    return float(np.sqrt(max(by_a @ covariance[:n, :n] @ by_a, 0.0)))
