"""Figures show their quantities with units, and name their recording."""

from __future__ import annotations

import inspect
import re
import sys
from base64 import b64decode
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from html import escape
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from pkgutil import walk_packages
from types import ModuleType

import armrig
import matplotlib as mpl
import numpy as np
import pytest
from armrig import Dataset, Fit, oe, plots
from armrig.models.uncertainty import parameter_draws
from armrig.numerics.polynomial import apply_filter
from armrig.plots.captions import axis_label, name_by_run, signature, symbol
from armrig.plots.layout import (
    decibels,
    drawable,
    logarithmic,
    save,
)
from armrig.recordings.files.loading import load
from armrig.recordings.recording import Recording
from armrig.report.figures import STYLE
from armrig.report.study import Study, study
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.text import Text
from matplotlib.textpath import text_to_path

from tests.clients.models.made_fits import changed


def said(ax: Axes) -> list[str]:
    legend = ax.get_legend()
    assert legend is not None
    return [text.get_text() for text in legend.get_texts()]


def hardly_a_pair() -> Fit:
    """Return an OE fit whose poles are as close to each other as they are uncertain."""
    rng = np.random.default_rng(0)
    F = np.real(np.poly([0.985 + 0.008j, 0.985 - 0.008j]))
    u = rng.standard_normal(500)
    y = apply_filter([0, 0.1, 0.05], F, u)
    return oe(Dataset(u=u, y=y + np.std(y) * rng.standard_normal(500), Ts=1.0), nb=2, nf=2)


Plot = Callable[[Study, Recording, Axes | None], Axes]


@pytest.fixture(scope="module")
def recording(three_recordings: tuple[Path, Path, Path]) -> Recording:
    return load(three_recordings[2])


@pytest.fixture(scope="module")
def done(three_recordings: tuple[Path, Path, Path]) -> Study:
    return study([load(path) for path in three_recordings])


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """Draw without a screen, and leave no figure open."""
    with mpl.rc_context({"backend": "agg"}):
        yield
        plt.close("all")


def _models(done: Study) -> list[Fit]:
    return [m.model for m in done.models]


PLOTS: dict[str, Plot] = {
    "data": lambda s, r, ax: plots.plot_data(r, ax=ax),
    "jitter": lambda s, r, ax: plots.plot_timing(r, ax=ax),
    "lateness": lambda s, r, ax: plots.plot_timing(r, quantity="lateness", ax=ax),
    "compare": lambda s, r, ax: plots.plot_compare(
        armrig.compare(s.validation, *_models(s)), ax=ax
    ),
    "residuals": lambda s, r, ax: plots.plot_residuals(s.best.tests, ax=ax),
    "bode": lambda s, r, ax: plots.plot_bode(*_models(s), ax=ax),
    "poles and zeros": lambda s, r, ax: plots.plot_poles_zeros(*_models(s), ax=ax),
    "step": lambda s, r, ax: plots.plot_step(*_models(s), ax=ax),
}
EVERY = pytest.mark.parametrize("plot", PLOTS.values(), ids=PLOTS.keys())


Shown = tuple[str, Axes, Axes]


@pytest.fixture(scope="module", params=PLOTS)
def shown(request: pytest.FixtureRequest, done: Study, recording: Recording) -> Shown:
    """Give a name, axes, and the axes that the plot returns, drawn once for all tests."""
    given = Figure().add_subplot()
    return request.param, given, PLOTS[request.param](done, recording, given)


def test_a_plot_draws_into_the_given_axes(shown: Shown) -> None:
    _, given, ax = shown
    assert ax is given
    assert ax.has_data()
    assert plt.get_fignums() == []


def test_a_plot_names_its_recording(shown: Shown, done: Study) -> None:
    """The first twelve digits of the hash of the recording."""
    name, _, ax = shown
    of_validation = name in ("data", "jitter", "lateness", "compare", "residuals")
    source = (done.validation if of_validation else done.estimation).source
    assert ax.get_title(loc="right") == f"recording {source[:12]}"


@EVERY
def test_a_plot_without_axes_creates_them(plot: Plot, done: Study, recording: Recording) -> None:
    ax = plot(done, recording, None)

    assert ax.has_data()
    assert len(plt.get_fignums()) == 1


