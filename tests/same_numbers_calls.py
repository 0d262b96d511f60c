"""Calls of `same_numbers.py` with their data, and its omissions with the reasons.

Each function marked with @variants is called like the public name that it calls, and gives
variants: their names and their results. The data are small and fixed. They are not made by the
signals of armrig, so that a change of those appears in their own numbers.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import armrig
import numpy as np
from armrig_core.rig.arm import ArmParameters, arm_matrices, chassis_matrices, zero_order_hold
from numpy.typing import NDArray
from scipy.signal import lfilter

from tests.plants import nonlinear_rig

Vector = NDArray[np.float64]
Variants = Iterator[tuple[str, Any]]

CALLS: dict[str, Callable[[], Variants]] = {}
"""Calls by name."""


def variants(function: Callable[[], Variants]) -> Callable[[], Variants]:
    """Enter a call into the table."""
    CALLS[function.__name__] = function
    return function


NOT_CALLED = {
    "ArmrigError": "an error",
    "Catalogue": "what catalogue returns",
    "ControlLaw": "what pid and others return",
    "FileError": "an error",
    "Fit": "what arx and others return",
    "GreyFit": "what greybox returns",
    "InputError": "an error",
    "LiveGap": "of a live rig",
    "RarxState": "what rarx_step returns",
    "Ode": "greybox takes it",
    "Parameter": "a part of an Ode",
    "Recording": "what load returns",
    "Rig": "a live rig",
    "RigError": "an error",
    "SearchResult": "what search returns",
    "example_recording": "load reads other recordings",
    "load_law": "reads what pid and others return",
    "plots": "drawn_figures.txt has the figures",
    "stream": "of a live rig",
    "compare_loop": "of a recorded run in control; test_loop_comparison has the numbers",
}
"""Public names that are not called, and why."""

PROJECTION = ("order", "horizon", "suggested_order", "singular_values", "canonical_correlations")
"""Members of a `Fit` and of its projection that only n4sid fills."""
NO_MEMBERS = {
    "Fit.quantities": "stand in the calls of tf and process",
    "Fit.to_continuous": "test_continuous_time compares it with tf",
    "Fit.to_discrete": "test_continuous_time compares it with tf",
    "*.plot": "plots draws it",
    "*.save": "load_fit reads it again",
    "*.to_pandas": "export has the columns",
    "*.to_xarray": "export has the columns",
    "Recording.channel": "the fields have them",
    "RecordingSummary.names": "the name that was asked for",
    "*.to_parquet": "columns are the same",
    "*Fit.Ts": "given",
    "*Fit.nk": "given",
    "Dataset.N": "the length of u",
    "ComparisonTable.data": "given",
    "ComparisonTable.of": "the rows have them",
    "ComparisonTable.models": "the rows have them",
    "Comparison.channel": "the model again",
    "ResidualTest.white_by_output": "white again",
    "ResidualTest.missing_dynamics_by_pair": "missing_dynamics again",
    "ResidualTest.feedback_by_pair": "feedback again",
    "ResidualTest.poorest_pair": "texts",
    "*Fit.findings": "the warnings again, by code",
    "*.names": "texts",
    "*.inputs": "texts",
    "*.outputs": "texts",
    "*.input_units": "texts",
    "*.units": "texts",
    "*.intersample": "texts",
    "*.history": "texts",
    "*Fit.orders": "given",
    "*Fit.integrator": "given",
    "Fit.form": "theta again",
    "Fit.quality": "loss, N and fit_percent again",
    "Fit.noise_covariance": "noise_variance again",
    "Fit.ny": "the number of names",
    "Fit.nu": "the number of names",
    "Fit.shared": "given",
    "Fit.output_weights": "given",
    "Fit.state_space": "n4sid has it",
    "Fit.order": "n4sid has it",
    **{f"*.projection.{name}": "n4sid has it" for name in PROJECTION},
    "*Fit.offset": "given",
    "*.estimated_from": "of other data",
    "*.summary": "summary calls it: it takes long",
    "*.explain": "a text",
    "*.table": "a text, or a table of texts",
    "*.lines": "a text",
    "*.texts": "texts",
    "*.require_result": "the fit itself",
    "*.origin": "texts",
    "*.facts": "the fields again",
    "*.metadata": "texts",
    "Dataset.replaced": "a copy",
    "Signals.replaced": "a copy",
    "Dataset.signals": "Signals has them",
    "Signals.select": "parts of Signals",
    "Signals.signals": "the object itself",
    "Signals.channels": "Signals calls it",
    "Signals.dataset": "Dataset has them",
    "Signals.experiments": "parts of Signals",
    "Signals.split": "parts of Signals",
    "Signals.N": "the length of u",
    "Signals.equidistant": "Ts again",
    "Dataset.experiments": "Dataset calls it",
    "Dataset.select": "Dataset calls it",
    "Dataset.split": "Dataset calls it",
    "Trend.each": "of functions",
    "*.fixed": "a parameter that was given",
    "*.slice_of": "numbers of parameters, which names has",
    "*.polynomial": "A, B, C, D and F again",
    "GreyFit.physics": "what was given",
    "Recording.dataset": "dataset calls it",
    "Recording.manifest": "what the table wrote",
    "CalibrationEstimate.calibration": "calibration calls it",
    "SearchResult.chosen": "ranked has it",
    "Study.best": "estimated again",
    "Study.models": "estimated and reference again",
    "Study.ranked": "estimated again",
    "Study.estimation": "given",
    "Study.validation": "given",
    "Study.model": "models again",
    "Study.recording_of": "recordings again",
    "Study.recordings": "load has them",
    "HandoutStudy.recordings": "load has them",
    "*.coefficients": "of internal bases",
    "*.without": "of internal bases",
}
"""Members, by class and name, whose numbers are left out, and why."""

BRIEF = {
    "ArmParameters": ("J_1", "b_1"),
    "Calibration": ("theta_1",),
    "Comparison": ("fit_percent", "rms_error", "velocity_fit_percent", "y", "characteristics"),
    "Correlation": ("g", "autocorrelation", "std"),
    "Dataset": ("u", "y", "starts"),
    "Delay": ("nk", "interval", "p_values", "before", "arx_loss"),
    "Draws": ("theta",),
    "Fit": ("theta", "std", "std_robust", "loss", "fit_percent"),
    "ImpulseResponse": ("g", "covariance", "rate"),
    "InputDescription": ("order", "highest_order", "weakest", "spectrum", "shares"),
    "ModelCharacteristics": ("gain", "poles", "poles_std", "bandwidth", "rise_time", "overshoot"),
    "OpenLoop": ("feedback", "p_value", "sims"),
    "OrderTable": ("na", "nb", "nk", "loss", "output_variance"),
    "PredictedStd": ("std", "covariance", "N"),
    "RarxState": ("theta", "std", "noise_variance"),
    "RecursiveEstimate": ("theta", "state"),
    "ResidualTest": ("e", "autocorrelation", "cross_correlation", "missing_dynamics", "feedback"),
    "SamplingTime": ("tau", "settling", "Ts_step", "Ts_spectrum", "Ts_transient", "response"),
    "Scored": ("error", "parameters"),
    "Signals": ("u", "y", "starts"),
    "Sims": ("F", "lags", "std"),
    "SpectralEstimate": ("G", "std_magnitude", "noise_spectrum", "coherence"),
    "StepAnalysis": ("gain", "dead_time", "tau", "settling", "overshoot"),
}
"""Members by which results of these classes are known, except the first result of a call."""
WHOLE = ("calibration", "dataset", "physical_model")
"""Calls of which every result is known by all its members."""
PARTS = ("ararx", "armax", "iv4", "load_fit", "pem")
"""Calls of which none is: models, of which `arx`, `bj`, `n4sid` and `oe` show all members."""

LEFT_OUT = {
    "*.white*.ljung_box": "stands in the test of the residuals, or is NaN",
    "*.white*.doubtful": "follows from two p values",
    "*.white*.unclear": "follows from two p values",
    "*.starts[[]*].iterations": "the way of a search",
    "*.starts[[]*].converged": "the way of a search",
    "pem odd.free[[]*].transients": "two of four are dependent: rounding decides which is 0",
    "*summary.size": "the length of a file rests on how zstd packs it",
    "*recordings[[]*].size": "the length of a file rests on how zstd packs it",
    "*[[]bytes]": "the length of a file rests on how zstd packs it",
    "rarx*.R": "LAPACK chooses the signs of its rows",
    "rarx *.error": "the first ones rest on parameters that are hardly determined; see errors",
    "compare integrator*overshoot*": "rounding: there is none",
    "*.densest.scale": "LAPACK chooses the signs of its columns",
    "summary high.zeros*.densest.*": "rounding decides to which of two pairs a draw belongs",
    "summary high.zeros*.draws.pairs": "rounding decides to which of two pairs a draw belongs",
    "*.draws.reals": "roots of draws in LAPACK's order; the borders rest on them",
    "*.draws.upper": "roots of draws in LAPACK's order; the borders rest on them",
}
"""Quantities that are left out, by name with * and ?, and why."""

LOOSER = {
    "*.std[[]resonance]": (5e-3, "differences of a peak that a search finds"),
    "*.std[[]overshoot]": (5e-3, "differences of a peak that a search finds"),
}
"""Relative tolerances of quantities, by name with * and ?, and why. The first that fits counts."""

ZERO = 1e-13
"""Rounding error of 0."""


def data_for(model: Any) -> armrig.Dataset:
    """Return data that fit a model's Ts, output and units."""
    u = switching(90, 3, 0.2)
    y = 0.3 * np.cumsum(u - u.mean()) * min(1.0, model.Ts) + np.sin(0.7 * np.arange(90))
    units = {"unit": model.unit, "input_unit": model.input_unit}
    return armrig.Dataset(u=u, y=y, Ts=model.Ts, output=model.output, **units)


