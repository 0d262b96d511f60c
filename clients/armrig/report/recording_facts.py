"""What a report says of its recordings: their roles, what they are of, and their timing."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from armrig.numerics.quantities import NBSP, microseconds, milliseconds, number
from armrig.recordings.calibration.staleness import calibrated
from armrig.recordings.jitter import Disturbances, SamplingStatistics, Spread
from armrig.recordings.recording import Recording
from armrig.report.study import STAIRCASE, STEP, Study, kind_of

_MOST_NOTES = 20  # of a recording


def role(study: Study, recording: Recording) -> str:
    """Return what a recording was used for."""
    if kind_of(recording) in (STEP, STAIRCASE):
        return kind_of(recording)
    if recording.sha256 == study.estimation.source:
        return "estimation and validation" if study.halves else "estimation"
    return "validation" if recording.sha256 == study.validation.source else "not used"


def run_name(recording: Recording) -> str:
    """Return the run's id as `@RUN`, which figures and commands show; without one, the hash."""
    run = recording.manifest.run_id
    return f"@{run}" if run else recording.short_hash


def facts(study: Study) -> list[list[str]]:
    """Return the table of the recordings, a column each."""
    rows: list[list[str]] = []
    recordings = study.recordings

    def row(name: str, value: Callable[[Recording], str]) -> None:
        values = [value(r) for r in recordings]
        if any(values):
            rows.append([name, *(v or "–" for v in values)])

    row("run", run_name)
    row("SHA-256", lambda r: r.short_hash)
    row("experiment", lambda r: r.manifest.experiment)
    row("made of", lambda r: ", ".join(f"{k} = {v}" for k, v in r.manifest.details.items()))
    row("started", lambda r: r.manifest.started.replace("T", " ")[:19])
    row("paced by", lambda r: {"scheduled": "the device"}.get(r.manifest.pacing, "the host"))
    row("samples at Ts", lambda r: f"{r.N} at {milliseconds(r.Ts)}")
    row("length", lambda r: f"{r.N * r.Ts:.1f} s")
    row("input", _input_range)
    row("calibrated", lambda r: calibrated(r.calibration))
    row("missing samples", lambda r: str(r.missing))
    row("in the dead band, or just after", lambda r: str(r.hidden))
    row("outcome", _outcome)
    return rows


def notes(recordings: Sequence[Recording]) -> list[str]:
    """Return the notes of the recordings: which, when, who and what."""
    said = []
    for recording in recordings:
        name, found = run_name(recording), recording.notes
        said += [f"{name} at {n.t:.2f}{NBSP}s, {n.owner}: {n.text}" for n in found[:_MOST_NOTES]]
        if len(found) > _MOST_NOTES:
            said.append(f"{name}: {len(found) - _MOST_NOTES} more notes")
    return said


def _outcome(recording: Recording) -> str:
    ended = recording.outcome.outcome if recording.outcome else ""
    if recording.truncated:
        what = "file cut off" if recording.cut_off else "file damaged"
        return f"{ended}, but the {what}" if ended else what
    return ended or "not known"


def _input_range(recording: Recording) -> str:
    u = recording.u[np.isfinite(recording.u)]
    return f"{u.min():.2f} to {u.max():.2f} V" if u.size else ""


def shared_facts(study: Study) -> list[str]:
    """Return what all recordings share: device, host and versions."""
    manifest = study.recording_of(study.estimation.source).manifest
    said = []
    for what, facts in (("Device", manifest.device), ("Host", manifest.host)):
        text = ", ".join(f"{k} {v}" for k, v in facts.items() if v not in ("", None, [], {}))
        if text:
            said.append(f"{what}: {text}.")
    said.append(f"Recorded by armrig {manifest.armrig}, protocol {manifest.protocol}.")
    return said


def timing_rows(timing: Sequence[SamplingStatistics]) -> list[list[str]]:
    """Return the table of sampling times, a column a recording."""

    def row(name: str, value: Callable[[SamplingStatistics], str]) -> list[str]:
        return [name, *(value(s) for s in timing)]

    return [
        row("sampling time asked for", lambda s: microseconds(s.Ts_us)),
        row("mean interval", lambda s: f"{s.mean_us:.2f} µs"),
        row("standard deviation of the interval", lambda s: microseconds(s.std_us)),
        row(
            "shortest … longest interval",
            lambda s: f"{s.least_us:.0f} … {microseconds(s.greatest_us)}",
        ),
        row("jitter p50, p99, p99.9", lambda s: _percentiles(s.jitter)),
        row("largest jitter", lambda s: microseconds(s.jitter.max)),
        row("lateness p50, p99, p99.9", lambda s: _percentiles(s.lateness)),
        row("largest lateness", lambda s: microseconds(s.lateness.max)),
        row("missing samples, most in a row", lambda s: f"{s.missing}, {s.longest_gap}"),
    ]


def disturbance_rows(found: Sequence[Disturbances]) -> list[list[str]]:
    """Return what disturbed the timing, a column a recording."""
    texts = [d.texts() for d in found]
    names = dict.fromkeys(name for text in texts for name in text)
    return [[name, *(text.get(name, "–") for text in texts)] for name in names]


def _percentiles(spread: Spread) -> str:
    return f"{number(spread.p50)}, {number(spread.p99)}, {microseconds(spread.p999)}"