_SIZES = {"default": (6.4, 4.8), "column": (84 / 25.4, 2.7)}


@pytest.mark.parametrize(
    ("place", "name"),
    [
        *(("column", name) for name in PLOTS),
        *(("default", name) for name in ("jitter", "compare", "residuals")),
    ],
)
def test_the_legend_is_above_the_data(
    place: str, name: str, done: Study, recording: Recording
) -> None:
    size = _SIZES[place]
    figure = Figure(figsize=size, layout="constrained")
    ax = PLOTS[name](done, recording, figure.add_subplot())
    FigureCanvasAgg(figure)
    figure.draw_without_rendering()

    for panel in figure.axes:
        legend = panel.get_legend()
        for other in figure.axes if legend else []:
            assert legend is not None
            named, data = legend.get_window_extent(), other.get_window_extent()
            assert named.y0 >= data.y1 or named.y1 <= data.y0
        for text in panel.findobj(Text) if legend else []:
            if isinstance(text, Text) and text.get_text() == panel.get_title(loc="right") != "":
                assert legend is not None
                assert text.get_window_extent().y0 >= legend.get_window_extent().y1
    seen = figure.get_tightbbox()
    width, height = size
    assert -0.02 < seen.x0 < seen.x1 < width + 0.02
    assert -0.02 < seen.y0 < seen.y1 < height + 0.02
    assert ax.has_data()


def test_a_pole_zero_figure_reports_its_draws_and_the_omitted_ones() -> None:
    fit = hardly_a_pair()
    ax = plots.plot_poles_zeros(fit, ax=Figure().add_subplot())

    assert said(ax) == ["OE[2 2 1], 95 %", "95 % by draws"]
    assert len(ax.collections) >= 2  # a shade and its border
    circle = np.hypot(*np.asarray(ax.lines[0].get_data(), np.float64))
    assert circle == pytest.approx(np.ones(circle.size))
    assert ax.lines[0].get_xdata()[[0, 360, -1]] == pytest.approx([1, -1, 1])  # type: ignore[index]
    draws = parameter_draws(fit)
    assert draws is not None
    assert draws.unstable > 0
    legend = ax.get_legend()
    assert legend is not None
    left_out = f"draws left out: {draws.unstable} of 1000 unstable"
    assert legend.get_title().get_text().splitlines() == ["× poles, ○ zeros", left_out]


def test_a_phase_does_not_jump_by_a_turn() -> None:
    import control

    late = control.tf([1.0], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0)
    ax = plots.plot_bode(late, omega=np.linspace(0.1, 3.0, 200), ax=Figure().add_subplot())

    (below,) = [other for other in ax.figure.axes if "arg" in other.get_ylabel()]
    phase = np.asarray(below.lines[0].get_ydata(), np.float64)
    np.testing.assert_allclose(phase, -8 * np.degrees(np.linspace(0.1, 3.0, 200)), atol=0.1)
    low, high = below.get_ylim()
    assert low < phase.min()
    assert phase.max() < high


def test_phases_agree_after_a_zero_that_is_hardly_damped() -> None:
    """The phase turns up if the zero is damped a little and down if it grows a little."""
    import control

    pair = [control.tf([1.0, d, 256.0], [1.0, 30.0, 300.0, 0.0]) for d in (0.05, -0.05)]
    ax = plots.plot_bode(*pair, omega=np.geomspace(0.5, 300.0, 500), ax=Figure().add_subplot())

    (below,) = [other for other in ax.figure.axes if "arg" in other.get_ylabel()]
    damped, growing = (np.asarray(line.get_ydata(), np.float64) for line in below.lines)
    np.testing.assert_allclose(growing[-100:], damped[-100:], atol=1.0)


def test_figures_name_a_run_if_it_is_known(recording: Recording) -> None:
    with name_by_run({recording.sha256: "0000000b"}):
        inside = plots.plot_data(recording, ax=Figure().add_subplot())
    outside = plots.plot_data(recording, ax=Figure().add_subplot())

    assert inside.get_title("right") == "recording @0000000b"
    assert outside.get_title("right") == f"recording {recording.short_hash}"


