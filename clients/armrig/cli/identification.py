"""The command that estimates models: identify."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.errors import InputError
from msgspec import structs

from armrig.cli.model_structures import (
    Given,
    estimated,
    estimation_options,
    requested,
    searched_for,
)
from armrig.cli.next_estimation import after_identify
from armrig.cli.options import chosen, group
from armrig.cli.printing import fields_of, say, say_answer, tell
from armrig.cli.reading_options import DataFile, recording_path
from armrig.cli.recorded_data import (
    SignalChoice,
    data_group,
    from_recording,
    source_facts,
    warn_of_estimation_data,
)
from armrig.cli.results import CHANNEL_WIDTH, WIDTH, Draw, Output, ShownFigure, check_output
from armrig.cli.spinner import estimating, spinner
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

_NK = "1; estimated with --search of one input and one output"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Search:
    """Range of a search."""

    search: bool = chosen(
        False, "--search", "Search several structures, or the given structure, with several orders."
    )
    most: int = chosen(5, "--max-order", "Highest order that --search tries.", min=1)
    jobs: int = chosen(1, "--jobs", "Number of processes that --search uses.", min=1)
    fixed: Given = field(default_factory=dict)
    """Fixed arguments of the search; the search chooses all other arguments."""


def identify(
    *,
    file: DataFile,
    given: Annotated[Given, estimation_options(without_nk=_NK)],
    searching: Annotated[_Search, group(_Search, ("search", "most", "jobs"))],
    validate: Path | None = chosen(
        None, "--validate F2", "Recording, or other data, for validation.", parser=recording_path
    ),
    signals: Annotated[SignalChoice, data_group()],
    save: Path | None = chosen(None, "--save JSON", "Model file to write."),
    out: ShownFigure,
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
    if searching.search:
        wanted = replace(searching, fixed=searched_for(given, *shape))
    else:
        wanted = requested(given, *shape)
    _check_files(out, save, file, validate)
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
    decides = signals.assume or searching.search
    if decides and shape == (1, 1) and not (given["integrator"] or out.json):
        integrator, taken = signals.choice(data)
    fit, request, searched = _estimated(wanted, data, other, integrator)
    found = Found(
        fit=fit,
        request=request,
        search=searched,
        validation=None if other is None else _validated(fit, other),
        doubts=_doubts(fit, data, integrator) if searched is None else searched.doubts,
        data=data,
        file=file,
        validate=validate,
        save=save,
        signals=signals,
        taken=taken,
    )
    out.show(
        facts=found.facts,
        say=lambda: found.say(verbose=out.verbose),
        figures=found.figures,
        say_next=found.say_next,
        write=None if save is None else lambda: found.fit.save(save),
        width=WIDTH if found.fit.nu == 1 else CHANNEL_WIDTH,
        columns=None if found.fit.nu == 1 else found.fit.nu,
    )


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


def _check_files(out: Output, save: Path | None, *inputs: Path | None) -> None:
    """Refuse, before the estimation, files that cannot or must not be written."""
    out.check(*inputs)
    if save is not None:
        check_output(save, [path for path in inputs if path is not None])
        if save.suffix.lower() != ".json":
            msg = f"--save {save}: a model is written as JSON; give a name that ends in .json"
            raise InputError(f"{msg}; to write a figure, use -o")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Validation:
    """Results of the model on the validation data."""

    data: Dataset | Signals
    table: ComparisonTable
    tests: ResidualTest


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """Model, and the results of its estimation or search."""

    fit: Fit
    request: Request
    """Request with which the model can be estimated again."""
    search: SearchResult | None
    validation: _Validation | None
    doubts: tuple[Finding, ...]
    """Findings that make the data doubtful."""
    data: Dataset | Signals
    file: Path
    validate: Path | None
    """File of the validation data."""
    save: Path | None
    """File of the model."""
    signals: SignalChoice
    taken: list[str]
    """Line that says how the output is taken."""

    def say(self, *, verbose: bool) -> None:
        """Print the answer, and the model."""
        from armrig.cli import model_output
        from armrig.validation.answer import answer

        for line in self.taken:
            say(line)
        v = self.validation
        table, tests = (v.table, v.tests) if v is not None else (None, None)
        say_answer(answer(self.fit, table, tests, self.doubts))
        for lines in self._all() if verbose else self._short():
            say("\n".join(lines))
        if hint := model_output.hint(self.fit):
            tell(hint)

    def _short(self) -> Iterator[Sequence[str]]:
        """Yield the results of a search, a short form of the model, and the findings to act on."""
        from armrig.cli import model_output

        if self.search is not None:
            yield model_output.short_search_lines(self.search)
        yield model_output.short_model_lines(self.fit, roots=self.search is None)
        if self.validation is not None:
            yield from ([line] for line in model_output.pair_lines(self.validation.tests))
        yield model_output.advice_lines(self.fit, self.doubts)

    def _all(self) -> Iterator[Sequence[str]]:
        """Yield all details of the search, the model and its validation."""
        from armrig.cli import model_output
        from armrig.validation.advice import advice

        if self.search is not None:
            yield model_output.search_lines(self.search)
        yield model_output.model_lines(self.fit)
        said = [f"! {f.about}: {f.text}" for f in self.doubts if self.search is None]
        yield [*said, repr(advice(self.fit))]
        if self.validation is not None:
            yield [f"validation on {self.validate}", repr(self.validation.table)]
            yield model_output.residual_lines(self.validation.tests)

    def facts(self) -> dict[str, Any]:
        """Return the model, its advice, the search and the validation as JSON fields."""
        from armrig.cli import model_output

        facts = model_output.model_facts(self.fit) | source_facts(self.data)
        found = (*self.doubts, *model_output.advice_on(self.fit))
        facts["advice"] = [fields_of(f, "about level text") for f in found]
        if self.search is not None:
            facts["search"] = _search_facts(self.search)
        if self.validation is not None:
            v = self.validation
            facts["validation"] = model_output.residual_facts(v.data, v.table.rows, v.tests)
        return facts

    def figures(self) -> dict[str, Draw]:
        """Return the diagrams of the model, and the errors of a search."""
        from armrig.plots import plot_bode, plot_compare, plot_poles_zeros, plot_step
        from armrig.validation.comparison import compare
        from armrig.validation.figures import plot_search

        fit = self.fit
        drawn: dict[str, Draw] = {}
        if self.search is not None:
            drawn["search"] = partial(plot_search, self.search)
        if (fit.ny, fit.nu) == (1, 1):
            each = {"bode": plot_bode, "step": plot_step, "poles": plot_poles_zeros}
            return drawn | {name: partial(plot, fit) for name, plot in each.items()}
        shown = self.data if self.validation is None else self.validation.data
        drawn["compare"] = partial(plot_compare, shown, table=compare(shown, fit))
        for i, j, channel in fit.channels():
            label = f"{fit.inputs[j]} to {fit.outputs[i]}"
            drawn[f"bode_{label.replace(' ', '_')}"] = partial(plot_bode, channel, labels=[label])
        return drawn

    def say_next(self) -> None:
        """Print the next command, which acts on the findings, saves the model or validates it."""
        from armrig.cli.model_output import to_act_on

        about = to_act_on(self.fit, self.doubts)
        about -= {"outliers"} if self.signals.hampel else set()
        about -= {"integrator"} if self.signals.integrator is False else set()
        after_identify(self, about)


def _estimated(
    wanted: _Search | Request,
    data: Dataset | Signals,
    other: Dataset | Signals | None,
    integrator: bool | None,
) -> tuple[Fit, Request, SearchResult | None]:
    """Return the model, the request with which to estimate it again, and the search if any."""
    if isinstance(wanted, Request):
        fit = estimated(data, wanted)
        return fit, wanted.of_fit(fit), None
    found = _searched(wanted, data, other, integrator)
    request = found.chosen.candidate.request_for(data)
    again = structs.replace(request, stable=False, focus=None, starts=None, replicates=None)
    return found.fit, again.of_fit(found.fit), found


def _doubts(fit: Fit, data: Dataset | Signals, integrator: bool | None) -> tuple[Finding, ...]:
    from armrig.validation.data_advice import examine_fit_of

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

    from armrig.validation.model_search import search

    given: Given = {"integrator": integrator} | wanted.fixed
    pool = ProcessPoolExecutor(wanted.jobs) if wanted.jobs > 1 else nullcontext()
    with estimating("--max-order") as progress, pool as executor:
        return search(
            data,
            other,
            orders=range(1, wanted.most + 1),
            executor=executor,
            progress=progress,
            **given,
        )


def _validated(fit: Fit, other: Dataset | Signals) -> _Validation:
    from armrig.validation.comparison import compare
    from armrig.validation.residuals import residuals

    with estimating("the orders"):
        table, tests = compare(other, fit), residuals(fit, other)
    warn_of_estimation_data(table)
    return _Validation(data=other, table=table, tests=tests)


def _search_facts(found: SearchResult) -> dict[str, Any]:
    rows = zip(found.ranked, found.rms, found.excess, found.excess_std, strict=True)
    return {
        "models": [
            {
                "model": j.candidate.name,
                "parameters": j.parameters,
                "rms_error": rms,
                "excess": excess,
                "excess_std": std,
                "chosen": j is found.chosen,
            }
            for j, rms, excess, std in rows
        ],
        "failed": {j.candidate.name: j.reason for j in found.failed},
        "reasons": found.explain().splitlines(),
    }
