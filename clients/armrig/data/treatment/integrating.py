"""Detection of outputs that integrate their input; the trend of such an output is not a drift."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from armrig.data.argument import treats_signals
from armrig.data.columns import Vector
from armrig.data.dataset import Dataset, Signals
from armrig.data.experiments import Trend
from armrig.data.finding import Finding, warning
from armrig.numerics.criteria import mdl
from armrig.numerics.least_squares import column_norms, least_squares, orthonormal
from armrig.numerics.polynomial import Array, apply_filter, lag_columns
from armrig.numerics.regressors import Whitening, whitening
from armrig.numerics.rounding import SHARE, is_constant, rounding_std
from armrig.numerics.whiteness import BAND_99_PERCENT, autoregression

_ORDER = 8  # order of the ARX model whose poles, except the slowest, shape the fast response
_MAX_FAST_POLE = 0.99  # modulus to which the poles of the fast response are limited
_LAGS = 30  # lags of u that describe the fast response
_PREFILTERS = 4  # passes of Steiglitz and McBride
_PASSES = 2  # estimates of the noise model
_POLES = 40  # poles that are compared with 1
_MAX_RISE = 10.83  # chi-squared, 1 degree of freedom, 99.9 %
_MAX_EFFECT_P = 1e-5  # p value of the integrated response to u below which y may integrate
_UNDECIDED_P = 0.01  # the same above which y does not
_MIN_RECORD_SHARE = 0.1  # least time constant of a pole that counts as 1, as a share of the record
_MIN_SHARE_OF_TEST = 0.2  # the same in the test: a disturbance hides that a slow heater settles
_POLE_ROUNDING = 1e-9
_REMOVED = 1e-10  # relative norm below which a filtered column is rounding
_UNSTABLE_SIGMAS = 4.0  # distance of an unstable pole from 1
_MIN_DEGREES = 10  # degrees of freedom below which the data are too few for a test
_MAX_SAMPLES = 6000  # longer data are averaged over blocks of samples


class IntegratingOutputWarning(UserWarning):
    """A linear trend was removed from an output that integrates its input."""


def integrates_by_name(output: str) -> bool:
    """Return whether an output integrates by construction, as an angle of the arm may."""
    from armrig_core.telemetry.channels import INTEGRATING_OUTPUTS  # 25 ms, rarely needed

    return output in INTEGRATING_OUTPUTS


def integrating(data: Dataset | Signals, output: str | None = None) -> Finding | None:
    """Return the evidence that an output integrates; None without evidence.

    An output that is known to integrate has no test. For any other output, `PoleTest` compares a
    pole at 1 with smaller poles.
    """
    signals = data.signals()
    i = signals.output(output)
    name = signals.outputs[i]
    if integrates_by_name(name):
        return warning("integrator", f"{name} integrates its input")
    tested = pole_test(signals, i)
    return _evidence(name, tested) if tested and tested.integrates else None


def _evidence(name: str, tested: PoleTest) -> Finding:
    text = f"{name} behaves as an integrating output (its response to u is not seen to return)"
    return warning("integrator", text, rise=tested.rise, share=tested.share)


def may_be_one(pole: float, std: float, N: int) -> bool:
    """Return whether a real pole is 1 within its accuracy, and no faster pole is in the interval.

    A wide interval is no evidence for 1: N samples must be too few for each pole in it to return.
    """
    width = BAND_99_PERCENT * std + _POLE_ROUNDING
    return abs(pole - 1) < width and (1 - pole + width) * _MIN_RECORD_SHARE * N < 1


@dataclass(frozen=True, slots=True, kw_only=True)
class PoleTest:
    """Likelihood of a pole at 1 in the response to u, compared with smaller poles."""

    rise: float
    """Rise of -2 log likelihood if the slowest pole is fixed at 1; inf for an unstable pole."""
    share: float
    """Shortest time constant that the data do not reject, divided by the length of the record."""
    p_effect: float
    """p value of the hypothesis that the pole at 1 has no effect on y."""

    @property
    def possible(self) -> bool:
        """True if u has an effect through a slow pole, and the pole may be 1."""
        return self.rise < _MAX_RISE and self.p_effect < _MAX_EFFECT_P

    @property
    def undecided(self) -> bool:
        """True if the data show neither an integrator nor that y is none."""
        return self.rise < _MAX_RISE and self.p_effect < _UNDECIDED_P and not self.integrates

    @property
    def integrates(self) -> bool:
        """True if the pole may be 1, and each other possible pole is as good as 1 in the record."""
        return self.possible and self.share >= _MIN_SHARE_OF_TEST


def pole_test(data: Signals, i: int) -> PoleTest | None:
    """Compare a pole at 1 in the response of output i to the inputs with smaller poles.

    The response to u is a slow pole p and a fast response, in additive noise ::

        y(t) = r w(t)/(1 - p q^-1) + sum_k h_k w(t-k) + c + d (1 - p^t)/(1 - p) + v(t)

    w is u filtered by the poles, except the slowest, of an ARX model or of the method of Steiglitz
    and McBride [2]_; the smaller loss decides. For each p the model is a linear regression. v is
    whitened by an autoregression of the residuals at the best p and at 1, of v or of its
    differences, so that a random walk v is no integrator. Each p has its best noise model. A
    time-invariant regression of y on its past would need many lags instead, because the noise of a
    measurement is added to y.

    The result is None for fewer than 40 samples, or 10 degrees of freedom, and if y is constant.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 16.4 (likelihood ratio).
    .. [2] K. Steiglitz, L. E. McBride, IEEE Trans. Automatic Control 10 (1965) 461-464.
    """
    parts = [_block_means(part.u, part.y[:, i], data.N) for part in data.experiments()]
    parts = [(u, y) for u, y in parts if y.size > 1]
    count = sum(int(np.isfinite(y).sum()) for _, y in parts)
    order, lags = min(_ORDER, count // 20), min(_LAGS, count // 5) // data.nu + 1
    if order < 2 or is_constant(np.concatenate([y for _, y in parts])):
        return None
    longest = max(y.size for _, y in parts)
    if all(_unstable(whitening(parts, n)) for n in (order, order // 2 + 1)):
        return PoleTest(rise=np.inf, share=0.0, p_effect=0.0)
    candidates = [_likelihood(parts, A, lags, longest) for A in _denominators(parts, order)]
    tests = [candidate for candidate in candidates if candidate is not None]
    return min(tests, key=lambda one: one[0])[1] if tests else None


def _likelihood(
    parts: list[tuple[Array, Vector]], A: Array, lags: int, longest: int
) -> tuple[float, PoleTest] | None:
    """Return the least loss with the fast poles of A, and the test; None with too few samples."""
    F, marks = _fast_poles(A), np.eye(len(parts))
    model = [
        _ExperimentRegressors.of(*part, F, lags, mark)
        for part, mark in zip(parts, marks, strict=True)
    ]
    poles = np.append(np.exp(-1 / np.geomspace(2, 20 * longest, _POLES)), 1.0)
    curves, effects = [], []
    slow = [part.slow(poles) for part in model]
    start, degrees, _ = _curve(model, np.ones(1), slow)
    if degrees < _MIN_DEGREES:
        return None
    for first in {int(np.argmin(start)), poles.size - 1}:
        for fixed in ([1.0], [1.0, -1.0]):
            k, D = first, np.array(fixed)
            for _ in range(_PASSES):
                D = np.convolve(fixed, _noise(model, D, [x[:, k] for x in slow], np.array(fixed)))
                costs, degrees, effect = _curve(model, D, slow)
                k = int(np.argmin(costs)) if first < poles.size - 1 else first
            curves.append(costs)
            effects.append(effect)
    if degrees < _MIN_DEGREES:
        return None
    best = np.min(curves, axis=0)
    rises = degrees * np.log(best / best.min())
    slowest = poles[int(np.argmax(rises < _MAX_RISE))]
    tau = np.inf if slowest == 1 else -1 / np.log(slowest)
    p_effect = effects[int(np.argmin([c[-1] for c in curves]))]
    test = PoleTest(rise=float(rises[-1]), share=float(tau / longest), p_effect=p_effect)
    return float(best.min()), test


@dataclass(frozen=True, slots=True, kw_only=True)
class _ExperimentRegressors:
    """Regressors of one experiment for a given slow pole."""

    w: Array
    """Inputs through the fast poles, (n, nu)."""
    fixed: Array
    """Columns that do not depend on the slow pole, (n, d)."""
    y: Vector
    """Output, NaN where it is missing."""
    mark: Vector
    """1 at the index of this experiment, else 0."""

    @classmethod
    def of(cls, u: Array, y: Vector, F: Array, lags: int, mark: Vector) -> _ExperimentRegressors:
        """Return the regressors; the free response of the fast poles has its own coefficients."""
        w = apply_filter([1.0], F, (u - u[0]).T).T
        pulse = apply_filter([1.0], F, np.eye(1, y.size)[0])
        free_response = np.column_stack([lag_columns(pulse, range(F.size - 1)), np.ones(y.size)])
        fixed = np.hstack(
            [*(lag_columns(x, range(lags)) for x in w.T), np.kron(mark, free_response)]
        )
        # The inputs before the start are not known.
        after_start = np.arange(y.size) >= min(lags, y.size // 10)
        return cls(w=w, fixed=fixed, y=np.where(after_start, y, np.nan), mark=mark)

    def slow(self, poles: Vector) -> Array:
        """Return each pole's response to the initial state, and to each input, (n, poles, d)."""
        t = np.arange(self.y.size, dtype=np.float64)
        columns = []
        for pole in poles:
            free = t if pole == 1 else np.expm1(t * np.log(pole)) / (pole - 1)
            response = apply_filter([1.0], [1.0, -pole], self.w.T).T
            columns.append(np.hstack([np.outer(free, self.mark), response]))
        return np.stack(columns, axis=1)


