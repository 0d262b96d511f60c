"""Models of the page, computed in a separate process: estimates, their validation, files.

The numbers are those of `armrig identify --json` and `armrig validate --json`.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from hashlib import file_digest
from pathlib import Path
from shlex import quote
from typing import Any, cast, get_args

import msgspec
import numpy as np
from armrig_core.errors import FileError, InputError
from armrig_core.telemetry.channels import INTEGRATING_OUTPUTS
from msgspec.structs import replace as changed

from armrig.dashboard.laws import file_in
from armrig.dashboard.model_data import (
    SECOND_HALF,
    ModelData,
    PreparedData,
    TreatmentStep,
    command_options,
    estimation_data,
    validation_data,
)
from armrig.dashboard.page_json import page_json
from armrig.data.dataset import Signals
from armrig.data.level import far_from_zero
from armrig.data.step import MEAN, codes_of
from armrig.estimation.request import OPTIONS, Request, options_of, too_high
from armrig.models.fit import Fit
from armrig.models.model_file import load_fit
from armrig.models.model_writing import model_text
from armrig.models.structure_table import OFFERED, OfferedName, users
from armrig.numerics.quantities import join_names
from armrig.recordings.files.imports import import_of, rig_name
from armrig.recordings.files.loading import load
from armrig.recordings.usability import data_verdict
from armrig.validation.advice import examine_fit_of
from armrig.validation.answer import answer
from armrig.validation.comparison import ComparisonTable, compare
from armrig.validation.feedback_and_delay.by_channel import ByChannel
from armrig.validation.residual_test import ResidualTest, results
from armrig.validation.residuals import residuals
from armrig.validation.search_result import free_parameters
from armrig.validation.structure_hints import StructureHints, structure_hints

_KEPT_FITS = 256
JUDGED_BY_HALF = "the second half of the recording"


class SavedModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Model in a file of the recordings' folder, which takes the place of a request."""

    file: str


Wanted = Request | SavedModel


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ValidatedFit:
    """Model with the results on its validation data."""

    fit: Fit
    simulated: ComparisonTable
    predicted: ComparisonTable
    """Comparison one step ahead."""
    tests: ResidualTest


def json_of(does: Callable[..., Any], *arguments: Any) -> bytes:
    """Return a result as JSON; this process encodes it, so that the server stays free."""
    return page_json(does(*arguments))


def decode_model_request(request: dict[str, Any]) -> Wanted:
    """Return the request, or the file of a saved model, that the page sent."""
    kind: type[Wanted] = SavedModel if "file" in request else Request
    return msgspec.convert(request, kind)


def data_facts(folder: Path, data: ModelData) -> dict[str, Any]:
    """Return facts about the data, and the structures of models."""
    path = folder / data.file
    estimation = estimation_data(folder, data)
    columns = estimation.columns.signals()
    data = changed(data, inputs=columns.inputs, outputs=columns.outputs)
    halves = data.validation == SECOND_HALF
    return {
        "data": data,
        "sha256": sha256_of(path),
        "validation_sha256": "" if halves else sha256_of(folder / str(data.validation)),
        "judged": JUDGED_BY_HALF if halves else data.validation,
        "Ts": columns.Ts,
        "N": columns.N,
        "seconds": columns.N * columns.Ts,
        **_signals(path),
        "history": [*map(str, columns.history)],
        "structures": [*_structures()],
    }


def _signals(path: Path) -> dict[str, Any]:
    """Return the signals of a recording with their units, and the verdict on its data."""
    if facts := import_of(path):
        columns = [{"name": c.name, "unit": c.unit} for c in facts.columns]
        found: dict[str, Any] = {"inputs": columns, "outputs": columns}
    else:
        recording = load(path)
        input = recording.description.input
        units = {name: recording.dataset(name).signals().units[0] for name in recording.outputs}
        outputs = [{"name": name, "unit": unit} for name, unit in units.items()]
        found = {"inputs": [{"name": input.name, "unit": input.unit}], "outputs": outputs}
    verdict = {"usable": True, "summary": ""}
    with suppress(FileError):  # an import without a known input has no verdict
        judged = data_verdict(load(path))
        verdict = {"usable": judged.usable, "summary": judged.summary}
    return found | {"verdict": verdict}


