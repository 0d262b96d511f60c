"""Standard deviations of a model's parameters, predicted for a planned input."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray

from armrig.data.dataset import Dataset, Vector
from armrig.models.fit import Fit
from armrig.models.structure import free_columns, transient_count
from armrig.numerics.checks import column, require_numbers
from armrig.numerics.least_squares import RANK_TOLERANCE, orthonormal
from armrig.numerics.polynomial import (
    Array,
    apply_filter,
    by_denominator,
    by_numerator,
    lag_columns,
    stable,
    without_integrator,
)
from armrig.numerics.quantities import digits, plural


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PredictedStd:
    """Standard deviations of an efficient estimate (the Cramér-Rao bound)."""

    names: tuple[str, ...]
    """Names of the parameters, in the order of a fit."""
    theta: Vector
    """Parameter values for which the standard deviations are predicted, (d,)."""
    covariance: NDArray[np.float64]
    """Inverse of the Fisher information, (d, d)."""
    N: int
    """Number of samples of the planned experiment; missing samples are not counted."""
    seconds: float
    """Length of the planned experiment, in s."""

    @property
    def std(self) -> Vector:
        """Standard deviations (d,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def seconds_for(self, **wanted: float) -> float:
        """Return the length, in s, at which a similar input reaches all wanted standard deviations.

        The information is assumed to be proportional to the length of the experiment. This
        assumption is inaccurate if the experiment is short compared with the slowest time constant.
        """
        return self.seconds * max(self._times_longer(name, std) for name, std in wanted.items())

    def explain(self, **wanted: float) -> str:
        """Return a text that states whether the experiment is long enough for the wanted accuracy.

        An example is ``predicted.explain(f1=0.001)``. Without arguments the text contains all
        predicted standard deviations.
        """
        if not wanted:
            return repr(self)
        lines = []
        for name, std in wanted.items():
            got = float(self.std[self._index(name)])
            times = self._times_longer(name, std)
            verdict = "is long enough" if times <= 1 else "is too short"
            lines.append(
                f"{name}: {digits(self.seconds, 3)} s give a standard deviation of "
                f"{digits(got, 3)}, {digits(std, 3)} is wanted: {digits(self.seconds, 3)} s "
                f"{verdict}, about {digits(self.seconds * times, 3)} s are needed"
            )
        if len(wanted) > 1:
            needed = self.seconds_for(**wanted)
            verdict = "is long enough" if needed <= self.seconds else "is too short"
            lines.append(
                f"together: {digits(self.seconds, 3)} s {verdict}, about {digits(needed, 3)} s "
                "are needed"
            )
        return "\n".join(lines)

    def _index(self, name: str) -> int:
        if name not in self.names:
            raise InputError(f"{name!r} is not among the parameters {', '.join(self.names)}")
        return self.names.index(name)

    def _times_longer(self, name: str, std: float) -> float:
        require_numbers(**{name: std})
        if not std > 0:
            raise InputError(f"{name}={std!r}: a wanted standard deviation must be > 0")
        return float(self.std[self._index(name)] / std) ** 2

    def __repr__(self) -> str:
        """Describe the prediction in a few lines."""
        lines = [f"predicted for {plural(self.N, 'sample')} in {self.seconds:.4g} s:"]
        for name, value, std in zip(self.names, self.theta, self.std, strict=True):
            share = f" ({digits(100 * std / abs(value), 2)} %)" if value != 0 else ""
            lines.append(f"  {name} = {value:.5g} ± {digits(std, 2)}{share}")
        return "\n".join(lines)


def input_dataset(u: ArrayLike | Dataset, Ts: float) -> Dataset:
    """Return a planned input as a `Dataset`."""
    if not isinstance(u, Dataset):
        values = column("u", u)
        return Dataset(u=values, y=np.zeros(values.size), Ts=Ts)
    if not np.isclose(u.Ts, Ts, rtol=1e-9, atol=0.0):
        raise InputError(
            f"the model has Ts={Ts:g} s and the data have Ts={u.Ts:g} s; plan at one rate"
        )
    return u


def cr_bound(
    Psi: Array,
    variance: float,
    names: tuple[str, ...],
    theta: Vector,
    planned: Dataset,
    to: Array,
    error: float = RANK_TOLERANCE,
) -> PredictedStd:
    """Return the Cramér-Rao bound from Psi; Psi^T Psi is `variance` times the information.

    The matrix `to` contains the derivatives of the reported parameters with respect to the
    parameters of Psi. `error` is the relative error of Psi.
    """
    basis = orthonormal(Psi, error)
    if basis.rank < Psi.shape[1]:
        raise InputError(
            f"the planned input determines only {basis.rank} of {Psi.shape[1]} parameters; "
            "use a richer input (describe_input reports its order), or lower the orders"
        )
    return PredictedStd(
        names=names,
        theta=theta,
        covariance=to @ (variance * (basis.W @ basis.W.T)) @ to.T,
        N=planned.N - planned.missing,
        seconds=planned.N * planned.Ts,
    )


def predicted_std(
    model: Fit,
    u: ArrayLike | Dataset,
    *,
    noise_variance: float | None = None,
) -> PredictedStd:
    """Predict the standard deviations of the parameters of a model for a planned input.

    The standard deviations are computed from the inverse of the Fisher information M. For Gaussian
    white e of variance lambda in A y = (B/F) u + (C/D) e, the information is ::

        M = (1/lambda) sum psi_u psi_u^T + sum psi_e psi_e^T

    The gradient of the prediction has a part psi_u from u and a part psi_e from e. The part psi_u
    is simulated. The initial states, and the level and ramp of an integrator, are estimated too.
    Therefore the projection of psi_u on the responses to these quantities is subtracted. In a model
    with A, the first samples are the initial values and are not predicted. The variance of psi_e is
    computed from impulse responses.

    Parameters
    ----------
    model : Fit
        Model of an earlier experiment, or an assumed model, see `Fit.of_channel`.
    u : array_like, shape (N,), or Dataset
        Planned input without the offset, in the unit of the model's input. If u is a Dataset, its
        input, gaps and boundaries of experiments are used, but not its y.
    noise_variance : float, optional
        Variance of e, in the squared unit of y. The default is the variance in the model.

    Returns
    -------
    PredictedStd
        Standard deviations in the order of the model's parameters. `explain` reports whether the
        experiment is long enough.

    Raises
    ------
    ValueError
        The input cannot determine all parameters, the noise variance is not known, or C or F has a
        root on or outside the unit circle. Data with gaps are also refused if the model is not an
        output-error model.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 7.4, 9.4 and 13.2.

    Examples
    --------
    >>> import armrig
    >>> model = armrig.Fit.of_channel(B=[0, 0.1], F=[1, -0.9], nk=1, Ts=0.01)
    >>> print(armrig.predicted_std(model, armrig.telegraph(1000, 0.05), noise_variance=1e-4))
    predicted for 1000 samples in 10 s:
      b1 = 0.1 ± 4.1e-05 (0.041 %)
      f1 = -0.9 ± 4.2e-05 (0.0047 %)
    """
    variance = model.noise_variance if noise_variance is None else noise_variance
    if not (np.isfinite(variance) and variance > 0):
        raise InputError(
            f"noise_variance={variance!r} must be > 0; give the variance of e, for example from an "
            "earlier fit"
        )
    for name, p in (("C", model.C), ("F", _without_known_root(model, "f"))):
        if not stable(p):
            raise InputError(f"{name} has a root on or outside the unit circle")
    planned = input_dataset(u, model.Ts)
    output_error = model.A.size == model.C.size == model.D.size == 1
    if planned.missing and not output_error:
        raise InputError(
            f"{plural(planned.missing, 'sample is', 'samples are')} missing, but only an "
            "output-error model can be planned with gaps: plan with the complete input"
        )
    rows = [block for part in planned.experiments() for block in _gradient(model, part, variance)]
    to_full = np.eye(model.theta.size)
    if model.integrating:
        # F = (1 - q^-1) F̃ is linear in F̃: f_k = f̃_k - f̃_(k-1). The equations for A are the
        # same.
        index = np.r_[model.slice_of(model.integrating)]
        to_full[index[1:], index[:-1]] = -1.0
        to_full = np.delete(to_full, index[-1], axis=1)
    return cr_bound(np.vstack(rows), variance, model.names, model.theta, planned, to_full)


def _gradient(model: Fit, part: Dataset, variance: float) -> Iterator[Array]:
    """Yield blocks of rows Psi for one experiment; the sum of Psi^T Psi is lambda M."""
    # The columns belong to a, b, c, d and f, without the factor of an integrator.
    # An integrator in A is removed by differencing y, an integrator in F by summing u.
    B, C, D, u, N = model.B, model.C, model.D, part.u, part.N
    A, F = (_without_known_root(model, letter) for letter in "af")
    if model.integrating == "f":
        # The mean of u leads to a ramp, which is projected out anyway. Without the mean, the sums
        # have smaller rounding errors.
        u = np.cumsum(u - np.mean(u))
    na, nf = A.size - 1, F.size - 1
    forced = apply_filter(B, F, u)
    white = apply_filter(D, C, np.column_stack([u, forced, apply_filter([1.0], A, forced)]).T)
    nothing = np.zeros((N, C.size + D.size - 2))
    Psi = np.hstack(
        [
            -lag_columns(white[2], range(1, na + 1)),
            by_numerator(white[0], F, range(model.nk, B.size)),
            nothing,
            by_denominator(white[1], F, nf),
        ]
    )
    rows = part.valid.copy()
    Z = np.zeros((N, 0))
    if model.A.size > 1:
        rows[: max(model.A.size, B.size) - 1] = False
        if model.integrating:
            Z = apply_filter(D, C, np.ones((1, N))).T  # offset of the input
    else:
        count = transient_count(
            numerator_degree=B.size - 1,
            denominator_degree=model.F.size - 1,
            integrator=model.integrator,
        )
        Z = apply_filter(D, C, free_columns(F, N, count=count, drift=model.integrator).T).T
    yield orthonormal(Z[rows]).without(Psi[rows])
    if na or nothing.size:
        yield _by_noise(model, np.sqrt(variance * np.arange(N, 0.0, -1.0)), Psi.shape[1])


def _by_noise(model: Fit, weight: Vector, width: int) -> Array:
    """Return the impulse responses from e to the gradient; row j is multiplied by `weight[j]`."""
    # psi_e(t) = sum_j s_j e(t-j): over N samples from rest, psi_e psi_e^T is expected to add up to
    # lambda times the sum of (N - j) s_j s_j^T.
    pulse = np.zeros(weight.size)
    pulse[0] = 1.0
    s = np.zeros((weight.size, width))
    A = _without_known_root(model, "a")
    na, nc, nd = A.size - 1, model.C.size - 1, model.D.size - 1
    nb = model.B.size - model.nk
    s[:, :na] = by_denominator(pulse, A, na)
    s[:, na + nb : na + nb + nc] = -by_denominator(pulse, model.C, nc)
    s[:, na + nb + nc : na + nb + nc + nd] = by_denominator(pulse, model.D, nd)
    return np.asarray(s * weight[:, None])


def _without_known_root(model: Fit, letter: str) -> Array:
    """Return A or F without the factor 1 - q^-1 of an integrator."""
    p = model.polynomial(letter)
    return without_integrator(p) if letter == model.integrating else p
