"""Data that commands read from recordings and other files, and notes about these data."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, TypeVar

import typer
from armrig_core.errors import InputError
from armrig_core.process.options import Group, argument, group, preset
from armrig_core.recording_file.part_names import part_paths
from armrig_core.telemetry.channels import ARM_OUTPUTS, CHANNELS, INTEGRATING_OUTPUTS

import armrig
from armrig.cli.options import CalibrationFile, Detrend, From, To
from armrig.cli.printing import inform, report_damage, say, spinner, tell, tell_findings
from armrig.cli.results import name_runs
from armrig.data.files import OTHER_DATA, RECORDING
from armrig.data.finding import few_samples
from armrig.data.level import far_from_zero
from armrig.data.step import DOUBT, MEAN, OTHER_INPUTS, codes_of
from armrig.data.time_range import between
from armrig.numerics.quantities import join_names, plural

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset, Signals, Vector
    from armrig.data.files.imported_file import Import
    from armrig.models.fit import Fit
    from armrig.models.spectral_estimate import SpectralEstimate
    from armrig.recordings.files.origin import Origin

T = TypeVar("T")
_NAMES = "@last or @NAME"


def recording_path(text: str) -> Path:
    """Return the path of a recording from its path or @name; print what the @name means.

    The line names the recording as later lines do. A name that the user typed in another form
    precedes this name, such as `@last is @monday`.
    """
    from armrig.recordings.files.recording_names import (
        contents,
        find_recording,
        name_of,
        recording_folder,
    )

    if not text.startswith("@"):
        _check_bare_name(Path(text))
        return Path(text)
    recording = find_recording(text, recording_folder())
    name = name_of(recording.path)
    which = f"{text}:" if name == text else f"{text} is {name},"
    inform(f"{which} {contents(recording)}", dim=True)
    return recording.path


def _check_bare_name(path: Path) -> None:
    """Refuse a word that is not a file: a name without @, or a file without its suffix."""
    if path.suffix or path.parent != Path() or path.exists():
        return
    from armrig.recordings.files.recording_names import NoSuchRecordingError

    beside = path.with_suffix(RECORDING)
    is_there = path.name and part_paths(beside)[0].exists()
    meant = str(beside) if is_there else f"@{path}"
    raise NoSuchRecordingError(f"{path}: there is no such file; did you mean {meant}?")


OtherFile = Annotated[
    Path | None, argument("F2", "Recording for validation.", False, parser=recording_path)
]
File = Annotated[Path, argument("F", f"Recording (*.mcap), {_NAMES}.", parser=recording_path)]
DataFile = Annotated[
    Path, argument("F", f"Recording (*.mcap, {_NAMES}), or {OTHER_DATA}.", parser=recording_path)
]
Assumption = Literal["integrating", "settling"]
PART = ("calibration", "start", "stop")
"""Options of reading a recording."""
_FLAGS = {"start": "--from", "stop": "--to"}
_DEFAULT_NAME = re.compile(r"[uy]\d*")  # of a column without a name
_DIGITS = 12  # of a number in a command line


@dataclass(frozen=True, slots=True, kw_only=True)
class DataOptions:
    """Options that choose and treat the data of a command."""

    input: str | None = preset(
        None,
        "Column of the input in other data: its name, or its number from 1.",
        "u",
        metavar="NAME",
    )
    signal: str | None = preset(
        None,
        "Output: a channel of the rig, or its rate; in other data, the column's name, or its "
        "number from 1.",
        "the first channel, in other data y",
        metavar="NAME",
    )
    Ts: float | None = preset(None, "Sampling time of other data, in s.", "from the times")
    detrend: Detrend = False
    hampel: bool = preset(False, "Mark single outliers of the output as missing.")
    assume: Assumption | None = preset(
        None,
        "Kind of the output: integrating, if it is the integral of its rate, or settling.",
        "a test of the data decides",
    )
    calibration: CalibrationFile = None
    start: From = None
    stop: To = None

    def given(self, *names: str) -> list[str]:
        """Return the options that differ from their defaults, as a user types them."""
        typed = []
        for name in names or OPTIONS:
            value = getattr(self, name)
            if value is None or value is False:  # not 0.0
                continue
            text = f"{value:.{_DIGITS}g}" if isinstance(value, float) else quote(str(value))
            flag = _FLAGS.get(name, f"--{name.replace('_', '-')}")
            typed.append(flag if value is True else f"{flag} {text}")
        return typed


OPTIONS = tuple(field.name for field in fields(DataOptions))
"""Names of all options of `DataOptions`."""

Named = Sequence[tuple[str, "Vector"]]
"""Names of signals, with their measured values."""
UNNAMED = ("", "y")
"""Names of model outputs that may mean any signal."""
_FIRST = CHANNELS[0].name
"""First channel of the arm, which a line `next:` does not name."""
_IS = ("is", "are")


def names(option: str, text: str | None) -> tuple[str, ...]:
    """Return the names in a text with commas; refuse empty and repeated names."""
    parts = tuple(name.strip() for name in text.split(",")) if text else ()
    if "" in parts:
        raise typer.BadParameter(f"{option} {text}: a name is empty; give names with commas, A,B")
    if repeated := [name for name in dict.fromkeys(parts) if parts.count(name) > 1]:
        raise typer.BadParameter(f"{option} {text}: {repeated[0]} is repeated; name it once")
    return parts


@contextmanager
def _importable(file: Path, roles: Sequence[str]) -> Iterator[None]:
    """Add the line of `armrig import` to the error of a file that needs an option of reading."""
    from armrig.data.files.table import ReadingError
    from armrig.recordings.files.imports import name_of_import

    try:
        yield
    except ReadingError as err:
        from armrig.recordings.files.imports import import_of

        if name := name_of_import(hashlib.sha256(file.read_bytes()).hexdigest()):
            raise InputError(f"{file} was imported as {name}: use {name}") from err
        facts = import_of(file) if file.suffix == RECORDING else None
        original = facts.sources[0].name if facts else str(file)
        words = ["armrig import", quote(original), *roles, err.option]
        raise InputError(f"{err}; import the file first: `{' '.join(words)}`") from err


def recording_outputs(recording: armrig.Recording, chosen: Sequence[str]) -> list[str]:
    """Return the names as outputs of a recording, by default the first; refuse any other name."""
    has = recording.outputs
    if unknown := [name for name in chosen if name not in has]:
        raise typer.BadParameter(f"--signal {unknown[0]}: a recording has {', '.join(has)}")
    return [*chosen] or [recording.first]


def require_arm(recording: armrig.Recording) -> None:
    """Refuse a recording of a rig that the arm's physical model does not describe."""
    if not recording.description.arm:
        raise InputError(
            f"{recording.name} is of the rig '{recording.description.title}', and this "
            "command is for the arm's physical model; use `armrig identify` or `armrig report`, or "
            "`armrig greybox F --model FILE.py` with your own equations"
        )