def test_a_step_keeps_its_ramp(done: Study) -> None:
    """The slope is the response to the step."""
    step = done.recordings[0]

    ax = plots.plot_data(step, ax=Figure().add_subplot())

    shown = np.asarray(ax.lines[0].get_ydata(), dtype=np.float64)
    np.testing.assert_array_equal(shown, step.theta_1)


def test_a_logarithmic_scale_is_named_and_its_numbers_do_not_overlap(done: Study) -> None:
    figure = Figure(figsize=(6.4, 2.6), layout="constrained")
    models = _models(done)
    far = changed(done.best.model, B=np.append(0.0, 2.0 * done.best.model.B[1:]))
    armrig.compare(done.validation, far, *models).plot(ax=figure.add_subplot())
    FigureCanvasAgg(figure)
    figure.draw_without_rendering()

    below = figure.axes[1]
    heights = [text.get_window_extent() for text in below.get_yticklabels()]
    assert below.get_yscale() == "symlog"
    legend = below.get_legend()
    assert legend is not None
    said, _, begin = legend.get_title().get_text().partition(" ±")
    assert said == "scale logarithmic beyond"
    dotted = [line.get_ydata()[0] for line in below.lines if line.get_linestyle() == ":"]
    assert dotted == [-float(begin.split()[0]), float(begin.split()[0])]
    assert len(heights) >= 3
    assert all(low.y1 <= high.y0 for low, high in pairwise(heights))


def test_the_labels_of_a_comparison_do_not_overlap(done: Study) -> None:
    figure = Figure(figsize=(6.3, 2.8), layout="constrained")
    compared = armrig.compare(done.validation, done.best.model, labels=["OE[4 4 1]"])
    compared.plot(ax=figure.add_subplot())
    FigureCanvasAgg(figure)
    figure.draw_without_rendering()

    upper, lower = (ax.yaxis.label.get_window_extent() for ax in figure.axes)
    assert lower.y1 < upper.y0


def _results_that_plot() -> list[type]:
    """Return the classes of armrig that have `.plot`, protocols left out."""
    found: set[type] = set()
    for module in walk_packages(armrig.__path__, "armrig."):
        if module.name.endswith("__main__"):
            continue
        for value in vars(import_module(module.name)).values():
            if isinstance(value, type) and value.__module__ == module.name and is_dataclass(value):
                found |= {value} if callable(vars(value).get("plot")) else set()
    return sorted(found, key=lambda one: one.__qualname__)


def test_every_result_plots_a_figure_that_can_be_saved() -> None:
    results = _results_that_plot()
    returned = {one.__name__: inspect.signature(one.plot).return_annotation for one in results}  # type: ignore[attr-defined]

    assert len(returned) > 15
    assert {
        name: what for name, what in returned.items() if what not in ("Figure", "Drawing")
    } == {}


def test_the_figure_of_axes_in_a_subfigure_is_the_whole_figure(recording: Recording) -> None:
    whole = Figure()
    ax = whole.subfigures(1, 2)[1].add_subplot()

    assert recording.plot(ax=ax) is whole


@pytest.mark.parametrize("integrator", [True, False])
def test_a_step_response_begins_at_zero(integrator: bool, done: Study) -> None:
    rng = np.random.default_rng(1)
    u = rng.standard_normal(300)
    data = Dataset(u=u, y=apply_filter([0.5], [1, -0.5], u) + rng.standard_normal(300), Ts=0.01)
    model = done.best.model if integrator else oe(data, nb=1, nf=1, nk=0)
    ax = plots.plot_step(model, ax=Figure().add_subplot())

    assert ax.lines[0].get_xydata()[0].tolist() == [0.0, 0.0]  # type: ignore[index]
    corners = np.asarray(ax.collections[0].get_paths()[0].vertices)
    assert [0.0, 0.0] in corners.tolist()
    assert ax.get_xlim()[0] == 0.0
    assert ax.get_ylim()[0] <= 0.0


def letters(figure: Figure) -> dict[str, str]:
    """Return the label of the y axis of each panel that has a letter."""
    marked = [(ax, text.get_text()) for ax in figure.axes for text in ax.texts]
    return {mark: ax.get_ylabel() for ax, mark in marked if re.fullmatch(r"\([a-z]\)", mark)}


