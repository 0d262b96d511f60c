"""Figures show what they say, with units, and name the recording they show."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from armrig import plots
from armrig.recording import Recording, load
from armrig.study import Study, study
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

Plot = Callable[[Study, Recording, Axes | None], Axes]


@pytest.fixture(scope="module")
def recording(three_recordings: tuple[Path, Path, Path]) -> Recording:
    """Give the validation recording."""
    return load(three_recordings[2])


@pytest.fixture(scope="module")
def done(three_recordings: tuple[Path, Path, Path]) -> Study:
    """Give a study of all three."""
    return study([load(path) for path in three_recordings])


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """Draw without a screen, and leave no figure open."""
    with mpl.rc_context({"backend": "agg"}):
        yield
        plt.close("all")


PLOTS: dict[str, Plot] = {
    "data": lambda s, r, ax: plots.plot_data(r, ax=ax),
    "jitter": lambda s, r, ax: plots.plot_timing(r, ax=ax),
    "lateness": lambda s, r, ax: plots.plot_timing(r, quantity="lateness", ax=ax),
    "compare": lambda s, r, ax: plots.plot_compare(s.validation, *(m.fit for m in s.models), ax=ax),
    "residuals": lambda s, r, ax: plots.plot_residuals(s.models[1].fit, s.validation, ax=ax),
    "bode": lambda s, r, ax: plots.plot_bode(*(m.fit for m in s.models), ax=ax),
    "poles and zeros": lambda s, r, ax: plots.plot_poles_zeros(*(m.fit for m in s.models), ax=ax),
    "step": lambda s, r, ax: plots.plot_step(*(m.fit for m in s.models), ax=ax),
}
EVERY = pytest.mark.parametrize("plot", PLOTS.values(), ids=PLOTS.keys())


@EVERY
def test_a_plot_draws_into_the_axes_it_is_given(
    plot: Plot, done: Study, recording: Recording
) -> None:
    """And returns them, and opens no window of its own."""
    ax = Figure().add_subplot()

    assert plot(done, recording, ax) is ax
    assert ax.has_data()
    assert plt.get_fignums() == []


@EVERY
def test_a_plot_without_axes_makes_them(plot: Plot, done: Study, recording: Recording) -> None:
    """For a person at the prompt."""
    ax = plot(done, recording, None)

    assert ax.has_data()
    assert len(plt.get_fignums()) == 1


@EVERY
def test_a_plot_names_its_recording(plot: Plot, done: Study, recording: Recording) -> None:
    """By the first twelve digits of the hash of what it was made from."""
    ax = plot(done, recording, Figure().add_subplot())

    of_data = plot in (PLOTS["data"], PLOTS["jitter"], PLOTS["lateness"])
    validation = plot in (PLOTS["compare"], PLOTS["residuals"])
    source = done.validation.source if of_data or validation else done.estimation.source
    assert ax.get_title(loc="right") == f"recording {source[:12]}"


@EVERY
def test_every_axis_says_what_it_shows(plot: Plot, done: Study, recording: Recording) -> None:
    """Each panel has a label at its value axis, the lowest one at the other too."""
    ax = plot(done, recording, Figure().add_subplot())

    panels = ax.figure.axes
    assert all(panel.get_ylabel() for panel in panels)
    assert panels[-1].get_xlabel()


def test_models_are_told_apart_without_colour(done: Study) -> None:
    """By the style of their lines."""
    ax = plots.plot_step(*(m.fit for m in done.models), ax=Figure().add_subplot())

    styles = [str(line.get_linestyle()) for line in ax.lines]
    assert len(set(styles)) == len(styles) == 3


def test_colours_differ_in_lightness(done: Study) -> None:
    """On a black and white printer the first two models differ by more than a tenth."""
    first, second = (np.dot(to_rgb(c), (0.299, 0.587, 0.114)) for c in (plots.BLUE, "#D55E00"))

    assert abs(first - second) > 0.1


def test_missing_samples_are_shaded(recording: Recording) -> None:
    """One shade for each stretch without an angle, in both panels."""
    ax = plots.plot_data(recording, ax=Figure().add_subplot())

    edges = np.diff(np.concatenate([[0], (~recording.valid).astype(int), [0]]))
    assert len(ax.patches) == np.count_nonzero(edges == 1) > 3


def test_the_histogram_tells_its_percentiles(recording: Recording) -> None:
    """Those of the data, not of what fits into the bins."""
    ax = plots.plot_timing(recording, quantity="lateness", ax=Figure().add_subplot())

    late = (recording.samples["t_host_ns"] - recording.samples["t_sched_ns"]) / 1e3
    legend = ax.get_legend()
    assert legend is not None
    said = [text.get_text() for text in legend.get_texts()]
    expected = [f"{n} {np.percentile(late, q):.3g} µs" for n, q in (("p50", 50), ("p99", 99))]
    assert said == [*expected, f"max {late.max():.3g} µs"]


def test_every_sample_is_in_the_histogram(recording: Recording) -> None:
    """The smallest at the left edge, the largest in the last bin."""
    ax = plots.plot_timing(recording, quantity="lateness", ax=Figure().add_subplot())

    counted = sum(patch.get_height() for patch in ax.patches)  # type: ignore[attr-defined]
    assert counted == recording.samples.size


def test_the_bode_band_is_three_standard_deviations(done: Study) -> None:
    """Of the magnitude, above the curve."""
    fit = done.models[1].fit
    omega = np.geomspace(1.0, 100.0, 20)
    ax = plots.plot_bode(fit, omega=omega, ax=Figure().add_subplot())

    answer = fit.frequency_response(omega)
    upper = np.abs(answer.G) + 3 * answer.std_magnitude
    edge = ax.collections[0].get_paths()[0].vertices
    heights = {round(float(np.log10(y)), 9) for y in np.asarray(edge)[:, 1]}
    assert all(round(float(np.log10(v)), 9) in heights for v in upper)


def test_the_bode_plot_takes_a_control_system(done: Study) -> None:
    """The physics as python-control has it lies on the model made from it."""
    import control
    from armrig_core.arm import ArmParameters, arm_matrices

    A, B, C = arm_matrices(ArmParameters())
    system = control.ss(A, B, C[:1], 0)
    omega = np.array([0.5, 1.0, 2.0])
    ax = plots.plot_bode(
        done.models[2].fit, system, omega=omega, labels=["a", "b"], ax=Figure().add_subplot()
    )

    sampled, continuous = (np.asarray(line.get_ydata()) for line in ax.lines)
    np.testing.assert_allclose(sampled, continuous, rtol=1e-3)


def test_identical_errors_need_no_logarithm(done: Study) -> None:
    """The errors' scale is linear where no model is far worse than another."""
    oe = done.models[1].fit
    ax = plots.plot_compare(done.validation, oe, oe, ax=Figure().add_subplot())

    assert ax.figure.axes[1].get_yscale() == "linear"