def _structures() -> Iterator[dict[str, Any]]:
    for name, row in OFFERED.items():
        yield {
            "name": name,
            "title": row.title,
            "equation": row.equation,
            "orders": dict(row.orders),
            "has_nk": not row.continuous,
            "several": row.several,
            "options": [_option(one) for one in row.options if one in OPTIONS],
        }


def _option(name: str) -> dict[str, Any]:
    hint, option = OPTIONS[name]
    kinds = get_args(hint)
    choices = [text for kind in kinds for text in get_args(kind) if isinstance(text, str)]
    kind = "choice" if choices else "flag" if hint is bool or bool in kinds else "text"
    return {"name": name, "kind": kind, "choices": choices, "help": option.help}


def hint_requests(folder: Path, data: ModelData) -> dict[str, Any]:
    """Return at most three requests that the data suggest, and the reasons."""
    estimation = estimation_data(folder, data)
    columns = estimation.columns.signals()
    every = [y[known] for y, known in zip(columns.y.T, columns.valid.T, strict=True)]
    level = not estimation.arm and far_from_zero([*every, *columns.u.T])
    with _quiet():
        found: Any = structure_hints(estimation.columns)
    if isinstance(found, ByChannel):
        if found.refused:
            raise InputError(next(iter(found.refused.values())))
        requests = [_request_of_all([*found.results.values()], estimation)]
    else:
        requests = [_request_of(found, k, level=level) for k in range(len(found.structures))]
    return {"requests": requests, "why": found.explain()}


def _request_of(hints: StructureHints, k: int, *, level: bool) -> Request:
    """Return the request of the recommended structure k."""
    s, family = hints.structures[k], cast(OfferedName, hints.family)
    orders: dict[OfferedName, dict[str, int | None]] = {
        "oe": {"nb": s.nb, "nf": s.nf},
        "bj": {"nb": s.nb, "nc": 1, "nd": 1, "nf": s.nf},
        "armax": {"na": s.nf, "nb": s.nb, "nc": s.nf},
    }
    return Request(
        structure=family,
        orders=orders[family],
        nk=s.nk,
        integrator=s.integrator,
        offset=level and not s.integrator,
    )


def _request_of_all(hints: list[StructureHints], data: PreparedData) -> Request:
    """Return one request for all channels, whose denominator has the largest order."""
    n = max(one.nf for one in hints)
    integrates = any(one.integrator for one in hints)
    request = Request(
        structure="oe",
        orders={"nb": n, "nf": n},
        nk=min(one.nk for one in hints),
        integrator=integrates,
    )
    return complete_request(request, data)


def complete_request(request: Request, data: PreparedData) -> Request:
    """Return the request with default orders, and with the options that several outputs need.

    Raises InputError for an order or option that the structure does not have.
    """
    row, columns = OFFERED[request.structure], data.columns.signals()
    for name in (*request.orders, *request.asked):
        if name not in (*row.orders, *row.options):
            able = " or ".join(users(name)) or "no structure"
            raise InputError(f"{name} goes with {able}, not with {request.structure}")
    if "form" in row.takes and not request.form:
        raise InputError(f"structure {request.structure} needs a form, such as P1D")
    request = changed(request, orders=dict(row.orders) | request.orders)
    if (columns.ny, columns.nu) == (1, 1):
        return request
    if not row.several:
        raise InputError(f"structure {request.structure} has one output and one input")
    if data.recorded and "shared" in row.takes:
        request = changed(request, shared=True)
    known = tuple(x for x in columns.outputs if not data.arm or x in INTEGRATING_OUTPUTS)
    if request.integrator is True and not known:
        raise InputError(f"the rig has no pole at 1 for {join_names(columns.outputs)}")
    return changed(request, integrator=known) if request.integrator is True else request


