"""State-space model of least simulation error, from the poles of a projection."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armrig.estimation.stability import stabilised
from armrig.estimation.start_values import noise_start
from armrig.estimation.state_space_problem import StateSpaceProblem, directions
from armrig.estimation.state_space_responses import Part
from armrig.estimation.subspace import Parts
from armrig.estimation.subspace_estimate import (
    SubspaceEstimate,
    SubspaceOptions,
    completed,
    filtered_estimate,
    unweighted,
)
from armrig.estimation.subspace_horizon import (
    Innovations,
    companion,
)
from armrig.numerics.covariance import pairwise_covariance
from armrig.numerics.levenberg_marquardt import levenberg_marquardt
from armrig.numerics.polynomial import (
    Array,
    drawn_to_edge,
    filtered,
    outward_normals,
    reflected,
    without_integrator,
)
from armrig.numerics.polynomial import stable as stable_polynomial


def for_simulation(
    signals: Parts, found: SubspaceEstimate, options: SubspaceOptions
) -> SubspaceEstimate:
    """Return the model with the B and D, and for one output the poles, of least simulation error.

    The simulation error y - (B u + x(0)) / A is linear in B, D and x(0). For one output the search
    over A starts from the poles of the projection, reflected into the unit circle. For several
    outputs the poles do not change: a search over the n ny parameters of A and C often fits the
    noise. It improved the simulation of data that were not used in six of nine trials, but made it
    worse by a third in another.

    K is the candidate with the least one-step loss for the estimated A, B and D. The first
    candidate is the gain of the projection. The second candidate is K by Hannan and Rissanen's
    regressions on the simulation error, for one output. The third candidate is K = 0, which is
    correct for white output noise.
    """
    model, parts, direct = found.model.stabilised(), unweighted(signals), options.direct
    one = len(model.C) == 1
    if one:
        model = model.with_transition(_searched_poles(parts, model, direct=direct))
    still = replace(model, K=np.zeros(model.K.shape))
    at, simulated, _ = completed(parts, still, direct=direct)
    gains = [model.K, still.K]
    if one:
        a = np.append(1.0, -model.A[:, 0])
        v = [y - yhat for (_, y), yhat in zip(signals, simulated, strict=True)]
        polynomials = noise_start([_without_past(a, x[:, 0]) for x in v], nc=a.size - 1, nd=0)[0]
        gains = [model.K, *((c - a)[1:, None] for c in (polynomials, reflected(a)))]
    fits = []
    for K in gains:
        candidate = replace(model, K=K)
        predictor, predicted, states = completed(
            parts, candidate, direct=direct, given=(at.Bbar, at.D)
        )
        errors = [y - yhat for (_, y), yhat in zip(signals, predicted, strict=True)]
        fit = replace(found, model=candidate, at=predictor, predicted=predicted, errors=errors)
        fits.append(replace(fit, free=candidate.A, states=states, parts=parts, Lambda=None))
    losses = [np.linalg.slogdet(pairwise_covariance(np.vstack(fit.errors)))[1] for fit in fits]
    best = fits[int(np.argmin(losses))]
    return filtered_estimate(signals, best, options, given=(best.at.B, best.at.D))


def _without_past(a: Array, v: Array) -> Array:
    """Return a(q) v; a sample that depends on a missing or unknown sample is NaN."""
    found = filtered(a, [1.0], v) if np.isfinite(v).all() else np.convolve(v, a)[: v.size]
    found[: a.size - 1] = np.nan
    return found


def _searched_poles(parts: tuple[Part, ...], model: Innovations, *, direct: bool) -> Array:
    """Return A of least simulation error for one output, in observer form.

    For given A the simulation error is linear in B, D and the initial state.
    """
    n = len(model.A)
    pole = np.array([1.0, -1.0]) if model.integrator else np.ones(1)
    start = np.append(1.0, -model.A[:, 0])
    start = without_integrator(start) if model.integrator else start
    problem = StateSpaceProblem(
        parts=parts, order=n, direct=direct, noise=False, level=model.integrator
    )
    # A change of the free polynomial, times the pole at 1, is a change of -A[:, 0].
    along = -np.column_stack([np.convolve(pole, row) for row in np.eye(start.size - 1)])
    V = directions(model.A, model.C) @ along

    def transition(f: Array) -> Array:
        return companion(np.convolve(pole, np.append(1.0, f)))

    def linearise(f: Array) -> tuple[Array, Array]:
        linear, J = problem.linearised(transition(f), model.C, V)
        return linear.e, J

    walls = _Circle()
    found = levenberg_marquardt(linearise, start[1:], admissible=walls.admits, walls=walls)
    return transition(stabilised(np.append(1.0, found.theta))[1:])


class _Circle:
    """Unit circle, the boundary of the roots of a monic polynomial."""

    def admits(self, f: Array) -> bool:
        """Return whether the roots are inside the circle."""
        return stable_polynomial(np.append(1.0, f))

    def inside(self, f: Array, previous: Array) -> Array:
        """Return f with the roots that left the circle moved inside."""
        return drawn_to_edge(np.append(1.0, f), np.append(1.0, previous))[1:]

    def normals(self, f: Array) -> Array:
        """Return the gradient of |z| for each root z on the circle."""
        return outward_normals(np.append(1.0, f))
