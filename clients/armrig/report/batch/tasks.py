"""Tasks of a batch, the runs that the tasks process, and the rows of their results."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Collection
from functools import lru_cache
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from armrig_core.errors import ArmrigError
from armrig_core.recording_file.part_names import PART, part_number

from armrig.data.dataset import Dataset
from armrig.data.treatment import detrend
from armrig.estimation.request import Request
from armrig.models.fit import Fit
from armrig.recordings.files.catalogue import Catalogue, catalogue, recording_files
from armrig.recordings.files.loading import load
from armrig.recordings.files.recording_summary import path_text
from armrig.recordings.recording import Recording
from armrig.recordings.usability import doubts, doubts_of_estimation, doubts_of_pair

_LATEST_NS = (1 << 63) - 1
"""Latest time that a table can contain, in ns since 1970; this time is in the year 2262."""


class Identify(Request, frozen=True, kw_only=True, tag="identify"):
    """Estimate a model from each recording."""

    signal: str | None = None
    """Output of the model."""
    detrend: bool = False


class Validate(msgspec.Struct, frozen=True, kw_only=True, tag="validate"):
    """Compare one model with each recording."""

    model: str
    """Content of a model file that `Fit.save` wrote. A path would not suffice, because other
    machines may not have the file."""
    detrend: bool = False


class Verify(msgspec.Struct, frozen=True, kw_only=True, tag="verify"):
    """Check each recording, as `armrig verify` does."""


class Report(msgspec.Struct, frozen=True, kw_only=True, tag="report"):
    """Write a report of each recording with an exciting input, and of its validation recording."""

    folder: str
    """Folder of the PDFs; the name of a PDF contains the name of its recording."""
    na: int
    nb: int
    nf: int
    nk: int


Task = Identify | Validate | Verify | Report


def name_of(task: Task) -> str:
    """Return the name of a task on the command line."""
    return str(type(task).__struct_config__.tag)


class Item(NamedTuple):
    """A run, which was recorded in a single file or in several parts."""

    name: str
    """Name of the file, or the common name of a run's parts; bytes not UTF-8 are escaped."""
    path: str
    bytes: int
    modified_ns: int
    """Time of the last change of the file, or of the run's newest part, in ns."""
    validation: str
    """Path of the recording that validates this run's model; "" without such a recording."""


def items_in(
    folder: Path, *, rigs: Collection[str] = (), kinds: Collection[str] = ()
) -> list[Item]:
    """Return the runs of some rigs and kinds of experiment, or all runs, sorted by name.

    An unreadable file is included only if `rigs` and `kinds` are both empty. If the folder cannot
    be read, the function raises an OSError.
    """
    folder_catalogue = catalogue(folder)
    chosen = {
        s.file
        for s in folder_catalogue.recordings
        if s.rig in (rigs or (s.rig,)) and s.kind in (kinds or (s.kind,))
    }
    validations = _validations(folder_catalogue)
    runs: dict[str, list[tuple[str, int, int]]] = {}
    for name, state in recording_files(folder):
        if name in chosen or not (rigs or kinds):
            runs.setdefault(_run(name), []).append((name, state.st_size, state.st_mtime_ns))
    return [
        Item(
            name=path_text(Path(run)),
            path=str(folder / run),
            bytes=sum(size for _, size, _ in files),
            modified_ns=min(max(modified for _, _, modified in files), _LATEST_NS),
            validation=next((validations[n] for n, _, _ in files if n in validations), ""),
        )
        for run, files in sorted(runs.items())
    ]


def _run(name: str) -> str:
    return name.rpartition(PART)[0] + ".mcap" if part_number(Path(name)) else name


def _validations(folder_catalogue: Catalogue) -> dict[str, str]:
    """Return the paths of validation recordings, by the names of the files that they validate."""
    of_run = {s.run_id: s.file for s in folder_catalogue.recordings if not s.is_validation}
    return {
        of_run[s.validation_of]: str(s.path.with_name(_run(s.file)))
        for s in reversed(folder_catalogue.recordings)  # the newest validation of a run is used
        if s.is_validation and s.validation_of in of_run
    }


