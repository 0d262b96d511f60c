"""The command that estimates models: identify."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.errors import InputError
from msgspec import structs

from armrig.cli.chosen_recording import DataFile, recording_path
from armrig.cli.figures import Plot, check_output, check_plot, write_plot
from armrig.cli.model_structures import (
    Given,
    estimated,
    estimation_options,
    requested,
    searched_for,
)
from armrig.cli.next_estimation import after_identify
from armrig.cli.options import (
    Json,
    Verbose,
    print_json,
    say,
    say_answer,
    tell,
)
from armrig.cli.recorded_data import (
    SignalChoice,
    from_recording,
    reads_data,
    source_facts,
    warn_of_estimation_data,
)
from armrig.estimation.request import Request
from armrig.models.structure_table import STRUCTURES, users
from armrig.numerics.quantities import listed

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset, Signals
    from armrig.data.finding import Finding
    from armrig.models.fit import Fit
    from armrig.validation.comparison import ComparisonTable
    from armrig.validation.residual_test import ResidualTest
    from armrig.validation.search_result import SearchResult

Search = Annotated[
    bool,
    typer.Option(
        "--search",
        help="Search several structures, or the given structure, with several orders.",
    ),
]
MaxOrder = Annotated[
    int, typer.Option("--max-order", min=1, help="Highest order that --search tries.")
]
Jobs = Annotated[
    int,
    typer.Option(
        "--jobs",
        min=1,
        help="Number of processes that --search uses.",
    ),
]
ValidationFile = Annotated[
    Path | None,
    typer.Option(
        "--validate",
        metavar="F2",
        parser=recording_path,
        help="Recording, or other data, for validation.",
    ),
]
Save = Annotated[Path | None, typer.Option("--save", metavar="JSON", help="Model file to write.")]


@estimation_options(without_nk="1; estimated with --search of one input and one output")
@reads_data()
def identify(
    file: DataFile,
    *,
    given: Given,
    search: Search = False,
    most: MaxOrder = 5,
    jobs: Jobs = 1,
    validate: ValidationFile = None,
    signals: SignalChoice,
    save: Save = None,
    plot: Plot = None,
    json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Estimate a model from data, or search for a model.

    The data are a recording or a file of another program.

    Each parameter is printed with its standard deviation. --signal theta_1,alpha gives one model of
    both outputs.

    The figure of -o shows the Bode diagram and the step response with 95 % bands, and the poles and
    zeros with 95 % regions. With --search, the figure also shows the errors of the models. With
    several signals, it shows the simulated outputs, and a Bode diagram for each pair.
    """
    shape = signals.shape
    if given["structure"] in (None, *users("offset")):
        signals = replace(signals, offset=given["offset"])
    if signals.assume == "settling" and given["integrator"]:
        raise typer.BadParameter("--assume settling contradicts --integrator: leave one out")
    wanted: _Search | Request
    if search:
        wanted = _Search(fixed=searched_for(given, *shape), most=most, jobs=jobs)
    else:
        wanted = requested(given, *shape)
    _check_files(file, validate, plot=plot, save=save)
    from armrig.recordings.usability import doubts_of_estimation

    data = signals.of(file)
    for recording in signals.read:
        for text in doubts_of_estimation(recording):
            tell(text)
    # An estimation may take minutes: find errors in the validation data before it.
    other = None if validate is None else signals.of(validate)
    wanted = _for_outputs(wanted, data, integrator=given["integrator"])
    taken: list[str] = []
    integrator = signals.integrator
    if (signals.assume or search) and shape == (1, 1) and not (given["integrator"] or json):
        integrator, taken = signals.choice(data)
    found = _found(wanted, data, other, integrator)
    if json:
        _print_json(found, data)
    else:
        for line in taken:
            say(line)
        _print_lines(found, validate, verbose=verbose)
    if save is not None:
        found.fit.save(save)
    _plot_model(found, data, plot)
    if not json:
        _say_next(found, data, file, validate, save, signals)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Search:
    """Range of a search."""

    fixed: dict[str, Any]
    """Fixed arguments of the search; the search chooses all other arguments."""
    most: int
    """Highest order to try."""
    jobs: int
    """Number of processes in parallel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Validation:
    """Results of the model on the validation data."""

    data: Dataset | Signals
    table: ComparisonTable
    tests: ResidualTest


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """Model, and the results of its estimation or search."""

    fit: Fit
    request: Request
    """Request with which the model can be estimated again."""
    search: SearchResult | None
    validation: _Validation | None
    doubts: tuple[Finding, ...]
    """Findings that make the data doubtful."""


def _for_outputs(
    wanted: _Search | Request, data: Dataset | Signals, *, integrator: bool
) -> _Search | Request:
    """Return what is wanted, with the integrators and the shared denominator of several outputs.

    A rig's outputs share one denominator, and only theta_1 integrates. All outputs of other data
    integrate. If the output of a rig does not integrate, a warning is printed.
    """
    from armrig.data.treatment import INTEGRATING_OUTPUTS

    columns, recorded = data.signals(), from_recording(data)
    integrating = tuple(
        name for name in columns.outputs if not recorded or name in INTEGRATING_OUTPUTS
    )
    if integrator and not integrating:
        msg = f"--integrator: the rig has no pole at 1 for {listed(columns.outputs)}"
        if columns.ny > 1:
            raise typer.BadParameter(msg)
        tell(f"{msg}, which does not integrate")
    if (columns.ny, columns.nu) == (1, 1):
        return wanted
    if isinstance(wanted, _Search):
        fixed = wanted.fixed | {"integrator": integrating if integrator or recorded else ()}
        return replace(wanted, fixed=fixed)
    if recorded and "shared" in STRUCTURES[wanted.structure].takes:
        wanted = structs.replace(wanted, shared=True)
    return structs.replace(wanted, integrator=integrating) if integrator else wanted


def _check_files(
    file: Path, validate: Path | None, *, plot: Path | None, save: Path | None
) -> None:
    """Refuse, before the estimation, files that cannot or must not be written."""
    inputs = [file] if validate is None else [file, validate]
    check_plot(plot, inputs)
    if save is not None:
        check_output(save, inputs)
        if save.suffix.lower() != ".json":
            msg = f"--save {save}: a model is written as JSON; give a name that ends in .json"
            raise InputError(f"{msg}; to write a figure, use -o")


def _found(
    wanted: _Search | Request,
    data: Dataset | Signals,
    other: Dataset | Signals | None,
    integrator: bool | None,
) -> _Found:
    """Estimate or search for a model; if there are validation data, validate the model."""
    searched = None
    if isinstance(wanted, _Search):
        searched = _searched(wanted, data, other, integrator)
        fit = searched.fit
        request = searched.chosen.candidate.request_for(data)
        again = structs.replace(request, stable=False, focus=None, starts=None, replicates=None)
    else:
        fit = estimated(data, wanted)
        again = wanted
    validation = None if other is None else _validated(fit, other)
    doubts = _doubts(fit, data, integrator) if searched is None else searched.doubts
    return _Found(
        fit=fit,
        request=again.of_fit(fit),
        search=searched,
        validation=validation,
        doubts=doubts,
    )


def _doubts(fit: Fit, data: Dataset | Signals, integrator: bool | None) -> tuple[Finding, ...]:
    from armrig.cli.spinner import spinner
    from armrig.validation.advice.data_advice import examine_fit_of

    with spinner("testing the data"):
        return tuple(examine_fit_of(data, fit, integrator))


def _searched(
    wanted: _Search,
    data: Dataset | Signals,
    other: Dataset | Signals | None,
    integrator: bool | None,
) -> SearchResult:
    from concurrent.futures import ProcessPoolExecutor
    from contextlib import nullcontext

    from armrig.cli.spinner import estimating
    from armrig.validation.model_search import search

    pool = ProcessPoolExecutor(wanted.jobs) if wanted.jobs > 1 else nullcontext()
    with estimating("--max-order") as progress, pool as executor:
        return search(
            data,
            other,
            orders=range(1, wanted.most + 1),
            executor=executor,
            progress=progress,
            **({"integrator": integrator} | wanted.fixed),
        )


def _validated(fit: Fit, other: Dataset | Signals) -> _Validation:
    from armrig.cli.spinner import estimating
    from armrig.validation.comparison import compare
    from armrig.validation.residuals import residuals

    with estimating("the orders"):
        table, tests = compare(other, fit), residuals(fit, other)
    warn_of_estimation_data(table)
    return _Validation(data=other, table=table, tests=tests)


def _print_lines(found: _Found, validate: Path | None, *, verbose: bool) -> None:
    from armrig.cli import model_output
    from armrig.validation.answer import answer

    table, tests = None, None
    if found.validation is not None:
        table, tests = found.validation.table, found.validation.tests
    say_answer(answer(found.fit, table, tests, found.doubts))
    if verbose:
        _print_all(found, validate)
    else:
        _print_short(found)
    if hint := model_output.hint(found.fit):
        tell(hint)


def _print_short(found: _Found) -> None:
    """Print the results of a search, a short form of the model, and the findings to act on."""
    from armrig.cli import model_output

    searched = found.search is not None
    if found.search is not None:
        say("\n".join(model_output.short_search_lines(found.search)))
    say("\n".join(model_output.short_model_lines(found.fit, roots=not searched)))
    if found.validation is not None:
        for line in model_output.pair_lines(found.validation.tests):
            say(line)
    say("\n".join(model_output.advice_lines(found.fit, found.doubts)))


def _print_all(found: _Found, validate: Path | None) -> None:
    """Print all details of the search, the model and its validation."""
    from armrig.cli import model_output
    from armrig.validation.advice.advice import advice

    if found.search is not None:
        say("\n".join(model_output.search_lines(found.search)))
    say("\n".join(model_output.model_lines(found.fit)))
    said = [f"! {f.about}: {f.text}" for f in found.doubts if found.search is None]
    say("\n".join([*said, repr(advice(found.fit))]))
    if found.validation is not None:
        say(f"validation on {validate}\n{found.validation.table!r}")
        say("\n".join(model_output.residual_lines(found.validation.tests)))


def _print_json(found: _Found, data: Dataset | Signals) -> None:
    from armrig.cli import model_output

    facts = model_output.model_facts(found.fit) | source_facts(data)
    facts["advice"] = [
        {"about": f.about, "level": f.level, "text": f.text}
        for f in (*found.doubts, *model_output.advice_on(found.fit))
    ]
    if found.search is not None:
        facts["search"] = _search_facts(found.search)
    if found.validation is not None:
        v = found.validation
        facts["validation"] = model_output.residual_facts(v.data, v.table.rows, v.tests)
    print_json(facts)


def _say_next(
    found: _Found,
    data: Dataset | Signals,
    file: Path,
    validate: Path | None,
    save: Path | None,
    signals: SignalChoice,
) -> None:
    """Print the next command, which acts on the findings, saves the model or validates it."""
    from armrig.cli import model_output

    about = model_output.to_act_on(found.fit, found.doubts)
    about -= {"outliers"} if signals.hampel else set()
    about -= {"integrator"} if signals.integrator is False else set()
    after_identify(
        found.fit,
        found.request,
        data,
        file,
        signals,
        about=about,
        tests=None if found.validation is None else found.validation.tests,
        validate=validate,
        save=save,
        searched=found.search is not None,
    )


def _plot_model(found: _Found, data: Dataset | Signals, plot: Path | None) -> None:
    if plot is None:
        return
    from armrig.plots import plot_bode, plot_compare, plot_poles_zeros, plot_step
    from armrig.validation.comparison import compare
    from armrig.validation.figures import plot_search

    fit, searched = found.fit, found.search
    drawn: dict[str, Any] = {}
    if searched is not None:
        drawn["search"] = lambda ax: plot_search(searched, ax=ax)
    if (fit.ny, fit.nu) == (1, 1):
        drawn["bode"] = lambda ax: plot_bode(fit, ax=ax)
        drawn["step"] = lambda ax: plot_step(fit, ax=ax)
        drawn["poles"] = lambda ax: plot_poles_zeros(fit, ax=ax)
    else:
        shown = data if found.validation is None else found.validation.data
        table = compare(shown, fit)
        drawn["compare"] = lambda ax: plot_compare(shown, table=table, ax=ax)
        for i, j, channel in fit.channels():
            label = f"{fit.inputs[j]} to {fit.outputs[i]}"
            name = f"bode_{label.replace(' ', '_')}"
            drawn[name] = partial(plot_bode, channel, labels=[label])
    write_plot(plot, height=3.6, **drawn)


def _search_facts(found: SearchResult) -> dict[str, Any]:
    rows = zip(found.ranked, found.rms, found.excess, found.excess_std, strict=True)
    return {
        "models": [
            {
                "model": j.candidate.name,
                "parameters": j.parameters,
                "rms_error": float(rms),
                "excess": float(excess),
                "excess_std": float(std),
                "chosen": j is found.chosen,
            }
            for j, rms, excess, std in rows
        ],
        "failed": {j.candidate.name: j.reason for j in found.failed},
        "reasons": found.explain().splitlines(),
    }