def frequencies(of: Any) -> Vector:
    """Return frequencies that are no special ones, up to Nyquist's."""
    Ts = of.Ts if hasattr(of, "Ts") else 0.01
    return np.array([0.013, 0.11, 0.29, 0.53, 0.97]) * np.pi / float(Ts)


ARGUMENTS: dict[str, Callable[[Any], Any]] = {
    "omega": frequencies,
    "data": data_for,
    "u": lambda of: switching(40, 5, 0.3),
    "n": lambda of: 20,
    "t": lambda of: np.array([0.0, 0.013, 0.1, 0.37]),
    "seconds": lambda of: 0.37,
    "z": lambda of: 0.7 + 0.1j,
    "x": lambda of: np.array([0.7, 0.1]),
    "counts": lambda of: 31234,
    "criterion": lambda of: "mdl",
}
"""Required arguments of methods by their names, made of the object."""

METHODS: dict[str, dict[str, Callable[[Any], dict[str, Any]]]] = {
    "step_response": {
        "25": lambda m: {"n": 25} if hasattr(m, "theta") else {},
        "rate": lambda m: {"n": 25, "rate": True} if hasattr(m, "theta") else {},
    },
    "orders": {"": lambda table: {"i": 1}},
    "predict": {
        "1": lambda m: {"data": data_for(m), "horizon": 1},
        "7": lambda m: {"data": data_for(m), "horizon": 7},
        "all": lambda m: {"data": data_for(m), "horizon": None},
    },
    "values": {c: partial(lambda c, t: {"criterion": c}, c) for c in ("aic", "mdl", "loss")},
    "chosen": {c: partial(lambda c, t: {"criterion": c}, c) for c in ("aic", "mdl")},
    "envelope": {c: partial(lambda c, t: {"criterion": c}, c) for c in ("aic", "mdl")},
    "best": {c: partial(lambda c, t: {"criterion": c}, c) for c in ("aic", "mdl")},
    "band": {"": lambda of: {}, "90": lambda of: {"level": 0.9}},
    "solve": {"": lambda of: {"h": 0.01, "n": 15, "method": "heun"}},
    "error": {"": lambda of: {"h": 0.01, "method": "ab2"}},
}
"""Arguments of these methods, each call with a name."""


# Data.


def switching(N: int, seed: int, p: float, low: float = 0.5, high: float = 4.5) -> Vector:
    """Return an input that switches with probability p."""
    rng = np.random.default_rng([seed, 77])
    return low + (high - low) * (np.cumsum(rng.random(N) < p) % 2)


def of_a_system(
    B: Any,
    F: Any,
    *,
    N: int = 400,
    Ts: float = 0.1,
    C: Any = (1.0,),
    D: Any = (1.0,),
    std: float = 0.1,
    seed: int = 1,
    u: Vector | None = None,
    u_0: float = 0.0,
    y_0: float = 0.0,
    output: str = "y",
    unit: str = "",
) -> armrig.Dataset:
    """Return data of B/F u + C/D e, about levels."""
    rng = np.random.default_rng([seed, 5])
    u = rng.standard_normal(N) if u is None else u
    y = lfilter(B, F, u) + lfilter(C, D, std * rng.standard_normal(N))
    return armrig.Dataset(u=u + u_0, y=y + y_0, Ts=Ts, output=output, unit=unit)


COMPLEX = ([0.0, 0.5, 0.3], np.poly([0.8 + 0.3j, 0.8 - 0.3j]))
REAL = ([0.0, 0.0, 0.0, 0.4, 0.1], np.poly([0.9, 0.4]))


def observed(matrices: Any, seed: int, N: int, Ts: float, std: float) -> armrig.Dataset:
    """Return theta_1 of the handout's rig, with coloured noise."""
    A, B, C = matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, Ts)
    rng = np.random.default_rng([seed, 12])
    u = 0.5 + 4.0 * (np.cumsum(rng.random(N) < 5 * Ts) % 2)
    x, y = np.zeros(Gamma.shape[0]), np.empty(N)
    e = rng.standard_normal(N)
    for k in range(N):
        y[k] = C[0] @ x + std * (e[k] + 0.5 * e[k - 1])
        x = Phi @ x + Gamma[:, 0] * u[k]
    return armrig.Dataset(u=u, y=y, Ts=Ts, output="theta_1", unit="rad")


@cache
def arm_data(seed: int = 1, N: int = 800) -> armrig.Dataset:
    """Return theta_1 of the arm at 10 ms."""
    return observed(arm_matrices, seed, N, 0.01, 2e-3)


@cache
def chassis_data(seed: int = 1, N: int = 900) -> armrig.Dataset:
    """Return theta_1 of the chassis alone at 4 ms."""
    return observed(chassis_matrices, seed, N, 0.004, 1e-3)


def holed(data: armrig.Dataset, every: int = 90, lost: int = 3) -> armrig.Dataset:
    """Return the data with gaps."""
    return data.replaced(step=None, valid=np.arange(data.N) % every >= lost)


@cache
def data() -> dict[str, armrig.Dataset]:
    """Return the data of most calls."""
    white = {"C": [1.0, 0.6], "D": [1.0, -0.7]}
    plain = of_a_system(*COMPLEX, u_0=0.2, seed=1)
    odd = of_a_system(*REAL, N=401, Ts=0.02, u=switching(401, 2, 0.2), y_0=5.0, seed=2, **white)
    third = of_a_system(*COMPLEX, N=251, u_0=2.0, y_0=-3.0, seed=3)
    slope = plain.replaced(step=None, y=plain.y + 3.0 + 0.02 * plain.t + 0.003 * plain.t**2)
    return {
        "plain": plain,
        "odd": odd,
        "holes": holed(plain, 60, 4),
        "two": armrig.merge([plain[:180], holed(third, 80, 2)]),
        "mean": armrig.detrend(third),
        "line": armrig.detrend(armrig.merge([slope[:150], slope[150:]]), 1),
        "resampled": armrig.resample(arm_data(3, 1600), 0.03),
    }


@cache
def integrating() -> armrig.Dataset:
    """Return data of a system with an integrator and an input about a level."""
    B, F = np.array([0.0, 0.3, 0.2]), np.convolve([1.0, -0.7], [1.0, -1.0])
    return of_a_system(B, F, N=500, Ts=0.05, u=switching(500, 4, 0.1, -1.5, 2.0), std=0.05, seed=4)


@cache
def fed_back() -> armrig.Dataset:
    """Return data of a loop that is closed."""
    rng = np.random.default_rng([6, 6])
    N, (B, F) = 500, COMPLEX
    r, e, u, y = rng.standard_normal(N), 0.3 * rng.standard_normal(N), np.zeros(N), np.zeros(N)
    v = lfilter([1.0], [1.0, -0.8], e)
    x = np.zeros(N)
    for t in range(N):
        for k in (1, 2):
            if t >= k:
                x[t] += B[k] * u[t - k] - F[k] * x[t - k]
        y[t] = x[t] + v[t]
        u[t] = r[t] - 0.3 * y[t]
    return armrig.Dataset(u=u, y=y, Ts=0.1)


