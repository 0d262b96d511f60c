"""The examples of drawn_figures.txt: every figure that armrig draws, of short data."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import armrig
import control
import numpy as np
import pytest
from armrig import Dataset, plots
from armrig.cli.recordings import TIMING_HEIGHT, timing_figures
from armrig.cli.results import write_plot
from armrig.control.law_check import LawCheck
from armrig.control.loop_comparison import LoopComparison
from armrig.estimation.nonparametric.step_analysis import StepAnalysis
from armrig.excitation import telegraph
from armrig.numerics.polynomial import apply_filter
from armrig.physics.calibration import estimate
from armrig.physics.integrators.accuracy import convergence, sinusoid
from armrig.physics.systems import beside_the_handout, physical_model
from armrig.recordings.overview import overview
from armrig.recordings.recording import Recording
from armrig.report.answers import Answers
from armrig.report.document import handout_contents
from armrig.report.figures import draw_figure as figure_of_panels
from armrig.report.figures import plot_velocity, write_figures
from armrig.report.handout_study import handout_study
from armrig.report.study import Study, study
from armrig.report.study_sections import study_contents
from armrig.validation.search_result import SearchResult
from armrig_core.rig.arm import ArmParameters, arm_matrices
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tests import same_numbers_calls as of
from tests.clients.chassis_data import angle
from tests.clients.handout_plant import HandoutPlant
from tests.clients.made_turns import made_turns, still
from tests.clients.models.made_fits import changed
from tests.plants import nonlinear_rig

P = ArmParameters()
A, B, _ = arm_matrices(P)
PROBLEM = sinusoid(A, B, omega=5.0, span=1.0)
OMEGA = np.geomspace(0.1, 3.0, 20)
TURNS = made_turns(noise=32.0)


@dataclass(frozen=True, kw_only=True)
class Examples:
    """Subjects of the figures."""

    step: Recording
    first: Recording
    second: Recording
    study: Study
    plant: HandoutPlant

    @property
    def steps(self) -> StepAnalysis:
        """Return ten steps of a second, smoothed, and delayed."""
        u = np.tile(np.repeat([0.5, 4.5], 100), 5)
        y = self.plant.angle(u) + 1e-3 * np.random.default_rng(1).standard_normal(u.size)
        found = armrig.step_analysis(Dataset(u=u, y=y, Ts=0.01, output="theta_1", unit="rad"))
        return replace(found, dead_time=0.03)

    @property
    def periods(self) -> Dataset:
        """Four periods of noise, a little of it in the angle."""
        u = np.tile(np.random.default_rng(1).uniform(0, 5, 100), 4)
        y = self.plant.angle(u) + 1e-3 * np.random.default_rng(2).standard_normal(u.size)
        return Dataset(u=u, y=y, Ts=0.01, output="theta_1", unit="rad")


def second_order(
    seed: int = 0, N: int = 300, std: float = 1.0, F: Any = (1, -1.2, 0.6), lost: slice = slice(0)
) -> Dataset:
    """Return data of a damped system; of a few samples y may be lost."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(N)
    y = apply_filter([0, 0.1, 0.05], F, u)
    valid = np.ones(N, bool)
    valid[lost] = False
    return Dataset(u=u, y=y + std * np.std(y) * rng.standard_normal(N), Ts=1.0, valid=valid)


def chassis() -> Dataset:
    """Return data of the chassis alone."""
    u = telegraph(600, 0.05, 0.5, 4.5, seed=1)
    y = angle(u, P) + 2e-3 * np.random.default_rng(5).standard_normal(u.size)
    return Dataset(u=u, y=y, Ts=2e-3, output="theta_1", unit="rad")


def hardly_a_pair() -> armrig.Fit:
    """Return a fit whose poles are as close to each other as they are uncertain."""
    F = np.real(np.poly([0.985 + 0.008j, 0.985 - 0.008j]))
    return armrig.oe(second_order(N=500, F=F), nb=2, nf=2)


def exact(B: Any, F: Any) -> armrig.Fit:
    """Return a model of these polynomials, of which nothing was estimated."""
    of_the_rig = physical_model(P, Dataset(u=[0.0, 1.0], y=[0.0, 1.0], Ts=1.0))
    return changed(of_the_rig, B=np.array(B), F=np.array(F), integrator=False)