Row = dict[str, Any]
Kind = str
"""Type of a column: "text", "truth" (a Boolean), "count", "number"; of lists "texts", "numbers"."""


def _columns(*lines: str) -> dict[str, Kind]:
    return dict(column.split() for line in lines for column in line.split(", "))


OF_THE_FILE: dict[str, Kind] = {"recording": "text", "bytes": "count", "modified_ns": "count"}
"""Columns that are known without opening the file. Their values change if the file changes."""
_OF_THE_RUN: dict[str, tuple[Kind, Callable[[Recording], Any]]] = {
    "sha256": ("text", lambda r: r.sha256),
    "rig": ("text", lambda r: r.manifest.rig),
    "device": ("text", lambda r: str(r.manifest.device.get("uid", ""))),
    "run_id": ("text", lambda r: r.manifest.run_id),
    "experiment": ("text", lambda r: r.manifest.experiment),
    "started": ("text", lambda r: r.manifest.started),
    "Ts": ("number", lambda r: r.Ts),
    "samples": ("count", lambda r: int(r.samples.size)),
    "missing": ("count", lambda r: r.missing),
    "calibration_sha256": ("text", lambda r: r.manifest.calibration_sha256),
    "recorded_by": ("text", lambda r: f"armrig {r.manifest.armrig}"),
    "damage": ("text", lambda r: r.damage),
}
OF_THE_RUN: dict[str, Kind] = {name: kind for name, (kind, _) in _OF_THE_RUN.items()}
OF_THE_RESULT: dict[str, Kind] = {"problem": "text", "doubts": "texts"}
"""Columns of every task; `problem` is the reason for a missing result, or ""."""
CHECKS = ("file", "samples", "envelope", "input", "timing", "configuration", "attachments", "clock")
"""Checks of `armrig verify`; the table has two columns for each check: result and finding."""
OF_THE_TASK: dict[str, dict[str, Kind]] = {
    "identify": _columns(
        "structure text, nk count, integrator truth, output text, N count, fit_percent number",
        "noise_variance number, loss number, fpe number, p_white number, converged truth",
        "names texts, parameters numbers, std numbers, std_robust numbers, warnings texts",
        "model text",
    ),
    "validate": _columns(
        "model_of text, output text, on_estimation_data truth, fit_percent number",
        "rms_error number, velocity_fit_percent number, p_white number",
        "p_no_dynamics_missing number, p_no_feedback number",
    ),
    "verify": _columns("passed truth", *(f"{c}_result text, {c}_found text" for c in CHECKS)),
    "report": _columns(
        "report text, report_sha256 text, validated_by text, best text, rms_error number"
    ),
}


def row_of(task: Task, item: Item) -> Row:
    """Return the row of a recording; if there is no result, `problem` contains the reason.

    The function raises no exception, so that a damaged recording does not stop the batch.
    """
    row = empty_row(task, item)
    try:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            # A search may overflow in an intermediate step; its result reports a failure.
            warnings.simplefilter("ignore", RuntimeWarning)
            recording = load(item.path)
            row |= {name: value(recording) for name, (_, value) in _OF_THE_RUN.items()}
            row["doubts"] = [f.text for f in doubts(recording)]
            row |= _result(task, recording, item)
    except OSError as err:
        reason = ": ".join(str(part) for part in (err.filename, err.strerror) if part)
        row["problem"] = reason or str(err)
    except ArmrigError as err:
        row["problem"] = str(err) or type(err).__name__
    except Exception as err:
        row["problem"] = f"{type(err).__name__}: {err}"
    row["problem"] = " ".join(row["problem"].split())
    if row["problem"] and row["damage"]:
        row["problem"] = f"{row['damage']}; {row['problem']}"
    return {name: _plain(value) for name, value in row.items()}