@cache
def late() -> armrig.Dataset:
    """Return data with a delay of four samples."""
    return of_a_system([0.0] * 5 + [0.5, 0.3], COMPLEX[1], seed=8, N=600)


@cache
def steps() -> armrig.Dataset:
    """Return a response to steps, with a dead time."""
    u = np.repeat([0.0, 2.0, 0.0, 2.0, 0.0], 60)
    return of_a_system([0.0, 0.0, 0.0, 0.1, 0.05], np.poly([0.85, 0.5]), u=u, N=300, std=0.01)


# Data in which little is alike: experiments, gaps, levels, delays, units and a sampling time.


@cache
def unlike(level: float = 0.0) -> armrig.Dataset:
    """Return three unequal experiments of a slow system with negative gain and a delay of three."""
    B, F = [0.0, 0.0, 0.0, -7.0, 2.5], np.poly([0.82, 0.35])
    parts = []
    for seed, (N, u_0, y_0) in enumerate([(67, -4.0, 300.0), (230, -3.0, -80.0), (41, 1.5, 0.0)]):
        noise = {"C": [1.0, 0.5], "D": [1.0, -0.6], "std": 2.0, "seed": 30 + seed}
        about = {"u_0": level * u_0, "y_0": level * y_0}
        u = switching(N, 40 + seed, 0.25, -1.7, 0.8)
        parts.append(of_a_system(B, F, N=N, Ts=0.5, u=u, **about, **noise))
    whole = armrig.merge(parts)
    lost = [5, 31, 32, 66, 71, 72, 73, 150, 210, 211, 330]
    lost += [0, 67] if level else []  # before which a simulation is not determined
    valid = ~np.isin(np.arange(whole.N), lost)
    told = {"output": "level", "unit": "mm", "input_unit": "A", "source": "beef01+beef02"}
    told |= {"valid": valid, "starts": whole.starts, "history": ["weighed"]}
    return armrig.Dataset(u=whole.u, y=whole.y, Ts=0.5, **told)


@cache
def unlike_integrating() -> armrig.Dataset:
    """Return two unequal experiments that integrate backwards, from other places."""
    B, F = [0.0, 0.0, -0.05, -0.02], np.convolve([1.0, -0.6], [1.0, -1.0])
    parts = []
    for seed, (N, y_0) in enumerate([(310, -3.0), (90, 8.0)]):
        u = switching(N, 50 + seed, 0.1, -2.4, 1.1)
        parts.append(of_a_system(B, F, N=N, Ts=0.25, u=u, y_0=y_0, std=0.02, seed=40 + seed))
    whole = armrig.merge(parts)
    valid = ~np.isin(np.arange(whole.N), [5, 120, 121, 122, 309, 311, 360])
    return armrig.Dataset(
        u=whole.u - 0.3, y=whole.y, Ts=0.25, valid=valid, starts=whole.starts, unit="m"
    )


@cache
def folder() -> Path:
    """Return a folder for files; it is removed at the end."""
    kept = tempfile.TemporaryDirectory(prefix="armrig-")
    _KEPT.append(kept)
    return Path(kept.name)


_KEPT: list[Any] = []


# Models that several calls are made of.


@cache
def oe_plain() -> Any:
    """Return a model of the plain data."""
    return armrig.oe(data()["plain"], nb=2, nf=2)


@cache
def oe_integrating() -> Any:
    """Return a model that integrates."""
    return armrig.oe(integrating(), nb=2, nf=2, integrator=True)


@cache
def oe_backwards() -> Any:
    """Return a model that integrates backwards."""
    return armrig.oe(unlike_integrating(), nb=2, nf=2, nk=2, integrator=True, offset=True)


@cache
def bj_odd() -> Any:
    """Return a model with a noise model of its own."""
    return armrig.bj(data()["odd"], nb=2, nc=1, nd=1, nf=2, nk=3)


@cache
def bj_unlike() -> Any:
    """Return a model of data in which little is alike."""
    return armrig.bj(unlike(), nb=2, nc=1, nd=1, nf=2, nk=3)


# Data and their treatment.


@variants
def Dataset() -> Variants:
    d = data()
    yield "line", d["line"]
    yield "resampled", d["resampled"]
    two = armrig.merge([d["line"], armrig.detrend(d["plain"])])
    yield "experiments", list(two.experiments())
    yield "trend", [t.later(0.7) for t in two.trends]
    yield "unlike", [unlike(1.0), unlike(1.0)[30:310], unlike(1.0).select(2, 0)]
    yield "unlike split", unlike(1.0).split(4)


def several() -> armrig.Signals:
    """Return two experiments of two inputs and two outputs, with missing values."""
    d = data()["holes"]
    return armrig.Signals(
        u=np.column_stack([d.u, np.roll(d.u, 30)]),
        y=np.column_stack([d.y, np.cumsum(d.u)]),
        Ts=d.Ts,
        starts=(0, 140),
        inputs=["u", "v"],
        outputs=["y", "sum"],
    )


@variants
def Signals() -> Variants:
    signals = several()
    yield "whole", signals
    yield "part", signals[40:170]
    yield "channels", signals.channels("sum", "v")
    yield "merged", armrig.merge([signals[:50], signals[200:]])
    yield "detrended", armrig.detrend(signals, 1)
    yield "resampled", armrig.resample(signals, 2 * signals.Ts)
    band = (0.0, 2.0 / signals.Ts)
    yield "prefiltered", armrig.prefilter(signals, band=band, order=1)
    yield "outliers", armrig.hampel(signals)


@variants
def merge() -> Variants:
    yield "trends", armrig.merge([data()["mean"], data()["plain"], data()["line"]])
    yield "unlike", armrig.merge([unlike(), armrig.detrend(unlike(1.0), 1), unlike().select(1)])


@variants
def detrend() -> Variants:
    drifting = integrating().replaced(step=None, y=integrating().y + 4 + 0.1 * integrating().t)
    yield "unlike", armrig.detrend(unlike(1.0), 1)
    yield "holes", armrig.detrend(holed(drifting, 70), 0)
    yield "twice", armrig.detrend(armrig.detrend(data()["two"], 0), 1)


@variants
def retrend() -> Variants:
    line = data()["line"]
    yield "numbers", armrig.retrend(line, np.sin(np.arange(line.N)))
    yield "resampled", armrig.retrend(armrig.resample(armrig.detrend(arm_data(3), 1), 0.03))
    yield "unlike", armrig.retrend(armrig.resample(armrig.detrend(unlike_integrating(), 1), 0.5))
    yield "unlike part", armrig.retrend(armrig.detrend(unlike(1.0), 1).select(2, 1)[10:200])


@variants
def resample() -> Variants:
    line = armrig.detrend(holed(arm_data(3), 300), 1)
    yield "3", armrig.resample(line, 0.03)
    yield "odd", armrig.resample(armrig.merge([arm_data(3, 401), arm_data(4, 500)]), 0.02)
    yield "unlike", armrig.resample(unlike(1.0), 1.0)


@variants
def difference() -> Variants:
    yield "line", armrig.difference(data()["line"])
    yield "unlike", armrig.difference(unlike(1.0))


@variants
def prefilter() -> Variants:
    d = data()
    yield "low", armrig.prefilter(d["plain"], band=(0.0, 8.0))
    yield "high", armrig.prefilter(d["odd"], band=(5.0, np.inf), order=2)
    yield "unlike band", armrig.prefilter(unlike_integrating(), band=(3.0, 9.0), order=1)


@variants
def hampel() -> Variants:
    two = data()["two"]
    size = np.linspace(0.5, 9, two.N) * np.nanstd(two.y)  # of all sizes: one is at any limit
    hit = np.random.default_rng(9).random(two.N) < 0.04
    wrong = two.replaced(step=None, y=np.where(hit, two.y + size, two.y))
    yield "two", armrig.hampel(wrong)
    yield "two low", armrig.hampel(wrong, threshold=4.0, order=3)
    hit = np.isin(np.arange(unlike().N), [40, 149, 200, 320])
    yield "unlike", armrig.hampel(unlike().replaced(step=None, y=unlike().y - 60 * hit))


