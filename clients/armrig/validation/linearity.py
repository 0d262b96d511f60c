"""Test whether one linear model can describe the data, and the kind of a nonlinear rig."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import product
from math import log, log10
from typing import TYPE_CHECKING, Literal

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_data
from armrig.data.dataset import Dataset, Signals
from armrig.data.files.column_faults import rails_of
from armrig.estimation.data_faults import CONSTANT_INPUT
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.polynomial import Array, filtered
from armrig.numerics.quantities import p_relation, percent, three_digits
from armrig.numerics.regressors import complete, past
from armrig.numerics.stretches import Mask
from armrig.numerics.whiteness import joint_p_value
from armrig.validation.feedback_and_delay.by_channel import ByChannel
from armrig.validation.feedback_and_delay.open_loop import open_loop, require_level

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Kind = Literal["", "dead zone", "saturation", "gain by level", "friction"]

_REMEDIES: Mapping[Kind, str] = {
    "": "record steps around one level, and estimate a model for this level",
    "dead zone": "leave out the samples below the dead zone, or record with u above it",
    "saturation": "mark the samples at the limit missing, or record with a smaller u",
    "gain by level": "record small steps around one level, and estimate a model for each level",
    "friction": "record with a u that keeps the rig moving, or estimate the friction (greybox)",
}
_MAX_LAGS = 30
_CLOSED_P = 1e-3  # the usual 0.05 finds feedback in one of twenty open-loop recordings
_ROWS_PER_PARAMETER = 4
_MAX_EFFECTS = 8  # combinations of effects that are tested jointly
_MIN_SIZE = 0.1  # least size of a tested combination of effects, relative to the largest
_MIN_OWN_SHARE = 1e-3  # least share of an effect that the linear model leaves unexplained
_ROBUST_LIMIT = 3.5  # robust standard deviations at which residuals are cut off
_MAX_LEFT = 0.5  # share of y's variance that a simulation may leave; else x is the prediction
_MAX_INSIDE = 0.35  # gain inside a dead zone, relative to the gain outside
_MAX_OUTSIDE = -0.5  # coefficient of a saturation: -1 if y stays at the limit
_ZONES = np.linspace(0.03, 0.75, 24)  # thresholds of a dead zone, as shares of the range of u
_TWO_LEVELS = 2
_LEVELS_OF_A_ZONE = 4  # least number of levels of u that distinguish a dead zone
_SAME_BIC = 1.0  # difference of BIC that does not distinguish two thresholds
_LEVELS = np.linspace(0.05, 0.95, 19)  # from the 5 % to the 95 % quantile


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Linearity:
    """Result of the test of linearity of one output with one input."""

    p: float
    """p value of the hypothesis that one linear model describes the data."""
    level: float
    """Level of the test: share of linear rigs that the test rejects by chance."""
    kind: Kind
    """Kind of the nonlinearity; "" if the rig is linear."""
    numbers: Mapping[str, float]
    """Numbers of the kind: `from` and `to` of a dead zone, or `at` and `share` of a saturation. For
    a gain: the least and the greatest, `gain_1` at `level_1` and `gain_2` at `level_2`."""
    rails: tuple[float, ...]
    """Largest or smallest values of y at which y stays exactly."""
    gain_of: str
    """Name of the signal that determines the gain: the input, or the output; "" if linear."""
    levels: Array
    """Levels of `gain_of`, (n,); (0,) if the rig is linear."""
    gains: Array
    """Static gain at `levels`, in y's unit per u's unit."""
    remarks: tuple[str, ...]
    """Limits of the answer."""
    output: str
    """Name of y."""
    input: str
    """Name of u."""
    units: Mapping[str, str]
    """Units of u and y, by name."""
    source: str
    """Hash of the recording, or ""."""

    @property
    def linear(self) -> bool:
        """True if the test does not reject, and y reaches no limit."""
        return not (self.p < self.level or self.rails)

    @property
    def remedy(self) -> str:
        """Remedy for the nonlinearity; "" if the rig is linear."""
        return "" if self.linear else _REMEDIES[self.kind]

    @property
    def verdict(self) -> str:
        """Answer in a few words, with the numbers of the kind."""
        return f"{'linear' if self.linear else 'NONLINEAR'}: {self.reason}"

    @property
    def reason(self) -> str:
        """The kind with its numbers, in a few words."""
        if self.linear:
            return "no nonlinearity found"
        x = {name: three_digits(value) for name, value in self.numbers.items()}
        u, of = (self.units.get(name, "") for name in (self.input, self.gain_of))
        if "from" in x:
            return f"a dead zone of {self.input} from {x['from']} to {x['to']} {u}".rstrip()
        if self.kind == "saturation":
            at = " and ".join(map(three_digits, self.rails)) or f"about {x['at']}"
            share = percent(100 * self.numbers["share"])
            return f"{self.output} saturates at {at} in {share} of the samples"
        if self.kind == "friction":
            return f"friction, {self.output} stops at rest"
        gains = (
            f"{x[f'gain_{i}']} at {self.gain_of} = {x[f'level_{i}']} {of}".rstrip() for i in (1, 2)
        )
        return f"a gain of {' and of '.join(gains)}"

    def explain(self) -> str:
        """Return the answer, its reason, the remedy and the limits of the answer."""
        found = f"Finding: effects that are not linear in {self.input} explain the errors of a long"
        lines = [f"{self.verdict}.", f"{found} linear model: p {p_relation(self.p)}."]
        if self.remedy:
            lines.append(f"So one linear model cannot describe the data: {self.remedy}.")
        return "\n".join([*lines, *(f"Note: {remark}." for remark in self.remarks)])

    def brief(self) -> str:
        """Return the answer, the remedy and the limits of the answer."""
        return "\n".join([repr(self), *([f"Remedy: {self.remedy}."] if self.remedy else [])])

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of the gain by level: see `armrig.plots.plot_linearity`."""
        from armrig.plots.layout import figure_of
        from armrig.validation.figures import plot_linearity

        return figure_of(plot_linearity(self, ax=ax))

    def __repr__(self) -> str:
        """Return the answer in a line, and the remarks."""
        said = f"{self.verdict} (p {p_relation(self.p)}, level {100 * self.level:g} %)"
        return "\n".join([said, *(f"  note: {remark}" for remark in self.remarks)])