def empty_row(task: Task, item: Item, problem: str = "") -> Row:
    """Return the row of an item without a result."""
    file_facts = {"recording": item.name, "bytes": item.bytes, "modified_ns": item.modified_ns}
    return dict.fromkeys(columns_of(task)) | file_facts | {"problem": problem, "doubts": []}


def _result(task: Task, recording: Recording, item: Item) -> Row:
    match task:
        case Identify():
            return _identification_row(task, *_data(task, recording, task.signal))
        case Validate():
            fit = _model(task.model)
            # `compare` refuses the first channel if the recording has no output of the model.
            output = fit.output if fit.output in recording.outputs else None
            return _validation_row(fit, *_data(task, recording, output))
        case Verify():
            return _verification_row(recording)
        case Report():
            return _report_row(task, recording, item)


def _data(
    task: Identify | Validate, recording: Recording, output: str | None
) -> tuple[Dataset, list[str]]:
    """Return the data of an output, or of the first channel, and the doubts about the data."""
    data, issues = recording.dataset(output), (*doubts(recording), *doubts_of_estimation(recording))
    return detrend(data) if task.detrend else data, [f.text for f in issues]


def _identification_row(task: Identify, data: Dataset, doubted: list[str]) -> Row:
    from armrig.models.model_writing import model_text

    task.check(data)
    fit = task.estimated(data)
    return _attributes("identify", fit, fit.search) | {
        "nk": task.nk,
        "p_white": fit.whiteness,
        "parameters": fit.theta,
        "model": model_text(fit),
        "doubts": doubted,
    }


def _attributes(task: str, *results: object) -> Row:
    """Return the columns of a task that are attributes of its results with the same names."""
    return {x: getattr(one, x) for one in results for x in {*OF_THE_TASK[task]} & {*dir(one)}}


def _validation_row(fit: Fit, data: Dataset, doubted: list[str]) -> Row:
    from armrig.validation.comparison import compare
    from armrig.validation.residuals import residuals

    tests = residuals(fit, data)
    return _attributes("validate", compare(data, fit)[0]) | {
        "model_of": fit.source,
        "output": fit.output,
        "p_white": tests.white.p_value,
        "p_no_dynamics_missing": tests.missing_dynamics,
        "p_no_feedback": tests.feedback,
        "doubts": doubted,
    }


def _verification_row(recording: Recording) -> Row:
    from armrig.recordings.files.verification import RESULTS, verify_recording

    verification = verify_recording(recording)
    row: Row = {"passed": verification.passed}
    for check in verification.checks:
        row |= {f"{check.about}_result": RESULTS[check.level], f"{check.about}_found": check.text}
    return row


def _report_row(task: Report, recording: Recording, item: Item) -> Row:
    from armrig.report.document import report
    from armrig.report.study import Orders, study

    Path(task.folder).mkdir(parents=True, exist_ok=True)
    validations = [load(item.validation)] if item.validation else []
    orders = Orders(na=task.na, nb=task.nb, nf=task.nf, nk=task.nk)
    done = study([recording, *validations], orders=orders)
    path = report(done, Path(task.folder, item.name).with_suffix(".pdf"))
    findings = [*doubts(recording), *(f for v in validations for f in doubts_of_pair(recording, v))]
    return {
        "report": path.name,
        "report_sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "validated_by": Path(item.validation).name,
        "best": done.best.name,
        "rms_error": done.best.comparison.rms_error,
        "doubts": [f.text for f in findings],
    }


@lru_cache(maxsize=1)
def _model(text: str) -> Fit:
    from armrig.models.model_file import fit_of

    return fit_of(text, "the model")


def _plain(value: Any) -> Any:
    """Return a value for JSON: None if it is not finite, and with escapes for bytes not UTF-8."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, float) and not isfinite(value):
        return None
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode()
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value


def columns_of(task: Task) -> dict[str, Kind]:
    """Return the types of the columns of a task's table by name, in the order of the columns."""
    return {**OF_THE_FILE, **OF_THE_RUN, **OF_THE_RESULT, **OF_THE_TASK[name_of(task)]}
