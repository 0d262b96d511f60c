"""What a report says of its recordings: their roles, what they are of, and their timing."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from armrig_core.calibration import Driver

from armrig.data.dataset import Dataset
from armrig.numerics.quantities import NBSP, microseconds, milliseconds, number, percent
from armrig.recordings.calibration.staleness import calibrated
from armrig.recordings.jitter import Disturbances, SamplingStatistics, Spread
from armrig.recordings.recording import Recording
from armrig.report.study import STAIRCASE, STEP, Study, kind_of

_MOST_NOTES = 20  # of a recording
_SCALE = "theta_1_rad_per_count"


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


def data_text(study: Study) -> str:
    """Return what angle and voltage are, and how much of the angle is missing."""
    hidden = 100 * study.estimation.missing / study.estimation.N
    steps = len(study.estimation.history)
    cut = 1 if study.halves else 0  # to have been cut in two is no treatment
    untouched = ": nothing is removed from it, no mean and no trend" if steps <= cut else ""
    return (
        "The voltage is the one that the device says it applied, the angle is unwrapped from the "
        "raw counts. It grows without end, because the voltage is never negative"
        f"{untouched}. {hidden:.1f}{NBSP}% "
        f"of the estimation data have no angle. {_units(study)}"
    )


def _units(study: Study) -> str:
    """Return what the rad and the volt of the models rest on."""
    calibrations = {
        calibrated(r.calibration): r.calibration
        for r in (study.recording_of(d.source) for d in (study.estimation, study.validation))
    }
    measured = [c for c in calibrations.values() if c and c.made]
    made = [c.made for c in measured if c.made]
    if len(made) < len(calibrations):
        return (
            "Angles and voltages rest on configured values that were never measured: what is in "
            "these units, the gain of a model too, is as good as they are."
        )
    scales = [m.figures[_SCALE] for m in made if _SCALE in m.figures]
    known = max((s.std / abs(s.value) for s in scales if s.value), default=None)
    angle = f"The rad is that of the calibration of {' and of '.join(calibrations)}"
    if known is not None:
        angle += f", known to {percent(100 * known)} (one standard deviation)"
    volt = "the volt that of a meter at the motor's terminals"
    if not all("driver_gain" in m.figures for m in made):
        of = "the codes" if all(c.driver == Driver() for c in measured) else "a configured driver"
        volt = f"the volt that of {of}: no meter was read at the motor's terminals"
    return f"{angle}; {volt}."


def treatment(study: Study) -> list[str]:
    """Return what was done to the data and what was taken from them, a sentence a step.

    What was done alike to both is told once.
    """
    ours, theirs = study.estimation, study.validation
    if ours.history == theirs.history and not (ours.trends or theirs.trends):
        return [f"Both: {step}." for step in ours.history]
    return [
        sentence
        for name, data in (("Estimation data", ours), ("Validation data", theirs))
        for sentence in (
            *(f"{name}: {step}." for step in data.history),
            *_trends(name, data),
        )
    ]


def _trends(name: str, data: Dataset) -> list[str]:
    """Return what `detrend` took from each experiment, so that it can be put back."""
    said = []
    for i, trend in enumerate(data.trends, 1):
        which = f"experiment {i} of {len(data.trends)}" if len(data.trends) > 1 else "the data"
        parts = [
            _line(what, level, slope, unit)
            for what, level, slope, unit in (
                ("u", trend.u_level, trend.u_slope, data.input_unit),
                (data.output, trend.y_level, trend.y_slope, data.unit),
            )
        ]
        said.append(f"{name}: from {which} were taken {' and '.join(parts)}.")
    return said


def _line(what: str, level: float, slope: float, unit: str) -> str:
    rising = f" rising by {number(slope)}{NBSP}{unit}/s" if slope else ""
    return f"{number(level)}{NBSP}{unit} of {what}{rising}"