def test_the_panel_letters_continue_across_several_results(recording: Recording) -> None:
    figure = Figure()
    for ax, name in zip(figure.subplots(1, 2), ("theta_1", "alpha"), strict=True):
        recording.dataset(name).plot(ax=ax)

    for _ in range(2):
        plots.letter(figure)

    assert sorted(letters(figure)) == ["(a)", "(b)", "(c)", "(d)"]
    assert letters(figure)["(b)"] == letters(figure)["(d)"] == "$u$ [V]"
    assert sum(len(ax.texts) for ax in figure.axes) == 4


def test_two_scales_of_one_panel_have_one_letter(recording: Recording) -> None:
    figure = armrig.spa(recording.dataset(), integrator=True).plot(ax=Figure().add_subplot())

    assert len(figure.axes) == 3
    assert list(letters(figure)) == ["(a)", "(b)"]


def test_a_saved_figure_has_panel_letters(done: Study, tmp_path: Path) -> None:
    figure = Figure(layout="constrained")
    plots.plot_bode(done.best.model, ax=figure.add_subplot())

    save(figure, tmp_path / "a.png")

    assert list(letters(figure)) == ["(a)", "(b)"]
    for ax in figure.axes:
        [mark] = [text.get_window_extent() for text in ax.texts]
        ticks = [text for axis in (ax, *ax.child_axes) for text in axis.findobj(Text)]
        others = [text for text in ticks if text.get_text() and text not in ax.texts]
        assert mark.x1 <= ax.bbox.x0
        assert not any(mark.overlaps(text.get_window_extent()) for text in others)


@pytest.mark.parametrize(("ending", "date"), [("svg", b"<dc:date>"), ("PDF", b"CreationDate")])
def test_equal_figures_give_equal_files(ending: str, date: bytes, tmp_path: Path) -> None:
    """Without a date; the ids in an SVG are not random."""
    written = []
    for name in ("first", "second"):
        figure = Figure(figsize=(2, 2))
        figure.add_subplot().plot([0, 1], clip_on=True)
        save(figure, tmp_path / f"{name}.{ending}")
        written.append((tmp_path / f"{name}.{ending}").read_bytes())

    assert written[0] == written[1]
    assert written[0].startswith(b"<?xml" if ending == "svg" else b"%PDF-")
    assert date not in written[0]


@pytest.mark.parametrize("result", ["recording", "dataset", "sampling time", "comparison"])
def test_a_notebook_shows_text_and_figure(result: str, done: Study, recording: Recording) -> None:
    data = recording.dataset()
    shown = {
        "recording": lambda: recording,
        "dataset": lambda: data,
        "sampling time": lambda: armrig.sampling_time(data),
        "comparison": lambda: armrig.compare(data, done.best.model),
    }[result]()
    html = shown._repr_html_()

    assert escape(repr(shown)) in html
    (image,) = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    png = b64decode(image)
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    assert 500 < int.from_bytes(png[16:20], "big") < 1000  # pixels, at 100 for each inch
    assert plt.get_fignums() == []


def test_a_notebook_shows_a_plot_once(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plt, "get_backend", lambda: "module://matplotlib_inline.backend_inline")
    shown: list[object] = []
    ipython = ModuleType("IPython.display")
    ipython.Image, ipython.display = bytes, shown.append  # type: ignore[attr-defined]
    figure = recording.plot()  # matplotlib asks a real IPython for hooks when it first draws
    monkeypatch.setitem(sys.modules, "IPython", ModuleType("IPython"))
    monkeypatch.setitem(sys.modules, "IPython.display", ipython)

    figure._ipython_display_()  # type: ignore[attr-defined]

    assert len(shown) == 1
    assert plt.get_fignums() == []  # of which the notebook shows what is left


A, B = "a1" * 32, "b2" * 32


