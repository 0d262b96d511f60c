"""Effects that a long linear model lacks, and the kind of nonlinearity that explains most."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from math import log
from typing import Literal

import numpy as np

from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array, apply_filter, continue_output
from armrig.numerics.regressors import LongArx
from armrig.numerics.rounding import without_rounding

Kind = Literal[
    "", "not known", "dead zone", "saturation", "gain by level", "speed by level", "friction",
    "backlash",
]  # fmt: skip
Way = Literal["u", "past u", "y"]
_PLAYS = np.geomspace(0.03, 1.2, 15)  # half widths, in standard deviations
_ROUNDS = 3  # simulations with an effect, from each of which the linear part is estimated again
_REFINED: Mapping[Kind, int] = {"gain by level": 3, "speed by level": 8}
_MOST_REFINED = 2  # effects of another kind that are refined
_MIN_LEAD = 0.05  # least lead of the kind over the second kind, as a share of its fall of BIC
_MIN_FALL = 8.0  # least fall of BIC, and least lead
_MAX_GROWTH = 10.0  # largest simulated value, relative to the largest measured value
_ZONES = np.linspace(0.03, 0.75, 24)  # thresholds of a dead zone, as shares of the range of u
_MIN_HELD = 0.05  # least share of the samples inside a dead zone, and outside
_LEVELS_OF_A_ZONE = 4  # least number of levels of u that distinguish a dead zone
_SAME_BIC = 1.0  # difference of BIC that does not distinguish two thresholds
_FRICTION = np.array([0.03, 0.06, 0.1, 0.15, 0.2, 0.27, 0.35, 0.45, 0.6])  # of the largest u
_SLOPES = (1, 2, 4, 8, 16)  # of the friction against the speed, which noise must not hide
_PARTS = 5  # intervals of a level, each with a gain
_MAX_GAIN_STD = 0.1  # of the gain
_MAX_GAIN_RATIO = 4.0  # of the gain to that of the linear model, and its inverse
_MIN_GAIN_CHANGE = 0.1  # least difference of two gains, as a share of the larger
_COEFFICIENTS: Mapping[Kind, tuple[float, float]] = {
    # 1 + c is the share of u that acts in the zone, or of x beyond the limit.
    "dead zone": (-1.35, -0.65),
    "saturation": (-1.5, -0.5),
    "friction": (-1.5, -0.5),
    "backlash": (0.5, 2.0),
}
"""Least and greatest coefficient of an effect that is what its kind says."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LongModel:
    """Long linear model of one output, with its signals minus their means."""

    arx: LongArx
    A: Array
    B: Array  # of each input; the tested input is the first
    U: Array  # inputs (N, nu)
    x: Array  # course of y that the inputs cause
    y: Array  # measured output; 0 where it is missing
    means: Mapping[str, float]  # of u and y
    parts: Sequence[slice]  # samples of each experiment
    rounding: float  # standard deviation of rounding errors of y

    @property
    def u(self) -> Array:
        """Tested input."""
        return self.U[:, 0]

    @property
    def has_errors(self) -> bool:
        """True if the model leaves more than rounding errors."""
        return bool(without_rounding([self.arx.errors(self.y)], self.rounding)[0].any())

    def course(self, A: Array, B: Array, U: Array) -> Array:
        """Return the course of A x = sum of B_j u_j that begins like y in each experiment."""
        return np.concatenate([continue_output(A, B, U[part], self.y[part]) for part in self.parts])

    def prediction(self) -> Array:
        """Return y one step ahead, and x where y or its past is missing."""
        p = self.x.copy()
        p[self.arx.rows] = self.y[self.arx.rows] - self.arx.errors(self.y)
        return p


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Effect:
    """Signals that act like u, like the past u, or that are added to y."""

    kind: Kind
    acts: Way
    signals: Callable[[LongModel], Sequence[Array]]
    of: str = "x"  # u, x, p (the prediction), or the rate of x
    numbers: Mapping[str, float] = field(default_factory=dict)
    thresholds: int = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _EffectModel:
    """A model with an effect."""

    effect: _Effect
    model: LongModel
    fall: float  # of BIC
    c: Array
    terms: Array  # of A y, (N, k)

    @property
    def holds(self) -> bool:
        """True if the effect is what its kind says."""
        least, most = _COEFFICIENTS.get(self.effect.kind, (-np.inf, np.inf))
        return self.c.size > 1 or least < float(self.c[0]) < most

    @property
    def may_hold(self) -> bool:
        """True if the effect at least has the direction of its kind."""
        least, most = _COEFFICIENTS.get(self.effect.kind, (0.0, 0.0))
        return self.c.size > 1 or (least + most) * float(self.c[0]) > 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Nonlinearity:
    """Kind of a nonlinearity, with its numbers; see `armrig.validation.linearity.Linearity`."""

    kind: Kind
    numbers: Mapping[str, float] = field(default_factory=dict)
    by: str = "y"
    """Signal that determines the kind: u, y, or the rate of y."""
    levels: Array = field(default_factory=lambda: np.zeros(0))
    gains: Array = field(default_factory=lambda: np.zeros(0))


