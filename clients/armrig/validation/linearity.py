"""Test whether one linear model can describe the data, and the kind of a nonlinear rig."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import product
from math import log
from operator import itemgetter
from typing import Any, Literal

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_data
from armrig.data.dataset import Dataset, Signals
from armrig.data.files.column_faults import rails_of
from armrig.data.treatment import hampel
from armrig.data.treatment.integrating import pole_test
from armrig.estimation.data_faults import CONSTANT_INPUT, looking_wrong, require_moving_output
from armrig.estimation.orders import require_samples
from armrig.numerics.polynomial import Array, continued, filtered
from armrig.numerics.quantities import digits, p_relation, percent
from armrig.numerics.regressors import LongArx, long_arx
from armrig.numerics.rounding import rounding_std, without_rounding
from armrig.numerics.whiteness import effects_p_value
from armrig.plots.layout import drawn_by
from armrig.validation.feedback_and_delay.by_channel import ByChannel, each_channel
from armrig.validation.feedback_and_delay.open_loop import (
    CHANCE_LEVEL,
    EXACT,
    OpenLoop,
    open_loop,
    require_level,
)

Kind = Literal["", "dead zone", "saturation", "gain by level", "friction"]

_REASONS: Mapping[Kind, str] = {
    "": "no nonlinearity found",
    "dead zone": "a dead zone of {input} from {from} to {to}{unit}",
    "saturation": "{output} saturates at {at} in {share} of the samples",
    "gain by level": (
        "a gain of about {gain_1} at {of} = {level_1}{unit}, {gain_2} at {of} = {level_2}{unit}"
    ),
    "friction": "friction, {output} stops at rest",
}
_REMEDIES: Mapping[Kind, str] = {
    "dead zone": "leave out the samples below the dead zone, or record with u above it",
    "saturation": "mark the samples at the limit missing, or record with a smaller u",
    "gain by level": "record small steps around one level, and estimate a model for each level",
    "friction": "record with a u that keeps the rig moving, or estimate the friction (greybox)",
}
_NO_STATIC_GAIN = "{output} integrates, with a response that changes with {of}"
_MIN_LAGS, _MAX_LAGS = 30, 100  # 30 lags leave effects of a slow pole, which look nonlinear
_MIN_ROWS_PER_PARAMETER = 4  # with fewer than 30 lags
_ROWS_PER_PARAMETER = 10  # with more lags: the test then loses a tenth of the rows
_MAX_SIZE = 4_000_000  # numbers in the regressors of more than 30 lags
_MAX_EFFECTS = 8  # combinations of effects that are tested jointly
_MIN_OWN_SHARE = 1e-3  # least share of an effect that the linear model leaves unexplained
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
    """Dead zone of u, saturated output, friction, or a gain by level; "" if the rig is linear."""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """Numbers of the kind: `from` and `to` of a dead zone, or `at` and `share` of a saturation. For
    a gain: the least and the greatest, `gain_1` at `level_1` and `gain_2` at `level_2`; empty if
    y integrates."""
    rails: tuple[float, ...]
    """Largest or smallest values of y at which y stays exactly."""
    gain_of: str = ""
    """Name of the signal that determines the gain: the input, or the output; "" if linear."""
    levels: Array = field(default_factory=lambda: np.zeros(0))
    """Levels of `gain_of`, (n,); (0,) if the rig is linear or integrates."""
    gains: Array = field(default_factory=lambda: np.zeros(0))
    """Static gain at `levels`, in y's unit per u's unit: the slope of a cubic, which may be wrong
    by half at the lowest and the highest level."""
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

    @property
    def linear(self) -> bool:
        """True if the test does not reject, and y reaches no limit."""
        return not self.kind

    @property
    def remedy(self) -> str:
        """Remedy for the nonlinearity; "" if the rig is linear."""
        return _REMEDIES.get(self.kind, "")

    @property
    def reason(self) -> str:
        """The kind with its numbers, in a few words."""
        x = {name: digits(value, 3) for name, value in self.numbers.items()}
        if self.kind == "saturation":
            at = " and ".join(digits(rail, 3) for rail in self.rails) or f"about {x['at']}"
            x |= {"at": at, "share": percent(100 * self.numbers["share"])}
        unit = self.units.get(self.input if "from" in x else self.gain_of)
        text = _REASONS[self.kind] if x or self.kind != "gain by level" else _NO_STATIC_GAIN
        x |= {"input": self.input, "output": self.output, "of": self.gain_of}
        return text.format(**x, unit=f" {unit}" if unit else "")

    @property
    def line(self) -> str:
        """Verdict, reason, p value and remedy in a line."""
        text = f"{self.reason} (p {p_relation(self.p)})"
        if self.linear:
            return text
        unless = f", unless a controller computed {self.input} from {self.output}"
        return f"NONLINEAR{unless if self.closed else ''}: {text}; {self.remedy}"

    def explain(self) -> str:
        """Return the answer, the tested hypothesis, and the limits of the answer."""
        null = f"Hypothesis: effects that are not linear in {self.input} do not explain the errors"
        return f"{self!r}\n{null} of a long linear model. Level: {100 * self.level:g} %."

    plot = drawn_by("plot_linearity", "the gain by level")

    def __repr__(self) -> str:
        """Return the answer in a line, and the remarks."""
        return "\n".join([self.line, *(f"  note: {remark}" for remark in self.remarks)])


@takes_data
@each_channel(  # the tested input is the first
    lambda data, y, u: (data.channels([y], sorted(data.inputs, key=lambda name: name != u)), {})
)
def linearity(data: Dataset | Signals, level: float = 0.05) -> Linearity | ByChannel[Linearity]:
    """Test whether one linear model can describe the data, and find the kind of nonlinearity.

    A long linear model whitens the errors ::

        A(q) y(t) = c + B(q) u(t) + e(t),     x = B/A u

    The model has 30 to 100 lags. If the rig is linear, e is not correlated with nonlinear effects,
    filtered by A or B. The effects are squares and cubes of u and x, their product, ``|Δu|``, and
    the sign and the square of Δx. A joint test gives `p`. If x does not follow y, the prediction of
    y replaces x. If the test rejects, the kind with the least BIC is reported. An output is also
    saturated if it stays at exactly its largest or smallest value. Of 200 000 samples or more,
    evenly spaced blocks are tested.

    Parameters
    ----------
    data : Dataset or Signals
        Data with an exciting input. An input of two levels cannot show a static nonlinearity of u.
        For Signals with several channels, each pair of an output and an input is tested, with all
        inputs in the linear model.
    level : float, default 0.05
        Level of the test, between 0 and 1.

    Returns
    -------
    Linearity
        .linear, .p, .kind, .numbers, .remedy, .explain(), .plot(). For Signals with several
        channels, the result is `ByChannel`: `found["y", "u"]` is the result of one channel.

    Raises
    ------
    ValueError
        level is outside 0 to 1, u or y is constant, u follows from y of the same sample, or there
        are too few samples.

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
    return _judged(data.signals(), level, None)