def row(folder: Path, data: ModelData, wanted: Wanted) -> dict[str, Any]:
    """Return a model's row in the table: request, numbers, verdicts, and lines to copy."""
    model, estimation = validate_model(folder, data, wanted), estimation_data(folder, data)
    fit, tests = model.fit, model.tests
    if isinstance(wanted, Request):
        wanted = complete_request(wanted, estimation)
    with _quiet():
        doubts = tuple(examine_fit_of(estimation.columns, fit, None))
    said = answer(fit, model.simulated, tests, doubts)
    findings = [one.text for one in (*doubts, *model.simulated.findings)]
    losses = [float(quality.loss) for quality in fit.quality]
    return {
        "request": wanted,
        "name": fit.label,
        "structure": fit.structure,
        "orders": fit.orders if (fit.ny, fit.nu) == (1, 1) else fit.specification or {},
        "parameters": free_parameters(fit),
        "loss": losses[0] if len(losses) == 1 else losses,
        "fit_simulated": {one.output: float(one.fit_percent) for one in model.simulated},
        "fit_predicted": {one.output: float(one.fit_percent) for one in model.predicted},
        "residuals": [*_verdicts(tests)],
        "trust": not (tests.rejects or tests.powerless or tests.blind),
        "rejected": "; ".join(one.text for one in results(tests) if one.level == "unusable"),
        "answer": said.splitlines()[0],
        "command": _command(folder, data, wanted),
        "python": _python(folder, estimation, wanted),
        "warnings": [*dict.fromkeys([*estimation.warnings, *fit.warnings, *findings])],
    }


def row_with_data(folder: Path, data: ModelData, wanted: Wanted) -> dict[str, Any]:
    """Return a model's row in the table, with the data of the model."""
    return row(folder, data, wanted) | {"data": data}


def _verdicts(tests: ResidualTest) -> Iterator[dict[str, Any]]:
    p = {
        "white": ("white", tests.whiteness),
        "dynamics": ("missing dynamics", tests.missing_dynamics),
        "feedback": ("feedback", tests.feedback),
        "errors": ("larger errors", tests.larger_errors),
    }
    for found in results(tests):
        about, value = p[found.about.rpartition(" ")[2]]  # also of "linear dynamics"
        rejected = found.level == "unusable"
        yield {"about": about, "words": found.text, "p": float(value), "rejected": rejected}


def _command(folder: Path, data: ModelData, wanted: Wanted) -> str:
    """Return the command that gives the numbers of the model again; "" if no command does."""
    saved = isinstance(wanted, SavedModel)
    options = command_options(folder, data, validate=saved)
    validation = quote(str(folder / (data.validation or data.file)))
    if options is None:
        return ""
    if isinstance(wanted, SavedModel):
        model = quote(str(folder / wanted.file))
        return " ".join(["armrig validate", validation, "--model", model, *options])
    if not {*wanted.asked} <= {*OPTIONS}:
        return ""
    options += [f"--validate {validation}"] if data.validation != SECOND_HALF else []
    file = quote(str(folder / data.file))
    return " ".join(["armrig identify", file, options_of(wanted), *options])


def _python(folder: Path, estimation: PreparedData, wanted: Wanted) -> str:
    """Return the lines of Python that give the model again."""
    if isinstance(wanted, SavedModel):
        return f"import armrig\n\nfit = armrig.load_fit({str(folder / wanted.file)!r})\n"
    arguments = wanted.arguments(estimation.columns)
    name = "two_stage" if arguments.pop("two_stage", False) else wanted.structure
    if name == "two_stage":
        arguments = {"structure": wanted.structure} | arguments
    given = "".join(f", {key}={x!r}" for key, x in arguments.items())
    lines = ["import armrig", "", *estimation.python, f"fit = armrig.{name}(data{given})"]
    return "\n".join([*lines, ""])


def validate_model(folder: Path, data: ModelData, wanted: Wanted) -> ValidatedFit:
    """Return a model with the results on its validation data; the process keeps them."""
    changed_ns = 0
    if isinstance(wanted, SavedModel):
        changed_ns = file_in(folder, wanted.file, ".json").stat().st_mtime_ns
    key = msgspec.json.encode(wanted, order="deterministic")
    # A file that was removed must not be answered from memory.
    estimation_data(folder, data), validation_data(folder, data)
    return _validate(folder, data, key, changed_ns)