def sign(v: Array) -> Array:
    """Return the sign of v, which is smooth near 0; v has the standard deviation 1."""
    return np.asarray(v / np.sqrt(v**2 + 0.25))


def deviation(v: Array) -> float:
    """Return the standard deviation of v, or 1 for a constant v."""
    return float(np.std(v)) or 1.0


def with_play(x: Array, half: float) -> Array:
    """Return what follows x (N,) with a play of the half width to both sides."""
    at, y = float(x[0]), []
    for low, high in zip((x - half).tolist(), (x + half).tolist(), strict=True):
        at = low if at < low else min(at, high)
        y.append(at)
    return np.array(y)


def nonlinearity(model: LongModel) -> Nonlinearity:
    """Return the kind whose effects lower BIC most, and "not known" without a clear lead.

    Each effect is first fitted with x of the linear model. The best effects of each kind are then
    refined: x is simulated with the effect, and A and B are estimated with it.
    """
    every: dict[Kind, list[_EffectModel]] = {}
    for effect in _effects(model):
        every.setdefault(effect.kind, []).append(_with_effect(model, effect))
    refined: list[_EffectModel] = []
    for kind, fits in every.items():
        fits.sort(key=_fall)
        refined += [_refine(fit) for fit in fits[-_REFINED.get(kind, _MOST_REFINED) :]]
    first = max(refined, key=lambda fit: (fit.holds, fit.fall))
    others = [fit for fit in refined if fit.effect.kind != first.effect.kind]
    lead = first.fall - max((fit.fall for fit in others if fit.holds), default=0.0)
    clear = lead > max(_MIN_FALL, _MIN_LEAD * first.fall) and first.fall > _MIN_FALL
    if not first.holds or not clear or any(fit.fall > first.fall for fit in others if fit.may_hold):
        return Nonlinearity(kind="not known")
    if first.effect.kind == "gain by level":
        return _gains(first)
    return Nonlinearity(kind=first.effect.kind, numbers=first.effect.numbers, by=first.effect.of)


def _fall(fit: _EffectModel) -> float:
    return fit.fall


