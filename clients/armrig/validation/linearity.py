"""Test whether one linear model can describe the data, and the kind of a nonlinear rig."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise, product
from math import log, log10
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_data
from armrig.data.dataset import Dataset, Signals
from armrig.data.files.column_faults import rails_of
from armrig.estimation.data_faults import CONSTANT_INPUT
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.polynomial import Array, filtered, monic
from armrig.numerics.quantities import p_relation, percent, three_digits
from armrig.numerics.regressors import complete, past
from armrig.numerics.stretches import Mask
from armrig.numerics.whiteness import joint_p_value
from armrig.validation.feedback_and_delay.by_channel import ByChannel, each_channel
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
CHANCE_LEVEL = 1e-3
"""Level of findings without a test by name: 0.05 finds feedback in one of twenty recordings."""
_MAX_LAGS = 30
_ROWS_PER_PARAMETER = 4
_MAX_EFFECTS = 8  # combinations of effects that are tested jointly
_MIN_SIZE = 0.1  # least size of a tested combination of effects, relative to the largest
_MIN_OWN_SHARE = 1e-3  # least share of an effect that the linear model leaves unexplained
_ROBUST_LIMIT = 3.5  # robust standard deviations at which residuals are cut off
_MAX_LEFT = 0.5  # share of y's variance that a simulation may leave; else x is the prediction
_MAX_INSIDE = 0.35  # gain inside a dead zone, relative to the gain outside
_MAX_OUTSIDE = -0.5  # coefficient of a saturation: -1 if y stays at the limit
_ZONES = np.linspace(0.03, 0.75, 24)  # thresholds of a dead zone, as shares of the range of u
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
    kind: Kind = ""
    """Kind of the nonlinearity; "" if the rig is linear."""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """Numbers of the kind: `from` and `to` of a dead zone, or `at` and `share` of a saturation. For
    a gain: the least and the greatest, `gain_1` at `level_1` and `gain_2` at `level_2`."""
    rails: tuple[float, ...]
    """Largest or smallest values of y at which y stays exactly."""
    gain_of: str = ""
    """Name of the signal that determines the gain: the input, or the output; "" if linear."""
    levels: Array = field(default_factory=lambda: np.zeros(0))
    """Levels of `gain_of`, (n,); (0,) if the rig is linear."""
    gains: Array = field(default_factory=lambda: np.zeros(0))
    """Static gain at `levels`, in y's unit per u's unit."""
    remarks: tuple[str, ...]
    """Limits of the answer."""
    closed: bool
    """True if feedback or a direct term is found with p < 0.1 %, so that u(t) may contain e(t)."""
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

    @property
    def line(self) -> str:
        """Reason, p value and remedy in a line."""
        remedy = f"; {self.remedy}" if self.remedy else ""
        return f"{self.reason} (p {p_relation(self.p)}){remedy}"

    def explain(self) -> str:
        """Return the answer, its reason, the remedy and the limits of the answer."""
        null = f"Hypothesis: effects that are not linear in {self.input} do not explain the errors"
        answer = self.reason if self.linear else self.verdict
        lines = [f"{answer}.", f"{null} of a long linear model; p {p_relation(self.p)}."]
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
    return _tested(signals, level=level, input=signals.inputs[0])


@each_channel(lambda data, output, input: (data.channels([output]), {"input": input}))
def _tested(data: Signals, *, level: float, input: str) -> Linearity | ByChannel[Linearity]:
    """Test one output with one input."""
    one, loop = data.dataset(data.outputs[0], input), None
    with suppress(InputError):
        loop = open_loop(one)
    together = loop is not None and loop.p_value < CHANCE_LEVEL
    closed = loop is not None and together and not loop.few_levels
    direct = loop is not None and loop.may_be_direct_term
    # In closed loop, u(t) contains e(t).
    model = _long_model(data, input, first=int(closed and not direct))
    at, rails = rails_of(one.y) if one.valid.any() else (one.valid, [])
    p, found = _p_value(model), dict[str, Any]()
    if rails or p < level:
        gains = [*_gains(model)]
        found = min(gains, key=itemgetter(0))[1]
        found |= min([*gains, *_thresholds(model)], key=itemgetter(0))[1]
    if rails:
        numbers = {"at": rails[-1], "share": float(np.mean(at[one.valid]))}
        found |= {"kind": "saturation", "numbers": numbers}
    remarks = []
    if np.unique(model.u).size <= 2:
        text = f"{input} has two levels, which cannot show a dead zone or another static "
        text += f"nonlinearity of {input}: record with several levels (staircase, white noise)"
        remarks.append(text)
    if closed and direct:
        remarks.append(f"if a controller computed {input} from {one.output}, p is not valid")
    return Linearity(
        p=p,
        level=level,
        **found,
        rails=tuple(rails),
        remarks=tuple(remarks),
        closed=together,
        output=one.output,
        input=input,
        units={input: one.input_unit, one.output: one.unit},
        source=one.source,
    )


def in_open_loop(data: Dataset | Signals) -> list[Linearity]:
    """Test each channel at a level of 0.1 %; leave out feedback, and channels without a result."""
    try:
        found = linearity(data, CHANCE_LEVEL)
    except InputError:
        return []
    each = [found] if isinstance(found, Linearity) else found.results.values()
    return [one for one in each if not one.closed]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _LongModel:
    """Long linear model of one output; the experiments are joined, and the means removed."""

    base: Basis  # of the lags of y and of each input, and of a constant per experiment
    rows: Mask  # rows that are used: all lags are in the same experiment, and known
    A: Array  # coefficients 0 … p of A
    B: Array  # coefficients 0 … p of B of the tested input
    lags_of_u: slice  # coefficients of the tested input
    u: Array  # tested input
    x: Array  # course of y that u causes
    y: Array  # measured output; 0 where it is missing
    means: tuple[float, float]  # of u and of y
    names: tuple[str, str]  # of u and of y

    def effects(self, P: Array, *signals: Array) -> Array:
        """Return signals that are filtered by A or B, in the rows that are used."""
        return np.column_stack([filtered(P, [1.0], x)[self.rows] for x in signals])

    def fitted(self, P: Array, *signals: Array) -> tuple[float, float, float, Array]:
        """Return BIC, A(1) and B(1) of the model with effects, and the effects' coefficients."""
        effects, y = self.effects(P, *signals), self.y[self.rows]
        own = orthonormal(self.base.without(effects))
        c = own.coefficients(y)
        loss = float(np.sum(own.without(self.base.without(y)) ** 2))
        theta = self.base.coefficients(y - effects @ c)
        A_1, B_1 = 1 + np.sum(theta[: self.A.size - 1]), np.sum(theta[self.lags_of_u])
        bic = y.size * log(max(loss, 1e-300)) + len(signals) * log(y.size)
        return bic, float(A_1), float(B_1), c


