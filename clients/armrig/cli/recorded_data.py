"""Data that commands read from recordings and other files, and notes about these data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import typer
from armrig_core.errors import InputError
from armrig_core.telemetry import THETA_1, OutputName

from armrig.cli.channels import (
    as_modelled,
    modelled_outputs,
    names,
    recorded_outputs,
    require_as_many,
)
from armrig.cli.column_notes import (
    check_varies,
    hint_at_means,
    tell_of_reading,
)
from armrig.cli.figures import name_runs
from armrig.cli.options import inform, tell, warned
from armrig.cli.reading_options import (
    OPTIONS,
    PART,
    READING,
    Assumption,
    DataOptions,
    data_options,
    grouped,
)
from armrig.data.files.suffixes import OTHER_DATA

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset, Signals
    from armrig.models.fit import Fit
    from armrig.models.spectral_estimate import SpectralEstimate
    from armrig.recordings.recording import Recording
    from armrig.validation.comparison import ComparisonTable


Data = TypeVar("Data", "Dataset", "Signals")

_UNNAMED = ("", "y")  # names of model outputs that may mean any signal


def loaded(
    files: Sequence[Path],
    calibration: Path | None,
    start: float | None = None,
    stop: float | None = None,
    *,
    one_plant: bool = True,
) -> list[Recording]:
    """Return the recordings; print their damage, and reasons not to use them together."""
    from armrig.cli.spinner import spinner
    from armrig.recordings.loading import load
    from armrig.recordings.usability import all_doubts, early_ends

    with spinner("reading"):
        recordings = [load(file, calibration, start=start, stop=stop) for file in files]
    name_runs(*recordings)
    # `warned` reports a file that is cut off. The end of a requested range is not an early end.
    whole = [r for r in recordings if not r.truncated and (start, stop) == (None, None)]
    early = [text.removesuffix(".") for text in early_ends(whole)]
    for text in (*early, *all_doubts(recordings, one_plant=one_plant)):
        tell(text)
    return [warned(recording) for recording in recordings]


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalChoice(DataOptions):
    """Signals to read from files: recordings, or other data."""

    offset: bool | None = None
    """True if a constant level of y is also estimated; None if the command has no such option."""
    read: list[Recording] = field(default_factory=list)
    """Recordings read so far; the first recording is for estimation."""

    @property
    def several(self) -> bool:
        """True if several outputs or inputs are named, with commas."""
        return "," in f"{self.signal}{self.input}"

    def options(self, data: Dataset | None = None) -> str:
        """Return the options with which another command reads the same data; "" for none.

        If the user named no output and the output of `data` is not the default, add --signal.
        """
        signal = self.signal
        if signal is None and data is not None and data.output not in (*_UNNAMED, THETA_1):
            signal = data.output
        return "".join(f" {typed}" for typed in replace(self, signal=signal).given())

    @property
    def integrator(self) -> bool | None:
        """True or False if --assume decides whether the output integrates, otherwise None."""
        return None if self.assume is None else self.assume == "integrating"

    def choice(self, data: Dataset, integrates: bool | None = None) -> tuple[bool, list[str]]:
        """Return whether the output is taken as integrating, and a line that names the choice.

        `integrates` is the choice of a command with a test of its own. For a recording, there is a
        line only if --assume or the test of the data decided.
        """
        from armrig.data.treatment.integrating import integration

        decided = integration(data, self.integrator if integrates is None else integrates)
        kinds: tuple[Assumption, Assumption] = ("settling", "integrating")
        reason = f"{decided.reason}:" if decided.reason else f"{data.output} is"
        taken = f"{reason} taken as {kinds[decided.integrates]}"
        if self.assume is not None:
            return decided.integrates, [f"{taken}, as --assume says"]
        line = f"{taken}; --assume {kinds[not decided.integrates]} changes this"
        return decided.integrates, [line] if decided.reason or not from_recording(data) else []

    def of(self, file: Path, model: Fit | None = None) -> Dataset:
        """Return the data of a file, and print its defects; the default output is the model's."""
        if self.several:
            raise typer.BadParameter(
                f"{self.options().strip()}: this command takes one output and one input; "
                "identify, validate and greybox take several, and in Python armrig.delay and "
                "armrig.open_loop test each channel"
            )
        if self._is_other(file):
            data = between(self._other(file, model), self.start, self.stop)
            check_varies(file, data.output, data.y[data.valid])
        else:
            data = self._recorded(file, model)
        return self._treated(file, data, model)

    def signals_of(self, file: Path, model: Fit | None = None) -> Signals:
        """Return signals of a file, and print its defects; the default signals are the model's."""
        outputs, inputs = names("--signal", self.signal), names("--input", self.input)
        if self._is_other(file):
            signals = between(self._table(file, inputs, outputs, model), self.start, self.stop)
        elif model is not None:
            signals = self.recorded_signals(file, model)
        else:
            signals = self._recording(file).signals(recorded_outputs(outputs or (THETA_1,)))
        return self._treated(file, signals, model)

    def _treated(self, file: Path, data: Data, model: Fit | None) -> Data:
        """Return the data after --hampel and --detrend."""
        from armrig.data.treatment import detrend, hampel

        if _without_means(model) and not self.detrend:
            tell("the model was estimated from data minus their means: validate it with --detrend")
        if self.hampel:
            data = hampel(data)
            inform(f"{file}: {data.history[-1]}", dim=True)
        return detrend(data) if self.detrend else data

    def recorded_signals(self, file: Path, model: Fit) -> Signals:
        """Return the signals of a model from a recording."""
        outputs = modelled_outputs(model, names("--signal", self.signal))
        return self._recording(file).signals(outputs)

    def _table(
        self,
        file: Path,
        inputs: Sequence[str],
        outputs: Sequence[str],
        model: Fit | None,
    ) -> Signals:
        from armrig.data.files.loading import load_signals

        if model is not None:
            require_as_many(model, outputs, inputs)
            inputs, outputs = inputs or model.inputs, outputs or model.outputs
        inputs, outputs = inputs or ("u",), outputs or ("y",)
        signals = self._read(load_signals, file, inputs=inputs, outputs=outputs)
        read = [f"outputs {', '.join(signals.outputs)}", f"inputs {', '.join(signals.inputs)}"]
        tell_of_reading(file, signals, read, "values are missing")
        every = [
            (name, signals.y[signals.valid[:, i], i]) for i, name in enumerate(signals.outputs)
        ]
        for name, y in every:
            check_varies(file, name, y)
        if not (self.detrend or _without_means(model)):
            hint_at_means(every, [(name, signals.u[:, j]) for j, name in enumerate(signals.inputs)])
        return signals if model is None else as_modelled(file, signals, model)

    def _read(self, load: Callable[..., Data], file: Path, **columns: Any) -> Data:
        """Return the data that `load_data` or `load_signals` reads."""
        from armrig.cli.spinner import spinner

        if self.calibration is not None:
            raise typer.BadParameter(
                f"--calibration applies to recordings; {file} has no readings of the rig's sensors"
            )
        with spinner("reading"):
            return load(file, **columns, **{name: getattr(self, name) for name in READING})

    def _other(self, file: Path, model: Fit | None) -> Dataset:
        from armrig.data.files.loading import load_data
        from armrig.data.treatment import INTEGRATING_OUTPUTS
        from armrig.estimation.data_faults import swapped

        columns = {
            "input": self.input or "u",
            "signal": self.signal or (model.output if model else None) or "y",
        }
        data = self._read(load_data, file, **columns)
        if model is not None and self.signal is not None and model.output not in _UNNAMED:
            # The user named the column, which is thus the model's output.
            data = data.replaced(step=None, output=model.output)
        read = [f"the {what} is column {name}" for what, name in columns.items()]
        tell_of_reading(file, data, read, f"samples without {data.output}")
        if data.output in INTEGRATING_OUTPUTS:
            tell(
                f"{data.output} is assumed to be the rig's angle, which integrates its input; if "
                "it is another signal, rename the column"
            )
        for finding in swapped(data):
            tell(f"{file}: {finding.text} (--input, --signal)")
        known = self.detrend or self.offset or _without_means(model) or _with_level(model)
        if not known:
            hint_at_means(
                [(data.output, data.y[data.valid])],
                [("u", data.u)],
                may_offset=self.offset is not None,
            )
        return data

    def _is_other(self, file: Path) -> bool:
        """Return True if --topic or the content shows that the file is not a recording."""
        from armrig.recordings.recording_summary import is_recording

        return self.topic is not None or not is_recording(file)

    def _recording(self, file: Path) -> Recording:
        """Return a recording; refuse options that apply to other data."""
        for typed in self.given("input", *READING):
            raise typer.BadParameter(f"{typed} applies to {OTHER_DATA}; {file} is a recording")
        from armrig.recordings.usability import doubts_of_pair

        [recording] = self.recordings(file)
        for text in doubts_of_pair(self.read[0], recording) if self.read else ():
            tell(text)
        self.read.append(recording)
        return recording

    def recordings(self, *files: Path) -> list[Recording]:
        """Return the chosen part of recordings."""
        return loaded(files, self.calibration, self.start, self.stop)

    def _recorded(self, file: Path, model: Fit | None) -> Dataset:
        recording = self._recording(file)
        if self.signal is None and model is not None and model.output not in _UNNAMED:
            return dataset_of(recording, model)
        if self.signal is None:
            return recording.dataset()
        return recording.dataset(recorded_outputs((self.signal,))[0])