def matching_outputs(recording: armrig.Recording, model: Fit, chosen: Sequence[str]) -> list[str]:
    """Return the model's outputs in the model's order; refuse a model of other signals.

    If the only output of the model has no name, it is the chosen output, or the first channel.
    """
    if (model.ny, model.nu) == (1, 1) and model.output in UNNAMED:
        return recording_outputs(recording, chosen)
    input = recording.description.input.name
    # A rig has one input, so the name of a single input, such as a column's, need not be its name.
    if not set(model.outputs) <= {*recording.outputs} or model.nu != 1:
        raise InputError(
            f"the model's inputs are {', '.join(model.inputs)} and its outputs "
            f"{', '.join(model.outputs)}, but a recording has the input {input} and the outputs "
            f"{', '.join(recording.outputs)}; use data with the model's signals"
        )
    if chosen and set(chosen) != set(model.outputs):
        raise typer.BadParameter(
            f"--signal {','.join(chosen)}: the model has {plural(model.ny, 'output')}, "
            f"{join_names(model.outputs)}; leave --signal out"
        )
    return [*model.outputs]


def require_as_many(model: Fit, outputs: Sequence[str], inputs: Sequence[str]) -> None:
    """Refuse column names if their number differs from the number of the model's signals."""
    for option, role, columns, model_names in (
        ("--signal", "output", outputs, model.outputs),
        ("--input", "input", inputs, model.inputs),
    ):
        if columns and len(columns) != len(model_names):
            raise typer.BadParameter(
                f"{option} {','.join(columns)}: the model has {plural(len(model_names), role)}, "
                f"{join_names(model_names)}; name a column for each, in this order"
            )


