"""The command that estimates models: identify."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer
from armrig_core.errors import InputError
from armrig_core.telemetry import THETA_1

from armrig.cli.chosen_recording import DataFile, recording_path
from armrig.cli.figures import Plot, check_output, check_plot, write_plot
from armrig.cli.model_structures import (
    Given,
    estimated,
    estimation_options,
    requested,
    searched_for,
)
from armrig.cli.next_step import say_next, typed, validation_beside
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
from armrig.cli.several_signals import Outputs
from armrig.cli.several_signals import identify as identify_several
from armrig.estimation.request import Request
from armrig.models.structure_table import users

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset
    from armrig.data.finding import Finding
    from armrig.models.fit import Fit
    from armrig.models.structure_table import OfferedName
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
        help="Number of processes that --search uses; it uses one process for several signals.",
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
Shared = Annotated[
    bool, typer.Option("--shared", help="One denominator for all outputs (OE, ARMAX).")
]
Save = Annotated[Path | None, typer.Option("--save", metavar="JSON", help="Model file to write.")]


@estimation_options(without_nk="1; estimated with --search of one input and one output")
@reads_data(several=True)
def identify(
    file: DataFile,
    *,
    given: Given,
    search: Search = False,
    most: MaxOrder = 5,
    jobs: Jobs = 1,
    validate: ValidationFile = None,
    signals: SignalChoice,
    shared: Shared = False,
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
    if given["structure"] in (None, *users("offset")):
        signals = replace(signals, offset=given["offset"])
    if signals.assume == "settling" and given["integrator"]:
        raise typer.BadParameter("--assume settling contradicts --integrator: leave one out")
    if signals.several or shared:
        _identify_several(
            file,
            given,
            signals,
            Outputs(validate=validate, save=save, figure=plot, json=json, verbose=verbose),
            most=most if search else None,
            jobs=jobs,
            shared=shared,
        )
        return
    wanted: _Search | Request
    if search:
        wanted = _Search(fixed=searched_for(given), most=most, jobs=jobs)
    else:
        wanted = requested(given)
    _check_files(file, validate, plot=plot, save=save)
    from armrig.recordings.usability import doubts_of_estimation

    data = signals.of(file)
    for recording in signals.read:
        for text in doubts_of_estimation(recording):
            tell(text)
    # An estimation may take minutes: find errors in the validation data before it.
    other = None if validate is None else signals.of(validate)
    if given["integrator"]:
        _warn_of_integrator(data)
    taken: list[str] = []
    integrator = signals.integrator
    if (signals.assume or isinstance(wanted, _Search)) and not (given["integrator"] or json):
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
    _plot_model(found, plot)
    if not json:
        _say_next(found, file, validate, save, signals)


def _identify_several(
    file: Path,
    given: Given,
    signals: SignalChoice,
    to: Outputs,
    *,
    most: int | None,
    jobs: int,
    shared: bool,
) -> None:
    """Estimate a model of several signals, or search for a model of at most `most` poles."""
    if not signals.several:
        raise typer.BadParameter("--shared is for several outputs: name them, --signal A,B")
    if jobs > 1:
        raise typer.BadParameter(
            f"--jobs {jobs}: a search of several signals uses one process; leave --jobs out"
        )
    if signals.assume is not None:
        raise typer.BadParameter(
            f"--assume {signals.assume} is for one output and one input: leave it out"
        )
    _check_files(file, to.validate, plot=to.figure, save=to.save)
    identify_several(file, given, signals, to, most=most, shared=shared)


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

    data: Dataset
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


def _warn_of_integrator(data: Dataset) -> None:
    """Warn if the data are a recording and their output does not integrate."""
    from armrig.data.treatment import INTEGRATING_OUTPUTS

    if from_recording(data) and data.output not in INTEGRATING_OUTPUTS:
        tell(f"--integrator: the rig has no pole at 1 for {data.output}, which does not integrate")


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
    wanted: _Search | Request, data: Dataset, other: Dataset | None, integrator: bool | None
) -> _Found:
    """Estimate or search for a model; if there are validation data, validate the model."""
    searched = None
    if isinstance(wanted, _Search):
        searched = _searched(wanted, data, other, integrator)
        fit = searched.fit
        again = Request(structure=cast("OfferedName", searched.chosen.candidate.family), orders={})
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


def _doubts(fit: Fit, data: Dataset, integrator: bool | None) -> tuple[Finding, ...]:
    from armrig.cli.spinner import spinner
    from armrig.validation.advice.data_advice import examine_fit_of

    with spinner("testing the data"):
        return tuple(examine_fit_of(data, fit, integrator))


def _searched(
    wanted: _Search, data: Dataset, other: Dataset | None, integrator: bool | None
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


def _validated(fit: Fit, other: Dataset) -> _Validation:
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


def _print_json(found: _Found, data: Dataset) -> None:
    from armrig.cli import model_output
    from armrig.validation.advice.advice import advice

    facts = model_output.model_facts(found.fit) | source_facts(data)
    facts["advice"] = [
        {"about": f.about, "level": f.level, "text": f.text}
        for f in (*found.doubts, *advice(found.fit).findings)
    ]
    if found.search is not None:
        facts["search"] = _search_facts(found.search)
    if found.validation is not None:
        v = found.validation
        facts["validation"] = model_output.residual_facts(v.data, v.table[0], v.tests)
    print_json(facts)


def _say_next(
    found: _Found, file: Path, validate: Path | None, save: Path | None, signals: SignalChoice
) -> None:
    """Print the next command, which acts on the findings, saves the model or validates it."""
    from armrig.cli import model_output
    from armrig.cli.next_step import CHECK, options_after, options_of

    fit, given = found.fit, signals.options()
    about = model_output.to_act_on(fit, found.doubts) - ({"outliers"} if signals.hampel else set())
    about -= {"integrator"} if signals.integrator is False else set()
    options = options_after(
        fit, found.request, about, searched=found.search is not None, detrended=signals.detrend
    )
    if validate is not None:
        validation = typed(validate)
    else:
        validation = validation_beside(file) if signals.read else ""
    values: dict[str, str | float] = {"file": typed(file), "given": given, "Ts": fit.Ts}
    values["validation"] = validation
    values["model"] = quote(str(save or "model.json"))
    values["options"] = options + given + (f" --validate {validation}" if validation else "")
    if fit.offset and not signals.detrend:
        given += " --detrend"  # `armrig check` has no option --offset
    if options == CHECK:
        say_next("identify check", **(values | {"given": given}))
    elif save is None or options != options_of(found.request):
        say_next("identify", **values)
    elif validate is not None and signals.read and fit.output == THETA_1:
        say_next("validate", **(values | {"estimation": typed(file), "file": validation}))
    elif validation:
        # `armrig validate` has no option --assume.
        say_next("identify --save", **values | {"given": replace(signals, assume=None).options()})
    else:
        after = "identify alone" if signals.read else "identify check"
        say_next(after, **(values | {"given": given}))


def _plot_model(found: _Found, plot: Path | None) -> None:
    if plot is None:
        return
    from armrig.plots import plot_bode, plot_poles_zeros, plot_step
    from armrig.validation.figures import plot_search

    fit, searched = found.fit, found.search
    write_plot(
        plot,
        height=3.6,
        **({} if searched is None else {"search": lambda ax: plot_search(searched, ax=ax)}),
        bode=lambda ax: plot_bode(fit, ax=ax),
        step=lambda ax: plot_step(fit, ax=ax),
        poles=lambda ax: plot_poles_zeros(fit, ax=ax),
    )


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
