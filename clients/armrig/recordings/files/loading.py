"""Loading: conversion of a file's samples, gaps and reports to a recording on a complete grid."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from itertools import chain, pairwise
from math import ceil, inf
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from armrig_core.errors import FileError, InputError, InputTypeError
from armrig_core.recording_file import manifest as records
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.manifest import (
    OUTCOME,
    RECOVERED,
    RUN,
    Manifest,
    Outcome,
    Recovered,
)
from armrig_core.recording_file.part_names import part_number, part_paths
from armrig_core.rig.calibration import Calibration, Driver
from armrig_core.rig.calibration_file import read_calibration
from armrig_core.rig.channels import sample_names
from armrig_core.telemetry import channels as rig_channels
from numpy.typing import NDArray

from armrig.data.files import IMPORTED, OTHER_DATA, RECORDING
from armrig.numerics.quantities import plural
from armrig.recordings.channels import channels_of
from armrig.recordings.daemon_reports import Gap, RecordingClock, reports_of
from armrig.recordings.files.attachment_hashes import attachment_fault, without_hash
from armrig.recordings.files.container import Content, FileRange, law_decisions, read
from armrig.recordings.files.imports import load_import, recording_of
from armrig.recordings.files.input_attachment import read_input
from armrig.recordings.files.recording_names import path_of_name
from armrig.recordings.files.recording_summary import is_foreign, is_recording
from armrig.recordings.grid import SampleGrid, check_sampling_time, grid
from armrig.recordings.recording import Recording, Vector

EVERYTHING = (0, 1 << 63)
"""Range of indices that contains all samples."""
_BEGINNING = FileRange(from_ns=0, to_ns=-1, k_end=0)  # up to the first chunk with samples
_REPORT_DELAY_NS = 1_000_000_000  # largest time between a sample and a report about it
_MAX_TIME = 1e15  # in s or in samples: later than any sample, and still exact as an integer
_ROUNDING_SAMPLES = 1e-6  # in samples: 0.3 / 0.1 is not exactly 3
# A telegraph signal, recorded by `armrig demo --virtual` of armrig 0.1.0.
_EXAMPLE = Path(__file__).parents[1] / "example.mcap"


def load(
    path: str | Path | Sequence[str | Path],
    calibration: Calibration | str | Path | None = None,
    *,
    start: float | None = None,
    stop: float | None = None,
) -> Recording:
    """Load the recording in a file, or in the parts of one run.

    If the file is truncated or damaged, the part before the damage is loaded, and `truncated` is
    True.

    Parameters
    ----------
    path : str or Path, or a sequence of them
        Name ``@NAME``, ``@NAME/validation`` or ``@last``, as in the commands; or MCAP file of
        armrigd, finished or unfinished (``*.mcap.active``). A run in several files is
        selected by the name of the run (all parts), the name of one part, or the names of
        consecutive parts.
    calibration : Calibration, str or Path, optional
        Calibration that converts the counts and codes, or the TOML file in which `armrig calibrate`
        stored it. The default is the calibration that the daemon attached to the recording.
    start, stop : float, optional
        Load only the samples with start <= t < stop, in s from the first sample of the run.
        `theta_1` counts its turns from the first sample in the range.

    Returns
    -------
    Recording
        N samples: `t` in s, `u` in V, `theta_1` and `alpha` in rad, each (N,).

    Raises
    ------
    FileError
        The file is not a recording or is damaged before its first sample. An attachment does not
        have the hash in the manifest. The calibration cannot be read. The parts belong to different
        runs, or the range contains no sample. No recording has the name, or several recordings have
        the name.
    OSError
        The file cannot be opened or read.

    Examples
    --------
    >>> path = armrig.example_recording().path
    >>> recording = armrig.load(path, start=5.0, stop=10.0)
    >>> recording.N, recording.Ts
    (500, 0.01)

    The signals are arrays of numpy. A missing angle is NaN.

    >>> t, u, theta_1, alpha = recording.t, recording.u, recording.theta_1, recording.alpha
    >>> u[:3].round(1)
    array([0.5, 4.5, 4.5])
    """
    sources = [path] if isinstance(path, str | Path) else path
    if not isinstance(sources, list | tuple) or not all(isinstance(p, str | Path) for p in sources):
        msg = f'path is a {type(path).__name__}: pass the name of a file, armrig.load("F.mcap"), '
        raise InputTypeError(msg + "or a list of the parts of a run, in their order")
    named = [path_of_name(source) for source in sources]
    paths = [part for source in named for part in files_of(source)]
    if not paths:
        raise FileError("the list of paths is empty: give at least one path of a recording")
    name = named[0] if len(named) == 1 else paths[0]
    if isinstance(calibration, (str, Path)):
        file = Path(calibration)
        if is_recording(file):
            msg = f"{file}: is a recording, not a calibration; give the parts of a run as a list, "
            raise FileError(f'{msg}armrig.load(["{paths[0].name}", "{file.name}"])')
        calibration = read_calibration(file)
    if len(paths) == 1 and (data := load_import(name)) is not None:
        if (start, stop) != (None, None) or calibration is not None:
            raise FileError(f"{name}: imported data are loaded whole, without a calibration")
        return recording_of(name, str(sources[0]), data)
    run = run_content(paths, start, stop)
    called = str(sources[0]) if str(sources[0]).startswith("@") and len(sources) == 1 else name.name
    recording = _assemble(name, called, run, calibration or run.calibration, paths)
    if run.between != EVERYTHING and not recording.N:
        msg = f"{name}: it contains no sample from {start or 0:g} s"
        msg += f" to {stop:g} s" if stop is not None else " on"
        asked_s = run.manifest.samples * run.manifest.Ts
        raise FileError(f"{msg}; its run has {asked_s:g} s" if asked_s > 0 else msg)
    return recording


def example_recording() -> Recording:
    """Return a recording of the emulated rig, for trying armrig without a rig.

    The recording contains 3000 samples, one every 10 ms. The motor voltage is a telegraph signal
    of 0.5 V and 4.5 V. `armrig demo --virtual` records the same experiment.

    Returns
    -------
    Recording
        30 s of `u` in V, `theta_1` and `alpha` in rad.

    Examples
    --------
    >>> recording = armrig.example_recording()
    >>> recording.N, recording.Ts
    (3000, 0.01)
    >>> armrig.oe(recording.dataset(), nb=4, nf=4, integrator=True).label
    'OE[4 4 1]'
    """
    return load(_EXAMPLE)


def files_of(path: Path) -> list[Path]:
    """Return the files of the run at a path; raise FileError if a part is missing.

    No error is raised if the last parts are missing. The outcome in the last existing part is then
    `continued`.
    """
    paths = part_paths(path)
    if paths == [path]:
        return paths
    numbers = [part_number(part) for part in paths]
    for number in range(1, numbers[-1]):
        if number not in numbers:
            msg = f"{path}: part {number} of this run is missing; read the other parts by their "
            raise FileError(f"{msg}own names, such as {paths[0].name}")
    return paths


class RunContent(NamedTuple):
    """Content of the files of a run, or of a range of samples of the run."""

    content: Content
    manifest: Manifest
    outcome: Outcome | None
    calibration: Calibration | None
    between: tuple[int, int]
    """Range of the samples: first index, and index after the last sample.

    `content` may contain samples outside this range.
    """


def run_content(
    paths: Sequence[Path],
    start: float | None = None,
    stop: float | None = None,
    *,
    digest: bool = True,
) -> RunContent:
    """Return the content of a run's files from `start` to `stop`; raises the errors of `load`."""
    between, part = EVERYTHING, None
    if start is not None or stop is not None:
        between, part = _range_to_read(paths[0], start or 0.0, inf if stop is None else stop)
    files = [_read(path, part, digest=digest) for path in paths]
    content, manifest, ended, attached = files[0]
    if len(files) > 1:
        try:
            content = join_parts([f[0] for f in files], [f[1] for f in files])
        except ValueError as err:
            raise FileError(f"{paths[0]}: {err}") from err
        ended = files[-1][2]
    return RunContent(content, manifest, ended, attached, between)


