"""Test whether one linear model can describe the data, and the kind of a nonlinear rig."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_data
from armrig.data.dataset import Dataset, Signals
from armrig.data.files.column_faults import rails_of
from armrig.data.step import OTHER_COLUMNS, OTHER_INPUTS, codes_of, laws_of
from armrig.data.treatment import hampel
from armrig.data.treatment.integrating import pole_test
from armrig.data.treatment.outliers import ENOUGH_NOISE, quantum
from armrig.estimation.data_faults import CONSTANT_INPUT, looking_wrong, require_moving_output
from armrig.estimation.orders import require_samples
from armrig.numerics.polynomial import Array, apply_filter
from armrig.numerics.quantities import digits, p_relation, percent
from armrig.numerics.regressors import long_arx
from armrig.numerics.rounding import rounding_std
from armrig.numerics.whiteness import effects_p_value
from armrig.plots.layout import plot_method
from armrig.validation.feedback_and_delay.by_channel import ByChannel, each_channel
from armrig.validation.feedback_and_delay.delay import is_narrow
from armrig.validation.feedback_and_delay.open_loop import (
    CHANCE_LEVEL,
    EXACT,
    OpenLoop,
    open_loop,
    require_level,
)
from armrig.validation.nonlinearity import (
    Kind,
    LongModel,
    Nonlinearity,
    deviation,
    nonlinearity,
    sign,
    with_play,
)

_REASONS: Mapping[Kind, str] = {
    "": "no nonlinearity found",
    "not known": "kind not known",
    "dead zone": "a dead zone of {input} from {from} to {to}{unit}",
    "saturation": "{output} saturates at {at} in {share} of the samples",
    "gain by level": (
        "a gain of about {gain_1} at {of} = {level_1}{unit}, {gain_2} at {of} = {level_2}{unit}"
    ),
    "speed by level": "{output} responds faster at some levels of {of} than at others",
    "friction": "friction, {output} stops at rest",
    "backlash": "backlash, a play of about {width}{unit} of {of}",
}
_REMEDIES: Mapping[Kind, str] = {
    "not known": "record small steps around one level, and estimate a model for each level",
    "dead zone": "leave out the samples below the dead zone, or record with u above it",
    "saturation": "mark the samples at the limit missing, or record with a smaller u",
    "gain by level": "record small steps around one level, and estimate a model for each level",
    "speed by level": "record small steps around one level, and estimate a model for each level",
    "friction": "record with a u that keeps the rig moving, or estimate the friction (greybox)",
    "backlash": "record a motion in one direction, or motions much larger than the play",
}
_NO_STATIC_GAIN = "a response that changes with {of}"
_LEVEL = 0.05
_MIN_LAGS, _MAX_LAGS = 30, 100  # 30 lags leave effects of a slow pole, which look nonlinear
_MIN_ROWS_PER_PARAMETER = 4  # with fewer than 30 lags
_ROWS_PER_PARAMETER = 10  # with more lags: the test then loses a tenth of the rows
_MAX_SIZE = 4_000_000  # numbers in the regressors of more than 30 lags
_MAX_EFFECTS = 8  # combinations of effects that are tested jointly
_MIN_OWN_SHARE = 1e-3  # least share of an effect that the linear model leaves unexplained
_MAX_LEFT = 0.5  # share of y's variance that a simulation may leave; else x is the prediction
_MOST_SAMPLES_OF_A_KIND = 20_000  # the kind is that of the first of more samples
_SIMULATIONS, _FEW_SIMULATIONS = 19, 4  # linear rigs with the converter, of short and long data
_LEAST_NOISE = 0.02  # least standard deviation of their noise, in steps of the converter
_PLAY = 0.2  # half width of the tested play, in standard deviations


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Linearity:
    """Result of the test of linearity of one output with one input."""

    p: float
    """p value of the hypothesis that one linear model describes the data."""
    level: float
    """Level of the test: share of linear rigs that the test rejects by chance."""
    kind: Kind = ""
    """Kind of the nonlinearity, "not known" if no kind has a clear lead, or "" if the rig is
    linear. The kinds are a dead zone of u, a saturated output, friction, backlash, and a gain or a
    speed of the response by level."""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """Numbers of the kind: `from` and `to` of a dead zone, `at` and `share` of a saturation, or the
    `width` of a play. For a gain: the least and the greatest, `gain_1` at `level_1` and `gain_2` at
    `level_2`; empty if y integrates, or if the data do not determine the gains."""
    rails: tuple[float, ...]
    """Largest or smallest values of y at which y stays exactly."""
    gain_of: str = ""
    """Signal that the kind is about: the input, the output, or its rate; "" if linear."""
    levels: Array = field(default_factory=lambda: np.zeros(0))
    """Levels of `gain_of`, (n,); (0,) without a determined gain by level."""
    gains: Array = field(default_factory=lambda: np.zeros(0))
    """Static gain at `levels`, in y's unit per u's unit: the mean slope of a fifth of the samples.
    A gain with a deviation above 10 %, or far from that of the linear model, is left out."""
    remarks: tuple[str, ...]
    """Limits of the answer."""
    narrow: bool = False
    """True if the band of u is too narrow to determine a long linear model. Slow modes that the
    model lacks then look nonlinear."""
    others: bool = False
    """True if the file has other columns that change, which may be inputs, too."""
    closed: bool
    """True if feedback or a direct term is found with p < 0.1 %, so that u(t) may contain e(t).
    False under a known control law, whose u(t) depends on y(t - 1) and earlier."""
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
        unit = self.units.get(self.gain_of)
        text = _REASONS[self.kind] if x or self.kind != "gain by level" else _NO_STATIC_GAIN
        x |= {"input": self.input, "output": self.output, "of": self.gain_of}
        return text.format(**x, unit=f" {unit}" if unit else "")

    @property
    def sure(self) -> bool:
        """True if the rig is nonlinear with p < 0.1 % in a wide band, or reaches a limit."""
        return bool(self.rails) or (not self.linear and self.p < CHANCE_LEVEL and not self.narrow)

    @property
    def line(self) -> str:
        """Verdict, reason, p value, level and remedy in a line."""
        text = f"{self.reason} (p {p_relation(self.p)}, level {100 * self.level:g} %)"
        if self.linear:
            return text
        if not self.sure and self.narrow:
            why = f"{self.input} determines few lags, and a longer linear model may explain"
            return f"perhaps nonlinear: {text}; {why} {self.output}: record a telegraph or noise"
        if not self.sure:
            chance = f"one linear rig in {1 / self.level:.0f} has such a p by chance"
            return f"perhaps nonlinear: {text}; {chance}: record again"
        causes = [f"a controller computed {self.input} from {self.output}"] * self.closed
        by_others = self.others and not self.rails
        causes += [f"another column of the file moves {self.output}"] * by_others
        unless = f", unless {' or '.join(causes)}" if causes else ""
        return f"NONLINEAR{unless}: {text}; {self.remedy}"

    def explain(self) -> str:
        """Return the answer, the tested hypothesis, and the limits of the answer."""
        null = f"Hypothesis: effects that are not linear in {self.input} do not explain the errors"
        return f"{self!r}\n{null} of a long linear model."

    plot = plot_method("plot_linearity", "the gain by level")

    def __repr__(self) -> str:
        """Return the answer in a line, and the remarks."""
        return "\n".join([self.line, *(f"  note: {remark}" for remark in self.remarks)])


@takes_data
@each_channel(  # the tested input is the first
    lambda data, y, u: (data.channels([y], sorted(data.inputs, key=lambda name: name != u)), {})
)
def linearity(data: Dataset | Signals, level: float = _LEVEL) -> Linearity | ByChannel[Linearity]:
    """Test whether one linear model can describe the data, and find the kind of nonlinearity.

    A long linear model whitens the errors ::

        A(q) y(t) = c + B(q) u(t) + e(t),     x = B/A u

    The model has 30 to 100 lags. If the rig is linear, e is not correlated with nonlinear effects,
    filtered by A or B. The effects are squares and cubes of u and x, their product, ``|Δu|``, the
    sign and the square of Δx, and a play of u. A joint test gives `p`. If x does not
    follow y, the prediction of y replaces x. If the test rejects, models with the effects of each
    kind are fitted, with x simulated with the effect. The kind with the least BIC is reported if
    its lead is clear, and "not known" otherwise. An output is also saturated if it stays at exactly
    its largest or smallest value. Of 200 000 samples or more, evenly spaced blocks are tested; a
    kind is that of the first 20 000 samples. Samples that look wrong are left out.

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
    return _test_robustly(data.signals(), level, None)


