"""The command that writes recordings up: report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

import typer

from armrig.cli.chosen_recording import recording_path
from armrig.cli.next_step import opener, say_next
from armrig.cli.options import (
    SAME_DATA,
    CalibrationFile,
    Json,
    Na,
    Nb,
    Nf,
    Nk,
    echo,
    print_json,
    tell,
)
from armrig.cli.output_file import check_output

if TYPE_CHECKING:
    from armrig.recordings.recording import Recording


def report(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="F…", parser=recording_path, help="Recordings (*.mcap), or their @names."
        ),
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="PDF", help="PDF to write.")
    ] = Path("report.pdf"),
    na: Na = 4,
    nb: Nb = 4,
    nf: Nf = 4,
    nk: Nk = 1,
    calibration: CalibrationFile = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a PDF that is there.")] = False,
    handout: Annotated[
        bool,
        typer.Option(
            "--handout", help="A section for each assignment, at most ten pages; F… as there are."
        ),
    ] = False,
    json: Json = False,
) -> None:
    """Typeset a report.

    The first recording that is no step estimates, the next validates. A report tells of whole runs:
    it takes no --from and --to.
    """
    files = files or []
    if not (files or handout):
        msg = "give recordings to report on, such as those of `armrig collect blackbox "
        msg += "--validation`; --handout needs none"
        raise typer.BadParameter(msg)
    check_output(output, files, suffix=".pdf")
    if output.exists() and not force:
        msg = f"-o {output}: is there already; --force overwrites it, or give another name"
        raise ValueError(msg)
    if handout:
        _report_handout(files, output, calibration, na=na, nb=nb, nf=nf, nk=nk, json=json)
        return
    from armrig.cli.recorded_data import loaded
    from armrig.cli.spinner import estimating, spinner
    from armrig.report.document import report as typeset
    from armrig.report.study import Orders, study

    recordings = loaded(files, calibration)
    _tell_of_ignored(recordings)
    with estimating("na, nb and nf"):
        done = study(recordings, orders=Orders(na=na, nb=nb, nf=nf, nk=nk))
    remarks = []
    if done.validation.digest == done.estimation.digest:
        tell(SAME_DATA)
        remarks.append(f"{SAME_DATA[0].upper()}{SAME_DATA[1:]}.")
    with spinner("typesetting"):
        typeset(done, output, remarks=remarks)
    if json:
        print_json({"report": str(output), "recordings": [r.sha256 for r in recordings]})
    else:
        echo(str(output))
        say_next("report", opener=opener(), file=quote(str(output)))


def _tell_of_ignored(recordings: Sequence[Recording]) -> None:
    """Tell which recordings no model of the report is estimated from or judged by."""
    from armrig.recordings.doubts import NO_MODEL

    kinds = [r.manifest.experiment.partition("-")[0] for r in recordings]
    excited = [r for r, kind in zip(recordings, kinds, strict=True) if kind not in NO_MODEL]
    for r in excited[2:]:
        tell(
            f"{r.path.name} is listed in the report, and no model is estimated from it or judged "
            f"by it: {excited[0].path.name} estimates, {excited[1].path.name} validates"
        )


def _report_handout(
    files: Sequence[Path],
    output: Path,
    calibration: Path | None,
    *,
    na: int,
    nb: int,
    nf: int,
    nk: int,
    json: bool,
) -> None:
    """Typeset the handout's report from whatever there is."""
    from armrig.cli.recorded_data import loaded
    from armrig.cli.spinner import estimating, spinner
    from armrig.report.handout import handout_report
    from armrig.report.handout_study import handout_study
    from armrig.report.study import Orders
    from armrig.report.typesetting import ReportError

    recordings = loaded(files, calibration, one_plant=False)
    with estimating("na, nb and nf"):
        done = handout_study(recordings, orders=Orders(na=na, nb=nb, nf=nf, nk=nk))
    try:
        with spinner("typesetting"):
            path = handout_report(done, output)
    except ReportError as err:
        raise ValueError(str(err)) from err
    if json:
        print_json({"report": str(path), "recordings": [r.sha256 for r in recordings]})
    else:
        echo(str(path))
        say_next("report", opener=opener(), file=quote(str(path)))
