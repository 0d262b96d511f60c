"""Models in continuous time: sampling, conversion of a sampled model, responses and quantities."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.errors import InputError

from armrig.models.responses import root_derivatives, standard_deviations
from armrig.models.state_space import Complex, Matrix, Vector
from armrig.models.transfer_function import TransferFunction
from armrig.numerics.checks import require_numbers
from armrig.numerics.polynomial import roots
from armrig.numerics.quantities import digits, plural

if TYPE_CHECKING:
    from armrig.models.fit import Fit

_REAL_TOLERANCE = 1e-7
_ORIGIN_TOLERANCE = 1e-12
_ROUNDING = 1e-9


def discrete(fit: Fit, Ts: float | None) -> Fit:
    """Return the sampled model, as `Fit.to_discrete` documents."""
    form = _transfer_function(fit)
    Ts = form.Ts if Ts is None else Ts
    require_numbers(Ts=Ts)
    if not (np.isfinite(Ts) and Ts > 0):
        raise InputError(f"Ts={Ts} s must be a positive number")
    sampled, J = form.sampled(Ts)
    white = sampled.C[0].size == sampled.D[0].size == 1
    return replace(
        fit,
        structure="oe" if white else "bj",
        form=sampled,
        Ts=Ts,
        covariance=J @ fit.covariance @ J.T,
        covariance_robust=J @ fit.covariance_robust @ J.T,
        free=fit.free if np.isclose(Ts, form.Ts, rtol=1e-9, atol=0.0) else (),
    )


def continuous(fit: Fit) -> Fit:
    """Return the model in continuous time, as `Fit.to_continuous` documents."""
    if fit.Ts == 0:
        return fit
    F, nk = fit.denominator, fit.nk
    n = F.size - 1
    b = fit.B[nk:]
    _require_logarithms(fit, roots(F))
    if nk < 1 or b.size > n:
        raise InputError(
            f"{fit.label} has {b.size} numerator coefficients from lag {nk} and "
            f"{plural(n, 'pole')}; a held "
            f"input gives at most {n}, from lag 1 on. Estimate with nk=1 and nb={n}, or in s"
        )
    z = roots(F).astype(np.complex128)
    if fit.integrator:
        z[np.argmin(np.abs(z - 1))] = 1.0
    scaled = np.real(np.poly(np.log(z)))  # s in 1/sample
    if fit.integrator:
        scaled[n] = 0.0
    powers = fit.Ts ** np.arange(n + 1.0)
    trial = TransferFunction(B=((np.ones(n),),), F=((scaled / powers,),), Ts=fit.Ts)
    sampled, by_f = trial.sampled(fit.Ts)
    of_b = by_f[sampled.slice_of("b", 0, 0), trial.slice_of("b")]
    numerator = np.linalg.solve(of_b, np.append(b, np.zeros(n - b.size)))
    # A coefficient that is rounding noise would be a zero far outside the sampled frequencies.
    size = np.abs(numerator) * fit.Ts ** np.arange(1.0, n + 1)
    kept = int(np.argmax(size > _ROUNDING * size.max()))
    form = replace(
        trial,
        B=((numerator[kept:],),),
        C=(fit.C,),
        D=(np.convolve(fit.A, fit.D),),
        delay=(nk - 1) * fit.Ts,
        integrators=(fit.integrator,),
    )
    input_response = replace(trial, B=((numerator,),))
    J = _derivatives(fit, input_response, form)
    return replace(
        fit,
        structure="tf",
        form=form,
        Ts=0.0,
        covariance=J @ fit.covariance @ J.T,
        covariance_robust=J @ fit.covariance_robust @ J.T,
    )


def _derivatives(fit: Fit, driven: TransferFunction, form: TransferFunction) -> Matrix:
    """Return the derivatives in s by the sampled model, from `driven`, the response to u alone."""
    n = driven.F[0][0].size - 1
    sampled, forward = driven.sampled(fit.Ts)
    rows = np.r_[sampled.slice_of("b", 0, 0), sampled.slice_of("f", 0, 0)]
    columns = np.r_[driven.slice_of("b"), driven.slice_of("f")]
    inverse = np.linalg.inv(forward[np.ix_(rows, columns)])
    by_theta = np.zeros((2 * n, fit.theta.size))  # of (b, f of the denominator A F)
    b_slice = fit.slice_of("b")
    by_theta[: b_slice.stop - b_slice.start, b_slice] = np.eye(b_slice.stop - b_slice.start)
    by_theta[n:, fit.slice_of("a")] = _products(fit.F, fit.A.size - 1, n)
    by_theta[n:, fit.slice_of("f")] = _products(fit.A, fit.F.size - 1, n)
    J = np.zeros((form.theta.size, fit.theta.size))
    b_slice = form.slice_of("b")
    J[np.r_[b_slice, form.slice_of("f")]] = (inverse @ by_theta)[n - b_slice.stop + b_slice.start :]
    if fit.integrator:
        J[form.slice_of("f").stop - 1] = 0.0
    C, D = form.slice_of("c"), form.slice_of("d")
    J[C, fit.slice_of("c")] = np.eye(C.stop - C.start)
    J[D, fit.slice_of("a")] = _products(fit.D, fit.A.size - 1, D.stop - D.start)
    J[D, fit.slice_of("d")] = _products(fit.A, fit.D.size - 1, D.stop - D.start)
    return J


def _products(p: Vector, count: int, size: int) -> Matrix:
    """Return the derivatives of p q by the coefficients q_1 … q_count, without that of q^0."""
    derivatives = np.zeros((size, count))
    for k in range(count):
        derivatives[k : k + p.size, k] = p
    return derivatives


def _require_logarithms(fit: Fit, z: Complex) -> None:
    """Refuse a pole at 0 or on the negative real axis, which no held model in s has."""
    bad = z[(z.real <= 0) & (np.abs(z.imag) <= _REAL_TOLERANCE)]
    if bad.size:
        raise InputError(
            f"{fit.label} has a pole at z = {digits(bad[0].real, 3)}: no model in s of the same "
            "order has this pole when sampled; lower the order, or estimate in s with armrig.tf"
        )


def _transfer_function(fit: Fit) -> TransferFunction:
    if not isinstance(fit.form, TransferFunction):
        raise InputError(
            f"{fit.label} is already sampled, with Ts={fit.Ts:g} s; "
            "fit.to_continuous().to_discrete(Ts) samples it at another Ts"
        )
    return fit.form


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """One physical number of a model."""

    name: str
    """Name, such as "gain" or "time constant 1"."""
    value: float
    std: float
    """Standard deviation by linearisation, from the trusted covariance."""
    unit: str


class Quantities(dict[str, Quantity]):
    """Physical numbers of a model by name, as a table to print: gain, poles, zeros and delay."""

    def __missing__(self, name: str) -> Quantity:
        """Refuse a name that the model does not have."""
        raise KeyError(f"{name!r}: the model has {', '.join(self)}")

    def __repr__(self) -> str:
        """Return a table with a line for each number."""
        width = max(map(len, self), default=0)
        return "\n".join(
            f"{name:{width}}  {q.value:.5g} ± {digits(q.std, 2)} {q.unit}".rstrip()
            if np.isfinite(q.value)
            else f"{name:{width}}  not determined: a pole may be 0; estimate with an integrator"
            for name, q in self.items()
        )


_Row = tuple[str, float, Vector, str]  # name, value, gradient by theta, unit


def quantities(fit: Fit) -> Quantities:
    """Return the physical numbers of a model, as `Fit.quantities` documents."""
    fit = continuous(fit)
    form = _transfer_function(fit)
    rows = [_gain(fit, form)]
    rows += _of_roots(fit, "f", "time constant", "natural frequency", "damping")
    rows += _of_roots(fit, "b", "zero's time constant", "zero's frequency", "zero's damping")
    if form.delay or form.delay_estimated:
        of_delay = np.zeros(form.theta.size)
        of_delay[form.slice_of("delay")] = 1.0
        rows.append(("delay", form.delay, of_delay, "s"))
    gradients = np.array([gradient for _, _, gradient, _ in rows])
    std = standard_deviations(gradients, fit.trusted_covariance).tolist()
    return Quantities(
        {
            name: Quantity(name=name, value=float(value), std=s, unit=unit)
            for (name, value, _, unit), s in zip(rows, std, strict=True)
        }
    )


def _gain(fit: Fit, form: TransferFunction) -> _Row:
    """Return B(0)/F(0), or that of the rate of an integrating output.

    The gain is NaN if F(0) and the gain are smaller than their standard deviations: a pole may be
    0. If a pole is far away instead, B(0) follows F(0), and their ratio is known.
    """
    theta, f = form.theta, form.slice_of("f")
    at_b, at_f = form.slice_of("b").stop - 1, f.stop - 1 - int(form.integrators[0])
    gradient = np.zeros(theta.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        below = theta[at_f] if at_f >= f.start else np.float64(1.0)  # 1/s has no f but 0
        value = theta[at_b] / below
        gradient[at_b] = 1 / below
        if at_f >= f.start:
            gradient[at_f] = -value / below
            P = fit.trusted_covariance
            if below**2 < P[at_f, at_f] and value**2 < gradient @ P @ gradient:
                value = np.nan
    rate = "/s" if form.integrators[0] else ""
    unit = f"{fit.unit}{rate}/{fit.input_unit}" if fit.unit and fit.input_unit else ""
    return "gain (rate)" if rate else "gain", value, gradient, unit


def _of_roots(fit: Fit, letter: str, real: str, frequency: str, damping: str) -> list[_Row]:
    """Return -1/s of each real root, and |s| and -Re s/|s| of each pair, slowest first."""
    s, by_own = root_derivatives(fit, letter)
    ds = np.zeros((s.size, fit.theta.size), dtype=np.complex128)
    ds[:, fit.slice_of(letter)] = by_own
    order = [k for k in np.argsort(np.abs(s)) if s[k].imag >= 0 and abs(s[k]) > _ORIGIN_TOLERANCE]
    reals = [k for k in order if s[k].imag == 0]
    pairs = [k for k in order if s[k].imag > 0]

    def label(name: str, k: int, group: list[int]) -> str:
        return name if len(group) == 1 else f"{name} {group.index(k) + 1}"

    rows: list[_Row] = [
        (label(real, k, reals), -1 / s[k].real, ds[k].real / s[k].real ** 2, "s") for k in reals
    ]
    for k in pairs:
        size = abs(s[k])
        by_size = (np.conj(s[k]) * ds[k]).real / size
        rows.append((label(frequency, k, pairs), size, by_size, "rad/s"))
        by_damping = -ds[k].real / size + s[k].real * by_size / size**2
        rows.append((label(damping, k, pairs), -s[k].real / size, by_damping, ""))
    return rows