def _long_model(data: Signals, input: str, first: int) -> _LongModel:
    """Return the long model with lags `first` … p of u; p depends on the number of samples."""
    j, nu, N = data.inputs.index(input), data.nu, int(np.count_nonzero(data.valid))
    if all(np.ptp(part.u[:, j]) == 0 for part in data.experiments()):
        raise InputError(CONSTANT_INPUT)
    p = min(round(15 * log10(max(N, 2))), _MAX_LAGS, N // (_ROWS_PER_PARAMETER * (1 + nu)) - 2)
    if p < 2:
        needed = 4 * _ROWS_PER_PARAMETER * (1 + nu)
        raise InputError(f"the test of linearity needs at least {needed} samples, got {N}")
    means = data.u.mean(axis=0), np.nanmean(data.y)
    u, y = data.u - means[0], data.y[:, 0] - means[1]
    lags, n, k = range(first, p + 1), p + 1 - first, np.arange(y.size)
    block = np.hstack([-past(y, range(1, p + 1)), *(past(v, lags) for v in u.T)])
    number = np.searchsorted(data.starts, k, side="right")
    rows = complete(block, y) & (k >= np.asarray(data.starts)[number - 1] + p)
    if np.count_nonzero(rows) < 2 * block.shape[1]:
        raise InputError(f"too few samples of {data.outputs[0]} have {p} known predecessors")
    constants = (number[:, None] == np.unique(number[rows])).astype(np.float64)
    Phi = np.hstack([block, constants])[rows]
    base = orthonormal(Phi)
    theta = base.coefficients(y[rows])
    A = monic(theta[:p])
    B = np.pad(theta[p : p + nu * n].reshape(nu, n), ((0, 0), (first, 0)))
    bounds = pairwise((*data.starts, y.size))
    x = np.concatenate([_simulated(A, B, u[a:b], y[a:b]) for a, b in bounds])
    with np.errstate(over="ignore", invalid="ignore"):
        left = np.var((x - y)[rows])
    if not left < _MAX_LEFT * np.var(y[rows]):
        x = np.where(rows, 0.0, np.nan_to_num(y))
        x[rows] = Phi @ theta
    return _LongModel(
        base=base,
        rows=rows,
        A=A,
        B=B[j],
        lags_of_u=slice(p + j * n, p + (j + 1) * n),
        u=u[:, j],
        x=x,
        y=np.nan_to_num(y),
        means=(float(means[0][j]), float(means[1])),
        names=(input, data.outputs[0]),
    )


def _simulated(A: Array, B: Array, u: Array, y: Array) -> Array:
    """Return the course of A x = sum of B_k u_k, which begins with the first values of y."""
    from scipy.signal import lfilter, lfiltic

    first = np.nan_to_num(y[: A.size - 1])
    drive = np.sum([filtered(b, [1.0], v) for b, v in zip(B, u.T, strict=True)], axis=0)
    with np.errstate(over="ignore", invalid="ignore"):  # the model may be unstable
        rest, _ = lfilter([1.0], A, drive[first.size :], zi=lfiltic([1.0], A, first[::-1]))
    return np.asarray(np.nan_to_num(np.concatenate([first, rest]), posinf=0.0, neginf=0.0))


def _p_value(model: _LongModel) -> float:
    """Return the p value of the joint test of all effects."""
    changes = (np.diff(v, prepend=v[0]) for v in (model.u, model.x))
    u, x, du, dx = (s / (np.std(s) or 1.0) for s in (model.u, model.x, *changes))
    of_x, of_dx = (x**2, x**3), (_sign(dx), dx * np.abs(dx), x * dx)
    of_u = model.effects(model.B, u**2, u**3, np.abs(du), *of_x, x * u, *of_dx)
    raw = np.hstack([of_u, model.effects(model.A, *of_x)])
    own, e = model.base.without(raw), model.base.without(model.y[model.rows])
    size, N = np.linalg.norm(own, axis=0), e.size
    used = size > _MIN_OWN_SHARE * np.linalg.norm(raw - raw.mean(axis=0), axis=0)
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


def _sign(v: Array) -> Array:
    """Return the sign of v, which is smooth near 0; v has the standard deviation 1."""
    return np.asarray(v / np.sqrt(v**2 + 0.25))


def _gains(model: _LongModel) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yield BIC and gain of models with u² and u³ or x² and x³, which act like u or add to y."""
    for name, P in (("u", model.B), ("x", model.B), ("y", model.A)):
        if name == "u" and np.unique(model.u).size <= 2:
            continue
        signal = model.u if name == "u" else model.x
        at, mean = np.quantile(signal[model.rows], _LEVELS), model.means[name != "u"]
        bic, A_1, B_1, (a, b) = model.fitted(P, signal**2, signal**3)
        slope = (2 * a * at + 3 * b * at**2) * np.sum(P)
        with np.errstate(divide="ignore", invalid="ignore"):
            if name == "u":
                gains = (B_1 + slope) / A_1
            else:
                gains = B_1 / (A_1 - slope) if name == "x" else B_1 / A_1 * (1 + slope / np.sum(P))
        numbers = dict[str, float]()
        for i, k in enumerate(sorted((int(np.argmin(gains)), int(np.argmax(gains)))), 1):
            numbers |= {f"level_{i}": float(at[k] + mean), f"gain_{i}": float(gains[k])}
        found = {"kind": "gain by level", "numbers": numbers, "gain_of": model.names[name != "u"]}
        yield bic, found | {"levels": at + mean, "gains": gains}


def _thresholds(model: _LongModel) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yield BIC and numbers of models with friction, a saturated output, or a dead zone of u."""
    zones = []
    for kind, P, effect, cost, numbers in _effects_of_thresholds(model):
        bic, _, B_1, (c,) = model.fitted(P, effect)
        found = (bic + cost, {"kind": kind, "numbers": numbers})
        inside = abs(1 + c * float(np.sum(P)) / (B_1 or 1.0))
        if kind == "friction" or (kind == "saturation" and c < _MAX_OUTSIDE):
            yield found
        elif kind != "saturation" and inside < _MAX_INSIDE:
            zones.append((*found, inside))
    if zones:  # between two levels of u, all thresholds leave the same errors
        same = min(zones, key=itemgetter(0))[0] + _SAME_BIC
        yield min((zone for zone in zones if zone[0] <= same), key=itemgetter(2))[:2]


def _effects_of_thresholds(
    model: _LongModel,
) -> Iterator[tuple[Kind, Array, Array, float, dict[str, float]]]:
    """Yield kind, filter, effect, BIC of the threshold, and numbers."""
    u, x, y_0, dx = (
        model.u + model.means[0],
        model.x,
        model.means[1],
        np.diff(model.x, prepend=model.x[0]),
    )
    late = np.append(0.0, model.B[1:])  # y(t) itself must not explain y(t)
    largest, cost = float(np.max(np.abs(u))), log(np.count_nonzero(model.rows))
    yield "friction", late, _sign(dx / (np.std(dx) or 1.0)), 0.0, {}
    for share, speed in product(_ZONES[::3], (model.y + y_0, dx)):
        # At rest, friction balances u up to a limit; in motion, it is at the limit.
        pull, limit = u + 4 * largest / (np.std(speed) or 1.0) * speed, share * largest
        yield "friction", late, np.clip(pull, -limit, limit), cost, {}
    for share in np.linspace(0.03, 0.45, 8):
        low, high = np.quantile(x[model.rows], (share, 1 - share))
        for a, b in ((-np.inf, high), (low, np.inf), (low, high)):
            numbers = {"at": float(high if b == high else low) + y_0, "share": float(share)}
            yield "saturation", model.A, x - np.clip(x, a, b), cost, numbers
    low, high = float(u.min()), float(u.max())
    zones = [(low, low + share * (high - low)) for share in _ZONES]
    zones += [(-share * high, share * high) for share in _ZONES if low < 0 < high]
    for a, b in zones if np.unique(u).size >= _LEVELS_OF_A_ZONE else []:
        yield "dead zone", model.B, np.clip(u, a, b), 0.0, {"from": float(a), "to": float(b)}
