"""The command report, which typesets a report of recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.errors import InputError
from armrig_core.process.printable import printable
from armrig_core.telemetry.telemetry import OutputName

from armrig.cli.columns import chosen_outputs
from armrig.cli.next_step import REASONS, for_the_report, free_name, opener, say_next
from armrig.cli.options import CalibrationFile, Json, ModelOrders, argument, chosen, noted
from armrig.cli.parameters import AMPLITUDE_V, OF_AMPLITUDE, OF_CHANGES, OF_OMEGA, OMEGA, cases
from armrig.cli.printing import echo, inform, print_json, tell
from armrig.cli.reading_options import recording_path
from armrig.cli.results import check_output
from armrig.cli.spinner import estimating, spinner
from armrig.data.finding import OWN_DATA

if TYPE_CHECKING:
    from armrig.recordings.recording import Recording


def report(
    *,
    files: Annotated[
        list[Path] | None,
        argument("F…", "Recordings (*.mcap) or their @names.", parser=recording_path),
    ] = None,
    output: Path = chosen(Path("report.pdf"), "-o --output PDF", "PDF to write."),
    signal: list[str] | None = chosen(
        None,
        "--signal NAME",
        "Output of the models, theta_1 or alpha; repeatable, for models of both outputs. The "
        "orders apply to theta_1; na, nb and nf of a model of alpha are one less.",
        "theta_1",
    ),
    orders: ModelOrders,
    calibration: CalibrationFile = None,
    force: bool = chosen(False, "--force", "Overwrite an existing PDF."),
    handout: bool = chosen(
        False,
        "--handout",
        "Write a section for each assignment, at most ten pages in total. The recordings F… "
        "are then optional.",
    ),
    questions: Path | None = chosen(
        None, "--questions TOML", "New file for the handout's questions; no report is written."
    ),
    answers: Path | None = chosen(
        None, "--answers TOML", "File with names, registration numbers and reasons (--handout)."
    ),
    given: Annotated[list[str] | None, noted(OF_CHANGES, " (--handout)")] = None,
    amplitude: Annotated[float, noted(OF_AMPLITUDE, " (--handout)")] = AMPLITUDE_V,
    omega: Annotated[float, noted(OF_OMEGA, " (--handout)")] = OMEGA,
    source: Path | None = chosen(
        None,
        "--source FOLDER",
        "New folder for the Typst source and its figures; --from typesets this source.",
    ),
    edited: Path | None = chosen(
        None, "--from FOLDER", "Folder with a source to typeset, in place of recordings."
    ),
    json: Json = False,
) -> None:
    """Typeset a report as a PDF.

    Steps and staircases are not used for the models. Of the other recordings, the first is used for
    estimation and the second for validation. A single other recording is cut into halves.

    A report covers complete runs. Here --from is not a start time: it names a folder that --source
    wrote.
    """
    files = files or []
    if questions is not None:
        _write_questions(questions)
        if not json:
            _say_next_answers(questions)
        return
    _check_options(
        files,
        handout,
        {
            "edited": edited,
            "source": source,
            "answers": answers,
            "set": given,
            "signal": ",".join(signal or ()),
        },
    )
    check_output(output, files, suffix=".pdf")
    if output.exists() and not force:
        raise InputError(f"-o {output}: exists; --force overwrites it, or give another name")
    recordings: list[Recording] = []
    if edited is not None:
        _typeset_source(edited, output)
    else:
        if handout:
            problem: dict[str, Any] = {"amplitude": amplitude, "omega": omega, "orders": orders}
            problem["cases"] = cases(given) if given else None
            recordings, typeset = _handout(files, calibration, answers, **problem)
        else:
            recordings, typeset = _study(files, calibration, orders, chosen_outputs(signal))
        with spinner("typesetting"):
            typeset(output, source=source)
    if json:
        print_json({"report": str(output), "recordings": [r.sha256 for r in recordings]})
    else:
        echo(str(output))
        if source is not None:
            say_next("report --source", source=quote(str(source)), report=free_name())
        elif answers or edited:
            say_next("report", opener=opener(), file=quote(str(output)))
        else:
            _say_next_answers(Path(REASONS))


def _say_next_answers(path: Path) -> None:
    """Print the next command: the file of the questions, or the report with the answers."""
    if path.exists():
        inform(f"fill in {path} before the next command")
        answers = f" --answers {quote(str(path))}"
        values = {"files": for_the_report(), "answers": answers, "report": free_name()}
        say_next("integrate", sinusoid="", **values)
    else:
        say_next("report --questions", questions=quote(str(path)))


def _check_options(files: Sequence[Path], handout: bool, given: dict[str, object]) -> None:
    edited = given["edited"]
    if edited and (
        files or handout or any(given[x] for x in ("source", "answers", "set", "signal"))
    ):
        raise typer.BadParameter(
            f"--from {edited}: give no recordings, and no option but -o and --force; the folder "
            f"contains all data of the report, the answers in {edited}/data.json"
        )
    for name in ("answers", "set"):
        if given[name] and not handout:
            raise typer.BadParameter(f"--{name} applies to the handout's report: add --handout")
    if given["signal"] and handout:
        raise typer.BadParameter(
            f"--signal {given['signal']}: the handout's report models theta_1; leave out --handout "
            "or --signal"
        )
    if not (files or handout or given["edited"]):
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


def _typeset_source(folder: Path, output: Path) -> None:
    from armrig.report.document import TEMPLATE, check_length
    from armrig.report.typesetting import compiled

    sources = sorted(folder.glob("*.typ"))
    if len(sources) != 1:
        raise InputError(
            f"--from {folder}: has {len(sources)} files *.typ; give a folder that `armrig report "
            "--source FOLDER` wrote"
        )
    with spinner("typesetting"):
        pdf, places = compiled(sources[0])
    if sources[0].name == TEMPLATE:
        check_length(places)
    output.write_bytes(pdf)


def _study(
    files: Sequence[Path],
    calibration: Path | None,
    orders: dict[str, Any],
    outputs: Sequence[OutputName],
) -> tuple[list[Recording], Callable[..., Any]]:
    """Return the recordings, and the function that typesets a report on them."""
    from armrig.cli.recorded_data import loaded
    from armrig.report.document import report as typeset
    from armrig.report.study import Orders, study

    recordings = loaded(files, calibration)
    _report_ignored(recordings)
    with estimating("na, nb and nf"):
        done = study(recordings, orders=Orders(**orders), outputs=outputs)
    remarks = []
    if done.validation.digest == done.estimation.digest:
        tell(OWN_DATA)
        remarks.append(f"{OWN_DATA[0].upper()}{OWN_DATA[1:]}.")
    return recordings, partial(typeset, done, remarks=remarks)


def _handout(
    files: Sequence[Path],
    calibration: Path | None,
    answers: Path | None,
    *,
    orders: dict[str, Any],
    **problem: Any,
) -> tuple[list[Recording], Callable[..., Any]]:
    """Return the recordings, and the function that typesets the handout's report."""
    from armrig.cli.recorded_data import loaded
    from armrig.recordings.usability import different_calibrations
    from armrig.report.answers import Answers, read_answers
    from armrig.report.document import handout_report
    from armrig.report.handout_study import handout_study
    from armrig.report.study import Orders

    said = Answers() if answers is None else read_answers(answers)
    recordings = loaded(files, calibration, one_plant=False)
    for text in different_calibrations(recordings):
        tell(text.removesuffix("."))
    with estimating("na, nb and nf"):
        done = handout_study(recordings, orders=Orders(**orders), **problem)
    return recordings, partial(handout_report, done, answers=said)


def _report_ignored(recordings: Sequence[Recording]) -> None:
    """Print the recordings that are not used for the models of the report."""
    from armrig.recordings.usability import NO_MODEL

    kinds = [r.manifest.experiment.partition("-")[0] for r in recordings]
    excited = [r for r, kind in zip(recordings, kinds, strict=True) if kind not in NO_MODEL]
    for r in excited[2:]:
        tell(
            f"{r.path.name} is only listed in the report: the models are estimated from "
            f"{excited[0].path.name} and validated on {excited[1].path.name}"
        )