_READABLE_FILES = (
    f"give a recording (*{RECORDING}, or @NAME of `armrig ls`); `armrig import` makes one of "
    f"{OTHER_DATA}"
)
_FOREIGN = (
    "not made by armrig; `armrig import {path} --topic NAME --input FIELD --signal FIELD` reads a "
    "topic of it, and without --topic lists the topics"
)
_IMPORTED = (
    "was imported and belongs to no rig, but a recording of a rig is needed here; sampling, hints, "
    "identify, validate, compare, check, linearity, plot, info and export read imported data"
)
_File = tuple[Content, Manifest, Outcome | None, Calibration | None]


def _read(path: Path, part: FileRange | None, *, digest: bool) -> _File:
    """Return content, manifest, outcome and calibration of a file; raises the errors of `load`."""
    try:
        content = read(path, part=part, digest=digest)
    except DamageError as err:
        raise FileError(f"{path}: {err}; {_READABLE_FILES}") from err
    if content is None and not path.stat().st_size:
        raise FileError(f"{path}: is empty, 0 B: nothing was recorded; record again")
    if content is None:
        raise FileError(f"{path}: is not a recording of the rig; {_READABLE_FILES}")
    entries = content.metadata.get(records.RUN)
    if entries is None:
        if is_foreign(path):
            raise FileError(f"{path}: {_FOREIGN.format(path=path)}")
        why = content.damage or "it contains no metadata named armrig.run"
        raise FileError(f"{path}: not a recording of a run: {why}")
    try:
        manifest = records.Manifest.of(entries)
        outcome = content.metadata.get(records.OUTCOME)
        ended = None if outcome is None else records.Outcome.of(outcome)
        text = content.attachments.get(records.CALIBRATION)
        attached = None if text is None else msgspec.json.decode(text, type=Calibration)
        recovered = _recovery(content)
        records.check_whole_numbers(manifest)
        if ended is not None:
            records.check_whole_numbers(ended)
        if recovered is not None:
            records.check_whole_numbers(recovered)
        is_imported = manifest.kind == IMPORTED
    except (msgspec.DecodeError, ValueError, RecursionError, OverflowError) as err:
        why = (str(err).splitlines() or [type(err).__name__])[0][:300]
        raise FileError(
            f"{path}: armrig did not write the manifest, the outcome or the calibration of this "
            f"file: {why}"
        ) from err
    if is_imported:
        raise FileError(f"{path}: {_IMPORTED}")
    try:
        check_sampling_time(manifest)
    except DamageError as err:
        raise FileError(f"{path}: {err}") from err
    check_attachments(path, content, manifest)
    return content, manifest, ended, attached