@variants
def drift() -> Variants:
    d = data()["plain"]
    jump = d.replaced(step=None, y=d.y + 0.4 * (d.t > 21.7))
    yield "jump", armrig.drift(jump, 4)
    yield "holes", armrig.drift(holed(jump), 4, integrator=False)
    yield "unlike", armrig.drift(unlike(1.0), 2, integrator=False)


@variants
def load_data() -> Variants:
    d, path = data()["holes"], folder() / "data.csv"
    rows = (f"{t:.6g};{u:.6g};{y:.6g}" for t, u, y in zip(d.t, d.u, d.y, strict=True))
    path.write_text("\n".join(["time [ms];u;y", *rows]).replace(".", ","))
    yield "semicolon", armrig.load_data(path)
    yield "Ts", armrig.load_data(path, Ts=0.2, time="time")
    np.savez(path.with_suffix(".npz"), u=d.u[:50], y=d.y[:50], Ts=0.3)
    yield "npz", armrig.load_data(path.with_suffix(".npz"))


@variants
def load_signals() -> Variants:
    d, path = several(), folder() / "signals.csv"
    rows = (",".join(f"{x:.6g}" for x in row) for row in np.column_stack([d.t, d.u, d.y]))
    path.write_text("\n".join(["t,u,v [V],y [m],sum", *rows]))
    yield "csv", armrig.load_signals(path, inputs=["u", "v"], outputs=["sum", "y"])


# Estimation.


@variants
def arx() -> Variants:
    yield "unlike", armrig.arx(unlike(), na=2, nb=2, nk=3)
    yield "line", armrig.arx(data()["line"], na=2, nb=2)
    yield "direct", armrig.arx(data()["two"], na=1, nb=3, nk=0)
    yield "stable", armrig.arx(integrating(), na=4, nb=3, stable=True)
    yield "fir", armrig.arx(data()["plain"], na=0, nb=8)
    yield "arm", armrig.arx(holed(arm_data(), 300), na=4, nb=4)


@variants
def iv4() -> Variants:
    yield "unlike", armrig.iv4(unlike(), na=2, nb=2, nk=3)
    yield "two", armrig.iv4(data()["two"], na=2, nb=2)
    yield "arm", armrig.iv4(arm_data(), na=4, nb=4, stable=True)


@cache
def driven_twice(missing: float = 0.0) -> armrig.Signals:
    """Return data of a plant with two inputs and two outputs whose noise is correlated."""
    rng = np.random.default_rng([9, 9])
    u = np.column_stack([switching(400, 11, 0.2, -1, 1), switching(400, 12, 0.3, -1, 1)])
    e = rng.multivariate_normal([0, 0], [[0.04, 0.02], [0.02, 0.05]], 400)
    F = np.array([1.0, -1.3, 0.6])
    y = np.column_stack(
        [
            lfilter([0, 1.0, 0.4], F, u[:, 0]) + lfilter([0, 0.5], F, u[:, 1]),
            lfilter([0, 0.3, -0.5], F, u[:, 0]) + lfilter([0, 0, 0.8], F, u[:, 1]),
        ]
    )
    y += np.column_stack([lfilter([1, 0.4], [1, -0.7], x) for x in e.T])
    return armrig.Signals(u=u, y=y, Ts=0.1, valid=rng.random(y.shape) >= missing)


def of_several(fit: armrig.Fit) -> Variants:
    """Return the numbers of a model that do not depend on the state's coordinates."""
    for i, j, channel in fit.channels():
        yield f"channel {i} {j}", (channel.theta, channel.std, channel.std_robust)
    yield "noise", (fit.noise_covariance, [q.loss for q in fit.quality])
    yield "poles", (np.sort(fit.poles().values.real), np.sort(fit.poles().std))
    yield "step", fit.step_response(12)
    data = driven_twice(0.1)
    for horizon in (1, 4, None):
        yield f"predicted {horizon}", fit.predict(data, horizon)
    yield "simulated", fit.simulate(data.u)


@variants
def MultivariableFit() -> Variants:
    orders = {"nb": 2, "nf": 2, "nk": [[1, 1], [1, 2]]}
    full, gaps = driven_twice(), driven_twice(0.1)
    fits = {
        "arx gaps": armrig.arx(gaps, na=[[2, 0], [1, 2]], nb=[[2, 1], [2, 2]]),
        "oe shared": armrig.oe(gaps, **orders, shared="denominator"),
        "bj gaps": armrig.bj(gaps, nc=1, nd=1, **orders),
        "armax shared": armrig.armax(full, na=3, nb=3, nc=2, shared="denominator"),
        "n4sid": armrig.n4sid(full, 3, replicates=20),
    }
    for name, fit in fits.items():
        for part, found in of_several(fit):
            yield f"{name} {part}", found


@variants
def ss() -> Variants:
    fits = {
        "innovations": armrig.ss(driven_twice(), order=3),
        "output error": armrig.ss(driven_twice(0.1), order=2, noise=False),
    }
    for name, fit in fits.items():
        for part, found in of_several(fit):
            yield f"{name} {part}", found


@variants
def armax() -> Variants:
    yield "offset", armrig.armax(integrating(), na=2, nb=2, nc=1, integrator=True, offset=True)
    yield "zero", armrig.armax(data()["mean"], na=2, nb=3, nc=1, nk=0, initial="zero")
    yield "unlike", armrig.armax(unlike(), na=2, nb=2, nc=1, nk=3)


@variants
def tf() -> Variants:
    fit = armrig.tf(holed(arm_data(3), 300), poles=4, zeros=2, integrator=True)
    yield "holes", (fit.theta, fit.std_robust, fit.quantities())


@variants
def process() -> Variants:
    system = of_a_system([0] * 5 + [0.5, 0.3], [1, -0.8], N=400, Ts=0.2)
    fit = armrig.process(system, "P1D")
    yield "dead time", (fit.theta, fit.std_robust, fit.quantities())


@variants
def two_stage() -> Variants:
    rng = np.random.default_rng(9)
    r, e = np.repeat(rng.choice([-1.0, 1.0], 50), 8), 0.1 * rng.standard_normal(400)
    u, y = np.zeros(400), np.zeros(400)
    for t in range(1, 400):
        y[t] = 0.8 * y[t - 1] + 0.5 * u[t - 1] + e[t]
        u[t] = r[t] - 0.5 * y[t]
    fit = armrig.two_stage(armrig.Dataset(u=u, y=y, Ts=0.1), r, nb=1, nf=1)
    yield "loop", (fit.theta, fit.std)


@variants
def ararx() -> Variants:
    yield "integrator", armrig.ararx(integrating(), na=2, nb=2, nd=1, integrator=True)
    yield "two", armrig.ararx(data()["two"], na=2, nb=2, nd=1)


@variants
def oe() -> Variants:
    yield "unlike integrator", oe_backwards()
    yield "integrator", oe_integrating()
    yield "unlike", armrig.oe(unlike(), nb=2, nf=2, nk=3)
    two = armrig.merge([integrating()[:250], integrating()[250:]])
    shifted = two.replaced(step=None, u=two.u + 0.8)
    yield "shifted", armrig.oe(shifted, nb=2, nf=2, integrator=True, offset=True)
    yield "zero", armrig.oe(data()["mean"], nb=3, nf=1, nk=0, initial="zero", stable=True)


@variants
def bj() -> Variants:
    yield "unlike", bj_unlike()
    yield "integrator", armrig.bj(integrating(), nb=2, nc=1, nd=1, nf=2, integrator=True)
    yield "holes", armrig.bj(data()["holes"], nb=2, nc=0, nd=1, nf=2, stable=True)


@variants
def pem() -> Variants:
    yield "unlike", armrig.pem(unlike(), nb=2, na=2, nd=1, nk=3)
    yield "odd", armrig.pem(data()["odd"], nb=2, na=1, nc=1, nf=1, nk=3)
    yield "a", armrig.pem(data()["plain"], nb=2, na=2, nc=1, initial="zero")


