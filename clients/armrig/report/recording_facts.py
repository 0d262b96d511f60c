"""Facts about the recordings of a report: their roles, their contents and their timing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from armrig_core.rig.calibration import Driver
from armrig_core.rig.channels import symbol
from armrig_core.telemetry.channels import CHANNELS

from armrig.data.dataset import Dataset
from armrig.data.figures import without_ramp
from armrig.data.finding import Finding
from armrig.numerics.quantities import (
    NBSP,
    error,
    microseconds,
    milliseconds,
    number,
    percent,
    plural,
)
from armrig.recordings.jitter import (
    SamplingStatistics,
    Spread,
    angle_of_jitter,
    disturbances,
    fastest_rate,
    sampling_statistics,
)
from armrig.recordings.overview import calibration_doubts, calibration_text, outcome_text
from armrig.recordings.recording import Recording
from armrig.recordings.usability import NO_MODEL
from armrig.report.sections import plain
from armrig.report.study import Study, each_output
from armrig.validation.linearity import in_open_loop

Rows = tuple[tuple[str, ...], ...]
_MAX_NOTES = 20  # of one recording in a report
_ANGLE_SCALE = f"{CHANNELS[0].name}_rad_per_count"


def role(study: Study, recording: Recording) -> str:
    """Return the use of a recording in the study."""
    if recording.manifest.kind in NO_MODEL:
        return recording.manifest.kind
    if recording.sha256 == study.estimation.source:
        return "estimation and validation" if study.halves else "estimation"
    return "validation" if recording.sha256 == study.validation.source else "not used"


def run_name(recording: Recording) -> str:
    """Return the run's id as `@RUN`, as in figures and commands, or the hash if there is no id."""
    run = recording.manifest.run_id
    return f"@{run}" if run else recording.short_hash


def without_turns(data: Dataset) -> str:
    """Return a text on the ramp that a figure of an output leaves out; "" if there is none."""
    return ", minus the ramp of its mean speed" if without_ramp(data)[2] else ""


def facts(study: Study) -> Rows:
    """Return the table of the recordings, one column for each recording."""
    return _rows(run_facts(r) for r in study.recordings)


def run_facts(r: Recording) -> dict[str, str]:
    """Return the facts about a run by name, as text; "" for a fact that is not known."""
    turns = r.description.channels[0].turns
    hidden = "in the dead band, or just after" if turns else f"without {r.first}"
    signal = r.description.input
    u = signal.value(r.u[np.isfinite(r.u)])
    facts = {
        "run": run_name(r),
        "experiment": r.manifest.experiment,
        "made with": ", ".join(f"{k} = {v}" for k, v in r.manifest.details.items()),
        "started": r.manifest.started.replace("T", " ")[:19],
        "paced by": "the device" if r.manifest.pacing == "scheduled" else "the host",
        "samples at Ts": f"{r.N} at {milliseconds(r.Ts)}",
        "length": f"{r.N * r.Ts:.1f} s",
        "input": f"{u.min():.2f} to {u.max():.2f} {signal.unit}" if u.size else "",
        "calibrated": calibration_text(r),
        "missing samples": str(r.missing),
        hidden: str(r.hidden),
        "outcome": outcome_text(r),
    }
    if r.is_imported:
        of_rig = ("made with", "started", "paced by", "calibrated", "outcome")
        facts = {name: text for name, text in facts.items() if name not in of_rig}
        facts |= {
            "imported": r.manifest.started[:19].replace("T", " "),
            "from": r.description.title,
        }
    return facts


def _rows(columns: Iterable[Mapping[str, str]]) -> Rows:
    """Return the rows of a table, each column by name; a row without any text is left out."""
    columns = [*columns]
    names = dict.fromkeys(name for texts in columns for name in texts)
    rows = [(name, *(texts.get(name, "") for texts in columns)) for name in names]
    return tuple((name, *(v or "–" for v in values)) for name, *values in rows if any(values))


def notes(recordings: Sequence[Recording]) -> list[str]:
    """Return the notes of the recordings: run, time, owner and text."""
    texts = []
    for recording in recordings:
        name, entries = run_name(recording), recording.notes
        texts += [
            f"Note of {name} at {n.t:.2f}{NBSP}s, {n.owner}: {n.text}" for n in entries[:_MAX_NOTES]
        ]
        if len(entries) > _MAX_NOTES:
            texts.append(f"Note of {name}: {plural(len(entries) - _MAX_NOTES, 'more note')}")
    return texts