def check_attachments(path: Path, content: Content, manifest: Manifest) -> None:
    """Refuse a file whose attachment does not have the hash that is in the manifest.

    If bytes of the file are damaged, the hash itself may be wrong: the difference is then added to
    `content.damage`. Raises FileError.
    """
    if not (fault := attachment_fault(content, manifest)):
        return
    if not content.damage or content.cut_off:
        raise FileError(f"{path}: {fault}")
    content.damage = f"{content.damage}; {fault}"


def beginning(path: Path) -> tuple[Path, Content]:
    """Return the first file of the run at a path, and its content up to the first samples."""
    first = part_paths(path)[0]
    return first, _read(first, _BEGINNING, digest=False)[0]


def _range_to_read(path: Path, start: float, stop: float) -> tuple[tuple[int, int], FileRange]:
    """Convert a time range to a range of sample indices and the part of the file to read."""
    if not 0 <= start < stop:
        raise FileError(f"start={start:g} s and stop={stop:g} s: 0 <= start < stop is needed")
    content, manifest, _, _ = _read(path, _BEGINNING, digest=False)
    k_first = origin_of(content, manifest)
    first, end = (
        k_first + ceil(min(t / manifest.Ts, _MAX_TIME) - _ROUNDING_SAMPLES) for t in (start, stop)
    )
    clock = clock_of(content, manifest, k_first)
    zero_ns = clock.zero_ns + clock.offset_ns - _REPORT_DELAY_NS
    from_ns = zero_ns + round(min(start, _MAX_TIME) * 1e9)
    to_ns = zero_ns + round(min(stop, _MAX_TIME) * 1e9) + 2 * _REPORT_DELAY_NS
    return (first, end), FileRange(from_ns=from_ns, to_ns=to_ns, k_end=end)


