"""Tables, sentences and figures of comparisons made by hand, word for word."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset, Signals
from armrig.data.merging import merge
from armrig.models.characteristics import SCALARS, ModelCharacteristics
from armrig.models.fit import Fit
from armrig.numerics.confidence_regions import Band
from armrig.numerics.polynomial import Array
from armrig.validation.comparison import Comparison, ComparisonTable, _misfit, compare
from armrig.validation.model_differences import explanation
from armrig_core.errors import InputError
from matplotlib.figure import Figure

from tests.clients.models.made_fits import made

PHYSICS = Fit.of_channel(B=np.array([0.0, 1.0]), nk=1, Ts=0.1)


def figures(
    values: dict[str, float] | None = None,
    *,
    std: float | dict[str, float] = 0.1,
    sampled: dict[str, tuple[float, float]] | None = None,
    **fields: Any,
) -> ModelCharacteristics:
    """Return characteristics: 1, 2, 3 … by name unless given."""
    known = {name: k + 1.0 for k, name in enumerate(SCALARS)} | (values or {})
    deviations = dict.fromkeys(SCALARS, std) if isinstance(std, float) else std
    linear = Band(low=np.array(0.0), high=np.array(1.0), method="linearised")
    ranges = dict.fromkeys(SCALARS, linear)
    for name, (low, high) in (sampled or {}).items():
        ranges[name] = Band(low=np.array(low), high=np.array(high), method="sampled")
    others: dict[str, Any] = {
        "integrating": False,
        "poles": np.array([-1.25 + 3j, -1.25 - 3j, -40.0, np.nan]),
        "poles_std": np.array([0.012, 0.012, 0.0, 0.0]),
        "poles_sampled": np.array([True, True, False, False]),
        "draws": None,
    }
    return ModelCharacteristics(**known, std=deviations, ranges=ranges, **(others | fields))


def row(name: str, rms: float, t: ModelCharacteristics | None = None, **fields: Any) -> Any:
    values: dict[str, Any] = {
        "channel": made(structure="oe", F=(1, -0.5)),
        "on_estimation_data": False,
    }
    return SimpleNamespace(
        name=name, rms_error=rms, characteristics=t or figures(), **(values | fields)
    )


@pytest.mark.parametrize(
    ("sizes", "own", "said"),
    [
        (
            (0.2, 0.5, 0.3999),
            (False, True, False),
            "m0 is closest to these data, 0.2 rms against 0.4 of m2: a small difference.",
        ),
        (
            (0.5, 0.2),
            (False, True),
            "m1 is closest to these data, 0.2 rms against 0.5 of m0, but it was estimated from "
            "these data: compare on another recording.",
        ),
        ((0.2, 0.20001), (False, False), "m0 and m1 are equally close to these data, 0.2 rms."),
    ],
)
def test_the_closest_model_is_named_with_its_error(
    sizes: tuple[float, ...], own: tuple[bool, ...], said: str
) -> None:
    rows = [
        row(f"m{k}", rms, on_estimation_data=seen)
        for k, (rms, seen) in enumerate(zip(sizes, own, strict=True))
    ]

    assert explanation(rows)[0] == said


def test_differences_are_relative_to_the_physics_in_any_order() -> None:
    """A difference counts beyond 2.58 σ of both models, and beyond a thousandth."""
    physics = row("physics", 1.0, figures({"overshoot": -8.0}, std=0.03), channel=PHYSICS)
    fit = row("fit", 1.1, figures({"gain": 1.12, "bandwidth": 4.2, "overshoot": 8.0}, std=0.04))

    for rows in ([physics, fit], [fit, physics]):
        lines = explanation(rows)[1:]

        assert [line.partition(";")[0] for line in lines] == [
            "bandwidth: fit 4.200 ± 0.040, physics 4.000 ± 0.030 (+5 %)",
            "overshoot: fit 8.000 ± 0.040, physics −8.000 ± 0.030 (−200 %)",
        ]
    last = row("last", 1.0, figures(std=1.0))
    assert explanation([fit, last])[1:] == [
        "fit and last: no characteristic differs by more than its uncertainty (2.58 σ)."
    ]
    exact = [row("a", 1.0, figures({"gain": 1.0009}, std=0.0)), row("b", 1.0, figures(std=0.0))]
    assert "no characteristic differs" in explanation(exact)[1]
    exact = [row("a", 1.0, figures({"gain": 1.0011}, std=0.0)), row("b", 1.0, figures(std=0.0))]
    assert explanation(exact)[1].startswith("steady gain: a 1.0011, b 1 (+0.11 %); on the rig")


def test_the_differences_of_a_poor_model_are_not_explained() -> None:
    arx = made(structure="arx", A=(1, -0.5))
    said = [
        explanation([row("a", rms, channel=model), row("b", 0.1)])[1]
        for rms, model in ((0.51, arx), (0.51, made(structure="oe", F=(1, -0.5))), (0.5, arx))
    ]

    assert said[0].startswith("a has 5.1 times the error of b: its characteristics differ because")
    assert said[0].endswith("noise at the output biases it: take OE.")
    assert said[1].endswith("because the model is poor. Look at its orders and its delay.")
    assert said[2].startswith("a and b: no characteristic differs")


def data(output: str = "alpha", unit: str = "rad") -> Dataset:
    """Return six samples without the fourth."""
    y = np.array([0.0, 1.0, 2.0, 99.0, 4.0, 3.0])
    valid = np.array([True, True, True, False, True, True])
    return Dataset(u=np.zeros(6), y=y, Ts=0.5, valid=valid, output=output, unit=unit)


def compared(name: str, y: Any, rms: float, **fields: Any) -> Comparison:
    values: dict[str, Any] = {
        "output": "alpha",
        "unit": "rad",
        "fit_percent": 12.345,
        "velocity_fit_percent": None,
        "on_estimation_data": False,
        "model": PHYSICS,
    }
    return Comparison(name=name, rms_error=rms, y=np.asarray(y, float), **(values | fields))


def test_only_samples_known_to_both_models_are_compared() -> None:
    """Errors 1, 1 about a mean of 2, squared deviations 1 + 0 + 1."""
    measured = np.array([1.0, 2.0, 3.0, np.nan, 5.0])
    modelled = np.array([2.0, 2.0, 4.0, 9.0, np.nan])

    percent, rms = _misfit(measured, modelled)

    assert (percent, rms) == (pytest.approx(0.0, abs=1e-9), pytest.approx(np.sqrt(2 / 3)))
    assert _misfit(measured, np.append(modelled[:4], -np.inf)) == (-np.inf, np.inf)
    assert np.isnan(_misfit(measured, np.full(5, np.nan))).all()


@pytest.mark.parametrize(
    ("integrators", "output", "offset", "velocity"),
    [
        ((False,), "alpha", False, False),
        ((True,), "alpha", True, True),
        ((False, True), "alpha", True, True),
        ((False,), "theta_1", False, True),
    ],
)
def test_the_velocity_is_compared_if_the_output_or_a_model_integrates(
    integrators: tuple[bool, ...], output: str, offset: bool, velocity: bool
) -> None:
    rng = np.random.default_rng(1)
    parts = []
    for _ in range(2):
        u = rng.standard_normal(30)
        valid = np.arange(30) != 12
        y = np.cumsum(u) + 0.1 * rng.standard_normal(30)
        parts.append(Dataset(u=u, y=y, Ts=0.1, output=output, unit="rad", valid=valid))
    whole = merge(parts)
    models = [
        made(
            B=(0, 0.5), F=np.convolve([1, -1], [1, -0.5]) if i else (1, -0.5), integrator=i,
            output=output,
        )
        for i in integrators
    ]  # fmt: skip

    found = compare(whole, *models, horizon=1)

    assert ("and input offset" in found.note) == offset
    for row_ in found.rows:
        assert (row_.velocity_fit_percent is not None) == velocity
        if row_.velocity_fit_percent is None:
            continue
        # Differences within each experiment, where both samples are measured.
        rates = [
            np.concatenate([np.diff(x[:12]), np.diff(x[13:30]), np.diff(x[30:42]), np.diff(x[43:])])
            for x in (whole.y, row_.y)
        ]
        error = np.linalg.norm(rates[0] - rates[1])
        expected = 100 * (1 - error / np.linalg.norm(rates[0] - rates[0].mean()))
        assert row_.velocity_fit_percent == pytest.approx(expected)


@pytest.mark.parametrize(("largest", "limit"), [(0.79, 0.0), (0.81, 0.3), (5.0, 0.3)])
def test_a_scale_is_logarithmic_beyond_three_times_the_least_error_if_one_is_8_times_it(
    largest: float, limit: float
) -> None:
    y = data().y
    rows = (compared("a", y + 0.1, 0.1), compared("b", y + largest, largest))

    table = ComparisonTable(rows=rows, horizon=None, note="", data=data())
    ax = Figure().add_subplot()
    table.plot(ax=ax)

    below = ax.figure.axes[1]
    assert below.get_yscale() == ("symlog" if limit else "linear")
    said = [text.get_text() for text in below.get_legend().get_texts()]
    edges = sorted(line.get_ydata()[0] for line in below.lines if line.get_linestyle() == ":")
    assert edges == ([-limit, limit] if limit else [])
    texts = " ".join([*said, below.get_legend().get_title().get_text()])
    assert (f"scale logarithmic beyond ±{limit:g} rad, dotted" in texts) == bool(limit)
    if limit:
        assert below.get_ylim()[1] == pytest.approx(2 * (largest - 0.1))


class Constant:
    """A model that predicts the same numbers always."""

    label = "constant"
    form = SimpleNamespace(integrators=(False, False))
    ny, nu = 2, 1

    def __init__(self, *y: float) -> None:
        self.y = np.array(y)

    def predict(self, data: Signals, horizon: int | None = 1) -> Array:
        return np.tile(self.y, (data.u.shape[0], 1))

    def estimated_from(self, data: Signals) -> bool:
        """Return whether the first number is 0."""
        return bool(self.y[0] == 0)


def compared_outputs() -> ComparisonTable:
    """Return a comparison of two models over outputs with missing samples."""
    y = np.array([[1.0, 2.0], [3.0, 4.0], [99.0, 6.0], [5.0, 99.0]])
    valid = np.array([[1, 1], [1, 1], [0, 1], [1, 0]], dtype=bool)
    data = Signals(
        u=np.zeros((4, 1)), y=y, Ts=0.5, valid=valid, outputs=["a", "long"], units=["rad", ""]
    )
    models: Any = Constant(3.0, 0.0), Constant(0.0, 4.0)
    return compare(data, *models, labels=("first", "second"), horizon=2)


def test_outputs_are_compared_at_their_measured_samples() -> None:
    """The outputs are 1, 3, 5 and 2, 4, 6."""
    table = compared_outputs()
    first, second = table.models
    spread = np.sqrt(8.0)

    assert [(r.name, r.output, r.unit) for r in table.of("a")] == [
        ("first", "a", "rad"),
        ("second", "a", "rad"),
    ]
    assert [r.rms_error for r in first] == pytest.approx([np.sqrt(8 / 3), np.sqrt(56 / 3)])
    assert [r.fit_percent for r in first] == pytest.approx([0, 100 * (1 - np.sqrt(56) / spread)])
    assert [r.rms_error for r in second] == pytest.approx([np.sqrt(35 / 3), np.sqrt(8 / 3)])
    assert [r.fit_percent for r in second] == pytest.approx([100 * (1 - np.sqrt(35) / spread), 0])
    assert [r.on_estimation_data for r in table] == [False, False, True, True]
    assert [f.about for f in compared_outputs().findings] == ["own data"]
    unbounded: Any = Constant(np.inf, 0.0)
    one, other = compare(compared_outputs().data, unbounded)
    assert (one.fit_percent, one.rms_error) == (-np.inf, np.inf)
    assert np.isfinite(other.rms_error)
    with pytest.raises(InputError, match="there is no such output; there are a, long"):
        table.of("b")


def test_a_panel_for_each_output_has_the_fits_of_its_models() -> None:
    table = compared_outputs()

    panels = table.plot().axes

    texts = [[text.get_text() for text in panel.texts] for panel in panels]
    assert "fit 0.0 %, -109.2 %" in texts[0]
    assert "fit -164.6 %, 0.0 %" in texts[1]
    for i, panel in enumerate(panels):
        measured, *models = panel.lines[:3]
        shown = np.asarray(measured.get_ydata(), float)
        valid = table.data.valid[:, i]
        np.testing.assert_array_equal(shown[valid], table.data.y[valid, i])
        for line, of_model in zip(models, table.models, strict=True):
            np.testing.assert_array_equal(line.get_ydata(), of_model[i].y)
    assert "rad" in panels[0].get_ylabel()
    assert panels[1].get_xlim() == (0.0, 1.5)