@takes_data
def linearity(data: Dataset | Signals, level: float = 0.05) -> Linearity | ByChannel[Linearity]:
    """Test whether one linear model can describe the data, and find the kind of nonlinearity.

    A long linear model whitens the errors ::

        A(q) y(t) = c + B(q) u(t) + e(t),     x = B/A u,     up to 30 lags

    If the rig is linear, e is not correlated with nonlinear effects, filtered by A or B. The
    effects are squares and cubes of u and x, their product, ``|Δu|``, and the sign and the square
    of Δx. A joint test of their principal combinations gives `p`. If x does not follow y, the
    prediction of y replaces x. Large e are cut off at 3.5 robust standard deviations.

    If the test rejects, the kind with the least BIC is reported. The kinds are a dead zone of u, a
    saturated output, friction, and a gain that depends on the level of u or y. An output is also
    saturated if it stays at exactly its largest or smallest value.

    Parameters
    ----------
    data : Dataset or Signals
        Data with an exciting input; missing samples and several experiments are allowed. For
        Signals with several channels, each pair of an output and an input is tested, with all
        inputs in the linear model. An input of two levels cannot show a dead zone or another static
        nonlinearity of u; `remarks` reports this.
    level : float, default 0.05
        Level of the test, between 0 and 1.

    Returns
    -------
    Linearity
        .linear, .p, .kind, .numbers, .remedy, .explain(), .plot(). For Signals with several
        channels, the result is `ByChannel`: `found["alpha", "u"]` is the result of one channel.

    Raises
    ------
    ValueError
        level is outside 0 to 1, u is constant, or there are too few samples.

    References
    ----------
    .. [1] S. A. Billings, W. S. F. Voon, Int. J. Control 44 (1986) 235-244.
    .. [2] R. S. Tsay, Biometrika 73 (1986) 461-466.

    Examples
    --------
    >>> import armrig, numpy as np
    >>> u = np.repeat(np.random.default_rng(1).uniform(0, 5, 50), 10)
    >>> y = np.maximum(u - 1, 0) + 0.01 * np.random.default_rng(2).standard_normal(500)
    >>> armrig.linearity(armrig.Dataset(u=u, y=y, Ts=0.1)).kind
    'dead zone'
    """
    require_level(level)
    signals = data.signals()
    if (signals.ny, signals.nu) == (1, 1):
        return _tested(signals, signals.inputs[0], level)
    results, refused = {}, {}
    for output, input in product(signals.outputs, signals.inputs):
        try:
            results[output, input] = _tested(signals.channels([output]), input, level)
        except InputError as err:
            refused[output, input] = str(err)
    return ByChannel(results=results, refused=refused)