def as_modelled(
    file: Path,
    data: Dataset | Signals,
    model: Fit,
    outputs: Sequence[str],
    inputs: Sequence[str],
) -> Dataset | Signals:
    """Return the data with the model's names, in the model's order.

    If the user names other columns as `outputs` and `inputs`, these columns are used as the model's
    signals. A message lists the columns.
    """
    if isinstance(data, armrig.Dataset):
        # A column that the user named is the model's signal.
        output = model.output if outputs and model.output not in UNNAMED else data.output
        input = model.inputs[0] if inputs else data.input
        return data.replaced(step=None, output=output, input=input)
    for wanted, columns in ((model.outputs, data.outputs), (model.inputs, data.inputs)):
        if set(wanted) != set(columns):
            tell(
                f"{file}: for the model's {', '.join(wanted)} the command reads "
                f"{', '.join(columns)}"
            )
    same_outputs = set(model.outputs) == set(data.outputs)
    same_inputs = set(model.inputs) == set(data.inputs)
    ordered = data.channels(
        model.outputs if same_outputs else None, model.inputs if same_inputs else None
    )
    return ordered.replaced(step=None, outputs=model.outputs, inputs=model.inputs)


def hint_at_means(outputs: Named, inputs: Named, *, may_offset: bool = False) -> None:
    """If the mean of a signal is far from 0, as at an operating point, suggest an option."""
    every = [*outputs, *inputs]
    if far_from_zero([x for _, x in every]):
        along = "estimate a level with --offset, or " if may_offset else ""
        means = ", ".join(f"the mean of {name} is {x.mean():.4g}" for name, x in every)
        y, u = join_names([name for name, _ in outputs]), " = ".join(name for name, _ in inputs)
        tell(
            f"{means}; if {y} {_IS[len(outputs) > 1]} not 0 at {u} = 0, {along}subtract the means "
            "with --detrend"
        )


def has_level(data: Dataset | Signals) -> bool:
    """Return True if a signal has a level far from 0, which is no angle of the arm."""
    columns = data.signals()
    every = [*(y for _, y in valid_outputs(columns)), *columns.u.T]
    return not from_arm(data) and far_from_zero(every)


def tell_of_reading(
    file: Path, data: Dataset | Signals, columns: Sequence[str], missing: str
) -> None:
    """Print first the doubts about the reading of a file, then its other facts."""
    name = short_name(file)
    steps = list(zip(data.history, codes_of(data.history), strict=True))
    for text, code in steps:
        if code == DOUBT:
            tell(f"{name}: {text}")
    if name == str(file) and DOUBT in codes_of(data.history):
        tell(f"{name}: `armrig import {quote(name)} …` takes the options that these lines name")
    tell_findings(few_samples(data.N, name))
    facts = [text for text, code in steps if code != DOUBT]
    parts = [f"{plural(data.N, 'sample')}, {data.Ts:g} s apart", *columns]
    parts += [f"{data.missing} {missing}"] if data.missing else []
    inform(f"{name}: {'; '.join([*parts, *facts])}", dim=True)