def _test_robustly(data: Signals, level: float, loop: OpenLoop | None) -> Linearity:
    """Test one output; `loop` is the result of the test for feedback, if it is known.

    A single wrong sample is no nonlinearity: the output is tested again without wrong samples.
    """
    result = _test_once(data, level, loop)
    if data.nu == 1 and not result.linear:
        with suppress(InputError):
            if looking_wrong(data)[0]:
                return _test_once(hampel(data), level, None)
    return result


def _test_once(data: Signals, level: float, loop: OpenLoop | None) -> Linearity:
    require_moving_output(data)
    (y,), u, together, closed, direct = data.outputs, data.inputs[0], False, False, False
    exact, channel = False, data.dataset(y, u)
    with suppress(InputError):
        loop = loop or open_loop(channel)
        exact = loop.exact
        together, direct = loop.sure and not loop.laws, loop.may_be_direct_term
        closed = together and not loop.few_levels
    if exact:
        raise InputError(EXACT)
    # In closed loop, u(t) contains e(t). Under a known law it contains e(t - 1) and earlier only:
    # the test is valid, and lag 0 has no effect.
    first = int(bool(laws_of(data.history)) or (closed and not direct))
    model = _long_model(data, first)
    p, (at, rails) = _p_value(model), rails_of(channel.y)
    if not model.has_errors:  # a linear rig that settles stays at its last value, too
        rails = []
    kind = Nonlinearity(kind="")
    if rails:
        numbers = {"at": rails[-1], "share": float(np.mean(at[channel.valid]))}
        kind = Nonlinearity(kind="saturation", numbers=numbers)
    elif p < level and (step := quantum(channel)):
        p = _p_beyond_converter(data, model, step, p, first)
    if not rails and p < level:
        long = data.N > _MOST_SAMPLES_OF_A_KIND
        kind = nonlinearity(_long_model(data[:_MOST_SAMPLES_OF_A_KIND], first) if long else model)
        slow = pole_test(data, 0)
        if kind.kind == "gain by level" and slow is not None and slow.possible:
            # A pole that may be 1 leaves no static gain.
            kind = Nonlinearity(kind=kind.kind, by=kind.by)
    remarks = []
    if np.unique(model.u).size <= 2:
        text = f"{u} has two levels, which cannot show a dead zone or another static nonlinearity "
        remarks.append(f"{text}of {u}: record with several levels (staircase, white noise)")
    if closed and direct:
        remarks.append(f"if a controller computed {u} from {y}, p is not valid")
    return Linearity(
        p=p,
        level=level,
        kind=kind.kind,
        numbers=kind.numbers,
        gain_of={"": "", "u": u, "rate": f"the rate of {y}"}.get(kind.by * bool(kind.kind), y),
        levels=kind.levels,
        gains=kind.gains,
        rails=tuple(rails),
        remarks=tuple(remarks),
        narrow=is_narrow(channel),
        others=bool({OTHER_COLUMNS, OTHER_INPUTS} & {*codes_of(data.history)}),
        closed=together,
        output=y,
        input=u,
        units={u: channel.input_unit, y: channel.unit},
    )


