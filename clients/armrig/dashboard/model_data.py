"""Data of the models on the page: two recordings, their signals, and their treatment in steps.

The lines of Python and the options of `armrig identify` that give the same data go with the data.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from shlex import quote
from typing import Annotated, Any, Literal

import msgspec
from armrig_core.errors import InputError
from msgspec import UNSET, Meta

from armrig.data.dataset import Dataset, Signals
from armrig.data.files.loading import load_data, load_signals
from armrig.data.time_range import between, sample_range
from armrig.data.treatment import detrend, resample
from armrig.recordings.files.imports import import_of
from armrig.recordings.files.loading import load

SECOND_HALF = ""
"""Value of `ModelData.validation` for the second half of the recording."""
_Name = Annotated[str, Meta(min_length=1, max_length=100)]
_File = Annotated[str, Meta(max_length=300)]
_Seconds = Annotated[float, Meta(ge=0, le=1e7)]


class TreatmentStep(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """Step of the treatment of data."""

    kind: Literal["means", "trend", "part", "resample", "mask"]
    start: _Seconds | None = None
    """Begin of the part, or of the outputs that count as missing, in s."""
    stop: _Seconds | None = None
    Ts: Annotated[float, Meta(gt=0, le=1e6)] | None = None
    """Sampling time after "resample", in s."""

    def treat(self, data: Dataset | Signals) -> tuple[Dataset | Signals, list[str]]:
        """Return the treated data, and the lines of Python that treat `data`."""
        if self.kind in ("means", "trend"):
            order = int(self.kind == "trend")
            return detrend(data, order), [f"data = armrig.detrend(data, {order})"]
        if self.kind == "resample":
            if self.Ts is None:
                raise InputError("resample needs Ts, the new sampling time in s")
            return resample(data, self.Ts), [f"data = armrig.resample(data, {self.Ts!r})"]
        part = sample_range(data, self.start, self.stop)
        shown = ":".join("" if n is None else str(n) for n in (part.start, part.stop))
        if self.kind == "part":
            return between(data, self.start, self.stop), [f"data = data[{shown}]"]
        valid, step = data.valid.copy(), f"marked samples {shown} as missing"
        valid[part] = False
        lines = ["valid = data.valid.copy()", f"valid[{shown}] = False"]
        lines.append(f"data = data.replaced(step={step!r}, valid=valid)")
        return data.replaced(step=step, valid=valid), lines


class ModelData(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Recordings for estimation and validation, their signals, and their treatment."""

    file: _File
    """Name of the recording, or the beginning of its SHA-256."""
    validation: _File | None = None
    """Recording for validation; `SECOND_HALF`; or None for the proposed recording."""
    inputs: tuple[_Name, ...] = ()
    outputs: tuple[_Name, ...] = ()
    treatments: Annotated[tuple[TreatmentStep, ...], Meta(max_length=50)] = ()

    @property
    def part(self) -> TreatmentStep:
        """Range that is loaded: the first step, if this step is a range."""
        first = self.treatments[:1]
        return first[0] if first and first[0].kind == "part" else TreatmentStep(kind="part")

    @property
    def steps(self) -> tuple[TreatmentStep, ...]:
        """Steps after the loading."""
        return tuple(s for k, s in enumerate(self.treatments) if k or s.kind != "part")


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedData:
    """Data of one recording after their treatment."""

    columns: Dataset | Signals
    python: tuple[str, ...]
    """Lines of Python that give these data the name `data`."""
    warnings: tuple[str, ...] = ()
    """Warnings about the treatment."""
    arm: bool = False
    """True for a recording of an arm."""
    recorded: bool = False
    """True for a recording of a rig; False for an import."""
    played: bool = False
    """True if armrig played the input, and no law computed it."""


def estimation_data(folder: Path, data: ModelData) -> PreparedData:
    """Return the data that models are estimated from."""
    return _prepare(folder / data.file, data, _ranges(folder, data)[0])


def validation_data(folder: Path, data: ModelData) -> PreparedData:
    """Return the data that models are validated on."""
    return _prepare(folder / (data.validation or data.file), data, _ranges(folder, data)[1])