def _judged(data: Signals, level: float, loop: OpenLoop | None) -> Linearity:
    """Test one output; `loop` is the result of the test for feedback, if it is known."""
    require_moving_output(data)
    (y,), u, together, closed, direct = data.outputs, data.inputs[0], False, False, False
    exact, one = False, data.dataset(y, u)
    with suppress(InputError):
        loop = loop or open_loop(one)
        exact = loop.exact
        together, direct = loop.p_value < CHANCE_LEVEL, loop.may_be_direct_term
        closed = together and not loop.few_levels
    if exact:
        raise InputError(EXACT)
    # In closed loop, u(t) contains e(t).
    model = _long_model(data, first=int(closed and not direct))
    p, (at, rails) = _p_value(model), rails_of(one.y)
    if not model.has_errors:  # a linear rig that settles stays at its last value, too
        rails = []
    found: dict[str, Any] = {}
    if rails or p < level:
        gains = [*_gains(model)]
        best = min([*gains, *_thresholds(model)], key=itemgetter(0))  # of the least BIC
        found = min(gains, key=itemgetter(0))[1] | best[1]
        found["gain_of"] = u if found["gain_of"] == "u" else y
        slow = pole_test(data, 0)
        if slow is not None and slow.possible:  # a pole that may be 1 leaves no static gain
            numbers = {} if found["kind"] == "gain by level" else found["numbers"]
            found |= {"numbers": numbers, "levels": np.zeros(0), "gains": np.zeros(0)}
    if rails:
        numbers = {"at": rails[-1], "share": float(np.mean(at[one.valid]))}
        found |= {"kind": "saturation", "numbers": numbers}
    remarks = []
    if np.unique(model.u).size <= 2:
        text = f"{u} has two levels, which cannot show a dead zone or another static nonlinearity "
        remarks.append(f"{text}of {u}: record with several levels (staircase, white noise)")
    if closed and direct:
        remarks.append(f"if a controller computed {u} from {y}, p is not valid")
    return Linearity(
        p=p,
        level=level,
        **found,
        rails=tuple(rails),
        remarks=tuple(remarks),
        closed=together,
        output=y,
        input=u,
        units={u: one.input_unit, y: one.unit},
    )