def origin_of(content: Content, manifest: Manifest) -> int:
    """Return the number k of the sample at which t is 0."""
    if manifest.k_first >= 0 or not content.samples.size:
        return manifest.k_first
    return int(content.samples["k"][0])


def _recovery(content: Content) -> Recovered | None:
    entries = content.metadata.get(records.RECOVERED)
    return None if entries is None else records.Recovered.of(entries)


def _assemble(
    path: Path,
    name: str,
    run: RunContent,
    calibration: Calibration | None,
    paths: Sequence[Path],
) -> Recording:
    content, manifest, outcome, _, between = run
    try:
        description = records.description_of(content.attachments)
    except (FileError, InputError) as err:
        raise FileError(f"{path}: the attached description of the rig: {err}") from err
    messages = content.messages
    try:
        spots = [(int(m.k_first), int(m.count)) for m in messages.get("gap", [])]
        # Samples after the damage of a file may have arrived, so they do not count as missing.
        ended = None if content.damage else outcome
        rows = grid(content.samples["k"], manifest, ended, spots, between)
    except ValueError as err:
        raise FileError(f"{path}: {err}") from err
    origin = origin_of(content, manifest)
    origin = rows.k_first if origin < 0 else origin
    clock = clock_of(content, manifest, origin)
    described = content.samples
    if description.channels != rig_channels.CHANNELS:
        names, kinds = sample_names(description.channels), described.dtype
        described = described.view([(name, kinds[i]) for i, name in enumerate(names)])
    samples, before = described[rows.taken], described[: rows.taken.start]
    reports = reports_of(messages, clock)
    gaps = reports["gaps"]
    saved = f"; saved: {plural(samples.size, 'sample')}, {content.read} of {content.size} B, "
    saved += f"{rows.N * manifest.Ts:g} s of {max(manifest.samples, 0) * manifest.Ts:g} s"
    t = np.arange(rows.k_first - origin, rows.k_first - origin + rows.N, dtype=np.float64)
    t *= manifest.Ts
    if between != EVERYTHING:
        first, end = rows.k_first, rows.k_first + rows.N
        reports = {name: _within(series, t, manifest.Ts) for name, series in reports.items()}
        reports["gaps"] = tuple(g for g in gaps if g.k_first < end and g.k_first + g.count > first)
    driver, u = calibration.driver if calibration else Driver(), _input(samples, rows, gaps)
    recording = Recording(
        path=path,
        name=name,
        sha256=content.sha256,
        manifest=manifest,
        outcome=outcome,
        recovered=_recovery(content),
        calibration=calibration,
        k_first=rows.k_first,
        t=t,
        u=np.where(u == 0, 0.0, driver.gain * u + driver.offset_v),  # 0 V remains 0 V
        r=_reference(paths, content, manifest, rows),
        decisions=None
        if manifest.controller_sha256 is msgspec.UNSET
        else partial(law_decisions, tuple(paths)),
        description=description,
        **channels_of(
            samples,
            rows,
            calibration if description.is_calibrated else None,
            manifest.Ts,
            before,
            description.channels,
        ),
        present=rows.present,
        samples=samples,
        truncated=bool(content.damage),
        cut_off=content.cut_off,
        damage=content.damage + saved if content.damage else "",
        part=(round(float(t[0]), 9), round(float(t[-1]) + manifest.Ts, 9))  # to ns
        if between != EVERYTHING and t.size
        else None,
        unhashed=without_hash(content, manifest),
        **reports,
    )
    pairs = (recording.channel(channel.name) for channel in description.channels)
    r = () if recording.r is None else (recording.r,)
    arrays = (*r, recording.t, recording.u, *chain.from_iterable(pairs), recording.present, samples)
    for array in arrays:
        array.flags.writeable = False
    return recording