def _tested(signals: Signals, input: str, level: float) -> Linearity:
    """Test one output with one input."""
    data, loop = signals.dataset(signals.outputs[0], input), None
    with suppress(InputError):
        loop = open_loop(data)
    closed = loop is not None and loop.p_value < _CLOSED_P and not loop.few_levels
    direct = loop is not None and loop.may_be_direct_term
    # In closed loop, u(t) contains e(t).
    model = _long_model(signals, input, first=int(closed and not direct))
    at, rails = rails_of(data.y) if data.valid.any() else (data.valid, [])
    p = _p_value(model)
    found = _Found(bic=0.0)
    if rails or p < level:
        every = [*_gains(model), *_thresholds(model)]
        found = min(every, key=lambda x: x.bic)
        curve = min((x for x in every if x.gain_of), key=lambda x: x.bic)
        found = replace(curve, kind=found.kind, numbers=found.numbers)
    if rails:
        numbers = {"at": rails[-1], "share": float(np.mean(at[data.valid]))}
        found = replace(found, kind="saturation", numbers=numbers)
    remarks = []
    if np.unique(data.u).size <= _TWO_LEVELS:
        text = f"{input} has two levels, which cannot show a dead zone or another static "
        text += f"nonlinearity of {input}: record with several levels (staircase, white noise)"
        remarks.append(text)
    if closed and direct:
        remarks.append(f"if a controller computed {input} from {data.output}, p is not valid")
    return Linearity(
        p=p,
        level=level,
        kind=found.kind,
        numbers=found.numbers,
        rails=tuple(rails),
        gain_of={"u": input, "": ""}.get(found.gain_of, data.output),
        levels=found.levels,
        gains=found.gains,
        remarks=tuple(remarks),
        output=data.output,
        input=input,
        units={input: data.input_unit, data.output: data.unit},
        source=data.source,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _LongModel:
    """Long linear model of one output; the signals of all experiments are joined."""

    base: Basis
    """Basis of the lags of y, of the lags of each input, and of a constant per experiment."""
    y: Array
    """Output in the rows that are used, from its mean."""
    A: Array
    B: Array
    """Coefficients 0 … p of A, and of B of the tested input."""
    lags_of_u: slice
    """Coefficients of the tested input."""
    u: Array
    """Tested input, from its mean."""
    x: Array
    """Course of y that u causes, from the mean of y."""
    measured: Array
    """Measured output, from its mean; 0 where it is missing."""
    rows: Mask
    """Rows that are used: all lags are in the same experiment, and known."""
    means: tuple[float, float]
    """Means of u and of y."""

    def effects(self, P: Array, *signals: Array) -> Array:
        """Return signals that are filtered by A or B, in the rows that are used."""
        return np.column_stack([filtered(P, [1.0], x)[self.rows] for x in signals])

    def fitted(self, P: Array, *signals: Array) -> tuple[float, float, float, Array]:
        """Return BIC, A(1) and B(1) of the model with effects, and the effects' coefficients."""
        effects, N = self.effects(P, *signals), self.y.size
        own = orthonormal(self.base.without(effects))
        c = own.coefficients(self.y)
        loss = float(np.sum(own.without(self.base.without(self.y)) ** 2))
        theta = self.base.coefficients(self.y - effects @ c)
        A_1, B_1 = 1 + np.sum(theta[: self.A.size - 1]), np.sum(theta[self.lags_of_u])
        return N * log(max(loss, 1e-300)) + len(signals) * log(N), float(A_1), float(B_1), c


def _long_model(signals: Signals, input: str, first: int) -> _LongModel:
    """Return the long model with lags `first` … p of u; p depends on the number of samples."""
    j, nu, N = signals.inputs.index(input), signals.nu, int(np.count_nonzero(signals.valid))
    if all(np.ptp(part.u[:, j]) == 0 for part in signals.experiments()):
        raise InputError(CONSTANT_INPUT)
    p = min(round(15 * log10(max(N, 2))), _MAX_LAGS, N // (_ROWS_PER_PARAMETER * (1 + nu)) - 2)
    if p < 2:
        needed = 4 * _ROWS_PER_PARAMETER * (1 + nu)
        raise InputError(f"the test of linearity needs at least {needed} samples, got {N}")
    u, y = signals.u - signals.u.mean(axis=0), signals.y[:, 0] - np.nanmean(signals.y)
    parts = [
        slice(a, b) for a, b in zip(signals.starts, (*signals.starts[1:], y.size), strict=True)
    ]
    block = np.vstack(
        [
            np.hstack(
                [-past(y[s], range(1, p + 1)), *(past(x, range(first, p + 1)) for x in u[s].T)]
            )
            for s in parts
        ]
    )
    rows = complete(block, y)
    if np.count_nonzero(rows) < 2 * block.shape[1]:
        raise InputError(f"too few samples of {signals.outputs[0]} have {p} known predecessors")
    number = np.searchsorted(signals.starts, np.arange(y.size), side="right")
    constants = (number[:, None] == np.unique(number[rows])).astype(np.float64)
    Phi = np.hstack([block, constants])[rows]
    base = orthonormal(Phi)
    theta = base.coefficients(y[rows])
    A, n = np.append(1.0, theta[:p]), p + 1 - first
    B = np.pad(theta[p : p + nu * n].reshape(nu, n), ((0, 0), (first, 0)))
    x = np.concatenate([_simulated(A, B, u[s], y[s]) for s in parts])
    with np.errstate(over="ignore", invalid="ignore"):
        left = np.var((x - y)[rows])
    if not left < _MAX_LEFT * np.var(y[rows]):
        x = np.where(rows, 0.0, np.nan_to_num(y))
        x[rows] = Phi @ theta
    return _LongModel(
        base=base,
        y=y[rows],
        A=A,
        B=B[j],
        lags_of_u=slice(p + j * n, p + (j + 1) * n),
        u=u[:, j],
        x=x,
        measured=np.nan_to_num(y),
        rows=rows,
        means=(float(signals.u[:, j].mean()), float(np.nanmean(signals.y))),
    )


def _simulated(A: Array, B: Array, u: Array, y: Array) -> Array:
    """Return the course of A x = sum of B_k u_k, which begins with the first values of y."""
    from scipy.signal import lfilter, lfiltic

    first = np.nan_to_num(y[: A.size - 1])
    drive = np.sum([filtered(b, [1.0], x) for b, x in zip(B, u.T, strict=True)], axis=0)
    with np.errstate(over="ignore", invalid="ignore"):  # the model may be unstable
        rest, _ = lfilter([1.0], A, drive[first.size :], zi=lfiltic([1.0], A, first[::-1]))
    x: Array = np.nan_to_num(np.concatenate([first, rest]), posinf=0.0, neginf=0.0)
    return x


def _p_value(model: _LongModel) -> float:
    """Return the p value of the joint test of all effects."""
    u, x, du, dx = (s / (np.std(s) or 1.0) for s in (model.u, model.x, *_changes(model)))
    of_x, of_dx = (x**2, x**3), (_sign(dx), dx * np.abs(dx), x * dx)
    raw = np.hstack(
        [
            model.effects(model.B, u**2, u**3, np.abs(du), *of_x, x * u, *of_dx),
            model.effects(model.A, *of_x),
        ]
    )
    own = model.base.without(raw)
    size = np.linalg.norm(own, axis=0)
    used = size > _MIN_OWN_SHARE * np.linalg.norm(raw - raw.mean(axis=0), axis=0)
    e, N = model.base.without(model.y), model.y.size
    robust = 1.4826 * float(np.median(np.abs(e)))
    if not used.any() or robust == 0:
        return float("nan")
    U, S, _ = np.linalg.svd(own[:, used] / size[used], full_matrices=False)
    # The transients of few changes of u do not determine many effects.
    most = max(2, min(N // 40, np.count_nonzero(np.diff(model.u)) // 3, _MAX_EFFECTS))
    U = U[:, _MIN_SIZE * S[0] < S][:, :most]
    e = np.clip(e, -_ROBUST_LIMIT * robust, _ROBUST_LIMIT * robust)
    degrees = N - model.base.rank
    return joint_p_value(U.T @ e, np.eye(U.shape[1]) * float(e @ e) / degrees, N=degrees)


def _changes(model: _LongModel) -> tuple[Array, Array]:
    """Return Δu and Δx."""
    return np.diff(model.u, prepend=model.u[0]), np.diff(model.x, prepend=model.x[0])


def _sign(v: Array) -> Array:
    """Return the sign of v, which is smooth near 0; v has the standard deviation 1."""
    return np.asarray(v / np.sqrt(v**2 + 0.25))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Found:
    """A kind of nonlinearity, and how well it describes the data."""

    bic: float
    kind: Kind = ""
    numbers: Mapping[str, float] = field(default_factory=dict)
    gain_of: str = ""
    levels: Array = field(default_factory=lambda: np.zeros(0))
    gains: Array = field(default_factory=lambda: np.zeros(0))


def _gains(model: _LongModel) -> Iterator[_Found]:
    """Yield models with the square and the cube of u or x, which act like u, or are added to y."""
    for name, P in (("u", model.B), ("x", model.B), ("y", model.A)):
        if name == "u" and np.unique(model.u).size <= _TWO_LEVELS:
            continue
        signal, mean = (model.u, model.means[0]) if name == "u" else (model.x, model.means[1])
        at = np.quantile(signal[model.rows], _LEVELS)
        bic, A_1, B_1, (a, b) = model.fitted(P, signal**2, signal**3)
        slope = (2 * a * at + 3 * b * at**2) * np.sum(P)
        with np.errstate(divide="ignore", invalid="ignore"):
            if name == "u":
                gains = (B_1 + slope) / A_1
            else:
                gains = B_1 / (A_1 - slope) if name == "x" else B_1 / A_1 * (1 + slope / np.sum(P))
        i, j = sorted((int(np.argmin(gains)), int(np.argmax(gains))))
        numbers = {"level_1": at[i] + mean, "gain_1": gains[i]}
        numbers |= {"level_2": at[j] + mean, "gain_2": gains[j]}
        yield _Found(
            bic=bic,
            kind="gain by level",
            numbers={key: float(value) for key, value in numbers.items()},
            gain_of=name,
            levels=at + mean,
            gains=gains,
        )


def _thresholds(model: _LongModel) -> Iterator[_Found]:
    """Yield models with friction, with a saturated output, and with a dead zone of u."""
    u, x, y_0, (_, dx) = model.u + model.means[0], model.x, model.means[1], _changes(model)
    late = np.append(0.0, model.B[1:])  # y(t) itself must not explain y(t)
    y, largest = model.measured + y_0, float(np.max(np.abs(u)))
    yield _Found(bic=model.fitted(late, _sign(dx / (np.std(dx) or 1.0)))[0], kind="friction")
    for share, speed in product(_ZONES[::3], (y, dx)):
        # At rest, friction balances u up to a limit; in motion, it is at the limit.
        pull, limit = u + 4 * largest / (np.std(speed) or 1.0) * speed, share * largest
        bic, *_ = model.fitted(late, np.clip(pull, -limit, limit))
        yield _Found(bic=bic + log(model.y.size), kind="friction")
    for share in np.linspace(0.03, 0.45, 8):
        low, high = np.quantile(x[model.rows], (share, 1 - share))
        for a, b in ((-np.inf, high), (low, np.inf), (low, high)):
            bic, _, _, (c,) = model.fitted(model.A, x - np.clip(x, a, b))
            if c < _MAX_OUTSIDE:
                at = float(high if b == high else low) + y_0
                numbers = {"at": at, "share": float(share)}
                yield _Found(bic=bic + log(model.y.size), kind="saturation", numbers=numbers)
    low, high, found = float(u.min()), float(u.max()), []
    zones = [(low, low + share * (high - low)) for share in _ZONES]
    zones += [(-share * high, share * high) for share in _ZONES if low < 0 < high]
    for a, b in zones if np.unique(u).size >= _LEVELS_OF_A_ZONE else []:
        bic, _, B_1, (c,) = model.fitted(model.B, np.clip(u, a, b))
        inside = abs(1 + c * float(np.sum(model.B)) / (B_1 or 1.0))
        if inside < _MAX_INSIDE:
            found.append((bic, inside, float(a), float(b)))
    if found:  # between two levels of u, all thresholds leave the same errors
        same = [x for x in found if x[0] <= min(found)[0] + _SAME_BIC]
        bic, _, a, b = min(same, key=lambda x: x[1])
        yield _Found(bic=bic, kind="dead zone", numbers={"from": a, "to": b})