def searched() -> SearchResult:
    """Return the result of a small search."""
    return armrig.search(
        second_order(), second_order(1), families=("arx", "oe"), orders=(1, 2), nk=1, offset=False
    )


def saved(write: Callable[[Path], object]) -> Iterator[Figure]:
    """Yield the figures that would be written."""
    drawn: list[Figure] = []

    def keep(figure: Figure, path: Path, **_: object) -> None:
        drawn.append(figure)
        path.touch()

    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as folder:
        patch.setattr(Figure, "savefig", keep)
        write(Path(folder))
    yield from drawn


def handout(e: Examples, folder: Path) -> None:
    """Draw the handout's figures."""
    whole = handout_study([e.step, e.first, e.second])
    data = chassis()
    grey, split = armrig.greybox(data), armrig.split_study(data, (1, 2, 4))
    contents = handout_contents(replace(whole, alone=data, grey=grey, split=split), Answers())
    write_figures(contents, whole.recordings, folder)


def punctual(recording: Recording) -> Recording:
    """Return a recording whose samples all came when they were due."""
    samples = recording.samples.copy()
    samples["t_device_us"] = 10_000 * np.arange(samples.size)
    return replace(recording, samples=samples)


def words(figure: Figure) -> str:
    """Close a figure and return its texts, a line for each axes."""
    plt.close("all")
    said = []
    for panel in figure.axes:
        named = panel.get_legend()
        inside = [*(named.get_texts() if named else []), *([named.get_title()] if named else [])]
        read = [panel.get_title(loc="right"), panel.get_title(), panel.get_xlabel()]
        read += [panel.get_ylabel(), *(text.get_text() for text in [*inside, *panel.texts])]
        said.append(" | ".join(word.replace("\n", " / ") for word in read if word))
    return "\n".join(said)


def ax() -> Axes:
    """Return axes of a figure of their own."""
    return Figure().add_subplot()


@cache
def checked_law() -> LawCheck:
    """Return the check of a law of a short record."""
    data = second_order(N=400)
    fit = armrig.oe(data, nb=2, nf=2)
    return armrig.control.check_law(
        armrig.control.pid(fit, time_constant=10 * fit.Ts), fit, draws=20
    )


def compared_loop(draws: NDArray[np.float64]) -> LoopComparison:
    """Return a run next to its prediction, which is a line of slope 1, and has the given draws."""
    n = np.arange(12.0)
    law = checked_law().law
    return LoopComparison(
        law=law,
        source="",
        model_sha256="",
        Ts=0.1,
        prelude=draws.size,
        t=0.1 * n,
        r=np.where(n < 6, 3.0, 8.0),
        z=n + (-1.0) ** n,
        predicted=np.vstack([n, *(n * d / 10 for d in draws)]),
        u=n / 6,
        predicted_u=np.vstack([n / 5, *(n / d for d in draws)]),
        noise=0.5 if draws.size else np.nan,
        limited_share=0.0,
        doubts=(),
    )