def _gains(fit: _EffectModel) -> Nonlinearity:
    """Return the gain in intervals of the level, where it is determined; else "not known".

    The effect is piecewise linear, because the slope of a cubic is wrong at both ends.
    """
    effect = replace(fit.effect, signals=partial(_bends, fit.effect.of))
    bent = _refine(_with_effect(fit.model, effect))
    model, rows = bent.model, bent.model.arx.rows
    s, bends, e = _signal(model, effect.of), effect.signals(model), model.arx.errors(model.y)
    basis = orthonormal(model.arx.errors(bent.terms))
    variance = float(np.sum(basis.without(e) ** 2)) / max(e.size - basis.rank, 1)
    sums = np.tri(_PARTS, _PARTS - 1, -1)
    rate, std = sums @ bent.c, np.sqrt(variance * np.sum((sums @ basis.W) ** 2, axis=1))
    A, B = model.arx.polynomials(model.y - bent.terms @ bent.c)
    linear = float(np.sum(model.B[0])) / float(np.sum(model.A))
    gain, share = (float(np.sum(P)) / float(np.sum(A)) for P in (B[0], _path(model, effect.acts)))
    with np.errstate(divide="ignore", invalid="ignore"):
        if effect.of == "u" or effect.acts == "y":
            share *= linear if effect.acts == "y" else 1.0
            gains = gain + share * rate
            relative = np.abs(share * std / gains)
        else:  # x acts like u
            gains, relative = gain / (1 - share * rate), np.abs(share * std / (1 - share * rate))
        near = np.abs(np.log(gains / linear)) < log(_MAX_GAIN_RATIO)
    near &= relative < _MAX_GAIN_STD
    level = s + bent.c @ np.array(bends) if effect.acts == "y" else s
    part = np.count_nonzero(np.array(bends)[:, rows] > 0, axis=0)
    name = "u" if effect.of == "u" else "y"
    if name == "y":  # the constant of the model contains the mean of the effect
        level = level + np.mean((model.y - level)[rows])
    counts = np.bincount(part, minlength=_PARTS)[:_PARTS]
    near &= counts > 0  # many equal levels leave a part empty
    totals = np.bincount(part, level[rows], minlength=_PARTS)[:_PARTS]
    levels = totals / np.maximum(counts, 1) + model.means[name]
    levels, gains = levels[near], gains[near]
    numbers: dict[str, float] = {}
    if gains.size > 1:
        least, most = float(gains.min()), float(gains.max())
        if abs(most - least) < _MIN_GAIN_CHANGE * max(abs(least), abs(most)):
            return Nonlinearity(kind="not known")
        for i, k in enumerate(sorted((int(np.argmin(gains)), int(np.argmax(gains)))), 1):
            numbers |= {f"level_{i}": float(levels[k]), f"gain_{i}": float(gains[k])}
    else:
        levels = gains = np.zeros(0)
    return Nonlinearity(kind="gain by level", numbers=numbers, by=name, levels=levels, gains=gains)


def _effects(model: LongModel) -> Iterator[_Effect]:
    """Yield the effects of each kind."""
    u, levels = model.u, np.unique(model.u).size
    if levels > 2:
        squares = partial(_powers, "u")
        yield _Effect(kind="gain by level", acts="u", signals=squares, of="u", thresholds=0)
        for half in (_PLAYS * deviation(u)).tolist():
            numbers, moved = {"width": 2 * half}, partial(_difference, with_play(u, half))
            yield _Effect(kind="backlash", acts="u", signals=moved, of="u", numbers=numbers)
    yield from _dead_zones(model) if levels >= _LEVELS_OF_A_ZONE else ()
    ways: tuple[tuple[Way, str], ...] = (("u", "x"), ("past u", "p"), ("y", "x"))
    for acts, name in ways:
        squares = partial(_powers, name)
        yield _Effect(kind="gain by level", acts=acts, signals=squares, of=name, thresholds=0)
    for half in _PLAYS.tolist():
        numbers, lost = {"width": 2 * half * deviation(model.x)}, partial(_play_of_x, half)
        yield _Effect(kind="backlash", acts="y", signals=lost, numbers=numbers)
    for share in np.linspace(0.03, 0.45, 8).tolist():
        low, high = np.quantile(model.x[model.arx.rows], (share, 1 - share)).tolist()
        for a, b in ((-np.inf, high), (low, np.inf), (low, high)):
            at = (high if b == high else low) + model.means["y"]
            numbers, beyond = {"at": at, "share": share}, partial(_beyond, a, b)
            yield _Effect(kind="saturation", acts="y", signals=beyond, numbers=numbers)
    for name, terms, rate in product("xp", (2, 3), (False, True)):
        speed = partial(_speeds_by_rate if rate else _speeds, name, terms)
        name = "rate" if rate else name
        yield _Effect(kind="speed by level", acts="past u", signals=speed, of=name, thresholds=0)
    for share, slope, of_rate in product(_FRICTION.tolist(), _SLOPES, (False, True)):
        brake = partial(_friction, share, slope, of_rate)
        yield _Effect(kind="friction", acts="past u", signals=brake)


def _dead_zones(model: LongModel) -> Iterator[_Effect]:
    """Yield dead zones from the least u on, and about 0, that hold enough samples."""
    u = model.u + model.means["u"]
    least, most = float(u.min()), float(u.max())
    ends = [(least, least + share * (most - least)) for share in _ZONES.tolist()]
    ends += [(-share * most, share * most) for share in _ZONES.tolist() if least < 0 < most]
    for a, b in ends:
        if _MIN_HELD < np.mean((a <= u) & (u <= b)) < 1 - _MIN_HELD:
            inside, numbers = partial(_inside, a, b), {"from": a, "to": b}
            yield _Effect(kind="dead zone", acts="u", signals=inside, of="u", numbers=numbers)