@variants
def n4sid() -> Variants:
    d = data()
    fits = {
        "integrator": armrig.n4sid(integrating(), 2, integrator=True, stable=True),
        "moesp": armrig.n4sid(d["odd"], 2, "moesp", nk=3),
        "n4sid": armrig.n4sid(d["odd"], 2, "n4sid", nk=3),
        "chosen": armrig.n4sid(d["plain"], horizon=8),
        "simulation": armrig.n4sid(d["two"], 2, focus="simulation"),
        "direct": armrig.n4sid(d["mean"], 3, nk=0),
        "unlike": armrig.n4sid(unlike(), 2, nk=3),
    }
    yield "integrator.state_space()", fits["integrator"].state_space()
    for name, fit in fits.items():
        yield name, fit
        for member in PROJECTION:
            yield f"{name}.{member}", getattr(fit if member == "order" else fit.projection, member)


@variants
def rarx() -> Variants:
    unlike_nk = armrig.rarx(unlike(), na=2, nb=2, nk=3, forgetting=0.98)
    yield "unlike", [unlike_nk, unlike_nk.error[40:]]
    forgetting = armrig.rarx(data()["two"], na=1, nb=4, nk=0, forgetting=0.96)
    yield "two", forgetting
    yield "two errors", forgetting.error[30:]
    yield "line", armrig.rarx(data()["line"], na=2, nb=2)


@variants
def rarx_start() -> Variants:
    yield "plain", armrig.rarx_start(na=2, nb=3, nk=2, forgetting=0.9)


@variants
def rarx_step() -> Variants:
    state, seen = armrig.rarx_start(na=2, nb=2, nk=3, forgetting=0.97), []
    for u, y in zip(unlike().u, unlike().y, strict=True):
        state = armrig.rarx_step(state, float(u), float(y))
        seen.append(state)
    yield "unlike", seen[29::31]


@variants
def select_orders() -> Variants:
    d = data()
    orders = (range(1, 4), range(1, 4), range(1, 3))
    yield "validation", armrig.select_orders(d["holes"], *orders, validation=d["two"])
    yield "two", armrig.select_orders(d["two"], (0, 2), (1, 4), (0, 3))
    yield "unlike alone", armrig.select_orders(unlike()[60:], (1, 2, 3), (1, 2), (2, 3, 4))


# Validation.


@variants
def residuals() -> Variants:
    slow, plain = armrig.arx(unlike(), na=2, nb=2, nk=3), data()["plain"]
    yield "unlike", armrig.residuals(slow, unlike())
    yield "unlike others", armrig.residuals(slow, unlike().select(2, 0), 11)
    still = plain.replaced(step=None, u=np.full(plain.N, 1.0))
    yield "still", armrig.residuals(oe_plain(), still)
    high = armrig.arx(data()["odd"], na=5, nb=5)
    yield "high", armrig.residuals(high, data()["odd"])
    yield "arm", armrig.residuals(armrig.arx(arm_data(), na=4, nb=4), holed(arm_data(2), 200))


@variants
def compare() -> Variants:
    slow = armrig.arx(unlike(), na=2, nb=2, nk=3), armrig.n4sid(unlike(), 2, nk=3)
    for horizon in (None, 3):
        found = armrig.compare(unlike().select(2, 1), *slow, horizon=horizon)
        yield f"unlike {horizon}", found
    yield "integrator", armrig.compare(unlike_integrating()[50:], oe_backwards(), labels=["one"])
    physics = armrig.physics.physical_model(ArmParameters(), arm_data())
    fit = armrig.arx(arm_data(), na=4, nb=4)
    yield "physics", armrig.compare(holed(arm_data(2)), fit, physics)


@variants
def search() -> Variants:
    plain = data()["plain"]
    some = {"families": ("oe", "arx"), "orders": (2, 1), "nk": (4, 3)}
    yield "unlike", armrig.search(unlike(), unlike().select(2, 0), **some)
    yield "plain", armrig.search(plain, data()["mean"], orders=range(1, 4))
    # The highest orders fail: fewer samples than they need.
    few = {"families": ("arx", "oe", "n4sid"), "orders": (2, 5, 30), "horizon": 3}
    failing = armrig.search(plain[:70], **few)
    yield "failing", (failing, len(failing.failed), len(failing.reasons))


@variants
def advice() -> Variants:
    yield "data", armrig.advice(data()["line"])
    yield "feedback", armrig.advice(fed_back())
    yield "fit", armrig.advice(armrig.arx(data()["odd"], na=4, nb=4))
    yield "unlike", armrig.advice(armrig.arx(unlike(), na=2, nb=2, nk=3))


@variants
def delay() -> Variants:
    yield "unlike integrator", armrig.delay(unlike_integrating(), integrator=True)
    yield "unlike", armrig.delay(unlike())
    yield "odd", armrig.delay(holed(data()["odd"]))
    yield "feedback", armrig.delay(fed_back())


@variants
def linearity() -> Variants:
    yield "rig", armrig.linearity(nonlinear_rig("gain by level", 1))


@variants
def open_loop() -> Variants:
    yield "integrator", armrig.open_loop(integrating())
    ends = np.cumsum(np.arange(1, 15) + 26)
    lost = np.concatenate([np.arange(end - n, end) for n, end in enumerate(ends, 1)])
    valid = ~np.isin(np.arange(500), lost)  # gaps of 1 to 14 samples: one is at any limit
    yield "gaps", armrig.open_loop(fed_back().replaced(step=None, valid=valid))
    yield "unlike", armrig.open_loop(unlike(1.0), 0.2)


def matrices(law: armrig.control.ControlLaw) -> tuple[Any, ...]:
    return (*(np.array(M) for M in (law.A, law.B, law.C)), law.D, law.u0)


@variants
def control_law() -> Variants:
    import control

    C = control.tf([0.2, -0.199], [1, -1], 0.01)
    yield "PI", matrices(armrig.control.control_law(C, outputs="alpha", reference=(-0.2, 0.2)))


@variants
def pid() -> Variants:
    import control

    yield (
        "heater",
        matrices(armrig.control.pid(control.tf([9.0], [175, 1]), time_constant=60.0, Ts=1.0)),
    )


@variants
def place() -> Variants:
    yield "arm", matrices(placed())


def placed() -> armrig.control.ControlLaw:
    plant = armrig.physics.arm(ArmParameters())
    return armrig.control.place(plant, [-18 + 18j, -18 - 18j, -42], rate=True, Ts=0.01)


@variants
def lqg() -> Variants:
    plant = armrig.physics.arm(ArmParameters())
    yield "arm", matrices(armrig.control.lqg(plant, effort=0.1, rate=True, Ts=0.01))


@variants
def check_law() -> Variants:
    found = armrig.control.check_law(placed(), armrig.physics.arm(ArmParameters()))
    yield (
        "arm",
        (found.worst_Ms, found.nominal.gain, found.nominal.phase_deg, found.nominal.delay_s),
    )


# Without structure.


@variants
def spa() -> Variants:
    d = data()
    yield "unlike", armrig.spa(unlike(), delay=3)
    yield "window", armrig.spa(d["plain"], 21, [0.1, 3.0, 12.0, 31.0], delay=1)
    yield "log", armrig.spa(d["plain"], "log")
    yield "unlike integrator", armrig.spa(unlike_integrating(), 24, integrator=True)


@cache
def periodic(noise: float = 0.05, output: bool = True) -> armrig.Dataset:
    """Return five periods of a signal with many lines, after the transient of a first."""
    rng = np.random.default_rng([3, 9])
    period = rng.standard_normal(80)
    u = np.tile(period, 5)
    return of_a_system(*COMPLEX, N=400, u=u, std=noise, seed=11)


@variants
def etfe() -> Variants:
    yield "periodic", armrig.etfe(periodic(), period_length=80)
    yield "integrator", armrig.etfe(integrating(), integrator=True)
    yield "unlike", armrig.etfe(unlike(1.0).select(1)[10:83])