def _whiten(
    model: list[_ExperimentRegressors], D: Vector, columns: list[Array]
) -> tuple[Array, Vector]:
    """Return the columns and y of all experiments, filtered by D, where y is known."""
    rows, targets = [], []
    for part, M in zip(model, columns, strict=True):
        y = np.convolve(part.y, D)[: part.y.size]
        finite = np.isfinite(y) & (np.arange(y.size) >= D.size - 1)
        rows.append(apply_filter(D, [1.0], M.T).T[finite])
        targets.append(y[finite])
    X = np.vstack(rows)
    before = np.sqrt(sum(np.sum(M**2, axis=0) for M in columns)) * float(np.abs(D).sum())
    X[:, np.linalg.norm(X, axis=0) < _REMOVED * before] = 0.0
    return X, np.concatenate(targets)


def _curve(
    model: list[_ExperimentRegressors], D: Vector, slow: list[Array]
) -> tuple[Vector, int, float]:
    """Return the loss for each slow pole, the degrees of freedom, and the p value at the last."""
    from scipy.special import chdtrc

    _, count, d = slow[0].shape
    M, y = _whiten(model, D, [part.fixed for part in model])
    X, _ = _whiten(model, D, [x.reshape(-1, count * d) for x in slow])
    basis = orthonormal(M)
    degrees = y.size - basis.rank - d
    if degrees < _MIN_DEGREES:
        return np.zeros(count), degrees, 1.0
    rounding = y.size * rounding_std(*(part.y for part in model)) ** 2
    size = column_norms(X).reshape(count, d)
    y, X = basis.without(y), basis.without(X).reshape(-1, count, d)
    Q, R = np.linalg.qr(X.transpose(1, 0, 2))
    # Of a response that the fast poles describe, too, only rounding errors are left.
    left = np.abs(np.diagonal(R, axis1=1, axis2=2)) > SHARE * size
    explained = (Q.transpose(0, 2, 1) @ y) ** 2 * left
    losses = np.maximum(y @ y - explained.sum(axis=1), rounding)
    effect = degrees * explained[-1, len(model) :].sum() / losses[-1]
    return losses / y.size, degrees, float(chdtrc(d - len(model), effect))