def setup_sentences(study: Study) -> list[str]:
    """Return sentences on the device, the host and the versions of the estimation data."""
    recording = study.recording_of(study.estimation.source)
    manifest, sentences = recording.manifest, []
    if recording.is_imported:
        return [f"Imported by armrig {manifest.armrig}."]
    for heading, facts in (("Device", manifest.device), ("Host", manifest.host)):
        known_facts = {k: v for k, v in facts.items() if v not in ("", None, [], {})}
        text = ", ".join(
            f"{k} {' and '.join(map(str, v if isinstance(v, list | tuple) else [v]))}"
            for k, v in known_facts.items()
        )
        if text:
            sentences.append(f"{heading}: {text}.")
    sentences.append(f"Recorded by armrig {manifest.armrig}, protocol {manifest.protocol}.")
    return sentences


def timing_rows(recordings: Sequence[Recording]) -> Rows:
    """Return the table of sampling times and their disturbances, one column for each recording."""
    return _rows(_timing(sampling_statistics(r)) | disturbances(r).texts() for r in recordings)


def _timing(s: SamplingStatistics) -> dict[str, str]:
    return {
        "requested sampling time": microseconds(s.Ts_us),
        "mean interval": f"{s.mean_us:.2f} µs",
        "standard deviation of the interval": microseconds(s.std_us),
        "shortest … longest interval": f"{s.least_us:.0f} … {microseconds(s.greatest_us)}",
        "jitter p50, p99, p99.9": _percentiles(s.jitter),
        "largest jitter": microseconds(s.jitter.max),
        "lateness p50, p99, p99.9": _percentiles(s.lateness),
        "largest lateness": microseconds(s.lateness.max),
        "missing samples, longest gap": f"{s.missing}, {s.longest_gap}",
    }


def _percentiles(spread: Spread) -> str:
    return f"{number(spread.p50)}, {number(spread.p99)}, {microseconds(spread.p999)}"


def data_text(study: Study) -> str:
    """Return a text on the sources of angles and voltage, and the percentages of missing angles."""
    signal, word = study.recordings[0].description.input, study.input
    sentences = [f"The {word} is the applied {word} that the device reports."]
    if signal.is_scaled:
        sentences = [
            f"The {word} is {signal.per_volt:g} {signal.unit}/V times the applied voltage that the "
            f"device reports{f', plus {signal.offset:g} {signal.unit}' if signal.offset else ''}."
        ]
    if study.recordings[0].is_imported:
        sentences = [f"The data are of another program: {study.recordings[0].description.title}."]
    steps = len(study.estimation.history)
    cut = 1 if study.halves else 0  # a split into halves is no treatment
    for part in each_output(study):
        y = part.symbol
        if study.of_arm:
            text = f"{y} is relative to the {CHANNELS[0].body}."
            if part.integrates:
                text = f"{y} is unwrapped from the raw counts. {y} grows without limit, because "
                text += "the voltage is never negative."
            sentences.append(
                text + " No mean and no trend is removed from this angle." * (steps <= cut)
            )
        if hidden := 100 * part.estimation.missing / part.estimation.N:
            sentences.append(f"{hidden:.1f}{NBSP}% of the estimation data have no {y}.")
        sentences += linearity_sentences(part.validation)
    if study.of_arm:
        sentences.append(_units(study))
    elif not study.recordings[0].is_imported:
        sentences.append("The scales of the outputs are those of the rig's description.")
    return " ".join(sentences)


def linearity_sentences(data: Dataset) -> list[str]:
    """Return a sentence on the linearity of the validation data; none if they are closed loop."""
    return [f"Linearity of the validation data: {finding.line}." for finding in in_open_loop(data)]