def reads_data(
    *without: str, several: bool = False
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that replaces the argument `signals` of a command by options of data."""
    names = [name for name in OPTIONS if name not in without]
    return grouped("signals", data_options(names, several=several), SignalChoice)


def reads_part(command: Callable[..., None]) -> Callable[..., None]:
    """Replace the argument `part` of a command by --calibration, --from and --to."""
    return grouped("part", data_options(PART, several=False), SignalChoice)(command)


def between(data: Data, start: float | None, stop: float | None) -> Data:
    """Return the samples with start <= t < stop, in s from the first sample."""
    if start is None and stop is None:
        return data
    Ts = data.Ts or 1.0
    first, end = (None if t is None else ceil(min(t / Ts, data.N) - 1e-6) for t in (start, stop))
    if (start or 0) < 0 or (first or 0) >= (data.N if end is None else min(end, data.N)):
        msg = f"no samples from --from {start or 0:g} s on"
        msg += f" to --to {stop:g} s" if stop is not None else ""
        raise InputError(f"{msg}: the data last {data.N * Ts:g} s")
    return data[first:end]


def from_recording(data: Dataset | Signals) -> bool:
    """Return True if data come from a recording of a rig."""
    return ":" not in data.source


def source_facts(data: Dataset | Signals) -> dict[str, str]:
    """Return the hash of the data's source file as a JSON field."""
    kind, _, digest = data.source.rpartition(":")
    return {kind or "recording": digest}


def _without_means(model: Fit | None) -> bool:
    from armrig.data.step import MEAN, codes_of

    return MEAN in codes_of(getattr(model, "history", ()))


def _with_level(model: Fit | None) -> bool:
    return bool(getattr(model, "offset", False))


def warn_of_estimation_data(table: ComparisonTable) -> None:
    """Print a warning if the comparison of a model uses the model's own estimation data."""
    for finding in table.findings:
        tell(finding.text)


def spectral_beside(data: Dataset) -> list[SpectralEstimate]:
    """Return the frequency response by spectral analysis; an empty list after a failure."""
    from armrig.cli.spinner import spinner
    from armrig.estimation.nonparametric.spectral import spectral_reference

    try:
        with spinner("estimating the spectrum"):
            return [spectral_reference(data)]
    except ValueError as err:
        tell(f"the figure has no spectral analysis: {err}")
        return []


def dataset_of(recording: Recording, model: Fit) -> Dataset:
    """Return the data of a recording whose output is the model's output."""
    for output in get_args(OutputName):
        if output == model.output:
            return recording.dataset(output)
    raise InputError(
        f"the output of the model is {model.output!r}, a recording has "
        f"{', '.join(get_args(OutputName))}; validate the model on data with its output"
    )