def test_a_fit_shows_itself(done: Study) -> None:
    """Frequency response with bands, step response, poles and zeros with regions, all named."""
    fit = done.models[1].fit

    figure = fit.plot()

    labels = [(ax.get_xlabel(), ax.get_ylabel()) for ax in figure.axes]
    assert {x for x, _ in labels} >= {r"$\omega$ [rad/s]", "$t$ [s]", "Re $z$"}
    bands = [ax for ax in figure.axes if ax.collections]
    assert len(bands) == 3  # magnitude, phase, step
    [roots] = [ax for ax in figure.axes if ax.get_xlabel() == "Re $z$"]
    regions = len(fit.poles()) + len(fit.zeros())
    assert len(roots.lines) == 3 + 2 + regions  # circle and axes, poles and zeros
    signed = [ax.get_title(loc="right") for ax in figure.axes]
    assert signed.count(f"recording {fit.source[:12]}") == 3
    assert len(plt.get_fignums()) == 1


def test_a_recording_and_its_data_show_themselves(recording: Recording) -> None:
    """Into the axes given, as plot_data does."""
    for source in (recording, recording.dataset("alpha")):
        ax = Figure().add_subplot()

        assert source.plot(ax=ax) is ax
        assert ax.get_title(loc="right") == f"recording {recording.short_hash}"
