"""The commands that test data and models: validate, compare, check, linearity, report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.errors import InputError
from armrig_core.process.options import argument, extend, preset
from armrig_core.process.printable import printable

import armrig
from armrig import plots
from armrig.cli import integration, physics, recorded_data, results
from armrig.cli.next_step import (
    REASONS,
    after_validate,
    chassis,
    command_line_name,
    path_texts,
    say_handout,
    say_next,
)
from armrig.cli.options import CalibrationFile, Json, ModelFile, ModelOrders
from armrig.cli.printing import (
    echo,
    estimating,
    fields_of,
    inform,
    print_result,
    say,
    say_answer,
    spinner,
    tell,
    tell_findings,
)
from armrig.data.finding import OWN_DATA
from armrig.numerics.quantities import join_names

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset, Signals
    from armrig.report.control_sections import ControlStudy
    from armrig.validation.comparison import ComparisonTable
    from armrig.validation.feedback_and_delay.delay_result import Delay
    from armrig.validation.feedback_and_delay.open_loop import OpenLoop
    from armrig.validation.linearity import Linearity

    _Tests = tuple[OpenLoop | str, Delay | str, Linearity | str]

_HORIZONS = (1, 10)
_ROUNDING = 1e-9  # relative difference of two errors


def validate(
    *,
    file: recorded_data.DataFile,
    model: ModelFile,
    signals: Annotated[recorded_data.SignalChoice, recorded_data.data_group(without="assume")],
    horizon: list[int] | None = preset(
        None, "Prediction horizon, in samples; repeatable.", "1 and 10", min=1
    ),
    lags: int | None = preset(None, "Number of lags in the tests of the residuals.", "25", min=1),
    out: results.ShownFigure,
) -> None:
    """Validate a model on a recording or other data.

    The command simulates the model, predicts the output, and tests the residuals.
    """
    from armrig.cli.model_output import error_facts, lags_outside, residual_facts
    from armrig.models.equation import input_and_output
    from armrig.validation.answer import simulation, tests_sentence
    from armrig.validation.figures import COLUMN_WIDTH, ROW_HEIGHT
    from armrig.validation.linearity import in_open_loop

    fit = armrig.load_fit(model)
    data = signals.of(file, fit)
    with estimating("the orders"):
        simulated = armrig.compare(data, fit)
        predicted = [armrig.compare(data, fit, horizon=h) for h in horizon or _HORIZONS]
        tests = armrig.residuals(fit, data, lags)
    tell_findings(simulated.findings)

    def facts() -> dict[str, Any]:
        errors = "fit_percent rms_error"
        ahead = [{"horizon": t.horizon} | error_facts(t.rows, errors) for t in predicted]
        model_facts = {"model": str(model), "identified_from": fit.source}
        return model_facts | residual_facts(data, simulated.rows, tests) | {"ahead": ahead}

    def say_validation() -> None:
        first = f"Simulated, {fit.heading} fits {simulation(simulated.rows)}."
        say_answer(f"{first}\n{tests_sentence(tests)}.")
        for test in in_open_loop(data):
            if not test.linear:
                say(f"Linearity of {test.input} to {test.output}: {test.line}.")
        _say_predictions(simulated, predicted)
        counts = [str(q.N) for q in fit.quality]
        valid_counts = [str(n) for n in data.signals().valid.sum(axis=0)]
        say(
            f"{input_and_output(fit)}; estimated from {join_names([*dict.fromkeys(counts)])} "
            "samples, "
            f"validated on {join_names([*dict.fromkeys(valid_counts)])} samples of "
            f"{command_line_name(file)}; "
            f"{simulated.note}",
            dim=True,
        )
        for line in tests.lines(every=True) if out.verbose else tests.pair_lines():
            say(line)
        if (out.verbose or out.plot is not None) and (why := lags_outside(tests)):
            say(why)

    def figures() -> dict[str, results.Draw]:
        return {
            "compare": simulated.plot,
            "residuals": tests.plot,
            **_responses(data, [fit], [fit.label]),
        }

    out.show(
        facts=facts,
        say=say_validation,
        figures=figures,
        say_next=lambda: after_validate(fit, tests, data, file, model, signals),
        width=max(results.WIDTH, COLUMN_WIDTH * (1 + fit.nu)),
        height=max(results.HEIGHT, ROW_HEIGHT * fit.ny),
    )


def _say_predictions(simulated: ComparisonTable, predicted: Sequence[ComparisonTable]) -> None:
    """Print the predictions; those equal to the simulation are in one sentence."""
    import numpy as np

    rms = [row.rms_error for row in simulated]
    same = [
        table.horizon
        for table in predicted
        if np.allclose([row.rms_error for row in table], rms, _ROUNDING, 0)
    ]
    if same:
        ahead = " and ".join(map(str, same))
        say(f"Predicted {ahead} ahead, it fits equally well: the model has no noise model.")
    for table in predicted:
        if table.horizon not in same:
            say("\n".join(_ahead_lines(table)))


def _ahead_lines(table: ComparisonTable) -> Iterator[str]:
    """Yield a line with the errors of each output; several outputs are named."""
    from armrig.validation.comparison import row_line

    ahead = f"{table.horizon} ahead"
    width = max(len(name) for name in table.outputs) if len(table.outputs) > 1 else 0
    for row in table:
        yield row_line(f"{ahead:9}" + (f" {row.output:{width}}" if width else ""), row)
        ahead = ""


def _responses(
    data: Dataset | Signals, fits: Sequence[armrig.Fit], names: Sequence[str], **more: results.Draw
) -> dict[str, results.Draw]:
    """Return the Bode diagram, `more` diagrams and the poles; {} for models of several signals."""
    if any((fit.ny, fit.nu) != (1, 1) for fit in fits):
        return {}
    beside = recorded_data.spectral_beside(data.signals().dataset())
    labels = [*names, *("spectral analysis, 95 %" for _ in beside)]
    bode = partial(plots.plot_bode, *fits, *beside, labels=labels)
    return {"bode": bode, **more, "poles": partial(plots.plot_poles_zeros, *fits, labels=names)}


def compare(
    *,
    file: recorded_data.File,
    other: recorded_data.OtherFile = None,
    orders: ModelOrders,
    model: list[Path] | None = preset(
        None, "Model file written by identify --save; repeatable.", metavar="JSON"
    ),
    horizon: int | None = preset(
        None, "Prediction horizon, in samples.", "none, the models are simulated", min=1
    ),
    settings: physics.Given = None,
    part: recorded_data.Part,
    out: results.ShownFigure,
) -> None:
    """Compare models on data that they were not estimated from.

    With F2, the command estimates an ARX and an OE model from F. On F2, it compares these two
    models, the physical model and the models of --model. Without F2, it compares the models of
    --model on F. --set adds a physical model with the given parameters.
    """
    from armrig.cli import model_output
    from armrig.recordings.usability import emulation

    changed = physics.physics_beside(settings) if settings else {}
    if other is None and not model:
        raise typer.BadParameter(
            "give a second recording to validate with, or the models to compare, --model FILE "
            "(from `armrig identify --save FILE`)"
        )
    files = [file] if other is None else [file, other]
    saved = [(path.stem, armrig.load_fit(path)) for path in model or []]
    _check_signals(saved, alone=other is None and not settings)
    if other is None:
        models, data, where = saved, part.recorded(file, saved[0][1]), command_line_name(file)
        recordings = part.read
    else:
        from armrig.physics.systems import HANDOUT

        recordings = part.recordings(*files)
        models, data, where = _estimate_models(recordings, saved, orders)
        changed.pop(HANDOUT, None)  # the handout's model is in the comparison already
    if changed:
        of_one = data.signals().dataset()
        models = [
            *models,
            *((name, armrig.physics.physical_model(p, of_one)) for name, p in changed.items()),
        ]
    names, fits = [name for name, _ in models], [fit for _, fit in models]
    table = armrig.compare(data, *fits, horizon=horizon, labels=names)
    tell_findings(table.findings)

    def say_comparison() -> None:
        model_output.print_comparison(table, f"on {where}", verbose=out.verbose)
        for text in emulation(recordings):
            say(text, dim=True)

    def figures() -> dict[str, results.Draw]:
        drawn = {"compare": table.plot}
        step = partial(plots.plot_step, *fits, labels=names)
        return drawn | _responses(data, fits, names, step=step)

    def say_after() -> None:
        columns = data.signals()
        channel = part.of_channel(columns.outputs[0], columns.inputs[0], data)
        say_next("check", file=command_line_name(file), given=channel.options(data))

    out.show(
        facts=lambda: {
            "validation": data.source,
            "models": [*map(model_output.row_facts, table.models)],
        },
        say=say_comparison,
        figures=figures,
        say_next=say_after,
        height=4.2,
    )


def _check_signals(saved: Sequence[tuple[str, armrig.Fit]], *, alone: bool) -> None:
    """Refuse models of several signals with models of other signals; `alone`: only saved models."""
    shapes = {(fit.outputs, fit.inputs) for _, fit in saved}
    several = any((fit.ny, fit.nu) != (1, 1) for _, fit in saved)
    if several and (len(shapes) > 1 or not alone):
        raise typer.BadParameter(
            "--model: models of several signals are compared with models of the same signals only, "
            "on one recording F"
        )


def _estimate_models(
    recordings: list[armrig.Recording], saved: list[tuple[str, armrig.Fit]], orders: dict[str, Any]
) -> tuple[list[tuple[str, armrig.Fit]], Dataset | Signals, str]:
    """Estimate ARX and OE models; return all models, the validation data and their name."""
    from armrig.report.study import Orders, study

    with estimating("na, nb and nf"):
        done = study(recordings, orders=Orders(**orders))
    where = command_line_name(done.recording_of(done.validation.source).path)
    if done.halves:
        where += ", its second half (the models are estimated from its first half)"
    models = [(row.name, row.model) for row in done.models]
    return models + saved, done.validation, where


_CHASSIS = (
    "handout 3.5 and 3.6 need a complete recording of the chassis alone: remove the arm, write "
    "chassis.toml with [arm] removed = true (docs/tutorial.md, part 9), and end `armrig lab`"
)
_TESTS = {"open loop": "3.7", "delay": "3.8", "linearity": ""}
"""Tests of `armrig check`, with their assignments in the handout."""


def check(
    *,
    file: recorded_data.DataFile,
    signals: Annotated[recorded_data.SignalChoice, recorded_data.data_group()],
    level: float = preset(0.05, "Significance level of the tests for feedback and linearity."),
    out: results.Shown,
) -> None:
    """Test the data for feedback, a delay and a nonlinearity.

    With several signals, each pair of an input and an output is tested.
    """
    from armrig.validation.feedback_and_delay.open_loop import require_level

    require_level(level)
    data = signals.of(file)
    recorded = recorded_data.from_recording(data)
    of_arm = recorded_data.from_arm(data)
    integrator, taken = signals.choice(data, named=not out.json)  # the remarks contain the reason
    with spinner("testing") as progress:
        loops = recorded_data.by_channel(partial(armrig.open_loop, level=level), data)
        delays = recorded_data.by_channel(
            partial(armrig.delay, integrator=integrator, progress=progress), data
        )
    recorded_data.require_result([*loops.values(), *delays.values()])
    linears = recorded_data.by_channel(partial(armrig.linearity, level=level), data)
    tests = {name: (loop, delays[name], linears[name]) for name, loop in loops.items()}

    def say_tests() -> None:
        for channel, outcomes in tests.items():
            recorded_data.say_channel(channel)
            for (which, number), outcome in zip(_TESTS.items(), outcomes, strict=True):
                where = f"{which} (handout {number})" if number and of_arm else which
                if isinstance(outcome, str):
                    say(f"{where}: not known: {outcome}")
                    continue
                brief = repr(outcome) if number else outcome.line
                first, *more = (outcome.explain() if out.verbose else brief).splitlines()
                verdict = first.removeprefix("open loop: ")
                say_answer("\n".join([f"{where}: {verdict}", *(f"  {line}" for line in more)]))

    def figures(outcomes: _Tests) -> dict[str, results.Draw]:
        loop, late, _ = outcomes
        shows_loop = not isinstance(loop, str) and loop.sims is not None
        drawn = {"open_loop": loop if shows_loop else "", "delay": late}
        return {
            name: outcome.plot for name, outcome in drawn.items() if not isinstance(outcome, str)
        }

    def say_after() -> None:
        if not recorded:
            say_next("hints", file=command_line_name(file), given=signals.options())
        elif signals.read[0].decisions:
            say_next("control", file=command_line_name(file), given=signals.options())
        elif not signals.read[0].description.arm:
            say_next("report", file=command_line_name(file))
        elif signals.read[0].manifest.kind == "greybox":
            say_next("integrate")
        elif alone := chassis(signals.origin):
            say_next("greybox", file=alone)
        else:
            inform(_CHASSIS)
            say_next("lab chassis")

    out.show(
        facts=lambda: recorded_data.facts_by_channel(data, tests, _test_facts),
        say=say_tests,
        taken=taken,
        figures=lambda: results.figures_by_channel(tests, figures),
        say_next=say_after,
        columns=None if () in tests else 2,
    )


def linearity(
    *,
    file: recorded_data.DataFile,
    signals: Annotated[recorded_data.SignalChoice, recorded_data.data_group()],
    level: float = preset(0.05, "Significance level of the test."),
    out: results.Shown,
) -> None:
    """Test whether the rig is linear; name a nonlinearity."""
    data = signals.of(file)
    outcomes = recorded_data.by_channel(partial(armrig.linearity, level=level), data)
    recorded_data.require_result(outcomes.values())
    nonlinear = {
        name: outcome for name, outcome in outcomes.items() if not getattr(outcome, "linear", True)
    }

    def say_test() -> None:
        for channel, outcome in outcomes.items():
            recorded_data.say_channel(channel)
            say_answer(
                outcome.explain() if out.verbose and not isinstance(outcome, str) else str(outcome)
            )

    out.show(
        facts=lambda: recorded_data.facts_by_channel(data, outcomes, _linearity_facts),
        say=say_test,
        figures=lambda: results.figures_by_channel(nonlinear, lambda one: {"linearity": one.plot}),
        say_next=lambda: say_next("hints", file=command_line_name(file), given=signals.options()),
    )


def _test_facts(outcomes: _Tests) -> dict[str, Any]:
    loop, late, straight = outcomes
    facts = {"open_loop": _loop_facts(loop), "delay": _delay_facts(late)}
    return facts | {"linearity": _linearity_facts(straight)}


def _loop_facts(loop: OpenLoop | str) -> dict[str, Any]:
    if isinstance(loop, str):
        return {"feedback": None, "p_value": None, "level": None, "lags": None, "remarks": [loop]}
    lags = None if loop.sims is None else loop.sims.p
    facts = fields_of(loop, "feedback p_value level") | {"lags": lags, "remarks": loop.remarks}
    return facts | ({"law_sha256": loop.laws} if loop.laws else {})


def _delay_facts(late: Delay | str) -> dict[str, Any]:
    if isinstance(late, str):
        return {"nk": None, "told": False, "remarks": [late]}
    names = "interval integrator level p_values before misfit t_q remarks"
    return fields_of(late, "nk delay") | {"told": late.told} | fields_of(late, names)


def _linearity_facts(test: Linearity | str) -> dict[str, Any]:
    if isinstance(test, str):
        return {"linear": None, "remarks": [test]}
    return fields_of(test, "linear p level kind numbers rails gain_of levels gains remedy remarks")


def report(
    *,
    files: Annotated[
        list[Path] | None,
        argument("F…", "Recordings (*.mcap) or their @names.", parser=recorded_data.recording_path),
    ] = None,
    output: Path = preset(Path("report.pdf"), "PDF to write.", names="-o --output PDF"),
    signal: list[str] | None = preset(
        None,
        "Output of the models; repeatable, for models of several outputs. The orders apply to "
        "theta_1 of the arm; na, nb and nf of a model of alpha are one less.",
        "the first channel",
        metavar="NAME",
    ),
    orders: ModelOrders,
    calibration: CalibrationFile = None,
    model: Path | None = preset(
        None,
        "Model of a run in control.",
        "the model that the run's law names",
        names="--model MODEL",
    ),
    force: bool = preset(False, "Overwrite an existing PDF."),
    handout: bool = preset(
        False,
        "Write a section for each assignment, at most ten pages in total. The recordings F… "
        "are then optional.",
    ),
    questions: Path | None = preset(
        None, "New file for the handout's questions; no report is written.", metavar="TOML"
    ),
    answers: Path | None = preset(
        None, "File with names, registration numbers and reasons (--handout).", metavar="TOML"
    ),
    settings: Annotated[list[str] | None, extend(physics.OF_CHANGES, " (--handout)")] = None,
    amplitude: Annotated[
        float, extend(integration.OF_AMPLITUDE, " (--handout)")
    ] = integration.AMPLITUDE_V,
    omega: Annotated[float, extend(integration.OF_OMEGA, " (--handout)")] = integration.OMEGA,
    source: Path | None = preset(
        None, "New folder for the Typst source and its figures.", metavar="FOLDER"
    ),
    json: Json = False,
) -> None:
    """Typeset a report as a PDF.

    Steps and staircases are not used for the models. Of the other recordings, the first is used for
    estimation and the second for validation. A single other recording is cut into halves.

    The report of a single run in control shows it next to its prediction by the model.

    A report always covers complete runs, so there is no option --from or --to.
    """
    from armrig.report.document import control_report

    files, outputs = files or [], ",".join(signal or ())
    if questions is not None:
        _write_questions(questions)
        if not json:
            _say_next_answers(files, questions)
        return
    of_handout = {"--answers": answers, "--set": settings}
    _check_options(files, outputs, handout, of_handout)
    results.check_output(output, files, "-o", "a report is a PDF", ".pdf")
    if output.exists() and not force:
        raise InputError(f"-o {output}: exists; --force overwrites it, or give another name")
    if handout:
        problem: dict[str, Any] = {"amplitude": amplitude, "omega": omega, "orders": orders}
        problem["cases"] = physics.cases(settings) if settings else None
        recordings, typeset = _handout_report(files, calibration, answers, **problem)
    elif control := _control_run(files, model):
        recordings, typeset = [control.run], partial(control_report, control)
    else:
        of_study = recorded_data.names("--signal", outputs)
        recordings, typeset = _study_report(files, calibration, orders, of_study)
    with spinner("typesetting"):
        typeset(output, source=source)
    print_result(
        {"report": output, "recordings": [r.sha256 for r in recordings]}, str(output), json=json
    )
    if json:
        return
    is_control = any(r.manifest.controller_sha256 for r in recordings)
    if answers or is_control or not all(r.description.arm for r in recordings):
        say_next("open", file=quote(str(output)))
    else:
        _say_next_answers(files, REASONS)


def _say_next_answers(files: Sequence[Path], path: Path) -> None:
    """Print the next command: the file of the questions, or the report with the answers."""
    if path.exists():
        inform(f"fill in {path} before the next command")
        say_handout(files, path)
    else:
        say_next("questions", files=path_texts(files), questions=quote(str(path)))


def _check_options(
    files: Sequence[Path],
    outputs: str,
    handout: bool,
    of_handout: dict[str, Any],
) -> None:
    """Refuse options that contradict each other."""
    for name in [name for name, value in of_handout.items() if value and not handout]:
        raise typer.BadParameter(f"{name} applies to the handout's report: add --handout")
    if outputs and handout:
        raise typer.BadParameter(
            f"--signal {outputs}: the handout's report models theta_1; leave out --handout or "
            "--signal"
        )
    if not (files or handout):
        raise typer.BadParameter(
            "give recordings to report on, such as those of `armrig collect blackbox "
            "--validation`; --handout needs none"
        )


def _write_questions(path: Path) -> None:
    from armrig.report.answers import questions_toml

    text = questions_toml(printable(quote(str(path))))
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise InputError(
            f"--questions {path}: exists and may contain answers; give another name"
        ) from None
    echo(str(path))


def _control_run(files: Sequence[Path], model: Path | None) -> ControlStudy | None:
    """Return the study of a run in control; None if there are other recordings."""
    from armrig.control.loop_comparison import model_path
    from armrig.recordings.files.control_run import control_run
    from armrig.report.control_sections import control_study

    recordings = [armrig.load(file) for file in files] if len(files) == 1 else []
    run = control_run(recordings[0]) if recordings else None
    if run is None:
        if model is not None:
            raise InputError(f"--model {model}: give one recording of a run in control")
        return None
    path = model or model_path(run.law)
    inform(f"the model is {path}")
    with spinner("predicting"):
        return control_study(_of_files(recordings)[0], armrig.load_fit(path))


def _study_report(
    files: Sequence[Path],
    calibration: Path | None,
    orders: dict[str, Any],
    outputs: Sequence[str],
) -> tuple[list[armrig.Recording], Callable[..., Any]]:
    """Return the recordings, and the function that typesets a report on them."""
    from armrig.report.document import report as typeset
    from armrig.report.study import Orders, study

    recordings = recorded_data.load_recordings(files, calibration)
    _report_ignored(recordings)
    with estimating("na, nb and nf"):
        done = study(_of_files(recordings), orders=Orders(**orders), outputs=outputs)
    remarks = []
    if done.validation.digest == done.estimation.digest:
        tell(OWN_DATA)
        remarks.append(f"{OWN_DATA[0].upper()}{OWN_DATA[1:]}.")
    return recordings, partial(typeset, done, remarks=remarks)


def _handout_report(
    files: Sequence[Path],
    calibration: Path | None,
    answers: Path | None,
    *,
    orders: dict[str, Any],
    **problem: Any,
) -> tuple[list[armrig.Recording], Callable[..., Any]]:
    """Return the recordings, and the function that typesets the handout's report."""
    from armrig.report.answers import Answers, read_answers
    from armrig.report.document import handout_report
    from armrig.report.handout_study import handout_study
    from armrig.report.study import Orders

    answer_set = Answers() if answers is None else read_answers(answers)
    recordings = recorded_data.load_recordings(files, calibration, one_plant=False)
    for recording in recordings:
        recorded_data.require_arm(recording)
    with estimating("na, nb and nf"):
        done = handout_study(_of_files(recordings), orders=Orders(**orders), **problem)
    return recordings, partial(handout_report, done, answers=answer_set)


def _of_files(recordings: Sequence[armrig.Recording]) -> list[armrig.Recording]:
    """Return the recordings with the names of their files, because a PDF outlives the @names."""
    return [replace(r, name=r.path.name) for r in recordings]


def _report_ignored(recordings: Sequence[armrig.Recording]) -> None:
    """Print the recordings that are not used for the models of the report."""
    from armrig.recordings.usability import NO_MODEL

    excited = [r for r in recordings if r.manifest.kind not in NO_MODEL]
    for r in excited[2:]:
        tell(
            f"{r.name} is only listed in the report: the models are estimated from "
            f"{excited[0].name} and validated on {excited[1].name}"
        )