def in_open_loop(data: Dataset | Signals, loop: OpenLoop | None = None) -> list[Linearity]:
    """Test each channel at a level of 0.1 %; leave out feedback, and channels without a result.

    `loop` is the result of the test for feedback in data of one channel, if it is known. A single
    wrong sample is no nonlinearity: one output is tested again without its wrong samples.
    """
    try:
        judged = _judged(data.signals(), CHANCE_LEVEL, loop) if loop else None
        found = judged or linearity(data, CHANCE_LEVEL)
        if isinstance(found, Linearity) and not found.linear and looking_wrong(data.signals())[0]:
            found = linearity(hampel(data), CHANCE_LEVEL)
    except InputError:
        return []
    each = [found] if isinstance(found, Linearity) else found.results.values()
    return [one for one in each if not one.closed]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _LongModel:
    """Long linear model of one output, with its signals minus their means."""

    arx: LongArx
    A: Array
    B: Array  # of the tested input
    u: Array  # tested input
    x: Array  # course of y that u causes
    y: Array  # measured output; 0 where it is missing
    means: Mapping[str, float]  # of u, x and y
    rounding: float  # standard deviation of rounding errors of y

    @property
    def has_errors(self) -> bool:
        """True if the model leaves more than rounding errors."""
        return bool(without_rounding([self.arx.errors(self.y)], self.rounding)[0].any())

    def fitted(self, P: Array, *signals: Array) -> tuple[float, float, float, Array]:
        """Return BIC, A(1) and B(1) of the model with effects P(q) signals, and their factors."""
        return self.arx.extended(self.y, filtered(P, [1.0], np.array(signals)).T)