def _units(study: Study) -> str:
    """Return a text on how the scales of angle and voltage in the models were determined."""
    calibrations = {
        calibration_text(r): r.calibration
        for r in (study.recording_of(d.source) for d in (study.estimation, study.validation))
    }
    measured = [c for c in calibrations.values() if c and c.made]
    made = [c.made for c in measured if c.made]
    if len(made) < len(calibrations):
        return (
            "The scales of angle and voltage are configured values that were never measured. "
            "Results in these units, such as a model's gain, are only as accurate as these values."
        )
    scales = [m.figures[_ANGLE_SCALE] for m in made if _ANGLE_SCALE in m.figures]
    relative_std = max((s.std / abs(s.value) for s in scales if s.value), default=None)
    angle = f"The radian is from the calibration of {plain(' and of '.join(calibrations))}"
    if relative_std is not None:
        angle += f", accurate to {percent(100 * relative_std)} (one standard deviation)"
    volt = "the volt is from a meter at the motor's terminals"
    if not all("driver_gain" in m.figures for m in made):
        origin = (
            "the converter codes"
            if all(c.driver == Driver() for c in measured)
            else "a configured driver"
        )
        volt = f"the volt is from {origin}: no meter was read at the motor's terminals"
    second = CHANNELS[1].name
    scale = ""
    if any(part.output == second for part in each_output(study)):
        scale = f". The scale of {symbol(second)} is a configured value that was never measured"
    return f"{angle}; {volt}{scale}."


def treatment(study: Study) -> list[str]:
    """Return a sentence for each step of the data's treatment, and for each removed trend.

    If both datasets had the same treatment, each step is reported once.
    """
    return list(dict.fromkeys(text for part in each_output(study) for text in _treatment(part)))


def _treatment(study: Study) -> Iterator[str]:
    ours, theirs = study.estimation, study.validation
    if ours.history == theirs.history and not (ours.trends or theirs.trends):
        yield from (f"Both: {step}." for step in ours.history)
        return
    for name, data in (("Estimation data", ours), ("Validation data", theirs)):
        yield from (f"{name}: {step}." for step in data.history)
        yield from _trends(name, data)


def _trends(name: str, data: Dataset) -> list[str]:
    """Return a sentence for each experiment, with the means and slopes that `detrend` removed."""
    sentences = []
    for i, trend in enumerate(data.trends, 1):
        which = f"experiment {i} of {len(data.trends)}" if len(data.trends) > 1 else "the data"
        parts = [
            _line(signal, float(level), float(slope), unit)
            for signal, level, slope, unit in (
                (data.input, trend.u_level, trend.u_slope, data.input_unit),
                (data.output, trend.y_level, trend.y_slope, data.unit),
            )
        ]
        sentences.append(f"{name}: {' and '.join(parts)} removed from {which}.")
    return sentences


def _line(signal: str, level: float, slope: float, unit: str) -> str:
    rising = f" rising by {number(slope)}{NBSP}{unit}/s" if slope else ""
    return f"{number(level)}{NBSP}{unit} of {signal}{rising}"


def calibration_sentences(recordings: Sequence[Recording]) -> list[str]:
    """Return the doubts about the calibrations of recordings, without repeated sentences.

    A sentence that holds only for some of the recordings begins with the names of their files.
    """
    files: dict[Finding, list[str]] = {}
    for r in recordings:
        for finding in calibration_doubts(r):
            files.setdefault(finding, []).append(r.path.name)
    return [
        finding.text
        if len(names) == len(recordings)
        else f"{', '.join(names)}: {finding.text[0].lower()}{finding.text[1:]}"
        for finding, names in files.items()
    ]


def jitter_verdicts(study: Study) -> Iterator[str]:
    """Yield sentences on the jitter of the validation data, if there is any, and its effect."""
    timing = sampling_statistics(study.recording_of(study.validation.source))
    if not timing.std_us > 0:  # NaN without times of a device
        return
    moved: list[str] = []
    for part in each_output(study):
        data = part.validation
        rate = f"at {number(fastest_rate(data))} {data.unit}/s"
        rate += "" if moved else ", the rate that 99 % of the data do not exceed,"
        by = error(angle_of_jitter(timing, data), data.unit)
        moved.append(f"{rate} this jitter moves {part.symbol} by {by}")
    yield (
        "The sampling interval of the validation data has a standard deviation of "
        f"{microseconds(timing.std_us)}. A{'; '.join(moved)[1:]}. The jitter affects both the "
        "measurement and the response to the input."
    )