@variants
def bla() -> Variants:
    rng = np.random.default_rng(4)
    several = [
        of_a_system(*COMPLEX, N=240, u=np.tile(rng.standard_normal(60), 4), seed=20 + i)
        for i in range(3)
    ]
    yield "several", armrig.bla(several, period_length=60, transient=2)
    pair = [
        of_a_system(*REAL, N=n, u=np.tile(rng.uniform(-3, 1, 35), n // 35), Ts=0.5)
        for n in (140, 175)
    ]
    yield "unlike", armrig.bla(pair, period_length=35, transient=1)


@variants
def impulse_response() -> Variants:
    d = data()
    yield "unlike integrator", armrig.impulse_response(unlike_integrating(), 18, integrator=True)
    yield "unlike", armrig.impulse_response(unlike(), 24, integrator=False)
    for kernel in ("dc", "ss"):
        yield kernel, armrig.impulse_response(d["plain"], 20, kernel)
    yield "plain", armrig.impulse_response(unlike()[50:], 12, None)
    yield "odd", armrig.impulse_response(d["odd"])


@variants
def correlation() -> Variants:
    yield "unlike", armrig.correlation(unlike(1.0), 9)
    yield "odd", armrig.correlation(data()["odd"], 8)
    yield "unlike integrator", armrig.correlation(unlike_integrating(), 7, integrator=True)


@variants
def step_analysis() -> Variants:
    yield "one", armrig.step_analysis(holed(steps()[40:119], 30, 1))
    u = np.repeat([0.0, 1.0], [40, 160])
    yield "overshoot", armrig.step_analysis(of_a_system(*COMPLEX, N=200, u=u, std=0.02, y_0=2.0))
    u = np.repeat([1.0, -2.0, 0.5, -1.0, 2.5], [30, 55, 25, 62, 40])
    down = of_a_system([0.0, 0.0, 0.0, -0.9], np.poly([0.7]), u=u, N=212, Ts=0.5, std=0.02, y_0=-3)
    ends = down[:90].replaced(step=None, valid=~np.isin(np.arange(90), [10, 33, 34, 60]))
    yield "unlike", armrig.step_analysis(armrig.merge([ends, down[90:]]))
    yield "unlike integrator", armrig.step_analysis(unlike_integrating(), integrator=True)
    u = np.repeat([-1.0, 2.0], [160, 200])
    slow = np.poly([0.93, 0.9, 0.8])
    yield (
        "smooth",
        armrig.step_analysis(of_a_system([0] * 6 + [-0.002], slow, u=u, N=360, std=1e-3)),
    )


@variants
def sampling_time() -> Variants:
    yield "steps", armrig.sampling_time(steps())
    yield "noisy", armrig.sampling_time(of_a_system(*COMPLEX, std=2.0, N=500))
    yield "arm", armrig.sampling_time(arm_data(2, 2000))
    yield "unlike integrator", armrig.sampling_time(unlike_integrating(), integrator=True)


@variants
def structure_hints() -> Variants:
    yield "odd", armrig.structure_hints(holed(data()["odd"]))
    yield "integrator", armrig.structure_hints(integrating(), integrator=True)


# Excitation.


@variants
def prbs() -> Variants:
    yield "plain", armrig.prbs(60)
    yield "clock", armrig.prbs(61, 3, 1.0, 2.0, 5)
    yield "register", armrig.prbs(70, 2, seed=np.random.default_rng(4), register=5)


@variants
def telegraph() -> Variants:
    yield "plain", armrig.telegraph(200, 0.1)
    yield "levels", armrig.telegraph(101, 0.4, 1.0, 3.0, 7)


@variants
def chirp() -> Variants:
    yield "linear", armrig.chirp(100, 0.01, 1.0, 20.0)
    yield "logarithmic", armrig.chirp(101, 0.02, 0.5, 15.0, 1.0, 2.0, sweep="logarithmic")


@variants
def multisine() -> Variants:
    yield "plain", armrig.multisine(64)
    yield "lines", armrig.multisine(90, (1, 3, 7), 1.0, 4.0, 5, periods=3)
    yield "rms", armrig.multisine(65, range(1, 9), 0.0, 5.0, seed=2, rms=0.6)


@variants
def staircase() -> Variants:
    yield "plain", armrig.staircase(61)
    yield "levels", armrig.staircase(50, (1.0, 3.0, 2.0), 0.5, 4.0)


@variants
def step() -> Variants:
    yield "plain", armrig.step(20)
    yield "late", armrig.step(20, low=1.0, high=2.0, at=7)


@variants
def white_noise() -> Variants:
    yield "uniform", armrig.white_noise(50)
    yield "normal", armrig.white_noise(51, 1.0, 3.0, 9, distribution="normal")


@variants
def input_from_file() -> Variants:
    path = folder() / "input.csv"
    path.write_text("\n".join(f"{x:.4f}" for x in switching(40, 6, 0.3)))
    yield "plain", armrig.input_from_file(path, 0.01)


@variants
def describe_input() -> Variants:
    yield "switching", armrig.describe_input(switching(300, 1, 0.1), 0.01)
    yield "noise", armrig.describe_input(np.random.default_rng(1).uniform(0.5, 4.5, 201), 0.05)
    yield "constant", armrig.describe_input(np.full(50, 2.0), 0.01)
    sines = 2.5 + np.sin(2 * np.pi * 5 * np.arange(200) / 100)
    yield "sine", armrig.describe_input(sines, 0.02)


@variants
def named_signal() -> Variants:
    from armrig.excitation import named_signals as n

    for name in n.NAMES:
        yield name, n.signal_by_name(name, 90, 0.01, a=0.1, low=1.0, high=4.0, seed=3)
    yield "step", n.step_at(50, 0.02, low=1.0, high=2.0, at=0.3)
    yield "levels", n.up_and_down(60, low=1.0, high=3.0, levels=4)
    yield "realisations", n.realisations(120, 3, 0.5, 4.5, 2, periods=2)
    yield "clock", n.clock_of(0.07)


def planned(noise_variance: float = 0.02, **more: Any) -> armrig.Fit:
    """Return a model for the design of an experiment."""
    known = {"B": COMPLEX[0], "F": COMPLEX[1], "nk": 1, "Ts": 0.1}
    return armrig.Fit.of_channel(noise_covariance=[[noise_variance]], **known | more)


@variants
def predicted_std() -> Variants:
    u = switching(201, 3, 0.2)
    yield "bj", armrig.predicted_std(planned(C=[1, 0.5], D=[1, -0.6]), u, noise_variance=0.1)
    arx = planned(A=COMPLEX[1], F=[1.0])
    yield "arx", armrig.predicted_std(arx, armrig.merge([late(), late()[:70]]))
    F = np.convolve([1.0, -0.7], [1.0, -1.0])
    model = planned(0.1, B=[0, 0.3, 0.2], F=F, integrator=True)
    yield "integrator", armrig.predicted_std(model, u)
    slow = planned(4.0, B=[0, 0, 0, -7.0, 2.5], F=np.poly([0.82, 0.35]), nk=3, Ts=0.5)
    yield "unlike", armrig.predicted_std(slow, unlike())
    fit = oe_backwards()
    yield "unlike fit", armrig.predicted_std(fit, unlike_integrating())


@variants
def predicted_parameter_std() -> Variants:
    predicted = partial(armrig.predicted_parameter_std, Ts=0.005, noise_variance=1e-5)
    u = switching(400, 5, 0.02)
    yield "chassis", predicted(armrig.physics.chassis, u)
    yield "two", predicted(armrig.physics.chassis, u, free=("J_1", "K_m"))
    yield "arm", predicted(armrig.physics.arm, u, free=("J_1", "J_2"), output="alpha")


# Physics.


OTHER = ArmParameters(J_1=0.0021, J_2=0.004, K_lin=0.9, R_m=2.8, b_1=0.002)


@variants
def ArmParameters_() -> Variants:
    yield "own", ArmParameters()
    yield "other", OTHER


CALLS["ArmParameters"] = CALLS.pop("ArmParameters_")


@variants
def arm() -> Variants:
    yield "own", armrig.physics.arm(ArmParameters())
    yield "other", armrig.physics.arm(OTHER)


@variants
def chassis() -> Variants:
    yield "own", armrig.physics.chassis(ArmParameters())
    yield "other", armrig.physics.chassis(OTHER)


@variants
def characteristics() -> Variants:
    yield "own", armrig.physics.characteristics()
    yield "other", armrig.physics.characteristics(OTHER)
    yield "stiff", armrig.physics.characteristics(replace(OTHER, K_lin=12.0))


@variants
def step_sensitivities() -> Variants:
    t = np.linspace(0, 0.8, 40)
    yield "rate", armrig.physics.step_sensitivities(ArmParameters(), t)
    few = {"names": ("J_1", "b_1"), "u": 2.0, "state": "theta_1"}
    yield (
        "chassis",
        armrig.physics.step_sensitivities(OTHER, t, model=armrig.physics.chassis, **few),
    )
    yield "alpha", armrig.physics.step_sensitivities(OTHER, t, names=("K_lin",), state="alpha")


@variants
def step_response() -> Variants:
    from armrig.physics.step_response import step_response

    t = np.linspace(0, 0.8, 40)
    for state in ("theta_1", "alpha_rate"):
        yield state, step_response(OTHER, t, state=state)


@variants
def physical_model() -> Variants:
    yield "angle", armrig.physics.physical_model(OTHER, arm_data())
    yield "rate", armrig.physics.physical_model(OTHER, armrig.difference(arm_data()))


@variants
def rehearse() -> Variants:
    u = switching(300, 2, 0.03)
    yield "plain", armrig.physics.rehearse(u, 0.01)
    yield "chassis", armrig.physics.rehearse(u, 0.005, parameters=OTHER, arm_removed=True)
    yield "from", armrig.physics.rehearse(u, 0.01, theta_1_rad=0.4, revolutions=9.0, alpha_rad=2.0)


LINEAR = arm_matrices(ArmParameters())[:2]
DAMPED = np.array([[0.0, 1.0], [-9.0, -0.8]]), np.array([[0.0], [2.0]])
METHODS_OF_INTEGRATION = ("forward_euler", "ab2", "trapezoidal", "heun", "midpoint")


@variants
def exact() -> Variants:
    yield "plain", armrig.physics.exact(*DAMPED, 2.0, 3.0, [1.0, -0.5], np.linspace(0, 3, 20))


@variants
def integrate() -> Variants:
    for method in METHODS_OF_INTEGRATION:
        found = armrig.physics.integrate(
            *DAMPED, lambda t: np.sin(2 * t) + t, [1.0, 0.2], 0.05, 30, method
        )
        yield method, found


@variants
def sinusoid() -> Variants:
    yield "plain", armrig.physics.sinusoid(*LINEAR, omega=10.0, amplitude=2.5)
    yield "from", armrig.physics.sinusoid(*DAMPED, omega=2.0, x0=[1.0, 0.0], span=3.0)


@variants
def convergence() -> Variants:
    problem = armrig.physics.sinusoid(*DAMPED, omega=2.0, x0=[1.0, 0.0], span=3.0)
    for method in METHODS_OF_INTEGRATION:
        yield method, armrig.physics.convergence(problem, method, [0.05, 0.025, 0.0125])
    yield "own", armrig.physics.convergence(problem, "heun")


@variants
def stability_limit() -> Variants:
    for method in METHODS_OF_INTEGRATION:
        yield (
            method,
            (
                armrig.physics.stability_limit(LINEAR[0], method),
                armrig.physics.stability_limit(DAMPED[0], method),
            ),
        )


@variants
def recommend_step() -> Variants:
    yield (
        "arm",
        armrig.physics.recommend_step(*LINEAR, omega=10.0, amplitude=2.5, methods=("ab2", "heun")),
    )
    yield "damped", armrig.physics.recommend_step(*DAMPED, omega=2.0, tolerance=1e-4, span=4.0)


@variants
def greybox() -> Variants:
    whole = chassis_data()
    two = armrig.merge([holed(whole[:400], 130), chassis_data(3, 500)])
    yield "plain", armrig.greybox(whole)
    yield "two", armrig.greybox(two, free=("J_1", "K_m"))
    fixed = {"fixed": replace(ArmParameters(), R_m=3.0), "fixed_std": {"R_m": 0.03, "K_m": 1e-4}}
    yield "fixed", armrig.greybox(whole, **fixed)
    yield "friction", armrig.greybox(rubbing(), friction="coulomb")
    yield "both ways", armrig.greybox(both_ways(), friction="coulomb")
    yield "viscous", armrig.greybox(rubbing(), friction="viscous", fixed_std={"K_m": 2e-4})
    yield "arm", armrig.greybox(holed(arm_data(), 160), armrig.physics.arm, ("J_1", "J_2"))
    chassis = armrig.Ode(
        f=lambda t, x, u, p: [x[1], (0.167 * u[0] - p.d * x[1]) / p.J],
        output=lambda t, x, u, p: x[0],
        states=["theta_1", "rate"],
        parameters={"J": armrig.Parameter(3e-3, low=0), "d": armrig.Parameter(0.05, low=0)},
    )
    yield "equations", armrig.greybox(holed(whole, 200), chassis)


@variants
def friction() -> Variants:
    curve = {"coulomb": 0.5, "viscous": 0.1, "static": 0.8, "width": 0.05}
    yield "curve", armrig.friction(np.linspace(-2, 2, 9), **curve)


@variants
def saturation() -> Variants:
    yield "plain", armrig.saturation(np.linspace(-2, 2, 9), -1.0, 0.5)


@cache
def rubbing() -> armrig.Dataset:
    """Return the chassis with dry friction, which the voltage always overcomes."""
    d = chassis_data(5)
    lag = np.cumsum(np.sign(d.u - 2.5) * 2e-5)
    return d.replaced(step=None, y=d.y - 0.3 * d.t + lag)


@cache
def both_ways() -> armrig.Dataset:
    """Return the emulator's chassis with dry friction, driven both ways."""
    from tests.clients import chassis_data

    u = 0.7 * switching(1200, 8, 0.01, -3.0, 3.0) + 0.5 * np.sin(0.02 * np.arange(1200))
    y = chassis_data.rubbing(u, ArmParameters(), 0.02)
    y += 1e-3 * np.random.default_rng(8).standard_normal(u.size)
    return armrig.Dataset(u=u, y=y, Ts=chassis_data.Ts, output="theta_1", unit="rad")


@variants
def split_study() -> Variants:
    yield "plain", armrig.split_study(chassis_data())
    yield "three", armrig.split_study(holed(chassis_data(), 200), (1, 3))
    fit = partial(armrig.arx, na=2, nb=2)
    yield "arx", armrig.split_study(data()["plain"], (1, 2), fit, parameter="b1")
    slow = partial(armrig.arx, na=2, nb=2, nk=3)
    yield "unlike", armrig.split_study(unlike(), (1, 2, 3), slow, parameter="b2")


# Recordings.


@cache
def recorded(kind: str) -> Path:
    """Return the path of a recording: the arm's with jitter, reports and events, and a gap."""
    from tests.clients import made_recordings as made

    inputs: dict[str, tuple[Vector, dict[str, Any]]] = {
        "estimation": (switching(700, 1, 0.05), {}),
        "validation": (switching(500, 2, 0.05), {"seed": 2, "missing": slice(300, 305)}),
        "step": (np.repeat([0.5, 4.5], [50, 150]), {"experiment": "step"}),
        "turned": (switching(400, 4, 0.05), {"seed": 4, "start": 3.0}),
    }
    u, options = inputs[kind]
    return made.written(folder(), made.of_the_arm(u, **options), f"{kind}.mcap")


@cache
def told() -> Path:
    """Return the path of a recording with the daemon's reports, flags and a rail."""
    from armrig_core.telemetry import protobuf

    from tests.clients import made_recordings as made

    rng = np.random.default_rng(12)
    counts = 32768 + np.cumsum(np.repeat(rng.integers(100, 900, 40), 5)) * 1
    samples = made.turning([int(c) % 67000 if c % 67000 < 65536 else 0 for c in counts * 1])
    messages: list[Any] = []
    for k, s in enumerate(samples):
        late = int(3_000 + 9_000 * rng.random())
        if 120 <= k < 124:
            messages += [made.gap(120, 4, 2.5)] if k == 120 else []
            continue
        messages.append(
            s._replace(t_host_ns=s.t_sched_ns + late, t_device_us=s.t_device_us + late // 900)
        )
        if k % 50 == 49:
            report = made.timing(k)
            report.link_round_trip_us.max, report.link_round_trip_us.n = 600.0 + k, 100
            report.collections = k // 10
            report.run_queue = 2 + k // 60
            report.cpu_pressure_percent = 1.5 * k
            clock = protobuf.message_class(protobuf.CLOCK)(t_host_ns=s.t_host_ns)
            clock.drift_ppm, clock.drift_std_ppm = 12.5 + k, 0.25
            clock.offset_ns, clock.offset_std_ns, clock.bound_ns = 1000 * k, 40 * k, 500 * k
            messages += [report, clock, made.event(k, "held up")]
    about = made.manifest(samples=len(samples))
    return made.written(folder(), made.recorded(messages, manifest=about), "told.mcap")


HIDDEN = (4.9, 5.2, 5.4)
"""Starting angles of a chassis whose rise after a step is in the dead band."""


@cache
def hidden(start: float) -> Path:
    """Return the path of a recording of a step from a voltage that turns the chassis."""
    from tests.clients import made_recordings as made

    u = np.repeat([0.5, 4.5], [100, 100])
    data = made.of_the_arm(u, experiment="step", start=start)
    return made.written(folder(), data, f"hidden-{start}.mcap")


@variants
def load() -> Variants:
    for kind in ("validation", "step", "turned"):
        yield kind, armrig.load(recorded(kind))
    yield "part", armrig.load(recorded("validation"), start=2.5, stop=4.0)
    for start in (0.37, 0.55, 0.9, 1.3):
        yield f"from {start}", armrig.load(told(), start=start)
    yield "told", armrig.load(told())
    yield "calibrated", armrig.load(recorded("turned"), other_calibration())


def other_calibration() -> Any:
    """Return a calibration that is not the default."""
    from armrig_core.rig.calibration import Calibration, Driver, Potentiometer

    return Calibration(
        theta_1=Potentiometer(zero_counts=30000.0, rad_per_count=-9.1e-5, wraps=True),
        alpha=Potentiometer(zero_counts=33000.0, rad_per_count=7e-5, wraps=False),
        driver=Driver(gain=0.97, offset_v=0.03),
    )


@variants
def dataset() -> Variants:
    for kind in ("validation", "turned"):
        for output in ("theta_1", "alpha", "velocity"):
            yield f"{kind} {output}", armrig.load(recorded(kind)).dataset(output)


@variants
def sampling_statistics() -> Variants:
    for path in (recorded("validation"), told()):
        yield path.stem, armrig.sampling_statistics(armrig.load(path))


@variants
def data_verdict() -> Variants:
    for path in (recorded("validation"), recorded("turned"), told()):
        yield path.stem, armrig.data_verdict(armrig.load(path))


@variants
def of_recordings() -> Variants:
    from armrig.recordings import findings, jitter, overview, usability
    from armrig.recordings.files.recording_summary import summary_of
    from armrig.recordings.files.verification import verify_recording
    from armrig.recordings.recording import export_columns

    for start in HIDDEN:
        yield f"hidden {start}", findings.check_step(armrig.load(hidden(start)))
    for path in (recorded("validation"), recorded("turned"), told()):
        r = armrig.load(path)
        yield f"{path.stem} disturbances", jitter.disturbances(r)
        yield f"{path.stem} overview", overview.overview(r)
        yield f"{path.stem} verification", verify_recording(r)
        yield f"{path.stem} columns", export_columns(r, raw=True)
        yield f"{path.stem} summary", summary_of(path)
        yield f"{path.stem} jitter", [jitter.jitter_us(r), jitter.lateness_us(r)]
        yield f"{path.stem} hidden", findings.check_step(r)
        turned = jitter.angle_of_jitter(armrig.sampling_statistics(r), r.dataset())
        yield f"{path.stem} angle", turned
        yield f"{path.stem} doubts", usability.all_doubts([r, armrig.load(recorded("step"))])


@variants
def catalogue() -> Variants:
    recorded("validation"), recorded("step")
    lab = folder() / "lab"
    lab.mkdir(exist_ok=True)
    for kind in ("validation", "step"):
        (lab / f"{kind}.mcap").write_bytes(recorded(kind).read_bytes())
    yield "lab", armrig.catalogue(lab)


@variants
def calibration() -> Variants:
    from armrig.physics.calibration import estimate
    from armrig_core.rig.calibration import Calibration, Made

    from tests.clients.made_turns import made_turns, still

    rest = still()
    meter = [(1.0, 1.03), (2.5, 2.51), (4.5, 4.46)]
    made = Made(date="2026-11-20", rig="1", device_uid="0001", armrig="0.1.0", figures={})
    cases: dict[str, Any] = {
        "rest": estimate(rest),
        "turns": estimate(rest, made_turns(noise=40.0)),
        "one": estimate(rest, made_turns(omega=(2.5,), direction=-1, noise=20.0)),
        "three": estimate(rest, made_turns(omega=(1.9, 3.1, 4.4), noise=30.0, seed=2), meter=meter),
        "meter": estimate(rest, meter=meter[:2], meter_std_v=0.02),
    }
    deflected = replace(rest, second=rest.second + 3000.0)
    cases["deflected"] = estimate(
        rest, made_turns(noise=40.0), deflected=deflected, meter=meter[:1]
    )
    for name, found in cases.items():
        yield name, found
        yield f"{name} made", found.calibration(Calibration(), made)


# What rests on all of it.


@variants
def load_fit() -> Variants:
    path = folder() / "model.json"
    bj_odd().save(path)
    yield "bj", armrig.load_fit(path)
    armrig.n4sid(data()["plain"], 2).save(path)
    yield "n4sid", armrig.load_fit(path)


@variants
def summary() -> Variants:
    fits = oe_backwards(), bj_unlike()
    yield "characteristics", [fit.summary().figures for fit in fits]
    yield "high", armrig.arx(data()["odd"], na=5, nb=5).summary()
    yield "n4sid", armrig.n4sid(data()["plain"], 3).summary()


@variants
def uncertainty() -> Variants:
    from armrig.models import uncertainty as u
    from armrig.models.uncertainty import parameter_draws

    d = data()
    few = d["odd"][:60]
    fits = {
        "poor": armrig.arx(few, na=3, nb=3),
        "integrator": oe_integrating(),
    }
    for name, fit in fits.items():
        draws = parameter_draws(fit, n=200)
        yield f"{name} draws", draws
        yield f"{name} poles", u.pole_regions(fit, draws)
        yield f"{name} zeros", u.zero_regions(fit, draws)
        yield (
            f"{name} bands",
            u.frequency_bands(fit, fit.frequency_response(frequencies(fit)), draws),
        )
        yield f"{name} step", u.step_band(fit, fit.step_response(20), draws)
        yield (
            f"{name} rate",
            u.step_band(fit, fit.step_response(20, rate=True), parameter_draws(fit)),
        )


@variants
def report() -> Variants:
    from armrig.report.handout_study import handout_study
    from armrig.report.study import study

    paths = (recorded("step"), recorded("estimation"), recorded("validation"), told())
    read = [armrig.load(path) for path in paths]
    yield "study", study(read[:3])
    handout = handout_study(read[:1])
    yield "handout", (handout.step, handout.sampling, handout.steps)


@variants
def batch() -> Variants:
    from armrig.report.batch.tasks import Identify, Validate, Verify, items_in, row_of

    lab = folder() / "batch"
    lab.mkdir(exist_ok=True)
    for kind in ("estimation", "validation"):
        (lab / f"{kind}.mcap").write_bytes(recorded(kind).read_bytes())
    items = items_in(lab, rigs=(), kinds=())
    yield "validations", validations()
    model = folder() / "batch.json"
    armrig.arx(armrig.load(recorded("estimation")).dataset(), na=4, nb=4).save(model)
    tasks = {
        "oe": Identify(structure="oe", orders={"nb": 4, "nf": 4}, integrator=True),
        "arx": Identify(
            structure="arx", orders={"na": 3, "nb": 3}, signal="velocity", detrend=True
        ),
        "validate": Validate(model=model.read_text()),
        "verify": Verify(),
    }
    for name, task in tasks.items():
        rows = [row_of(task, item) for item in items]
        yield name, [{k: v for k, v in row.items() if k != "modified_ns"} for row in rows]


def validations() -> list[int]:
    """Return the number of the recording that validates each of a folder, of several the newest."""
    from armrig.report.batch.tasks import items_in

    from tests.clients import made_recordings as made

    lab = folder() / "pairs"
    lab.mkdir(exist_ok=True)
    for i in range(3):
        details = {"validation_of": "run-0"} if i else {}
        times = {"run_id": f"run-{i}", "started": f"2026-11-20T05:0{i}:00+01:00"}
        kind = "blackbox-validation" if i else "blackbox"
        about = made.manifest(details=details, experiment=kind, **times)
        made.written(lab, made.recorded([made.sample(0)], manifest=about), f"of-{i}.mcap")
    items = items_in(lab)
    return [int(Path(i.validation).stem[-1]) if i.validation else -1 for i in items]