@lru_cache(maxsize=_KEPT_FITS)
def _validate(folder: Path, data: ModelData, key: bytes, changed_ns: int) -> ValidatedFit:
    half = None if data.validation != SECOND_HALF else SECOND_HALF
    fit = _fit(folder, changed(data, validation=half), key, changed_ns)
    other = validation_data(folder, data).columns
    with _quiet():
        return ValidatedFit(
            fit=fit,
            simulated=compare(other, fit),
            predicted=compare(other, fit, horizon=1),
            tests=residuals(fit, other),
        )


@lru_cache(maxsize=_KEPT_FITS)
def _fit(folder: Path, data: ModelData, key: bytes, _: int) -> Fit:
    wanted = decode_model_request(msgspec.json.decode(key))
    if isinstance(wanted, SavedModel):
        return load_fit(file_in(folder, wanted.file, ".json"))
    estimation = estimation_data(folder, data)
    request = complete_request(wanted, estimation)
    request.check(estimation.columns)
    named = join_names([*request.orders] or ["the number of time constants"])
    with _quiet():
        try:
            fit = request.estimated(estimation.columns)
        except np.linalg.LinAlgError as err:
            raise too_high(named) from err
    if not np.isfinite([*fit.theta, *(q.loss for q in fit.quality)]).all():
        raise too_high(named)
    return fit


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the warnings of libraries, as the commands do."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def save(folder: Path, data: ModelData, wanted: Wanted, name: str) -> dict[str, Any]:
    """Write the model's file into the folder; refuse to replace a file."""
    path = folder / f"{name.removesuffix('.json')}.json"
    if path.parent != folder or path.name.startswith(".") or not name.isprintable():
        raise InputError(f"{name!r}: give a name without / and without a dot at its beginning")
    text = model_text(validate_model(folder, data, wanted).fit)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise InputError(f"{path.name}: exists already; give another name") from None
    return {"file": path.name}


def data_of_model(folder: Path, file: str) -> ModelData:
    """Return the data that the model of a file was estimated from, without validation data.

    Raises InputError if the folder does not contain the recording.
    """
    fit = load_fit(file_in(folder, file, ".json"))
    digest = fit.source.rpartition(":")[2]
    return ModelData(
        file=name_of_hash(folder, digest),
        inputs=() if fit.inputs == ("u",) else fit.inputs,
        outputs=fit.outputs,
        treatments=(TreatmentStep(kind="means"),) if MEAN in codes_of(fit.history) else (),
    )


def name_of_hash(folder: Path, digest: str) -> str:
    """Return the name of the newest recording whose SHA-256 begins with `digest`."""
    paths = sorted(folder.glob("*.mcap"), reverse=True)
    if digest and (found := next((p for p in paths if sha256_of(p).startswith(digest)), None)):
        return found.name
    raise InputError(
        f"there is no recording with the SHA-256 {digest[:12] or '(none)'} in {folder}"
    )


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    stat = path.stat()
    return _digest(path, stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=4096)
def _digest(path: Path, changed_ns: int, size: int) -> str:
    with path.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


def report(folder: Path, data: ModelData, wanted: tuple[Wanted, ...]) -> bytes:
    """Return the report of the chosen models as a PDF."""
    from armrig.report.document import report as typeset
    from armrig.report.study import study_of_fits

    files = dict.fromkeys([data.file, data.validation or data.file])
    recordings = [replace(load(folder / name), name=name) for name in files]
    # An import has names and a source that the report's recordings do not have.
    names = [rig_name(x) for x in estimation_data(folder, data).columns.signals().outputs]
    pair = []
    for prepared in (estimation_data(folder, data), validation_data(folder, data)):
        columns = prepared.columns
        several = isinstance(columns, Signals)
        named: dict[str, Any] = {"outputs": (*names,)} if several else {"output": names[0]}
        source = columns.source.rpartition(":")[2]
        pair.append(columns.replaced(step=None, source=source, **named))
    fits: dict[str, Fit] = {}
    for k, one in enumerate(wanted, start=1):
        fit = replace(validate_model(folder, data, one).fit, outputs=(*names,))
        fits[fit.label if fit.label not in fits else f"{fit.label}, model {k}"] = fit
    halves = data.validation == SECOND_HALF
    done = study_of_fits(recordings, pair[0], pair[1], fits, halves=halves)
    with tempfile.TemporaryDirectory(prefix="armrig-") as place:
        return typeset(done, Path(place) / "report.pdf").read_bytes()
