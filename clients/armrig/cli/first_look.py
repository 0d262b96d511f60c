"""The commands that test data without a model: plot, sampling, hints, check, linearity."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from armrig_core.errors import InputError

from armrig.cli.next_step import (
    AFTER,
    chassis,
    kind_of,
    say_next,
    step_again,
    typed,
    validation_beside,
)
from armrig.cli.options import Json, chosen, group
from armrig.cli.printing import (
    fields_of,
    inform,
    print_json,
    print_table,
    say,
    say_answer,
    say_more,
)
from armrig.cli.reading_options import DataFile, File
from armrig.cli.recorded_data import (
    Channel,
    Part,
    SignalChoice,
    data_group,
    each_channel,
    from_recording,
    source_facts,
)
from armrig.cli.results import (
    FIGURE_HELP,
    Draw,
    Output,
    Shown,
    ShownFigure,
    check_plot,
    figure_path,
    of_channel,
    write_plot,
)
from armrig.cli.spinner import spinner

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset, Signals
    from armrig.estimation.nonparametric.sampling_time import SamplingTime
    from armrig.estimation.nonparametric.step_analysis import StepAnalysis
    from armrig.validation.feedback_and_delay.delay_result import Delay
    from armrig.validation.feedback_and_delay.open_loop import OpenLoop
    from armrig.validation.linearity import Linearity
    from armrig.validation.structure_hints import StructureHints

_CHASSIS = (
    "handout 3.5 and 3.6 need a complete recording of the chassis alone: remove the arm, write "
    "chassis.toml with [arm] removed = true (docs/tutorial.md, part 9), and end `armrig lab`"
)
_TESTS = {"open loop": "3.7", "delay": "3.8", "linearity": ""}
"""Tests of `armrig check`, with their assignments in the handout."""


def plot(
    file: File,
    part: Part,
    figure: Path = chosen(Path("plot.png"), "-o --plot FIGURE", FIGURE_HELP, parser=figure_path),
    json: Json = False,
) -> None:
    """Plot a recording, and report its faults (handout 3.1.4).

    The figure shows u, theta_1, its rate and alpha. Missing samples and the dead band are shaded,
    and outliers are ringed. A drift is reported in the text.
    """
    from armrig.recordings.overview import overview

    check_plot(figure, [file])
    [recording] = part.recordings(file)
    with spinner("looking for outliers and drift"):
        found = overview(recording)
    [written] = write_plot(figure, signals=found.plot, height=7.0)
    if json:
        print_json(found.facts() | {"figure": str(written)})
        return
    print_table(*found.rows())
    after = f"plot {kind_of(file)}"
    say_next(after if after in AFTER else "plot", file=typed(file))


def sampling(
    file: DataFile,
    signals: Annotated[SignalChoice, data_group(without="hampel", several=False)],
    out: ShownFigure,
) -> None:
    """Recommend a sampling time (handout 3.1).

    The handout has two rules: a sampling frequency of 20 times the bandwidth, and 7 to 10 samples
    in the transient. The command applies both rules, to a recorded step or to any other input.
    """
    from armrig.estimation.nonparametric.sampling_time import sampling_time

    out.check(file)
    data = signals.of_one(file)
    integrates, taken = signals.choice(data)
    integrator = signals.integrator if out.json else integrates  # the notes contain the reason
    with spinner("estimating the response"):
        choice = sampling_time(data, integrator=integrator)
        steps = _steps(data, integrator) if choice.from_step else None
    if steps is not None:  # print a warning that both results contain only once
        said = set(choice.notes)
        steps = replace(steps, warnings=tuple(w for w in steps.warnings if w not in said))
    analysis = {} if steps is None else {"step": steps}

    def say_sampling() -> None:
        for line in taken:
            say(line)
        if out.verbose:
            say_answer("\n".join(map(repr, [choice, *analysis.values()])))
        else:
            say_answer(choice.brief())
            say_more(f"aliasing, reasons{', step analysis' * len(analysis)}")

    def say_after() -> None:
        if signals.read and (again := step_again(signals.read[0])):
            say_next("step hidden", again=again)
        elif from_recording(data):
            say_next("sampling", Ts=choice.Ts)
        else:
            say_next("sampling other", file=typed(file), given=signals.options())

    out.show(
        facts=lambda: source_facts(data) | _sampling_facts(choice) | _step_facts(steps),
        say=say_sampling,
        figures=lambda: {name: a.plot for name, a in (analysis | {"sampling": choice}).items()},
        say_next=say_after,
        height=5.0,
    )


def _sampling_facts(choice: SamplingTime) -> dict[str, Any]:
    method = "step" if choice.from_step else "impulse response"
    of = "tau omega_step omega_first omega_spectrum settling settling_std Ts_step Ts_spectrum "
    of += "Ts_transient near_nyquist beyond notes"
    return fields_of(choice, "Ts recorded_at output") | {"method": method} | fields_of(choice, of)


def _step_facts(steps: StepAnalysis | None) -> dict[str, Any]:
    of = "gain gain_std tau tau_std equivalent_time equivalent_time_std settling settling_std "
    of += "overshoot overshoot_std dead_time dead_time_interval"
    return {} if steps is None else {"step": fields_of(steps, of)}


def _steps(data: Dataset, integrator: bool | None) -> StepAnalysis | None:
    """Return the analysis of the steps; None if the levels are not held long enough."""
    from armrig.estimation.nonparametric.step_analysis import step_analysis

    try:
        return step_analysis(data, integrator=integrator)
    except ValueError:
        return None


def hints(
    file: DataFile,
    signals: Annotated[SignalChoice, data_group(without="hampel")],
    out: Annotated[Output, group(Output, ("plot", "json"))],
) -> None:
    """Suggest a model structure for the data (handout 3.2).

    The command estimates the order and nk, and whether there is an integrator. It uses the impulse
    response, the spectra and the Hankel matrix, which assume no structure. With several signals, it
    looks at each pair of an input and an output.
    """
    from armrig.validation.data_advice import data_doubts
    from armrig.validation.structure_hints import call_of_all, structure_hints

    out.check(file)
    data = signals.of(file)
    with spinner("estimating without a structure"):
        doubts = {name: data_doubts(one) for name, one in each_channel(data)}
        found = _by_channel(partial(structure_hints, integrator=signals.integrator), data)
    _require_result(found.values())
    known = {name: one for name, one in found.items() if not isinstance(one, str)}

    def facts() -> dict[str, Any]:
        each = {
            channel: _hint_facts(one) | {"doubts": [d.text for d in doubts[channel]]}
            for channel, one in found.items()
        }
        return source_facts(data) | _facts_by_channel(each)

    def say_hints() -> None:
        if signals.shape == (1, 1):
            for line in signals.choice(data, known[()].integrator)[1]:
                say(line)
        for channel, one in found.items():
            _head(channel)
            text = f"not known: {one}" if isinstance(one, str) else repr(one)
            say_answer("\n".join([text, *(f"! {d.about}: {d.text}" for d in doubts[channel])]))
        if () not in found and len(known) == len(found):
            of_set = {(output, input): one for (input, output), one in known.items()}
            say_answer(f"all channels: {call_of_all(of_set)}")

    def say_after() -> None:
        given = signals.options()
        if any(d.about == "feedback" for of_channel in doubts.values() for d in of_channel):
            say_next("identify check", file=typed(file), given=given)
            return
        validation = validation_beside(file) if from_recording(data) else ""
        validate = f" --validate {validation}" if validation else ""
        options = f"{_options([*known.values()])}{given}"
        say_next("hints", file=typed(file), options=options, validate=validate)

    out.show(
        facts=facts,
        say=say_hints,
        figures=lambda: _hint_figures(known, data),
        say_next=say_after,
        height=5.0 if () in known else 4.0,
        columns=None if () in known else 2,
    )


def _options(found: Sequence[StructureHints]) -> str:
    """Return the options of `armrig identify` that the hints of all channels suggest."""
    nb, nf = max(one.nb for one in found), max(one.nf for one in found)
    options = f"--structure oe --nb {nb} --nf {nf} --nk {min(one.nk for one in found)}"
    return options + " --integrator" * any(one.integrator for one in found)


def _hint_figures(
    found: Mapping[Channel, StructureHints], data: Dataset | Signals
) -> dict[str, Draw]:
    drawn: dict[str, Draw] = {}
    for channel, one in found.items():
        drawn |= of_channel("impulse", one.response.plot, channel)
        if not channel:
            drawn["spectra"] = partial(data.plot, "spectrum")
        drawn |= of_channel("structure", one.plot, channel)
    return drawn


def _hint_facts(found: StructureHints | str) -> dict[str, Any]:
    if isinstance(found, str):
        return {"structure": None, "reasons": [found]}
    of = "integrator integrator_shown low_slope low_slope_std high_slope relative_degree "
    of += "resonances antiresonances nk_interval singular_values threshold"
    return {
        "structure": "oe",
        "orders": fields_of(found, "nb nf nk"),
        "structures": [dict(s) for s in found.structures],
        **fields_of(found, of),
        "reasons": [line.removeprefix("- ") for line in found.explain().splitlines()],
    }


def check(
    *,
    file: DataFile,
    signals: Annotated[SignalChoice, data_group()],
    level: float = chosen(0.05, "--level", "Significance level of the test for feedback."),
    out: Shown,
) -> None:
    """Test the data for feedback and a delay (handout 3.7, 3.8).

    With several signals, each pair of an input and an output is tested.
    """
    from armrig.validation.feedback_and_delay.delay import delay
    from armrig.validation.feedback_and_delay.open_loop import open_loop, require_level
    from armrig.validation.linearity import CHANCE_LEVEL
    from armrig.validation.linearity import linearity as linear

    out.check(file)
    require_level(level)
    data = signals.of(file)
    integrator, taken = signals.integrator, list[str]()
    if signals.shape == (1, 1):
        integrates, taken = signals.choice(data)
        integrator = integrator if out.json else integrates  # the remarks then contain the reason
    with spinner("testing") as progress:
        loops = _by_channel(partial(open_loop, level=level), data)
        delays = _by_channel(partial(delay, integrator=integrator, progress=progress), data)
    _require_result([*loops.values(), *delays.values()])
    linears = {
        name: "u depends on y" if getattr(one, "closed", False) else one
        for name, one in _by_channel(partial(linear, level=CHANCE_LEVEL), data).items()
    }
    tests = {name: (loop, delays[name], linears[name]) for name, loop in loops.items()}

    def facts() -> dict[str, Any]:
        each = {
            channel: {
                "open_loop": _loop_facts(loop),
                "delay": _delay_facts(late),
                "linearity": _linearity_facts(straight, gains=False),
            }
            for channel, (loop, late, straight) in tests.items()
        }
        return source_facts(data) | _facts_by_channel(each)

    def say_tests() -> None:
        for line in taken:
            say(line)
        for channel, found in tests.items():
            _head(channel)
            for (which, number), one in zip(_TESTS.items(), found, strict=True):
                where = f"{which} (handout {number})" if number and from_recording(data) else which
                if isinstance(one, str):
                    say(f"{where}: not known: {one}")
                    continue
                brief = one.brief() if number else f"{'NONLINEAR: ' * (not one.linear)}{one.line}"
                first, *more = (one.explain() if out.verbose else brief).splitlines()
                verdict = first.removeprefix("open loop: ")
                say_answer("\n".join([f"{where}: {verdict}", *(f"  {line}" for line in more)]))

    def figures() -> dict[str, Draw]:
        drawn: dict[str, Draw] = {}
        for channel, found in tests.items():
            for which, one in zip(_TESTS, found[:2], strict=False):
                if not isinstance(one, str):
                    drawn |= of_channel(which.replace(" ", "_"), one.plot, channel)
        return drawn

    def say_after() -> None:
        if not from_recording(data):
            say_next("check other", file=typed(file), given=signals.options())
        elif kind_of(file) == "greybox":
            say_next("check greybox")
        elif recorded := chassis():
            say_next("check with chassis", chassis=recorded)
        else:
            inform(_CHASSIS)
            say_next("check")

    columns = None if () in tests else 2
    out.show(facts=facts, say=say_tests, figures=figures, say_next=say_after, columns=columns)


def linearity(
    *,
    file: DataFile,
    signals: Annotated[SignalChoice, data_group()],
    level: float = chosen(0.05, "--level", "Significance level of the test."),
    out: Shown,
) -> None:
    """Test whether the rig is linear; name a nonlinearity."""
    from armrig.validation.linearity import linearity as test

    out.check(file)
    data = signals.of(file)
    found = _by_channel(partial(test, level=level), data)
    _require_result([*found.values()])

    def facts() -> dict[str, Any]:
        each = {channel: _linearity_facts(one) for channel, one in found.items()}
        return source_facts(data) | _facts_by_channel(each)

    def say_test() -> None:
        for channel, one in found.items():
            _head(channel)
            known = one if isinstance(one, str) else one.explain() if out.verbose else one.brief()
            say_answer(known)

    def figures() -> dict[str, Draw]:
        drawn: dict[str, Draw] = {}
        for channel, one in found.items():
            if not isinstance(one, str):
                drawn |= of_channel("linearity", one.plot, channel)
        return drawn

    out.show(
        facts=facts,
        say=say_test,
        figures=figures,
        say_next=lambda: say_next("check other", file=typed(file), given=signals.options()),
    )


def _loop_facts(loop: OpenLoop | str) -> dict[str, Any]:
    if isinstance(loop, str):
        return {"feedback": None, "p_value": None, "level": None, "lags": None, "remarks": [loop]}
    lags = None if loop.sims is None else loop.sims.p
    return fields_of(loop, "feedback p_value level") | {"lags": lags, "remarks": loop.remarks}


def _linearity_facts(found: Linearity | str, *, gains: bool = True) -> dict[str, Any]:
    if isinstance(found, str):
        return {"linear": None, "remarks": [found]}
    of = "linear p level kind numbers rails gain_of levels gains remedy remarks"
    return fields_of(found, of if gains else "linear p level kind numbers remedy remarks")


def _delay_facts(late: Delay | str) -> dict[str, Any]:
    if isinstance(late, str):
        return {"nk": None, "told": False, "remarks": [late]}
    of = "interval integrator level p_values before misfit t_q remarks"
    return fields_of(late, "nk delay") | {"told": late.told} | fields_of(late, of)


def _by_channel(test: Callable[[Any], Any], data: Dataset | Signals) -> dict[Channel, Any]:
    """Return the result of a test for each channel, or the reason why there is no result."""
    columns = data.signals()
    if (columns.ny, columns.nu) == (1, 1):
        try:
            return {(): test(data)}
        except ValueError as err:
            return {(): str(err)}
    found = test(columns)
    every = {**found.results, **found.refused}
    return {channel: every[channel[::-1]] for channel, _ in each_channel(data)}


def _require_result(found: Collection[Any]) -> None:
    """Refuse the data if no channel has a result."""
    reasons = [one for one in found if isinstance(one, str)]
    if len(reasons) == len(found):
        raise InputError(reasons[0])


def _facts_by_channel(each: Mapping[Channel, dict[str, Any]]) -> dict[str, Any]:
    """Return the facts of a single channel, or a list with the names of each channel."""
    if () in each:
        return each[()]
    named = [dict(zip(("input", "output"), c, strict=True)) | facts for c, facts in each.items()]
    return {"channels": named}


def _head(channel: Channel) -> None:
    if channel:
        say(" to ".join(channel), bold=True)