def command_options(folder: Path, data: ModelData, *, validate: bool) -> list[str] | None:
    """Return the options with which a command reads the data; None if the command has none.

    The command is `armrig validate` or `armrig identify`.
    """
    if data.steps not in ((), (TreatmentStep(kind="means"),)):
        return None
    part = _ranges(folder, data)[validate]
    named = {"--input": data.inputs, "--signal": data.outputs}
    if validate or not import_of(folder / data.file):
        del named["--input"]
    words = [f"{flag} {quote(','.join(names))}" for flag, names in named.items() if names]
    ends = {"--from": part.start, "--to": part.stop}
    words += [f"{flag} {t!r}" for flag, t in ends.items() if t is not None]
    return words + ["--detrend"] * len(data.steps)


def _ranges(folder: Path, data: ModelData) -> tuple[TreatmentStep, TreatmentStep]:
    """Return the ranges for estimation and validation; they are equal for two recordings."""
    part = data.part
    if data.validation != SECOND_HALF:
        return part, part
    columns = _prepare(folder / data.file, msgspec.structs.replace(data, treatments=()), part)
    seconds = columns.columns.N // 2 * columns.columns.Ts
    middle = round((part.start or 0.0) + seconds, 9)
    replaced = msgspec.structs.replace
    return replaced(part, stop=middle), replaced(part, start=middle)


def _prepare(path: Path, data: ModelData, part: TreatmentStep) -> PreparedData:
    """Return the treated data of a part of a recording."""
    key = msgspec.structs.replace(data, file="", validation=None, treatments=data.steps)
    return _treat(path, path.stat().st_mtime_ns, key, part)


@lru_cache(maxsize=8)
def _treat(path: Path, _: int, data: ModelData, part: TreatmentStep) -> PreparedData:
    read = _read_import(path, data, part) if import_of(path) else _read_recording(path, data, part)
    columns, lines = read.columns, [*read.python]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for step in data.treatments:
            columns, more = step.treat(columns)
            lines += more
    texts = tuple(str(one.message) for one in caught)
    return replace(read, columns=columns, python=tuple(lines), warnings=texts)


def _read_recording(path: Path, data: ModelData, part: TreatmentStep) -> PreparedData:
    recording = load(path, start=part.start, stop=part.stop)
    input, outputs = recording.description.input.name, data.outputs or (recording.first,)
    if data.inputs not in ((), (input,)):
        raise InputError(f"{', '.join(data.inputs)}: the input of {path.name} is {input}")
    several = len(outputs) > 1
    call = f"signals({[*outputs]!r})" if several else f"dataset({outputs[0]!r})"
    ends = {"start": part.start, "stop": part.stop}
    given = "".join(f", {name}={t!r}" for name, t in ends.items() if t is not None)
    run = recording.manifest
    return PreparedData(
        columns=recording.signals(outputs) if several else recording.dataset(outputs[0]),
        python=(f"data = armrig.load({str(path)!r}{given}).{call}",),
        arm=bool(recording.description.arm),
        recorded=True,
        played=run.samples > 0 and run.controller_sha256 is UNSET,
    )


def _read_import(path: Path, data: ModelData, part: TreatmentStep) -> PreparedData:
    facts: Any = import_of(path)
    inputs = data.inputs or facts.inputs or ("u",)
    outputs = data.outputs or facts.outputs or ("y",)
    columns: Dataset | Signals
    if len(inputs) == len(outputs) == 1:
        columns = load_data(path, input=inputs[0], signal=outputs[0])
        call = f"load_data({str(path)!r}, input={inputs[0]!r}, signal={outputs[0]!r})"
    else:
        columns = load_signals(path, inputs=inputs, outputs=outputs)
        call = f"load_signals({str(path)!r}, inputs={inputs!r}, outputs={outputs!r})"
    columns, cut = part.treat(columns) if part != TreatmentStep(kind="part") else (columns, [])
    return PreparedData(columns=columns, python=(f"data = armrig.{call}", *cut))