def _long_model(data: Signals, first: int) -> _LongModel:
    """Return the long model with lags `first` … p of u; p depends on the number of samples."""
    nu, N = data.nu, int(np.count_nonzero(data.valid))
    if all(np.ptp(part.u[:, 0]) == 0 for part in data.experiments()):
        raise InputError(CONSTANT_INPUT)
    affordable = min(N // _ROWS_PER_PARAMETER, _MAX_SIZE // max(N, 1)) // (1 + nu)
    most = N // (_MIN_ROWS_PER_PARAMETER * (1 + nu)) - 2
    p = min(max(_MIN_LAGS, min(affordable, _MAX_LAGS)), most)
    require_samples("the test of linearity", needed=4 * _MIN_ROWS_PER_PARAMETER * (1 + nu), got=N)
    mean, y_0 = data.u.mean(axis=0), float(np.nanmean(data.y))
    parts = [(part.u - mean, part.y[:, 0] - y_0) for part in data.experiments()]
    arx = long_arx(parts, p, first)
    if np.count_nonzero(arx.rows) < 2 * (p + nu * (p + 1 - first)):
        raise InputError(f"too few samples of {data.outputs[0]} have {p} known predecessors")
    y = data.y[:, 0] - y_0
    A, B = arx.polynomials(y)
    x = np.concatenate([continued(A, B, *part) for part in parts])
    with np.errstate(over="ignore", invalid="ignore"):
        left = np.var((x - y)[arx.rows])
    if not left < _MAX_LEFT * np.var(y[arx.rows]):
        x = np.nan_to_num(y)
        x[arx.rows] -= arx.errors(y)
    u, means = data.u[:, 0] - mean[0], {"u": float(mean[0]), "x": y_0, "y": y_0}
    return _LongModel(
        arx=arx,
        A=A,
        B=B[0],
        u=u,
        x=x,
        y=np.nan_to_num(y),
        means=means,
        rounding=rounding_std(data.y),
    )


def _p_value(model: _LongModel) -> float:
    """Return the p value of the joint test of all effects."""
    changes = (np.diff(v, prepend=v[0]) for v in (model.u, model.x))
    u, x, du, dx = (s / (np.std(s) or 1.0) for s in (model.u, model.x, *changes))
    of_x, of_dx = np.array([x**2, x**3]), (_sign(dx), dx * np.abs(dx), x * dx)
    like_u = np.array([u**2, u**3, np.abs(du), *of_x, x * u, *of_dx])
    effects = np.vstack([filtered(model.B, [1.0], like_u), filtered(model.A, [1.0], of_x)]).T
    own, e = model.arx.errors(effects), model.arx.errors(model.y)
    if not model.has_errors:
        return 1.0
    moving = np.std(effects[model.arx.rows], axis=0) * np.sqrt(e.size)
    used = np.linalg.norm(own, axis=0) > _MIN_OWN_SHARE * moving
    # The transients of few changes of u do not determine many effects.
    switches = int(np.count_nonzero(np.diff(model.u)))
    most = max(2, min(e.size // 40, switches // 3, _MAX_EFFECTS))
    return effects_p_value(e, own[:, used], most, e.size - model.arx.base.rank)


def _sign(v: Array) -> Array:
    """Return the sign of v, which is smooth near 0; v has the standard deviation 1."""
    return np.asarray(v / np.sqrt(v**2 + 0.25))


def _gains(model: _LongModel) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yield BIC and gain of models with u² and u³ or x² and x³, which act like u or add to y."""
    cases = [("u", model.B, model.u), ("x", model.B, model.x), ("y", model.A, model.x)]
    for name, P, signal in cases[np.unique(model.u).size <= 2 :]:
        at = np.quantile(signal[model.arx.rows], _LEVELS)
        bic, A_1, B_1, (a, b) = model.fitted(P, signal**2, signal**3)
        rate = 2 * a * at + 3 * b * at**2
        slope = rate * np.sum(P)
        with np.errstate(divide="ignore", invalid="ignore"):
            added = B_1 / A_1 * (1 + rate)
            gains = {"u": (B_1 + slope) / A_1, "x": B_1 / (A_1 - slope), "y": added}[name]
        levels, numbers = at + model.means[name], dict[str, float]()
        for i, k in enumerate(sorted((int(np.argmin(gains)), int(np.argmax(gains)))), 1):
            numbers |= {f"level_{i}": float(levels[k]), f"gain_{i}": float(gains[k])}
        of = {"numbers": numbers, "gain_of": name, "levels": levels, "gains": gains}
        yield bic, {"kind": "gain by level"} | of


def _thresholds(model: _LongModel) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yield BIC and numbers of models with friction, a saturated output, or a dead zone of u."""
    x, y_0 = model.x, model.means["y"]
    u, dx = model.u + model.means["u"], np.diff(x, prepend=x[0])
    late = np.append(0.0, model.B[1:])  # y(t) itself must not explain y(t)
    largest, cost = float(np.max(np.abs(u))), log(np.count_nonzero(model.arx.rows))
    friction = {"kind": "friction", "numbers": {}}
    yield model.fitted(late, _sign(dx / (np.std(dx) or 1.0)))[0], friction
    for share, speed in product(_ZONES[::3], (model.y + y_0, dx)):
        # At rest, friction balances u up to a limit; in motion, it is at the limit.
        pull, limit = u + 4 * largest / (np.std(speed) or 1.0) * speed, share * largest
        yield model.fitted(late, np.clip(pull, -limit, limit))[0] + cost, friction
    for share in np.linspace(0.03, 0.45, 8):
        low, high = np.quantile(x[model.arx.rows], (share, 1 - share))
        for a, b in ((-np.inf, high), (low, np.inf), (low, high)):
            bic, _, _, (c,) = model.fitted(model.A, x - np.clip(x, a, b))
            numbers = {"at": float(high if b == high else low) + y_0, "share": float(share)}
            if c < _MAX_OUTSIDE:
                yield bic + cost, {"kind": "saturation", "numbers": numbers}
    least, most, zones = float(u.min()), float(u.max()), []
    ends = [(least, least + share * (most - least)) for share in _ZONES]
    ends += [(-share * most, share * most) for share in _ZONES if least < 0 < most]
    for a, b in ends if np.unique(u).size >= _LEVELS_OF_A_ZONE else []:
        bic, _, B_1, (c,) = model.fitted(model.B, np.clip(u, a, b))
        inside = abs(1 + c * float(np.sum(model.B)) / (B_1 or 1.0))
        if inside < _MAX_INSIDE:
            zones.append((bic, inside, {"from": float(a), "to": float(b)}))
    # Between two levels of u, all thresholds leave the same errors.
    same = min((bic for bic, *_ in zones), default=0.0) + _SAME_BIC
    for bic, _, numbers in sorted((z for z in zones if z[0] <= same), key=itemgetter(1))[:1]:
        yield bic, {"kind": "dead zone", "numbers": numbers}