def short_name(file: Path) -> str:
    """Return the @NAME of a recording, or the path of another file."""
    from armrig.recordings.files.recording_names import name_of

    return (name_of(file) if file.suffix == RECORDING else "") or str(file)


def name_recording(recording: armrig.Recording) -> armrig.Recording:
    """Return the recording with the name that the command line gives it."""
    from armrig.recordings.files.recording_names import name_of

    return replace(recording, name=name_of(recording.path) or recording.name)


def load_recordings(
    files: Sequence[Path],
    calibration: Path | None,
    start: float | None = None,
    stop: float | None = None,
    *,
    one_plant: bool = True,
) -> list[armrig.Recording]:
    """Return the recordings; print their damage, and reasons not to use them together."""
    from armrig.recordings.usability import all_doubts, early_ends

    with spinner("reading"):
        recordings = [
            name_recording(armrig.load(file, calibration, start=start, stop=stop)) for file in files
        ]
    name_runs(*recordings)
    # `warned` reports a file that is cut off. The end of a requested range is not an early end.
    complete = [r for r in recordings if not r.truncated and (start, stop) == (None, None)]
    tell_findings([*early_ends(complete), *all_doubts(recordings, one_plant=one_plant)])
    return [report_damage(recording) for recording in recordings]


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalChoice(DataOptions):
    """Signals to read from files: recordings, or other data."""

    offset: bool | None = None
    """True if a constant level of y is also estimated; None if the command has no such option."""
    read: list[armrig.Recording] = field(default_factory=list)
    """Recordings read so far; the first recording is for estimation."""
    columns: dict[str, str] = field(default_factory=dict)
    """Names of the columns that numbers chose in the first file that was read."""

    @classmethod
    def of_options(cls, **options: Any) -> Self:
        """Return the choice; a repeated option gives several names, as names with commas do."""
        for name in ("signal", "input"):
            if isinstance(options.get(name), list):
                options[name] = ",".join(options[name]) or None
        return cls(**options)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names in --signal; empty if the user named no output."""
        return names("--signal", self.signal)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names in --input; empty if the user named no input."""
        return names("--input", self.input)

    @property
    def default(self) -> str:
        """Output without --signal: the first channel of the recording that was read."""
        return self.read[0].first if self.read else _FIRST

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of the named outputs and inputs; 1 where the user named none."""
        return len(self.outputs) or 1, len(self.inputs) or 1

    def options(self, data: Dataset | Signals | None = None) -> str:
        """Return the options with which another command reads the same data; "" for none.

        If the user named no output and the output of `data` is not the default, add --signal.
        """
        signal, outputs = self.signal, () if data is None else data.signals().outputs
        if signal is None and len(outputs) == 1 and outputs[0] not in (*UNNAMED, self.default):
            signal = outputs[0]
        return "".join(f" {typed}" for typed in replace(self, signal=signal).given())

    def of_channel(self, output: str, input: str, data: Dataset | Signals) -> Self:
        """Return the choice of one output and one input of `data`."""
        if data.signals().ny == data.signals().nu == 1:
            return self
        # The input of a recording is always u.
        recorded = from_recording(data)
        return replace(
            self,
            signal=None if recorded and output == self.default else output,
            input=None if recorded else input,
        )

    @property
    def origin(self) -> Origin | None:
        """Rig and calibration of the first recording that was read; None without a recording."""
        from armrig.recordings.files.origin import Origin

        return Origin.of_run(self.read[0].path, self.read[0].manifest) if self.read else None

    @property
    def integrator(self) -> bool | None:
        """True or False if --assume decides whether the output integrates, otherwise None."""
        return None if self.assume is None else self.assume == "integrating"

    def choice(
        self, data: Dataset | Signals, integrates: bool | None = None, *, named: bool = True
    ) -> tuple[bool | None, list[str]]:
        """Return whether the output is taken as integrating, and a line that names the choice.

        `integrates` is the choice of a command with a test of its own. For a recording, there is a
        line only if --assume or the test of the data decided. With several signals, or if the
        choice is not `named`, the command's test makes it unless --assume does.
        """
        if not named or self.shape != (1, 1):
            return self.integrator, []
        from armrig.data.treatment.integrating import integration

        assumption = self.integrator if integrates is None else integrates
        data = data.signals().dataset()
        decided = integration(data, assumption)
        kinds: tuple[Assumption, Assumption] = ("settling", "integrating")
        reason = f"{decided.reason}:" if decided.reason else f"{data.output} is"
        taken = f"{reason} taken as {kinds[decided.integrates]}"
        if self.assume is not None:
            return decided.integrates, [f"{taken}, as --assume says"]
        line = f"{taken}; --assume {kinds[not decided.integrates]} changes this"
        if decided.integrates:  # another input may move y as an integrator does
            others = zip(data.history, codes_of(data.history), strict=True)
            line += "".join(f"; {text}" for text, code in others if code == OTHER_INPUTS)
        return decided.integrates, [line] if decided.reason or not from_arm(data) else []

    def of(self, file: Path, model: Fit | None = None) -> Dataset | Signals:
        """Return the data of a file, and print its defects; the default signals are the model's.

        The data of one output and one input are a Dataset.
        """
        if self.assume is not None and self.shape != (1, 1):
            raise typer.BadParameter(
                f"--assume {self.assume} is for one output and one input: leave it out"
            )
        from armrig.recordings.files.imports import import_of
        from armrig.recordings.files.recording_summary import is_recording

        imported = import_of(file) if is_recording(file) else None
        is_other = imported is not None or not is_recording(file)
        data = self._table(file, model, imported) if is_other else self.recorded(file, model)
        return self._treat(file, data, model)

    def of_one(self, file: Path) -> Dataset:
        """Return the data of one output and one input, and print their defects."""
        if self.shape != (1, 1):
            raise typer.BadParameter(
                f"{self.options().strip()}: this command takes one output and one input; name one "
                "of each"
            )
        return self.of(file).signals().dataset()

    def _treat(self, file: Path, data: Dataset | Signals, model: Fit | None) -> Dataset | Signals:
        if _without_means(model) and not self.detrend:
            tell("the model was estimated from data minus their means: validate it with --detrend")
        if self.hampel:
            data = armrig.hampel(data)
            inform(f"{short_name(file)}: {data.history[-1]}", dim=True)
        return armrig.detrend(data) if self.detrend else data

    def _table(self, file: Path, model: Fit | None, imported: Import | None) -> Dataset | Signals:

        from armrig.estimation.data_faults import swap_warnings

        outputs, inputs = self.outputs, self.inputs
        if model is not None:
            require_as_many(model, outputs, inputs)
        if imported is not None:
            has = {column.name for column in imported.columns}
            if model is None or not {*model.inputs} <= has:
                inputs = inputs or imported.inputs
            if model is None or not {*model.outputs} <= has:
                outputs = outputs or imported.outputs
        if model is not None:
            inputs, outputs = inputs or model.inputs, outputs or model.outputs
        inputs, outputs = inputs or ("u",), tuple(name or "y" for name in outputs) or ("y",)
        data = self._read_as_first(file, inputs, outputs)
        columns = data.signals()
        if isinstance(data, armrig.Dataset):
            at = [
                name or typed
                for name, typed in zip(_of_column(data), inputs + outputs, strict=True)
            ]
            read = [f"the input is column {at[0]}", f"the signal is column {at[1]}"]
            missing = "samples without {}"
        else:
            read = [f"outputs {', '.join(columns.outputs)}", f"inputs {', '.join(columns.inputs)}"]
            missing = "values are missing"
        if model is not None:
            data = as_modelled(file, data, model, self.outputs, self.inputs)
            columns = data.signals()
        tell_of_reading(file, data, read, missing.format(columns.outputs[0]))
        for name in columns.outputs:
            if name in INTEGRATING_OUTPUTS:
                tell(
                    f"{name} is assumed to be the rig's angle, which integrates its input; if it "
                    "is another signal, rename the column"
                )
        if isinstance(data, armrig.Dataset):
            for finding in swap_warnings(data):
                tell(f"{file}: {finding.text} (--input, --signal)")
        self._hint_at_means(columns, model)
        data = between(data, self.start, self.stop)
        for name, y in valid_outputs(data.signals()):
            if y.size > 1 and (y == y[0]).all():
                raise InputError(
                    f"{file}: {name} is constant, {y[0]:.4g}, so it responds to no input; give a "
                    "column that varies (--signal), or record again"
                )
        return data

    def _hint_at_means(self, data: Signals, model: Fit | None) -> None:
        if not (
            self.detrend or self.offset or _without_means(model) or getattr(model, "offset", False)
        ):
            inputs = list(zip(data.inputs, data.u.T, strict=True))
            hint_at_means(valid_outputs(data), inputs, may_offset=self.offset is not None)

    def _read_as_first(
        self, file: Path, inputs: tuple[str, ...], outputs: tuple[str, ...]
    ) -> Dataset | Signals:
        """Return the columns; numbers choose the columns that they chose in the first file.

        Numbers choose columns by place if the file has no names.
        """
        from armrig.data.files.table import NoColumnError

        typed = (*inputs, *outputs)
        by_name = [self.columns.get(x, x) for x in typed]
        try:
            data = self._read(file, tuple(by_name[: len(inputs)]), tuple(by_name[len(inputs) :]))
        except NoColumnError:
            if not self.columns:
                raise
            data = self._read(file, inputs, outputs)
            if any(other := _of_column(data)):
                raise InputError(
                    f"{file}: columns {join_names(typed)} are {join_names(other)}, in the first "
                    f"file {join_names(by_name)}; give the columns of both files the same names"
                ) from None
        chosen = _of_column(data)
        if not self.columns and len(chosen) == len(typed):
            pairs = zip(typed, chosen, strict=True)
            self.columns.update({x: name for x, name in pairs if x.isdecimal() and name})
        return data

    def _read(
        self, file: Path, inputs: tuple[str, ...], outputs: tuple[str, ...]
    ) -> Dataset | Signals:
        """Return the columns of a file that is not a recording."""
        if self.calibration is not None:
            raise typer.BadParameter(
                f"--calibration applies to recordings; {file} has no readings of the rig's sensors"
            )
        with spinner("reading"), _importable(file, self.given("input", "signal")):
            if len(inputs) == len(outputs) == 1:
                return armrig.load_data(file, input=inputs[0], signal=outputs[0], Ts=self.Ts)
            return armrig.load_signals(file, inputs=inputs, outputs=outputs, Ts=self.Ts)

    def recordings(self, *files: Path) -> list[armrig.Recording]:
        """Return the chosen part of recordings."""
        return load_recordings(files, self.calibration, self.start, self.stop)

    def recorded(self, file: Path, model: Fit | None) -> Dataset | Signals:
        """Return the data of a recording; the default outputs are the model's.

        Options that apply to other data are refused.
        """
        for typed in self.given("input", "Ts"):
            raise typer.BadParameter(f"{typed} applies to {OTHER_DATA}; {file} is a recording")
        from armrig.recordings.usability import doubts_of_pair

        [recording] = self.recordings(file)
        tell_findings(doubts_of_pair(self.read[0], recording) if self.read else ())
        self.read.append(recording)
        if model is None:
            outputs = recording_outputs(recording, self.outputs)
        else:
            outputs = matching_outputs(recording, model, self.outputs)
        data = recording.dataset(outputs[0]) if len(outputs) == 1 else recording.signals(outputs)
        if self.offset is not None and has_level(data):
            self._hint_at_means(data.signals(), model)
        return data


def _of_column(data: Dataset | Signals) -> list[str]:
    """Return the names of inputs and outputs, "" for a column without a name."""
    columns = data.signals()
    both = (*columns.inputs, *columns.outputs)
    return ["" if _DEFAULT_NAME.fullmatch(name) else name for name in both]


def data_group(*, without: str = "", several: bool = True) -> Group:
    """Return the options of data, without the option `without`, as a group.

    If `several` is True, --input and --signal may be repeated.
    """
    names = [name for name in OPTIONS if name != without]
    repeatable = ("input", "signal") if several else ()
    return group(DataOptions, names, SignalChoice.of_options, repeatable=repeatable)


Part = Annotated[SignalChoice, group(DataOptions, PART, SignalChoice)]
"""Options --calibration, --from and --to."""


Channel = tuple[str, ...]
"""Names of an input and an output; empty if there is only one channel."""


def each_channel(data: Dataset | Signals) -> Iterator[tuple[Channel, Dataset]]:
    """Yield the names and the data of each pair of an input and an output."""
    columns = data.signals()
    for output in columns.outputs:
        for input in columns.inputs:
            siso = columns.ny == columns.nu == 1
            yield () if siso else (input, output), columns.dataset(output, input)


def by_channel(test: Callable[[Any], Any], data: Dataset | Signals) -> dict[Channel, Any]:
    """Return the result of a test for each channel, or the reason why there is no result."""
    columns = data.signals()
    if (columns.ny, columns.nu) == (1, 1):
        try:
            return {(): test(data)}
        except ValueError as err:
            return {(): str(err)}
    outcome = test(columns)
    every = {**outcome.results, **outcome.refused}
    return {channel: every[channel[::-1]] for channel, _ in each_channel(data)}


def require_result(outcomes: Collection[Any]) -> None:
    """Refuse the data if no channel has a result."""
    reasons = [outcome for outcome in outcomes if isinstance(outcome, str)]
    if len(reasons) == len(outcomes):
        raise InputError(reasons[0])


def facts_by_channel(
    data: Dataset | Signals, outcomes: Mapping[Channel, T], facts: Callable[[T], dict[str, Any]]
) -> dict[str, Any]:
    """Return the data's source and the facts of a single channel, or a list with each channel."""
    if () in outcomes:
        return source_facts(data) | facts(outcomes[()])
    named = [{"input": c[0], "output": c[1]} | facts(outcome) for c, outcome in outcomes.items()]
    return source_facts(data) | {"channels": named}