FIGURES: dict[str, Callable[[Examples], Any]] = {
    "report": lambda e: saved(
        lambda to: write_figures(study_contents(e.study, ()), e.study.recordings, to)
    ),
    "report, detail of alpha": lambda e: figure_of_panels(
        2.0, [partial(plot_velocity, study([e.first, e.second], outputs=("alpha",)))]
    ),
    "handout": lambda e: saved(lambda to: handout(e, to)),
    "armrig info": lambda e: saved(
        lambda to: write_plot(to / "a.svg", height=TIMING_HEIGHT, **timing_figures(e.first))
    ),
    "write_plot": lambda e: saved(
        lambda to: write_plot(
            to / "a.svg", a=lambda ax: ax.plot(0, 0), b=lambda ax: ax.plot(0, 0), height=2.0
        )
    ),
    "plot_data, samples lost": lambda e: second_order(N=40, lost=slice(10, 13)).plot(ax=ax()),
    "plot_signals": lambda e: plots.plot_signals(e.second.signals(), ax=ax()),
    "plot_signals, a straight line": lambda e: plots.plot_signals(
        e.step.signals()[:60].replaced(step=None, intersample="foh", starts=(0, 30)), ax=ax()
    ),
    "plot_data, placed": lambda e: second_order(N=40).plot(
        ax=Figure().add_axes((0.1, 0.2, 0.5, 0.6))
    ),
    "plot_data, alpha": lambda e: e.second.dataset("alpha").plot(ax=ax()),
    "plot_spectrum": lambda e: second_order().plot("spectrum", ax=ax()),
    "plot_values": lambda e: e.second.dataset().plot("values", ax=ax()),
    "plot_timing, all the same": lambda e: plots.plot_timing(punctual(e.first), ax=ax()),
    "plot_overview": lambda e: replace(
        overview(e.second), outliers={"theta_1": e.second.t[[50, 400]]}
    ).plot(ax=ax()),
    "plot_calibration": lambda e: estimate(
        still(), TURNS, meter=[(0.5, 0.47), (2.5, 2.44), (4.5, 4.42)]
    ).plot(TURNS, ax=ax()),
    "plot_calibration, no speeds": lambda e: replace(estimate(still(), TURNS), speeds=None).plot(
        TURNS, ax=ax()
    ),
    "plot_impulse": lambda e: armrig.impulse_response(e.plant.dataset(1, 600), 20).plot(ax=ax()),
    "plot_spectral, spa": lambda e: armrig.spa(second_order(), "log").plot(ax=ax()),
    "plot_spectral, etfe": lambda e: armrig.etfe(e.periods).plot(ax=ax()),
    "plot_spectral, bla": lambda e: armrig.bla([e.periods, e.periods]).plot(ax=ax()),
    "plot_step_analysis": lambda e: e.steps.plot(),
    "plot_sampling_time, impulse": lambda e: armrig.sampling_time(e.plant.dataset(1)).plot(ax=ax()),
    "plot_structure": lambda e: armrig.structure_hints(e.plant.dataset(1)).plot(ax=ax()),
    "plot_orders, validated": lambda e: armrig.select_orders(
        second_order(), validation=second_order(1)
    ).plot("mdl", ax=ax()),
    "plot_input": lambda e: armrig.describe_input(telegraph(3000, 0.1, seed=1), 0.01).plot(),
    "plot_input, constant": lambda e: armrig.describe_input(np.ones(40), 0.01).plot(),
    "plot_fit, draws": lambda e: hardly_a_pair().plot(),
    "plot_fit, exact": lambda e: e.study.models[-1].model.plot(),
    "plot_bode, others": lambda e: plots.plot_bode(
        control.tf([1.0], [1.0, 1.0]), armrig.spa(second_order()), omega=OMEGA, ax=ax()
    ),
    "plot_step, mixed": lambda e: plots.plot_step(
        exact([0, 1.0], [1, -1.0]), exact([0, 1.0], [1, -0.5]), n=30, ax=ax()
    ),
    "plot_poles_zeros, cancelling": lambda e: plots.plot_poles_zeros(
        armrig.oe(second_order(N=1000, std=0.1, F=(1, -0.8)), nb=3, nf=2), ax=ax()
    ),
    "plot_poles_zeros, far": lambda e: plots.plot_poles_zeros(
        exact([0, 1.0, 3.0], [1, -0.5]), exact([0, 1.0], [1, 3.0]), ax=ax()
    ),
    "plot_compare, samples lost": lambda e: armrig.compare(
        second_order(N=40, lost=slice(10, 13)), exact([0, 0.1], [1, -0.5]), exact([0, 9.0], [1, 0])
    ).plot(ax=ax()),
    "plot_compare, no errors": lambda e: armrig.compare(
        Dataset(u=[0.0, 2.0, 1.0] * 4, y=[1.0, 0.0, 2.0] * 4, Ts=1.0), exact([0, 1.0], [1, 0])
    ).plot(ax=ax()),
    "plot_search": lambda e: searched().plot(ax=ax()),
    "plot_search, some far off": lambda e: replace(
        searched(), rms=np.array([1.0, 5.0, 400.0, 2000.0]), chosen_index=1, horizon=3
    ).plot(ax=ax()),
    "plot_open_loop, no verdict": lambda e: armrig.open_loop(
        Dataset(u=np.full(1000, 2.5), y=second_order(N=1000).y, Ts=0.01)
    ).plot(ax=ax()),
    "plot_linearity": lambda e: armrig.linearity(nonlinear_rig("gain by level", 1)).plot(ax=ax()),
    "plot_law_steps": lambda e: checked_law().plot(ax=ax()),
    "plot_loop_comparison": lambda e: compared_loop(np.array([10.0, 11.0])).plot(ax=ax()),
    "plot_loop_comparison, one model": lambda e: compared_loop(np.zeros(0)).plot(ax=ax()),
    "plot_loop_diagram": lambda e: plots.plot_loop_diagram(checked_law().law, ax=ax()),
    "plot_loop": lambda e: plots.plot_loop(checked_law(), ax=ax()),
    "plot_nyquist": lambda e: plots.plot_nyquist(checked_law(), ax=ax()),
    "plot_root_locus": lambda e: plots.plot_root_locus(checked_law(), ax=ax()),
    "plot_rig": lambda e: plots.plot_rig(ax=ax()),
    "plot_physical_step": lambda e: plots.plot_physical_step(
        beside_the_handout(replace(P, J_1=2 * P.J_1, K_lin=2 * P.K_lin)), u=2, seconds=0.5, ax=ax()
    ),
    "plot_sensitivities": lambda e: plots.plot_sensitivities(u=2, seconds=0.5, ax=ax()),
    "plot_stability_regions": lambda e: plots.plot_stability_regions(A, h=0.01, ax=ax()),
    "plot_stability_edge": lambda e: plots.plot_stability_edge(A, "ab2", ax=ax()),
    "plot_convergence": lambda e: plots.plot_convergence(
        [convergence(PROBLEM, "heun", [1e-2, 5e-3])], ax=ax()
    ),
    "plot_data, unlike": lambda e: of.unlike(1.0).plot(ax=ax()),
    "plot_spectrum, unlike": lambda e: of.unlike().plot("spectrum", ax=ax()),
    "plot_values, unlike": lambda e: of.unlike_integrating().plot("values", ax=ax()),
    "plot_compare, many": lambda e: armrig.compare(
        of.unlike().select(1),
        *(
            changed(exact([0, 0, 0, -2.0 - k], [1, -0.9]), Ts=0.5, nk=3, input_unit="A")
            for k in range(7)
        ),
        labels=[*"abcde", "with a name that is longer than the figure is wide, " * 3, "g"],
    ).plot(ax=ax()),
    "plot_residuals, unlike": lambda e: armrig.residuals(
        armrig.arx(of.unlike(), na=2, nb=2, nk=3), of.unlike().select(2, 0), 9
    ).plot(ax=ax()),
    "plot_spectral, unlike": lambda e: armrig.spa(
        of.unlike_integrating(), 24, integrator=True
    ).plot(ax=ax()),
    "plot_impulse, unlike": lambda e: armrig.impulse_response(of.unlike(), 12, None).plot(
        level=0.9, ax=ax()
    ),
    "plot_correlation, unlike": lambda e: armrig.correlation(of.unlike(), 9).plot(ax=ax()),
    "plot_step_analysis, unlike": lambda e: armrig.step_analysis(
        of.unlike_integrating(), integrator=True
    ).plot(),
    "plot_delay, unlike": lambda e: armrig.delay(of.unlike()).plot(ax=ax()),
    "plot_open_loop, unlike": lambda e: armrig.open_loop(of.unlike(), 0.2).plot(ax=ax()),
    "plot_input, unlike": lambda e: armrig.describe_input(of.unlike().u, 0.5).plot(),
    "plot_orders, unlike": lambda e: armrig.select_orders(
        of.unlike(), (1, 2, 3), (1, 2), (2, 3), of.unlike().select(2, 0)
    ).plot("fpe", ax=ax()),
    "plot_split, unlike": lambda e: armrig.split_study(
        of.unlike(), (1, 2, 3), lambda data: armrig.arx(data, na=2, nb=2, nk=3), parameter="b1"
    ).plot(ax=ax()),
    "plot_solution, two steps": lambda e: plots.plot_solution(
        PROBLEM, {"heun": 0.01, "ab2": 0.004}, ax=ax()
    ),
}


@pytest.fixture(scope="module")
def examples(three_recordings: tuple[Path, Path, Path], plant: HandoutPlant) -> Examples:
    """Give the subjects of the figures."""
    step, first, second = map(armrig.load, three_recordings)
    done = study([step, first, second])
    return Examples(step=step, first=first, second=second, study=done, plant=plant)