@pytest.mark.parametrize(
    ("sources", "text"),
    [
        ((A,), "recording a1a1a1a1a1a1"),
        ((f"{A}+{B}",), "recordings a1a1a1a1a1a1, b2b2b2b2b2b2"),
        ((A, B, A), "recordings a1a1a1a1a1a1, b2b2b2b2b2b2"),
        ((f"data:{A}", f"data:{B}"), "data a1a1a1a1a1a1, b2b2b2b2b2b2"),
        ((f"{A}+data:{B}",), "recording a1a1a1a1a1a1; data b2b2b2b2b2b2"),
        (("", A, ""), "recording a1a1a1a1a1a1"),
        (("",), ""),
        (("c3",), "recording @0000000b"),
        (("d4",), "recording d4"),
    ],
)
def test_the_sources_of_a_figure_are_listed_once_by_kind(
    sources: tuple[str, ...], text: str
) -> None:
    assert signature(*sources, runs={"c3": "0000000b", "d4": ""}) == text


def test_symbols_and_exponents_are_in_mathtext() -> None:
    written = [symbol(name) for name in ("J_1", "K_lin", "N", "T_c", "J_12")]

    assert written == ["$J_1$", "$K_{lin}$", "$N$", "$T_c$", "$J_{12}$"]
    shown = drawable("(1.2 ± 0.1)·10⁻¹² m, 10³ s⁻¹ and 10 m²")
    assert shown == "(1.2 ± 0.1)·$10^{-12}$ m, $10^{3}$ s$^{-1}$ and 10 m²"
    assert [axis_label("theta_1", "rad"), axis_label("flow", "")] == [
        r"$\theta_1$ [rad]",
        "flow [–]",
    ]


def test_an_exponent_in_the_text_of_a_report_is_drawn_without_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The font of the reports has no glyph of ⁻."""
    with mpl.rc_context(STYLE):
        text = drawable("$J_1$ = (1.2 ± 0.1)·10⁻³ kg m² and $w$ [s⁻¹]")
        text_to_path.get_text_path(FontProperties(), text, ismath=True)

    assert not caplog.records


@pytest.mark.parametrize("name", [r"$\frac$", "a_{ $", r"$\alpha_{$", "温度"])
def test_any_name_is_drawn_without_a_warning(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    u = np.tile([0.0, 0.0, 1.0, 1.0, 1.0], 40)
    y = apply_filter([0, 0.1], [1, -0.9], u) + 0.1 * np.random.default_rng(0).standard_normal(200)
    data = Dataset(u=u, y=y, Ts=0.1, output=name, unit=name)
    fits = (armrig.arx(data, na=1, nb=1), armrig.arx(data, na=2, nb=2))

    labels = name, rf"$\beta$ {name}"
    for figure in (data.plot(), armrig.compare(data, *fits, labels=labels).plot()):
        save(figure, tmp_path / "figure.svg")

        assert name.replace("$", r"\$") in figure.axes[0].get_ylabel()
    assert not caplog.records


@pytest.mark.parametrize(("name", "text"), [("alpha", "dead band or "), ("light", "")])
def test_only_a_rig_with_a_dead_band_has_it_in_the_legend(name: str, text: str) -> None:
    y = np.arange(40.0)
    y[5:8] = np.nan

    ax = plots.plot_data(Dataset(u=np.zeros(40), y=y, Ts=0.1, output=name, unit="V"))

    assert said(ax) == [f"{text}missing sample"]


def test_a_magnitude_of_zero_has_minus_300_decibels() -> None:
    np.testing.assert_allclose(
        decibels(np.array([10.0, -0.1, 3j, 0.0])), [20, -20, 20 * np.log10(3), -300]
    )


@pytest.mark.parametrize(
    ("high", "ticks"), [(150.0, [1, 2, 5, 10, 20, 50, 100]), (900, [1, 10, 100])]
)
@pytest.mark.parametrize("way", ["x", "y"])
def test_a_logarithmic_axis_has_plain_numbers(way: str, high: float, ticks: list[float]) -> None:
    """At 1, 2 and 5 times a power of ten, or at decades only beyond a ratio of 200."""
    ax = Figure().add_subplot()
    axis = getattr(ax, f"{way}axis")

    logarithmic(axis, 1.0, high)

    assert (ax.get_xscale(), ax.get_yscale()) == (
        ("log", "linear") if way == "x" else ("linear", "log")
    )
    assert axis.get_view_interval().tolist() == [1.0, high]
    shown = [t for t in axis.get_major_locator()() if 1 <= t <= high]
    assert shown == pytest.approx(ticks)
    assert axis.get_major_formatter()(20.0) == "20"
    assert axis.get_minor_formatter()(20.0) == ""
