"""The commands that look at data before a model: plot, sampling, hints (handout 3.1, 3.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.errors import InputError

from armrig.cli.chosen_recording import DataFile, File
from armrig.cli.figures import (
    FIGURE_HELP,
    Draw,
    Plot,
    check_plot,
    figure_path,
    of_channel,
    write_plot,
)
from armrig.cli.next_step import AFTER, kind_of, say_next, step_again, typed, validation_beside
from armrig.cli.options import (
    Json,
    Verbose,
    fields_of,
    print_json,
    print_table,
    say,
    say_answer,
    say_more,
)
from armrig.cli.recorded_data import (
    Channel,
    SignalChoice,
    each_channel,
    from_recording,
    reads_data,
    reads_part,
    source_facts,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.dataset import Dataset, Signals
    from armrig.data.finding import Finding
    from armrig.estimation.nonparametric.sampling_time import SamplingTime
    from armrig.estimation.nonparametric.step_analysis import StepAnalysis
    from armrig.validation.structure_hints import StructureHints

Drawing = Annotated[
    Path,
    typer.Option("-o", "--plot", metavar="FIGURE", parser=figure_path, help=FIGURE_HELP),
]


@reads_part
def plot(
    file: File,
    part: SignalChoice,
    figure: Drawing = Path("plot.png"),
    json: Json = False,
) -> None:
    """Plot a recording, and report its faults (handout 3.1.4).

    The figure shows u, theta_1, its rate and alpha. Missing samples and the dead band are shaded,
    and outliers are ringed. A drift is reported in the text.
    """
    from armrig.cli.spinner import spinner
    from armrig.recordings.overview import overview

    check_plot(figure, [file])
    [recording] = part.recordings(file)
    with spinner("looking for outliers and drift"):
        found = overview(recording)
    [written] = write_plot(figure, signals=lambda ax: found.plot(ax=ax), height=7.0)
    if json:
        print_json(found.facts() | {"figure": str(written)})
        return
    print_table(*found.rows())
    after = f"plot {kind_of(file)}"
    say_next(after if after in AFTER else "plot", file=typed(file))


@reads_data("hampel", several=False)
def sampling(
    file: DataFile,
    signals: SignalChoice,
    plot: Plot = None,
    json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Recommend a sampling time (handout 3.1).

    The handout has two rules: a sampling frequency of 20 times the bandwidth, and 7 to 10 samples
    in the transient. The command applies both rules, to a recorded step or to any other input.
    """
    from armrig.cli.spinner import spinner
    from armrig.estimation.nonparametric.sampling_time import sampling_time

    check_plot(plot, [file])
    data = signals.of_one(file)
    integrates, taken = signals.choice(data)
    integrator = signals.integrator if json else integrates  # the notes then contain the reason
    with spinner("estimating the response"):
        choice = sampling_time(data, integrator=integrator)
        steps = _steps(data, integrator) if choice.from_step else None
    if steps is not None:  # print a warning that both results contain only once
        said = set(choice.notes)
        steps = replace(steps, warnings=tuple(w for w in steps.warnings if w not in said))
    shown = {"sampling": choice} if steps is None else {"step": steps, "sampling": choice}
    write_plot(plot, height=5.0, **{name: _drawing(one) for name, one in shown.items()})
    if json:
        print_json(source_facts(data) | _sampling_facts(choice) | _step_facts(steps))
        return
    if taken:
        say("\n".join(taken))
    if verbose:
        say_answer("\n".join(map(repr, reversed(shown.values()))))
    else:
        say_answer(choice.brief())
        say_more(f"aliasing, reasons{', step analysis' * (steps is not None)}")
    if signals.read and (again := step_again(signals.read[0])):
        say_next("step hidden", again=again)
    elif from_recording(data):
        say_next("sampling", Ts=choice.Ts)
    else:
        say_next("sampling other", file=typed(file), given=signals.options())


def _steps(data: Dataset, integrator: bool | None) -> StepAnalysis | None:
    """Return the analysis of the steps; None if the levels are not held long enough."""
    from armrig.estimation.nonparametric.step_analysis import step_analysis

    try:
        return step_analysis(data, integrator=integrator)
    except ValueError:
        return None


def _drawing(one: Any) -> Any:
    return lambda ax: one.plot(ax=ax)


def _sampling_facts(choice: SamplingTime) -> dict[str, Any]:
    method = "step" if choice.from_step else "impulse response"
    of = "tau omega_step omega_first omega_spectrum settling settling_std Ts_step Ts_spectrum "
    of += "Ts_transient near_nyquist beyond notes"
    return fields_of(choice, "Ts recorded_at output") | {"method": method} | fields_of(choice, of)