def _noise(
    model: list[_ExperimentRegressors], D: Vector, slow: list[Array], fixed: Vector
) -> Vector:
    """Return the autoregression of the noise, filtered by `fixed`, at a slow pole."""
    columns = [np.hstack([part.fixed, x]) for part, x in zip(model, slow, strict=True)]
    M, y = _whiten(model, D, columns)
    theta = least_squares(M, y[:, None])[:, 0]
    errors = (part.y - X @ theta for part, X in zip(model, columns, strict=True))
    least = rounding_std(*(part.y for part in model))
    filtered_errors = [np.convolve(e, fixed)[fixed.size - 1 : e.size] for e in errors]
    return autoregression(filtered_errors, mdl, least)[0]


def _block_means(u: Array, y: Vector, N: int) -> tuple[Array, Vector]:
    """Return the signals of an experiment; means over blocks if the data have many samples."""
    n = -(-N // _MAX_SAMPLES)
    stop = y.size - y.size % n
    return u[:stop].reshape(-1, n, u.shape[1]).mean(axis=1), y[:stop].reshape(-1, n).mean(axis=1)


def _unstable(noise: Whitening) -> bool:
    """Return whether an ARX model has a real pole significantly larger than 1."""
    n, roots = noise.A.size - 1, np.roots(noise.A)
    z = float(np.max(roots.real[roots.imag == 0], initial=0.0))
    if z <= 1:
        return False
    # dz = -sum da_k z^(n-k) / A'(z)
    by_a = z ** np.arange(n - 1, -1, -1) / np.polyval(np.polyder(noise.A), z)
    return bool(z - 1 > _UNSTABLE_SIGMAS * np.sqrt(by_a @ noise.covariance[:n, :n] @ by_a))


def _denominators(parts: list[tuple[Array, Vector]], order: int) -> Iterator[Array]:
    """Yield the denominators of ARX and of Steiglitz and McBride; the smaller loss decides."""
    # ARX takes the noise of a measurement for dynamics, and misses poles of the plant near 1. The
    # other method fails for noise that drifts.
    A = whitening(parts, order).A
    yield A
    if any(np.isnan(y).any() for _, y in parts):
        return
    for _ in range(_PREFILTERS):
        D = _inside(A)
        A = whitening(
            [(apply_filter([1.0], D, u.T).T, apply_filter([1.0], D, y)) for u, y in parts], order
        ).A
    yield A


def _fast_poles(A: Array) -> Array:
    """Return the polynomial of the roots of A except the root nearest to 1, all inside."""
    z = np.roots(A)
    return _inside(np.poly(np.delete(z, np.argmin(np.abs(z - 1)))))


def _inside(A: Array) -> Array:
    """Return the polynomial whose roots outside the unit circle are reflected, and limited."""
    z = np.roots(np.atleast_1d(A))
    size = np.maximum(np.abs(z), np.finfo(np.float64).tiny)
    return np.atleast_1d(
        np.real(np.poly(z * np.minimum(1, np.minimum(1 / size, _MAX_FAST_POLE) / size)))
    )


# Rate of an output, such as an angle's velocity.


def rate_name(output: str) -> str:
    """Return the name of the rate of an output."""
    from armrig_core.telemetry.channels import RATES

    return RATES.get(output) or f"rate of {output}"


@treats_signals
def difference(data: Signals) -> Signals:
    """Return data with the velocities (y(t) - y(t-1)) / Ts as outputs; u is unchanged.

    The velocity is missing if one of the two samples is missing, and at the first sample of each
    experiment. A model of the velocity has the same nk as a model of the position, and
    one pole less, because it has no integrator.

    Parameters
    ----------
    data : Dataset or Signals
        N samples, Ts in s.

    Returns
    -------
    Dataset or Signals
        N samples whose outputs are the rates of y, in y's unit per s; the rate of theta_1 is named
        `velocity`.

    Examples
    --------
    >>> data = armrig.difference(armrig.example_recording().dataset("theta_1"))
    >>> data.output, data.unit
    ('velocity', 'rad/s')
    """
    Ts, y = data.Ts, np.full(data.y.shape, np.nan)
    y[1:] = np.diff(data.y, axis=0) / Ts
    y[list(data.starts)] = np.nan
    names = [rate_name(output) for output in data.outputs]
    each = f"output{'s' * (data.ny > 1)} {', '.join(map(repr, names))}"
    return data.replaced(
        y=y,
        valid=np.isfinite(y),
        outputs=names,
        units=[f"{unit}/s" if unit else "" for unit in data.units],
        trends=[
            Trend(u_level=t.u_level, u_slope=t.u_slope, y_level=t.y_slope) for t in data.trends
        ],
        step=f"took differences of {', '.join(data.outputs)} over Ts={Ts:g} s as the {each}",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Integration:
    """Decision whether an output is taken as integrating, with the reason for the decision."""

    integrates: bool
    """True if the model treats y as the integral of its rate."""
    reason: str = ""
    """Evidence from the test; "" if the test finds no integrator or is not needed."""
    undecided: bool = False
    """True if the data do not distinguish an integrator from a slow pole."""
    rejected: bool = False
    """True if y is theta_1, and its response returns within a tenth of the record."""
    unstable: bool = False
    """True if the response of y to u has a real pole outside the unit circle."""
    others: tuple[str, ...] = ()
    """Other inputs, without which an output that settles would seem to integrate."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the result, with the evidence from the test; () without evidence."""
        if not self.reason:
            return ()
        note = "taken as integrating (--assume settling, in Python integrator=False, changes this)"
        return (f"{self.reason}: {note}",)


def integration(
    data: Dataset, integrator: bool | None, all_inputs: Signals | None = None
) -> Integration:
    """Decide whether the output is taken as integrating; `all_inputs` has all inputs of the output.

    If `integrator` is given, its value is the decision. Otherwise an output integrates if its name
    is theta_1, or if `pole_test` finds an integrator. In this last case, the notes report the
    result of the test. If the response of theta_1 returns, another rig may be read as theta_1, or a
    controller may hold the angle. Another input that moves a slow output hides that it returns, so
    the test with all inputs can reject an integrator.
    """
    if integrator is not None:
        return Integration(integrates=integrator)
    test = pole_test(data.signals(), 0)
    if integrates_by_name(data.output):
        returns = test is not None and test.rise > _MAX_RISE and test.share < _MIN_RECORD_SHARE
        return Integration(integrates=True, rejected=returns)
    if test is None:
        return Integration(integrates=False, undecided=True)
    if (test.integrates or test.undecided) and all_inputs is not None and all_inputs.nu > 1:
        together = pole_test(all_inputs, 0)
        if together is not None and together.rise > _MAX_RISE and np.isfinite(together.rise):
            others = tuple(name for name in all_inputs.inputs if name != data.input)
            return Integration(integrates=False, others=others)
    return Integration(
        integrates=test.integrates,
        reason=_evidence(data.output, test).text if test.integrates else "",
        undecided=test.undecided,
        unstable=bool(np.isinf(test.rise)),
    )