def _p_beyond_converter(
    data: Signals, model: LongModel, step: float, p: float, first: int
) -> float:
    """Return the p value p, less what the steps of a coarse converter of y explain.

    The error of rounding follows from y, so that it looks nonlinear if the noise is smaller than
    the step. The linear model is simulated with the noise and the converter. A share 1/(n + 1) of
    n linear rigs has a p value below the least that comes, which replaces this share.
    """
    errors = model.arx.errors(model.y)
    variance = float(np.mean(errors**2)) / float(np.sum(model.A**2)) - step**2 / 12
    if variance > (ENOUGH_NOISE * step) ** 2:
        return p
    rng, std = np.random.default_rng(1), max(np.sqrt(max(variance, 0.0)), _LEAST_NOISE * step)
    known = np.isfinite(data.y[:, 0])
    phase = float(data.y[known, 0][0])
    simulated = []
    for _ in range(_SIMULATIONS if data.N <= _MOST_SAMPLES_OF_A_KIND else _FEW_SIMULATIONS):
        # The model has the rounded levels of y: the true ones lie anywhere within a step.
        low, wide = step * rng.uniform(-0.5, 0.5, 2)
        y = model.x * (1 + wide / np.ptp(model.x)) + model.means["y"] + low
        y += std * rng.standard_normal(data.N)
        y = np.where(known, phase + step * np.round((y - phase) / step), np.nan)
        simulated.append(_p_value(_long_model(data.replaced(step=None, y=y[:, None]), first)))
    return min(1.0, p / (len(simulated) + 1) / max(min(simulated), 1e-300))


