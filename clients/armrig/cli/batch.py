"""The command `armrig batch`, which runs a task on all recordings of a folder."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.errors import FileError, InputError
from armrig_core.telemetry.telemetry import THETA_1, OutputName
from msgspec.structs import asdict

from armrig.cli.model_structures import Given, estimation_options, requested
from armrig.cli.options import Commands, Detrend, Json, ModelOrders, argument, chosen, group, option
from armrig.cli.printing import echo, print_json, some, tell
from armrig.cli.spinner import spinner

if TYPE_CHECKING:
    from armrig.report.batch.batch import Batch
    from armrig.report.batch.tasks import Task

batch = Commands(
    "Process all recordings of a folder. Write a table (Parquet) with a row for each recording.",
    no_args_is_help=True,
)
Folder = Annotated[Path, argument("FOLDER", "Folder of the recordings.")]
Table = Annotated[
    Path, option("-o --output PARQUET", "Table to write; an existing table is continued.")
]
_TASKS_PER_WORKER = 2  # one runs, one waits
_CLUSTER_TASKS = 256  # a cluster may grow
_MAX_NAMES = 3  # recordings in a message


@dataclass(frozen=True, slots=True, kw_only=True)
class _Selection:
    """Options of all batches: the recordings, the processes and the form of the result."""

    rig: list[str] | None = chosen(None, "--rig", "Id of a rig to include; repeatable.", "all")
    kind: list[str] | None = chosen(
        None, "--kind", "Kind of experiment to include; repeatable.", "all"
    )
    workers: int | None = chosen(
        None, "--workers", "Number of processes on this machine.", "one for each core", min=1
    )
    scheduler: str | None = chosen(
        None,
        "--scheduler ADDRESS",
        "Address of a Dask scheduler whose workers process the recordings.",
    )
    force: bool = chosen(False, "--force", "Process all recordings again and replace the table.")
    json: Json = False


Selection = Annotated[_Selection, group(_Selection)]


@batch.add("batch identify weeks -o models.parquet --integrator --kind blackbox")
def identify(
    *,
    folder: Folder,
    output: Table,
    given: Annotated[Given, estimation_options(structure="oe", nk=1)],
    signal: OutputName = chosen(THETA_1, "--signal", "Output of the model."),
    detrend: Detrend = False,
    selection: Selection,
) -> None:
    """Estimate a model from each recording.

    The table contains the parameters, their standard deviations, the fit and the model.
    """
    from armrig.report.batch.tasks import Identify

    task = Identify(**asdict(requested(given)), signal=signal, detrend=detrend)
    _do(task, folder, output, selection)


@batch.add("batch validate weeks --model model.json -o fits.parquet")
def validate(
    *,
    folder: Folder,
    model: Annotated[Path, option("--model JSON", "Model file written by identify --save.")],
    output: Table,
    detrend: Detrend = False,
    selection: Selection,
) -> None:
    """Validate one model on each recording.

    The table contains the results of the simulation and of the tests of the residuals.
    """
    from armrig.models.model_file import load_fit
    from armrig.models.model_writing import model_text
    from armrig.report.batch.tasks import Validate

    fit = load_fit(model)
    if (fit.ny, fit.nu) != (1, 1):
        raise FileError(
            f"{model} is a model of several signals; here give a model of one output and one "
            "input, such as fit['alpha', 'u'] of it (armrig.load_fit and fit.save in Python)"
        )
    task = Validate(model=model_text(fit), detrend=detrend)
    _do(task, folder, output, selection)


@batch.add("batch verify weeks -o checks.parquet")
def verify(folder: Folder, output: Table, selection: Selection) -> None:
    """Check the integrity of each recording. The exit code is 1 if a check fails."""
    from armrig.report.batch.tasks import Verify

    _do(Verify(), folder, output, selection)


@batch.add("batch report weeks -o reports.parquet --kind blackbox")
def report(
    *,
    folder: Folder,
    output: Table,
    reports: Path = chosen(Path("reports"), "--reports FOLDER", "Folder for the PDFs."),
    orders: ModelOrders,
    selection: Selection,
) -> None:
    """Write a report on each recording, with its validation recording if there is one."""
    from armrig.report.batch.tasks import Report

    _do(Report(folder=str(reports.resolve()), **orders), folder, output, selection)


def _do(task: Task, folder: Path, output: Path, selection: _Selection) -> None:
    """Run the task and print the result; exit with 1 after a problem or a failed check."""
    from functools import partial

    from armrig.report.batch.batch import batch as processed
    from armrig.report.batch.workers import cluster, processes

    if output.suffix != ".parquet":
        raise InputError(f"-o {output}: the name of a table ends in .parquet")
    if not output.absolute().parent.is_dir():
        raise InputError(f"-o {output}: there is no directory {output.parent}; create it first")
    scheduler, workers = selection.scheduler, selection.workers
    if scheduler is not None and workers is not None:
        raise typer.BadParameter(
            "--workers applies to processes on this machine; a Dask cluster has its own workers"
        )
    many = workers or os.cpu_count() or 1
    executor, at_once = partial(processes, many), _TASKS_PER_WORKER * many
    if scheduler is not None:
        executor, at_once = partial(cluster, scheduler), _CLUSTER_TASKS
    with spinner("processing") as count:
        done = processed(
            folder.resolve(),
            task,
            output,
            open_executor=executor,
            at_once=at_once,
            rigs=tuple(selection.rig or ()),
            kinds=tuple(selection.kind or ()),
            anew=selection.force,
            count=count,
        )
    _say(done, json=selection.json)


def _say(done: Batch, *, json: bool) -> None:
    problems = done.problems
    failed = {row["recording"]: _failed(row) for row in done.rows if row.get("passed") is False}
    damaged = {
        row["recording"]: f"the result covers the undamaged part: {row['damage']}"
        for row in done.rows
        if row["damage"] and not row["problem"] and row["recording"] not in failed
    }
    without = {row["recording"]: row["problem"] for row in problems}
    if json:
        facts = {"table": str(done.table), "rows": len(done.rows), "done_before": done.done_before}
        print_json(facts | {"problems": without, "damaged": damaged, "failed": failed})
    else:
        before = f", {done.done_before} of them processed before" if done.done_before else ""
        echo(f"{done.table}: {len(done.rows)} recordings{before}; {len(without)} without a result")
        _list(without, "column problem contains")
        _list(damaged, "column damage contains")
        _list(failed, "columns of the checks contain")
    if failed:
        names = some([*failed], _MAX_NAMES)
        tell(f"{len(failed)} failed a check: {names}; the table contains the checks")
    if problems or failed:
        raise typer.Exit(1)


def _failed(row: dict[str, Any]) -> str:
    """Return the failed checks of a recording and their results."""
    from armrig.report.batch.tasks import CHECKS

    failed = (about for about in CHECKS if row[f"{about}_result"] == "failed")
    return "; ".join(f"{about} failed: {row[f'{about}_found']}" for about in failed)


def _list(found: dict[str, str], columns: str) -> None:
    """Print the first findings about recordings, and the columns that contain all findings."""
    for name, text in [*found.items()][:_MAX_NAMES]:
        echo(f"  {name}: {text}")
    if len(found) > _MAX_NAMES:
        echo(f"  and {len(found) - _MAX_NAMES} more; the {columns} all reasons")