def say_channel(channel: Channel) -> None:
    """Print the names of a channel; nothing if there is only one channel."""
    if channel:
        say(" to ".join(channel), bold=True)


def valid_outputs(data: Signals) -> list[tuple[str, Vector]]:
    """Return the outputs with their names, without missing values."""
    each = zip(data.outputs, data.y.T, data.valid.T, strict=True)
    return [(name, y[valid]) for name, y, valid in each]


def from_recording(data: Dataset | Signals) -> bool:
    """Return True if data come from a recording of a rig."""
    return ":" not in data.source


def from_arm(data: Dataset | Signals) -> bool:
    """Return True if data come from a recording of the arm: it is known which output integrates."""
    return from_recording(data) and ARM_OUTPUTS.issuperset(data.signals().outputs)


def source_facts(data: Dataset | Signals) -> dict[str, str]:
    """Return the hash of the data's source file as a JSON field."""
    kind, _, digest = data.source.rpartition(":")
    return {kind or "recording": digest}


def _without_means(model: Fit | None) -> bool:
    return MEAN in codes_of(getattr(model, "history", ()))


def spectral_beside(data: Dataset) -> list[SpectralEstimate]:
    """Return the frequency response by spectral analysis; an empty list after a failure."""
    from armrig.estimation.nonparametric.spectral import spectral_reference

    try:
        with spinner("estimating the spectrum"):
            return [spectral_reference(data)]
    except ValueError as err:
        tell(f"the figure has no spectral analysis: {err}")
        return []