def _step_facts(steps: StepAnalysis | None) -> dict[str, Any]:
    """Return the analysis of the steps as JSON fields; empty without an analysis."""
    if steps is None:
        return {}
    of = ("gain", "tau", "equivalent_time", "settling", "overshoot")
    names = [text for name in of for text in (name, f"{name}_std")]
    names += ["dead_time", "dead_time_interval"]
    return {"step": {name: getattr(steps, name) for name in names}}


@reads_data("hampel")
def hints(
    file: DataFile,
    signals: SignalChoice,
    plot: Plot = None,
    json: Json = False,
) -> None:
    """Suggest a model structure for the data (handout 3.2).

    The command estimates the order and nk, and whether there is an integrator. It uses the impulse
    response, the spectra and the Hankel matrix, which assume no structure. With several signals, it
    looks at each pair of an input and an output.
    """
    from armrig.cli.spinner import spinner
    from armrig.validation.advice.data_advice import data_doubts
    from armrig.validation.structure_hints import structure_hints

    check_plot(plot, [file])
    data = signals.of(file)
    found: dict[Channel, StructureHints | str] = {}
    doubts: dict[Channel, list[Finding]] = {}
    with spinner("estimating without a structure"):
        for channel, of_channel in each_channel(data):
            doubts[channel] = data_doubts(of_channel)
            try:
                found[channel] = structure_hints(of_channel, integrator=signals.integrator)
            except ValueError as err:
                found[channel] = str(err)
    known = {name: one for name, one in found.items() if not isinstance(one, str)}
    if not known:
        raise InputError(str(next(iter(found.values()))))
    if plot is not None:
        _draw_hints(known, data, plot)
    if json:
        each = [
            dict(zip(("input", "output"), channel, strict=False))
            | _hint_facts(one)
            | {"doubts": [d.text for d in doubts[channel]]}
            for channel, one in found.items()
        ]
        print_json(source_facts(data) | (each[0] if len(each) == 1 else {"channels": each}))
        return
    if signals.shape == (1, 1):
        _, taken = signals.choice(data, known[()].integrator)
        if taken:
            say("\n".join(taken))
    for channel, one in found.items():
        if channel:
            say(" to ".join(channel), bold=True)
        text = f"not known: {one}" if isinstance(one, str) else repr(one)
        say_answer("\n".join([text, *(f"! {d.about}: {d.text}" for d in doubts[channel])]))
    if any(d.about == "feedback" for of_channel in doubts.values() for d in of_channel):
        say_next("identify check", file=typed(file), given=signals.options())
        return
    validation = validation_beside(file) if from_recording(data) else ""
    validate = f" --validate {validation}" if validation else ""
    options = f"{_options([*known.values()])}{signals.options()}"
    say_next("hints", file=typed(file), options=options, validate=validate)


def _options(found: Sequence[StructureHints]) -> str:
    """Return the options of `armrig identify` that the hints of all channels suggest."""
    integrator = " --integrator" if any(one.integrator for one in found) else ""
    orders = {name: max(getattr(one, name) for one in found) for name in ("nb", "nf")}
    nk = min(one.nk for one in found)
    return f"--structure oe --nb {orders['nb']} --nf {orders['nf']} --nk {nk}{integrator}"


def _draw_hints(
    found: Mapping[Channel, StructureHints], data: Dataset | Signals, plot: Path
) -> None:
    drawn: dict[str, Draw] = {}
    for channel, one in found.items():
        drawn |= of_channel("impulse", partial(_plot, one.response), channel)
        if not channel:
            drawn["spectra"] = partial(data.plot, "spectrum")
        drawn |= of_channel("structure", partial(_plot, one), channel)
    write_plot(plot, height=5.0 if () in found else 4.0, **drawn)


def _plot(one: Any, ax: Axes) -> None:
    one.plot(ax=ax)


def _hint_facts(found: StructureHints | str) -> dict[str, Any]:
    if isinstance(found, str):
        return {"structure": None, "reasons": [found]}
    of = "integrator integrator_shown low_slope low_slope_std high_slope relative_degree "
    of += "resonances antiresonances nk_interval"
    return {
        "structure": "oe",
        "orders": {"nb": found.nb, "nf": found.nf, "nk": found.nk},
        "structures": [dict(s) for s in found.structures],
        **fields_of(found, of),
        "singular_values": found.singular_values.tolist(),
        "threshold": found.threshold,
        "reasons": [line.removeprefix("- ") for line in found.explain().splitlines()],
    }
