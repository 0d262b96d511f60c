"""The Fisher information of a polynomial model for a planned input."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike

from armrig.data.dataset import Dataset, Vector
from armrig.excitation.experiment_design.predicted_std import PredictedStd, inverted, planned_data
from armrig.models.structure import free_columns, transient_count
from armrig.numerics.checks import column
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import (
    Array,
    by_denominator,
    by_numerator,
    filtered,
    lagged,
    stable,
    without_integrator,
)


def predicted_std(
    model: ModelWithNoise,
    u: ArrayLike | Dataset,
    *,
    noise_variance: float | None = None,
    initial: Literal["estimate", "zero"] = "estimate",
) -> PredictedStd:
    """Predict the standard deviations of a model's parameters for an input not yet played.

    The inverse of the Fisher information for Gaussian white e in A y = (B/F) u + (C/D) e, ::

        M = (1/lambda) sum psi_u psi_u^T + sum psi_e psi_e^T

    where psi_u, the part of the prediction's gradient that u makes, is simulated, less its
    projection on the initial states (and level and ramp of an integrator), which an estimate must
    spend data on; psi_e, the part that e makes, has its variance from impulse responses.

    Parameters
    ----------
    model : Fit or PlannedModel
        From an earlier experiment, or from what is believed.
    u : array_like, shape (N,), or Dataset
        Planned input in the unit of the model's, about its offset. A Dataset is planned for as it
        is, with its gaps and its experiments; its y does not matter.
    noise_variance : float, optional
        In place of the model's, in y's unit squared.
    initial : {"estimate", "zero"}
        Whether initial states will be estimated along; the first samples of a model with A serve
        as its past.

    Returns
    -------
    PredictedStd
        Standard deviations in the order of the model's parameters; `explain` tells whether the
        experiment is long enough.

    Raises
    ------
    ValueError
        The input cannot determine all parameters, the noise variance is not known, or gaps are
        planned for a model that is not output error.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 7.4, 9.4 and 13.2.
    """
    variance = model.noise_variance if noise_variance is None else noise_variance
    if not (np.isfinite(variance) and variance > 0):
        raise InputError(
            f"noise_variance={variance!r} must be > 0; give the variance of e, for example of an "
            "earlier fit"
        )
    if initial not in ("estimate", "zero"):
        raise InputError(f'initial={initial!r} must be "estimate" or "zero"')
    planned = planned_data(u, model.Ts)
    output_error = model.A.size == model.C.size == model.D.size == 1
    if planned.missing and not output_error:
        raise InputError(
            f"{planned.missing} samples are missing; gaps are planned for with an output-error "
            "model only: plan with the complete input"
        )
    rows = [
        block
        for part in planned.experiments()
        for block in _gradient(model, part, variance, estimate=initial == "estimate")
    ]
    names, theta, to_full = _parameters(model)
    return inverted(np.vstack(rows), variance, names, theta, planned, to_full)


def _gradient(
    model: ModelWithNoise, part: Dataset, variance: float, *, estimate: bool
) -> Iterator[Array]:
    """Yield rows whose squares add up to lambda M, for one experiment.

    The columns belong to a, b, c, d, f; with an integrator to the coefficients without it. One in
    A is taken out by differences of y, one in F by sums of u.
    """
    A, B, C, D = model.A, model.B, model.C, model.D
    F, u, N = model.F, part.u, part.N
    inside = integrating_polynomial(model)
    if inside == "A":
        A = without_integrator(A)
    if inside == "F":
        # The mean of u makes a ramp, which is projected out; without it the sums round less.
        F, u = without_integrator(F), np.cumsum(u - np.mean(u) if estimate else u)
    na, nf = A.size - 1, F.size - 1
    forced = filtered(B, F, u)
    white = filtered(D, C, np.column_stack([u, forced, filtered([1.0], A, forced)]).T)
    nothing = np.zeros((N, C.size + D.size - 2))
    Psi = np.hstack(
        [
            -lagged(white[2], range(1, na + 1)),
            by_numerator(white[0], F, range(model.nk, B.size)),
            nothing,
            by_denominator(white[1], F, nf),
        ]
    )
    rows = part.valid.copy()
    Z = np.zeros((N, 0))
    if model.A.size > 1:
        rows[: max(model.A.size, B.size) - 1] = False
        if inside and estimate:
            Z = filtered(D, C, np.ones((1, N))).T  # the input's offset
    elif estimate:
        count = transient_count(
            numerator_degree=B.size - 1,
            denominator_degree=model.F.size - 1,
            integrator=model.integrator,
        )
        Z = filtered(D, C, free_columns(F, N, count=count, drift=model.integrator).T).T
    yield orthonormal(Z[rows]).without(Psi[rows])
    if na or nothing.size:
        yield _by_noise(model, np.sqrt(variance * np.arange(N, 0.0, -1.0)), Psi.shape[1])


def _by_noise(model: ModelWithNoise, weight: Vector, width: int) -> Array:
    """Return the impulse responses from e to the gradient, row j weighted by the times it occurs.

    With psi_e(t) = sum_j s_j e(t-j) the expected sum of psi_e psi_e^T over N samples from rest is
    lambda times the sum of (N - j) s_j s_j^T.
    """
    pulse = np.zeros(weight.size)
    pulse[0] = 1.0
    s = np.zeros((weight.size, width))
    A = without_integrator(model.A) if integrating_polynomial(model) == "A" else model.A
    na, nc, nd = A.size - 1, model.C.size - 1, model.D.size - 1
    nb = model.B.size - model.nk
    s[:, :na] = by_denominator(pulse, A, na)
    s[:, na + nb : na + nb + nc] = -by_denominator(pulse, model.C, nc)
    s[:, na + nb + nc : na + nb + nc + nd] = by_denominator(pulse, model.D, nd)
    return np.asarray(s * weight[:, None])


def _parameters(model: ModelWithNoise) -> tuple[tuple[str, ...], Vector, Array]:
    """Return names, values, and the derivatives of them by those that are estimated."""
    parts = {"a": model.A[1:], "b": model.B[model.nk :], "c": model.C[1:]}
    parts |= {"d": model.D[1:], "f": model.F[1:]}
    names = tuple(f"{letter}{k + 1}" for letter, p in parts.items() for k in range(p.size))
    to_full = np.eye(len(names))
    if model.integrator:
        # F = (1 - q^-1) F̃ is linear in F̃: f_k = f̃_k - f̃_(k-1); and so is A.
        letter = integrating_polynomial(model).lower()
        own = [k for k, name in enumerate(names) if name[0] == letter]
        to_full = np.delete(to_full, own[-1], axis=1)
        to_full[own[1:], own[:-1]] = -1.0
    return names, np.concatenate(list(parts.values())), to_full


class ModelWithNoise(Protocol):
    """What is asked of a model: a `Fit` has it, and so has `PlannedModel`."""

    @property
    def A(self) -> Vector: ...  # noqa: D102
    @property
    def B(self) -> Vector: ...  # noqa: D102
    @property
    def C(self) -> Vector: ...  # noqa: D102
    @property
    def D(self) -> Vector: ...  # noqa: D102
    @property
    def F(self) -> Vector: ...  # noqa: D102
    @property
    def nk(self) -> int: ...  # noqa: D102
    @property
    def integrator(self) -> bool: ...  # noqa: D102
    @property
    def noise_variance(self) -> float: ...  # noqa: D102
    @property
    def Ts(self) -> float: ...  # noqa: D102


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedModel:
    """A model that is believed before there are data: A y = (B/F) u + (C/D) e.

    Raises
    ------
    ValueError
        A denominator does not begin with 1 or is unstable, or B is nothing but zeros.
    """

    B: Vector
    """Coefficients in q^-1; the zeros that it begins with are the delay."""
    F: Vector = field(default_factory=lambda: np.ones(1))
    """Coefficients in q^-1, beginning with 1; with `integrator` one of its roots is 1."""
    noise_variance: float
    """Variance of e, in y's unit squared."""
    Ts: float
    """Sampling time, in s."""
    integrator: bool = False
    """A, where it has coefficients, or else F has the factor 1 - q^-1, known and not estimated."""
    A: Vector = field(default_factory=lambda: np.ones(1))
    """As F."""
    C: Vector = field(default_factory=lambda: np.ones(1))
    """As F."""
    D: Vector = field(default_factory=lambda: np.ones(1))
    """As F."""

    def __post_init__(self) -> None:
        """Refuse what no model can be."""
        for name in "ABCDF":
            p = column(name, getattr(self, name))
            object.__setattr__(self, name, p)
            if name != "B" and p[0] != 1:
                raise InputError(f"{name}={p.tolist()} must begin with 1")
        if not self.B.any():
            raise InputError("B has no coefficient but 0; give the numerator in q^-1, delay first")
        name = integrating_polynomial(self)
        p = getattr(self, name or "F")
        if name and abs(np.sum(p)) > 1e-8 * np.sum(np.abs(p)):
            raise InputError(
                f"integrator=True, but {name}(1)={np.sum(p):.3g} is not 0; multiply {name} with "
                "1 - q^-1"
            )
        F = without_integrator(self.F) if name == "F" else self.F
        for name, p in (("C", self.C), ("F", F)):
            if not stable(p):
                msg = f"{name} has a root on or outside the unit circle"
                msg += "; an integrator is told by integrator=True" if name == "F" else ""
                raise InputError(msg)

    @property
    def nk(self) -> int:
        """Samples before u reaches y."""
        return int(np.argmax(self.B != 0))


def integrating_polynomial(model: ModelWithNoise) -> str:
    """Return "A" or "F", whichever has the known factor 1 - q^-1, or "" where none has."""
    return "" if not model.integrator else "A" if model.A.size > 1 else "F"
