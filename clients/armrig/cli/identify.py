"""The commands that choose and estimate models: sampling, hints, identify, batch."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.errors import FileError, InputError
from armrig_core.process.options import CommandGroup, argument, group, option, preset
from armrig_core.telemetry.channels import INTEGRATING_OUTPUTS
from msgspec import UNSET, structs
from msgspec.structs import asdict

import armrig
from armrig import plots
from armrig.cli import model_structures, results
from armrig.cli.next_step import (
    after_identify,
    command_line_name,
    counterpart,
    say_next,
    step_again,
)
from armrig.cli.options import Detrend, Json, ModelFile, ModelOrders
from armrig.cli.printing import (
    estimating,
    fields_of,
    inform,
    print_result,
    say,
    say_answer,
    say_more,
    some,
    spinner,
    tell,
    tell_findings,
)
from armrig.cli.recorded_data import (
    DataFile,
    SignalChoice,
    by_channel,
    data_group,
    facts_by_channel,
    from_arm,
    from_recording,
    has_level,
    recording_path,
    require_result,
    say_channel,
    source_facts,
)
from armrig.data.step import laws_of
from armrig.estimation.request import Request
from armrig.models.structure_table import STRUCTURES, users
from armrig.numerics.quantities import join_names, plural

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset, Signals
    from armrig.data.finding import Finding
    from armrig.estimation.nonparametric.sampling_time import SamplingTime
    from armrig.estimation.nonparametric.step_analysis import StepAnalysis
    from armrig.models.fit import Fit
    from armrig.report.batch.tasks import Row, Task
    from armrig.validation.comparison import ComparisonTable
    from armrig.validation.residual_test import ResidualTest
    from armrig.validation.structure_hints import StructureHints

_MAX_SHOWN_MODELS = 5  # models of a search without --verbose
_MAX_REASONS = 3  # reasons without --verbose; the table shows the first
_FIRST_ORDER = (
    "P1D"  # process whose time constant and dead time `next:` estimates, if hints find it
)
_LEAST_S, _LEAST_SAMPLES = 30.0, 600  # of the experiment that `next:` names
_SLOW_S, _TIME_CONSTANTS = 300.0, 10  # length from which a rig is slow; then its time constants
_NK = "1, with --search estimated for one input and one output"


@dataclass(frozen=True, slots=True, kw_only=True)
class _SearchRange:
    """Range of a search."""

    search: bool = preset(
        False, "Search several structures, or the given structure, with several orders."
    )
    most: int | None = preset(
        None,
        "Highest order that --search tries.",
        "5, and up to 8 if needed",
        "--max-order",
        min=1,
        max=100,
    )
    jobs: int = preset(1, "Number of processes that --search uses.", min=1)
    open_loop: bool = preset(
        False,
        "The input was not computed from the output, so that --search may try nk = 0.",
        "only for an input that armrig played, or that is held",
    )
    fixed: model_structures.Given = field(default_factory=dict)
    """Fixed arguments of the search; the search chooses all other arguments."""

    def typed(self, values: model_structures.Given) -> str:
        """Return the options of the search, as typed."""
        named = [*model_structures.option_texts(values), "--search"]
        named += [] if self.most is None else [f"--max-order {self.most}"]
        return " ".join([*named, *["--open-loop"] * self.open_loop])


def sampling(
    file: DataFile,
    signals: Annotated[SignalChoice, data_group(without="hampel", several=False)],
    out: results.ShownFigure,
) -> None:
    """Recommend a sampling time (handout 3.1).

    The handout has two rules: a sampling frequency of 20 times the bandwidth, and 7 to 10 samples
    in the transient. The command applies both rules, to a recorded step or to any other input.
    """
    data = signals.of_one(file)
    integrator, taken = signals.choice(data, named=not out.json)  # the notes contain the reason
    with spinner("estimating the response"):
        choice, steps = armrig.sampling_time(data, integrator=integrator), None
        if choice.from_step:
            with suppress(ValueError):  # the levels are not held long enough
                steps = armrig.step_analysis(data, integrator=integrator)
                steps = replace(steps, warnings=())  # they are notes of `choice`, too
    analysis = {} if steps is None else {"step": steps}

    def say_sampling() -> None:
        if out.verbose:
            say_answer("\n".join(map(repr, [choice, *analysis.values()])))
        else:
            say_answer(choice.brief())
            say_more(f"aliasing, reasons{', step analysis' * len(analysis)}")

    def say_after() -> None:
        if signals.read and (again := step_again(signals.read[0])):
            say_next("collect step again", signals.origin, again=again)
        elif from_recording(data) and not laws_of(data.history):
            say_next("collect pair", signals.origin, **_experiment(choice))
        else:
            say_next("hints", file=command_line_name(file), given=signals.options())

    out.show(
        facts=lambda: source_facts(data) | _sampling_facts(choice) | _step_facts(steps),
        say=say_sampling,
        taken=taken,
        figures=lambda: {name: a.plot for name, a in (analysis | {"sampling": choice}).items()},
        say_next=say_after,
        height=5.0,
    )


def _experiment(choice: SamplingTime) -> dict[str, str | float]:
    """Return sampling time, length and switching of the experiment that the line `next:` names."""
    from armrig_core.commands.commands import LONGEST_TS

    from armrig.estimation.nonparametric.sampling_time import nearest_125

    Ts = min(choice.Ts, LONGEST_TS)
    seconds, switching = max(_LEAST_S, _LEAST_SAMPLES * Ts), ""
    if seconds > _SLOW_S:  # a slow rig is sampled faster, and its input is held for about tau
        seconds = max(_SLOW_S, nearest_125(_TIME_CONSTANTS * choice.tau))
        Ts = min(Ts, nearest_125(seconds / _LEAST_SAMPLES))
        switching = f" --a {nearest_125(Ts / choice.tau):g}"
    return {"Ts": Ts, "seconds": seconds, "switching": switching}


def _sampling_facts(choice: SamplingTime) -> dict[str, Any]:
    method = "step" if choice.from_step else "impulse response"
    names = "tau omega_step omega_first omega_spectrum settling settling_std Ts_step Ts_spectrum "
    names += "Ts_transient near_nyquist beyond notes"
    return (
        fields_of(choice, "Ts recorded_at output") | {"method": method} | fields_of(choice, names)
    )


def _step_facts(steps: StepAnalysis | None) -> dict[str, Any]:
    names = "gain gain_std tau tau_std equivalent_time equivalent_time_std settling settling_std "
    names += "overshoot overshoot_std dead_time dead_time_interval"
    return {} if steps is None else {"step": fields_of(steps, names)}


def hints(
    file: DataFile,
    signals: Annotated[SignalChoice, data_group(without="hampel")],
    out: Annotated[results.OutputOptions, results.output_group("plot", "json")],
) -> None:
    """Suggest a model structure for the data (handout 3.2).

    The command estimates the order and nk, and whether there is an integrator. Its reasons are the
    description lengths of models, the spectra and the test for a delay. With several signals, it
    looks at each pair of an input and an output.
    """
    from armrig.validation.structure_hints import call_of_all

    data = signals.of(file)
    with spinner("estimating without a structure"):
        outcomes = by_channel(partial(armrig.structure_hints, integrator=signals.integrator), data)
        tests = by_channel(armrig.linearity, data)
    linear = {n: f"not known: {t}" if isinstance(t, str) else t.line for n, t in tests.items()}
    require_result(outcomes.values())
    channel_hints = {
        name: outcome for name, outcome in outcomes.items() if not isinstance(outcome, str)
    }
    spectra = {"spectra": partial(data.plot, "spectrum")} if () in channel_hints else {}

    def say_hints() -> None:
        for channel, outcome in outcomes.items():
            say_channel(channel)
            hint = f"not known: {outcome}" if isinstance(outcome, str) else repr(outcome)
            say_answer(f"{hint}\n  linearity: {linear[channel]}")
        if () not in outcomes and len(channel_hints) == len(outcomes):
            by_pair = {
                (output, input): outcome for (input, output), outcome in channel_hints.items()
            }
            say_answer(f"all channels: {call_of_all(by_pair)}")

    def say_after() -> None:
        data_options = signals.options()
        validation = counterpart(file, "validation") if from_recording(data) else ""
        validate = f" --validate {validation}" if validation else ""
        options = _options([*channel_hints.values()], level=has_level(data))
        if len(channel_hints) > 1 and any(hint.doubts for hint in channel_hints.values()):
            options = "--search"  # with feedback, OE would be biased
        options += data_options
        values = {"options": options, "validate": validate, "model": "model.json"}
        say_next("identify", file=command_line_name(file), **values)

    out.show(
        facts=lambda: facts_by_channel(
            data, {n: (one, linear[n]) for n, one in outcomes.items()}, _hint_facts
        ),
        say=say_hints,
        taken=signals.choice(data, channel_hints[()].integrator)[1] if () in channel_hints else (),
        figures=lambda: results.figures_by_channel(
            channel_hints,
            lambda one: {"impulse": one.response.plot, **spectra, "structure": one.plot},
        ),
        say_next=say_after,
        height=5.0 if () in channel_hints else 4.0,
        columns=None if () in channel_hints else 2,
    )


def _options(all_hints: Sequence[StructureHints], *, level: bool) -> str:
    """Return the options of `armrig identify` for hints, and for outputs with a level."""
    offset = " --offset" * level
    if [hint.process for hint in all_hints if not hint.doubts] == [_FIRST_ORDER]:
        return f"--structure process --form {_FIRST_ORDER}{offset}"
    nf = max(hint.nf for hint in all_hints)
    # With one denominator, each channel of a sampled plant has a numerator of its order.
    nb = max(hint.nb for hint in all_hints) if len(all_hints) == 1 else nf
    lagged = [hint for hint in all_hints if hint.nk_interval] or all_hints  # without unknown delays
    family = all_hints[0].family if len(all_hints) == 1 else "oe"
    poles = f"--na {nf} --nc {nf}" if family == "armax" else f"--nf {nf}"
    options = f"--structure {family} --nb {nb} {poles} --nk {min(hint.nk for hint in lagged)}"
    integrates = any(hint.integrator for hint in all_hints)
    return options + (" --integrator" if integrates else offset)


def _hint_facts(hint: tuple[StructureHints | str, str]) -> dict[str, Any]:
    """Return the hints about a channel, or the reason for missing hints, and its linearity."""
    suggestion, linear = hint
    if isinstance(suggestion, str):
        return {"structure": None, "reasons": [suggestion], "doubts": [], "linearity": linear}
    names = "integrator integrator_shown low_slope high_slope relative_degree "
    names += "resonances antiresonances nk_interval excess"
    return {
        "structure": suggestion.family,
        "orders": fields_of(suggestion, "nb nf nk")
        if suggestion.family != "armax"
        else {"na": suggestion.nf, "nb": suggestion.nb, "nc": suggestion.nf, "nk": suggestion.nk},
        "structures": [fields_of(s, "nb nf nk integrator") for s in suggestion.structures],
        **fields_of(suggestion, names),
        "reasons": [*suggestion.reasons],
        "doubts": [f.text for f in suggestion.findings if f.level != "good"],
        "linearity": linear,
    }


def identify(
    *,
    file: DataFile,
    options: Annotated[model_structures.Given, model_structures.estimation_options(default_nk=_NK)],
    searching: Annotated[
        _SearchRange, group(_SearchRange, ("search", "most", "jobs", "open_loop"))
    ],
    validate: Path | None = preset(
        None, "Recording, or other data, for validation.", metavar="F2", parser=recording_path
    ),
    signals: Annotated[SignalChoice, data_group()],
    save: Path | None = preset(None, "Model file to write.", metavar="JSON"),
    out: results.ShownFigure,
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
    if options["structure"] in (None, *users("offset")):
        signals = replace(signals, offset=options["offset"])
    if signals.assume == "settling" and options["integrator"]:
        raise typer.BadParameter("--assume settling contradicts --integrator: leave one out")
    wanted: _SearchRange | Request
    if searching.search:
        wanted = replace(searching, fixed=model_structures.search_arguments(options, *shape))
    else:
        wanted = model_structures.build_request(options, *shape)
    if save is not None:
        contents = "a model is written as JSON, a figure by -o"
        results.check_output(
            save, list(filter(None, [file, validate])), "--save", contents, ".json"
        )
        if save.is_file() and b"armrig control law" in save.read_bytes()[:200]:
            text = "is a control law, which would be overwritten; give another name"
            raise InputError(f"--save {save}: {text}")
    from armrig.recordings.usability import doubts_of_estimation

    data = signals.of(file)
    for recording in signals.read:
        tell_findings(doubts_of_estimation(recording))
    # An estimation may take minutes: find errors in the validation data before it.
    other = None if validate is None else signals.of(validate)
    if isinstance(wanted, _SearchRange) and signals.read:
        runs = [recording.manifest for recording in signals.read]
        played = all(run.samples > 0 and run.controller_sha256 is UNSET for run in runs)
        wanted = replace(wanted, open_loop=wanted.open_loop or played)
    wanted = _for_outputs(wanted, data, integrator=options["integrator"])
    decides = (signals.assume or searching.search) and not (options["integrator"] or out.json)
    integrator, taken = signals.choice(data, named=bool(decides))
    fit, request, searched = _estimate_or_search(wanted, data, other, integrator)
    outcome = IdentifyOutcome(
        fit=fit,
        request=request,
        search=searched,
        validation=None if other is None else _validate_fit(fit, other),
        doubts=_doubts(fit, data, integrator) if searched is None else searched.doubts,
        data=data,
        file=file,
        validate=validate,
        save=save,
        signals=signals,
        search_options=searching.typed(options) if searching.search else "",
    )
    out.show(
        facts=outcome.facts,
        say=lambda: outcome.say(verbose=out.verbose),
        taken=taken,
        figures=outcome.figures,
        say_next=outcome.say_next,
        write=None if save is None else partial(_save, outcome.fit, save),
        width=results.WIDTH if outcome.fit.nu == 1 else results.CHANNEL_WIDTH,
        columns=None if outcome.fit.nu == 1 else outcome.fit.nu,
    )


def _for_outputs(
    wanted: _SearchRange | Request, data: Dataset | Signals, *, integrator: bool
) -> _SearchRange | Request:
    """Return what is wanted, with the integrators and the shared denominator of several outputs."""
    # A rig's outputs share one denominator. Some outputs of the arm integrate, and all other data.
    columns, recorded, is_arm = data.signals(), from_recording(data), from_arm(data)
    integrating = tuple(
        name for name in columns.outputs if not is_arm or name in INTEGRATING_OUTPUTS
    )
    if integrator and not integrating:
        msg = f"--integrator: the rig has no pole at 1 for {join_names(columns.outputs)}"
        if columns.ny > 1:
            raise typer.BadParameter(msg)
        tell(f"{msg}, which does not integrate")
    if (columns.ny, columns.nu) == (1, 1):
        return wanted
    if isinstance(wanted, _SearchRange):
        fixed = wanted.fixed | {"integrator": integrating if integrator or is_arm else ()}
        return replace(wanted, fixed=fixed)
    if recorded and "shared" in STRUCTURES[wanted.structure].takes:
        wanted = structs.replace(wanted, shared=True)
    return structs.replace(wanted, integrator=integrating) if integrator else wanted


@dataclass(frozen=True, slots=True, kw_only=True)
class _Validation:
    """Results of the model on the validation data."""

    data: Dataset | Signals
    table: ComparisonTable
    tests: ResidualTest


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyOutcome:
    """Model, and the results of its estimation or search."""

    fit: Fit
    request: Request
    """Request with which the model can be estimated again."""
    search: armrig.SearchResult | None
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
    search_options: str
    """Options of the search, as typed; "" without a search."""

    def say(self, *, verbose: bool) -> None:
        """Print the answer, and the model."""
        from armrig.validation.answer import answer

        v = self.validation
        table, tests = (v.table, v.tests) if v is not None else (None, None)
        say_answer(answer(self.fit, table, tests, self.doubts))
        for lines in self._all() if verbose else self._short():
            say("\n".join(lines))

    def _short(self) -> Iterator[Sequence[str]]:
        """Yield the results of a search, a short form of the model, and the findings to act on."""
        from armrig.cli import model_output
        from armrig.models import equation

        if (search := self.search) is not None:
            reasons = search.reasons[1:_MAX_REASONS]
            yield [search.table(_MAX_SHOWN_MODELS), *(f"- {reason}" for reason in reasons)]
        yield equation.short_lines(self.fit, roots=self.search is None)
        if self.validation is not None:
            yield from ([line] for line in self.validation.tests.pair_lines())
        yield model_output.advice_lines(self.fit, self.doubts)

    def _all(self) -> Iterator[Sequence[str]]:
        """Yield all details of the search, the model and its validation."""
        from armrig.models import equation

        if self.search is not None:
            yield [self.search.table(), self.search.explain()]
        yield equation.estimation_lines(self.fit)
        doubt_lines = [f"! {f.about}: {f.text}" for f in self.doubts if self.search is None]
        yield [*doubt_lines, repr(armrig.advice(self.fit))]
        if self.validation is not None:
            yield [f"validation on {self.validate}", repr(self.validation.table)]
            yield self.validation.tests.lines(every=True)

    def facts(self) -> dict[str, Any]:
        """Return the model, its advice, the search and the validation as JSON fields."""
        from armrig.cli import model_output
        from armrig.models import equation

        facts = equation.estimation_facts(self.fit) | source_facts(self.data)
        findings = (*self.doubts, *model_output.advice_on(self.fit))
        facts["advice"] = [fields_of(f, "about level text") for f in findings]
        if self.search is not None:
            facts["search"] = _search_facts(self.search)
        if self.validation is not None:
            v = self.validation
            facts["validation"] = model_output.residual_facts(v.data, v.table.rows, v.tests)
        return facts

    def figures(self) -> dict[str, results.Draw]:
        """Return the diagrams of the model, and the errors of a search."""
        from armrig.validation.figures import plot_search

        fit = self.fit
        drawn: dict[str, results.Draw] = {}
        if self.search is not None:
            drawn["search"] = partial(plot_search, self.search)
        if (fit.ny, fit.nu) == (1, 1):
            each = {
                "bode": plots.plot_bode,
                "step": plots.plot_step,
                "poles": plots.plot_poles_zeros,
            }
            return drawn | {name: partial(plot, fit) for name, plot in each.items()}
        data = self.data if self.validation is None else self.validation.data
        drawn["compare"] = armrig.compare(data, fit).plot
        for i, j, channel in fit.channels():
            label = f"{fit.inputs[j]} to {fit.outputs[i]}"
            drawn[f"bode_{label.replace(' ', '_')}"] = partial(
                plots.plot_bode, channel, labels=[label]
            )
        return drawn

    def say_next(self) -> None:
        """Print the next command, which acts on the findings, saves the model or validates it."""
        from armrig.cli.model_output import advice_on

        done = {"outliers"} if self.signals.hampel else set()
        done |= {"integrator"} if self.signals.integrator is False else set()
        findings = (*self.doubts, *advice_on(self.fit))
        after_identify(self, [f for f in findings if f.level != "good" and f.remedy not in done])


def _estimate_or_search(
    wanted: _SearchRange | Request,
    data: Dataset | Signals,
    other: Dataset | Signals | None,
    integrator: bool | None,
) -> tuple[Fit, Request, armrig.SearchResult | None]:
    """Return the model, the request with which to estimate it again, and the search if any."""
    if isinstance(wanted, Request):
        fit = model_structures.estimate_model(data, wanted)
        return fit, wanted.of_fit(fit), None
    search = _search_models(wanted, data, other, integrator)
    request = search.chosen.candidate.request
    again = structs.replace(request, stable=False, focus=None, starts=None, replicates=None)
    return search.fit, again.of_fit(search.fit), search


def _doubts(fit: Fit, data: Dataset | Signals, integrator: bool | None) -> tuple[Finding, ...]:
    from armrig.validation.advice import examine_fit_of

    with spinner("testing the data"):
        return tuple(examine_fit_of(data, fit, integrator))


def _search_models(
    wanted: _SearchRange,
    data: Dataset | Signals,
    other: Dataset | Signals | None,
    integrator: bool | None,
) -> armrig.SearchResult:
    from concurrent.futures import ProcessPoolExecutor

    arguments: model_structures.Given = {"integrator": integrator} | wanted.fixed
    pool = ProcessPoolExecutor(wanted.jobs) if wanted.jobs > 1 else nullcontext()
    with estimating("--max-order") as progress, pool as executor:
        return armrig.search(
            data,
            other,
            orders=None if wanted.most is None else range(1, wanted.most + 1),
            open_loop=wanted.open_loop,
            executor=executor,
            progress=progress,
            **arguments,
        )


def _save(fit: Fit, path: Path) -> None:
    """Write a model, and say whether another file was replaced."""
    replaced = path.exists()
    fit.save(path)
    if replaced:
        inform(f"replaced: {path}", dim=True)


def _validate_fit(fit: Fit, other: Dataset | Signals) -> _Validation:
    with estimating("the orders"):
        table, tests = armrig.compare(other, fit), armrig.residuals(fit, other)
    tell_findings(table.findings)
    return _Validation(data=other, table=table, tests=tests)


def _search_facts(search: armrig.SearchResult) -> dict[str, Any]:
    rows = zip(search.ranked, search.rms, search.excess, search.excess_std, strict=True)
    return {
        "models": [
            {
                "model": j.candidate.name,
                "parameters": j.parameters,
                "rms_error": rms,
                "excess": excess,
                "excess_std": std,
                "chosen": j is search.chosen,
            }
            for j, rms, excess, std in rows
        ],
        "failed": {candidate.name: reason for candidate, reason in search.failed.items()},
        "reasons": search.explain().splitlines(),
    }


batch = CommandGroup(
    "Process all recordings of a folder. Write a table (Parquet) with a row for each recording.",
    no_args_is_help=True,
)
Folder = Annotated[Path, argument("FOLDER", "Folder of the recordings.")]
Table = Annotated[
    Path, option("-o --output PARQUET", "Table to write; an existing table is continued.")
]
_TASKS_PER_WORKER = 2  # one runs, one waits
_CLUSTER_TASKS = 2000  # enough for 1000 workers, because a cluster may grow
_MAX_NAMES = 3  # recordings in a message


@dataclass(frozen=True, slots=True, kw_only=True)
class _Selection:
    """Options of all batches: the recordings, the processes and the form of the result."""

    rig: list[str] | None = preset(None, "Id of a rig to include; repeatable.", "all rigs")
    kind: list[str] | None = preset(None, "Kind of experiment to include; repeatable.", "all kinds")
    workers: int | None = preset(
        None, "Number of processes on this machine.", "one for each core", min=1
    )
    scheduler: str | None = preset(
        None, "Address of a Dask scheduler whose workers process the recordings.", metavar="ADDRESS"
    )
    force: bool = preset(False, "Process all recordings again and replace the table.")
    json: Json = False


Selection = Annotated[_Selection, group(_Selection)]


@batch.add("batch identify weeks -o models.parquet --integrator --kind blackbox", "identify")
def identify_each(
    *,
    folder: Folder,
    output: Table,
    options: Annotated[model_structures.Given, model_structures.estimation_options(structure="oe")],
    signal: str | None = preset(None, "Output of the model.", "the first channel", metavar="NAME"),
    detrend: Detrend = False,
    selection: Selection,
) -> None:
    """Estimate a model from each recording.

    The table contains the parameters, their standard deviations, the fit and the model.
    """
    from armrig.report.batch.tasks import Identify

    task = Identify(
        **asdict(model_structures.build_request(options)), signal=signal, detrend=detrend
    )
    _process(task, folder, output, selection)


@batch.add("batch validate weeks --model model.json -o fits.parquet", "validate")
def validate_each(
    *,
    folder: Folder,
    model: ModelFile,
    output: Table,
    detrend: Detrend = False,
    selection: Selection,
) -> None:
    """Validate one model on each recording.

    The table contains the results of the simulation and of the tests of the residuals.
    """
    from armrig.models.model_writing import model_text
    from armrig.report.batch.tasks import Validate

    fit = armrig.load_fit(model)
    if (fit.ny, fit.nu) != (1, 1):
        raise FileError(
            f"{model} is a model of several signals; here give a model of one output and one "
            "input, such as fit[OUTPUT, INPUT] of it (armrig.load_fit and fit.save in Python)"
        )
    task = Validate(model=model_text(fit), detrend=detrend)
    _process(task, folder, output, selection)


@batch.add("batch verify weeks -o checks.parquet", "verify")
def verify_each(folder: Folder, output: Table, selection: Selection) -> None:
    """Check the integrity of each recording. The exit code is 1 if a check fails."""
    from armrig.report.batch.tasks import Verify

    _process(Verify(), folder, output, selection)


@batch.add("batch report weeks -o reports.parquet --kind blackbox", "report")
def report_each(
    *,
    folder: Folder,
    output: Table,
    reports: Path = preset(Path("reports"), "Folder for the PDFs.", metavar="FOLDER"),
    orders: ModelOrders,
    selection: Selection,
) -> None:
    """Write a report on each recording, with its validation recording if there is one."""
    from armrig.report.batch.tasks import Report

    _process(Report(folder=str(reports.resolve()), **orders), folder, output, selection)


def _process(task: Task, folder: Path, output: Path, selection: _Selection) -> None:
    """Run the task and print the result; exit with 1 after a problem or a failed check."""
    from armrig.report.batch.batch import Open
    from armrig.report.batch.batch import batch as processed
    from armrig.report.batch.cluster import cluster
    from armrig.report.batch.workers import processes

    results.check_output(output, (), "-o", "a table is a Parquet file", ".parquet")
    many = selection.workers or os.cpu_count() or 1
    executor: Open = partial(processes, many)
    at_once = _TASKS_PER_WORKER * many
    if selection.scheduler is not None:
        if selection.workers is not None:
            raise typer.BadParameter("--workers does not go with --scheduler, which has its own")
        executor, at_once = cluster(selection.scheduler, folder.resolve()), _CLUSTER_TASKS
    with spinner("processing") as count:
        rows, done_before = processed(
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
    _say_batch(output, rows, done_before, json=selection.json)


def _say_batch(table: Path, rows: list[Row], done_before: int, *, json: bool) -> None:
    failed, damaged, without = dict[str, str](), dict[str, str](), dict[str, str]()
    for row in rows:
        name = row["recording"]
        if row["problem"]:
            without[name] = row["problem"]
        if row.get("passed") is False:
            failed[name] = _failure_text(row)
        elif row["damage"] and not row["problem"]:
            damaged[name] = f"the result covers the undamaged part: {row['damage']}"
    facts = {"table": table, "rows": len(rows), "done_before": done_before}
    before = f", {done_before} of them processed before" if done_before else ""
    print_result(
        facts | {"problems": without, "damaged": damaged, "failed": failed},
        f"{table}: {plural(len(rows), 'recording')}{before}; {len(without)} without a result",
        *_first(without, "column problem contains"),
        *_first(damaged, "column damage contains"),
        *_first(failed, "columns of the checks contain"),
        json=json,
    )
    if failed:
        names = some([*failed], _MAX_NAMES)
        tell(f"{len(failed)} failed a check: {names}; the table contains the checks")
    if without or failed:
        raise typer.Exit(1)


def _failure_text(row: dict[str, Any]) -> str:
    """Return the failed checks of a recording and their results."""
    from armrig.report.batch.tasks import CHECKS

    failed = (about for about in CHECKS if row[f"{about}_result"] == "failed")
    return "; ".join(f"{about} failed: {row[f'{about}_found']}" for about in failed)


def _first(findings: dict[str, str], columns: str) -> Iterator[str]:
    """Yield the first findings about recordings, and the columns that contain all findings."""
    for name, text in [*findings.items()][:_MAX_NAMES]:
        yield f"  {name}: {text}"
    if len(findings) > _MAX_NAMES:
        yield f"  and {len(findings) - _MAX_NAMES} more; the {columns} all reasons"