def _reference(
    paths: Sequence[Path], content: Content, manifest: Manifest, rows: SampleGrid
) -> Vector | None:
    """Return the reference at each row of a run in control; None if the reference is not known.

    The reference with which a law begins is attached. That of a client's controller, and of a law
    after the command `set_reference`, is in the decisions.
    """
    if manifest.controller_sha256 is msgspec.UNSET:
        return None
    k = rows.k_first + np.arange(rows.N)
    with suppress(DamageError):
        decisions = law_decisions(paths)
        decided, decision = decisions["r"], np.searchsorted(decisions["k"], k, side="right") - 1
        if not decided.size:
            return None
        r = decided[np.maximum(decision, 0)]
        if manifest.controller_sha256 and content.input and content.input_sha256:
            attached = read_input(paths[0], content.input, manifest.samples)
            row = np.clip(k - max(manifest.k_first, 0), 0, attached.size - 1)
            is_set = decisions["reference_n"][np.maximum(decision, 0)] > 0
            r = np.where(is_set, r, attached[row])
        elif manifest.controller_sha256:
            return None
        return r if np.isfinite(r).all() else None
    return None


def _within(reports: tuple[Any, ...], t: Vector, Ts: float) -> tuple[Any, ...]:
    """Return the reports whose times are between the first time in `t` and the last time + Ts."""
    if not t.size:
        return ()
    begin, end = float(t[0]), float(t[-1]) + Ts
    return tuple(f for f in reports if begin <= f.t < end)


def clock_of(content: Content, manifest: Manifest, k_first: int) -> RecordingClock:
    """Return the clock whose zero is the time at which sample `k_first` was due."""
    if content.samples.size:
        k, due_ns = (int(content.samples[name][0]) for name in ("k", "t_sched_ns"))
    elif content.messages.get("gap"):
        gap = content.messages["gap"][0]
        k, due_ns = gap.k_first, gap.t_from_ns
    else:
        k, due_ns = k_first, 0
    zero_ns = due_ns - round((k - k_first) * manifest.Ts * 1e9)
    return RecordingClock(zero_ns=zero_ns, offset_ns=manifest.clock_offset_ns)


def _input(samples: NDArray[np.void], rows: SampleGrid, gaps: tuple[Gap, ...]) -> Vector:
    """Return the voltage (N,) in V; that of a missing sample is in its gap record, else NaN."""
    applied = samples["u_applied_v"]
    if applied.size == rows.N:
        return applied.copy()
    u = rows.filled((gap.k_first, gap.count, gap.u_held_v) for gap in gaps)
    u[rows.present] = applied
    return u


def join_parts(contents: Sequence[Content], manifests: Sequence[Manifest]) -> Content:
    """Join the contents of consecutive parts of one run into one content.

    Raises ValueError if the parts belong to different runs, a part is missing, or k does not
    increase.
    """
    for before, after in pairwise(manifests):
        if (before.rig, before.run_id) != (after.rig, after.run_id):
            raise InputError(
                f"run {after.run_id} of rig {after.rig} is not run {before.run_id} of rig "
                f"{before.rig}: only the parts of one run are joined"
            )
        if after.part != before.part + 1:
            raise InputError(
                f"part {after.part} does not follow part {before.part}: give the parts of a run "
                "in their order, with none left out"
            )
    run = Content(
        sha256=hashlib.sha256("".join(c.sha256 for c in contents).encode()).hexdigest(),
        size=sum(c.size for c in contents),
        damage="; ".join(
            f"part {m.part}: {c.damage}"
            for c, m in zip(contents, manifests, strict=True)
            if c.damage
        ),
        cut_off=any(c.cut_off for c in contents),
        read=sum(c.read for c in contents),
        samples=np.concatenate([c.samples for c in contents]),
        metadata={RUN: contents[0].metadata[RUN]},
        attachments=contents[0].attachments,
        input=contents[0].input,
        input_sha256=contents[0].input_sha256,
    )
    for content in contents:
        for stream, messages in content.messages.items():
            run.messages.setdefault(stream, []).extend(messages)
        if RECOVERED in content.metadata:
            run.metadata[RECOVERED] = content.metadata[RECOVERED]
    if OUTCOME in contents[-1].metadata:
        run.metadata[OUTCOME] = contents[-1].metadata[OUTCOME]
    k = run.samples["k"]
    if k.size and not (k[1:] > k[:-1]).all():
        raise InputError("the samples of a part do not follow the samples of the previous part")
    return run