def in_open_loop(data: Dataset | Signals, loop: OpenLoop | None = None) -> list[Linearity]:
    """Test each channel; leave out feedback, and channels without a result.

    `loop` is the result of the test for feedback in data of one channel, if it is known.
    """
    try:
        judged = _test_robustly(data.signals(), _LEVEL, loop) if loop else None
        tested = judged or linearity(data)
    except InputError:
        return []
    each = [tested] if isinstance(tested, Linearity) else tested.results.values()
    return [result for result in each if not result.closed]


def _long_model(data: Signals, first: int) -> LongModel:
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
    ends = np.cumsum([0, *(y.size for _, y in parts)]).tolist()
    U, zeros = data.u - mean, np.nan_to_num(y)
    model = LongModel(
        arx=arx,
        A=A,
        B=B,
        U=U,
        x=zeros,
        y=zeros,
        means={"u": float(mean[0]), "y": y_0},
        parts=[slice(a, b) for a, b in pairwise(ends)],
        rounding=rounding_std(data.y),
    )
    x = model.course(A, B, U)
    with np.errstate(over="ignore", invalid="ignore"):
        left = np.var((x - y)[arx.rows])
    if not left < _MAX_LEFT * np.var(y[arx.rows]):
        x = model.prediction()
    return replace(model, x=x)


def _p_value(model: LongModel) -> float:
    """Return the p value of the joint test of all effects."""
    changes = (np.diff(v, prepend=v[0]) for v in (model.u, model.x))
    u, x, du, dx = (s / deviation(s) for s in (model.u, model.x, *changes))
    of_x, of_dx = [x**2, x**3], (sign(dx), dx * np.abs(dx), x * dx)
    like_u = [u**2, u**3, np.abs(du), *of_x, x * u, *of_dx]
    if u.size <= _MOST_SAMPLES_OF_A_KIND:
        like_u.append(with_play(u, _PLAY))
    effects = np.vstack(
        [
            apply_filter(model.B[0], [1.0], np.array(like_u)),
            apply_filter(model.A, [1.0], np.array(of_x)),
        ]
    ).T
    effect_errors, e = model.arx.errors(effects), model.arx.errors(model.y)
    if not model.has_errors:
        return 1.0
    moving = np.std(effects[model.arx.rows], axis=0) * np.sqrt(e.size)
    used = np.linalg.norm(effect_errors, axis=0) > _MIN_OWN_SHARE * moving
    # The transients of few changes of u do not determine many effects.
    switches = int(np.count_nonzero(np.diff(model.u)))
    most = max(2, min(e.size // 40, switches // 3, _MAX_EFFECTS))
    return effects_p_value(e, effect_errors[:, used], most, e.size - model.arx.base.rank)