def _signal(model: LongModel, name: str) -> Array:
    return {"u": model.u, "x": model.x}[name] if name != "p" else model.prediction()


def _powers(name: str, model: LongModel) -> Sequence[Array]:
    s = _signal(model, name)
    return s**2, s**3


def _bends(name: str, model: LongModel) -> Sequence[Array]:
    """Return signals whose sum is piecewise linear, with as many samples in each interval."""
    s = _signal(model, name)
    edges = np.quantile(s[model.arx.rows], np.arange(1, _PARTS) / _PARTS)
    return [np.maximum(s - edge, 0.0) for edge in edges]


def _difference(w: Array, model: LongModel) -> Sequence[Array]:
    return (w - model.u,)


def _inside(a: float, b: float, model: LongModel) -> Sequence[Array]:
    return (np.clip(model.u + model.means["u"], a, b),)


def _beyond(a: float, b: float, model: LongModel) -> Sequence[Array]:
    return (model.x - np.clip(model.x, a, b),)


def _play_of_x(half: float, model: LongModel) -> Sequence[Array]:
    return (with_play(model.x, half * deviation(model.x)) - model.x,)


def _speeds(name: str, terms: int, model: LongModel) -> Sequence[Array]:
    """Return what x adds to the pull u - x/G, which is 0 at rest."""
    x = _signal(model, name)
    pull, v = model.u - x * float(np.sum(model.A)) / float(np.sum(model.B[0])), x / deviation(x)
    return (v * pull, v**2 * pull, v**4 * pull)[:terms]


def _speeds_by_rate(name: str, terms: int, model: LongModel) -> Sequence[Array]:
    """Return what the squared rate of x, as the current of a capacitor, adds to the pull."""
    x = _signal(model, name)
    rate = np.diff(x, prepend=x[0])
    v = rate / deviation(rate)
    signals = (model.u, x, v)
    return [v**2 * s for s in signals] + [v**4 * s for s in signals] * (terms > 2)


def _friction(share: float, slope: float, of_rate: bool, model: LongModel) -> Sequence[Array]:
    """Return the friction: at rest it balances u up to a limit; in motion it is at the limit."""
    u = model.u + model.means["u"]
    largest = float(np.max(np.abs(u)))
    speed = np.diff(model.x, prepend=model.x[0]) if of_rate else model.y + model.means["y"]
    pull = u + slope * largest / deviation(speed) * speed
    return (np.clip(pull, -share * largest, share * largest),)


def _path(model: LongModel, acts: Way) -> Array:
    """Return the polynomial by which an effect acts on A y."""
    late = np.append(0.0, model.B[0, 1:])
    return np.asarray({"u": model.B[0], "past u": late, "y": model.A}[acts])


def _with_effect(model: LongModel, effect: _Effect) -> _EffectModel:
    """Return the model with an effect, and the fall of BIC."""
    signals = np.array(effect.signals(model))
    terms, e = apply_filter(_path(model, effect.acts), [1.0], signals).T, model.arx.errors(model.y)
    unexplained = orthonormal(model.arx.errors(terms))
    ratio = float(np.sum(unexplained.without(e) ** 2)) / max(float(e @ e), 1e-300)
    price = (signals.shape[0] + effect.thresholds) * log(e.size)
    c, fall = unexplained.coefficients(e), -e.size * log(max(ratio, 1e-300)) - price
    return _EffectModel(effect=effect, model=model, fall=fall, c=c, terms=terms)


def _refine(fit: _EffectModel) -> _EffectModel:
    """Return the best of the models whose x, A and B are those with the effect."""
    effect, best = fit.effect, fit
    limit = _MAX_GROWTH * float(np.max(np.abs(fit.model.y)))
    for _ in range(_ROUNDS):
        model = best.model
        A, B = model.arx.polynomials(model.y - best.terms @ best.c)
        U = model.U.copy()
        if effect.acts != "y":
            U[:, 0] += best.c @ np.array(effect.signals(model))
        x = model.course(A, B, U)
        if not np.max(np.abs(x)) < limit:
            break
        refined = _with_effect(replace(model, A=A, B=B, x=x), effect)
        if not refined.fall > best.fall:
            break
        best = refined
    return best
