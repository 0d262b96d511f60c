"""Contents of a recording, and its overview (handout, 3.1.4): missing samples, outliers, drift."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from math import tau
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.recording_file.manifest import Recovered
from armrig_core.rig.channels import DeviceChannel

from armrig.data.columns import Vector
from armrig.data.finding import Finding, good
from armrig.data.treatment import Drift, drift, hampel
from armrig.numerics.quantities import digits, join_names, plural
from armrig.recordings.daemon_reports import gap_lines
from armrig.recordings.findings import second_moves
from armrig.recordings.jitter import Spread, disturbances, sampling_statistics
from armrig.recordings.recording import Recording
from armrig.recordings.usability import data_verdict, doubts_of_calibration

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from armrig.data.dataset import Dataset

_MIN_INPUT_CHANGES = 20  # as many as the coefficients of u in the model that finds outliers

_RATE_INTERVAL_S = 0.1
"""Interval, in s, over which the rate of a turning shaft is computed.

One step of the converter changes this rate by 0.06 rad/s. Over an interval of 2 ms, one step would
change the rate by 3 rad/s.
"""
_MAX_GAPS, _MAX_NOTES = 3, 10  # lines without --verbose
_MAX_TEXT = 1000  # characters
_BY_DEVICE = "the device", "arrival of the samples at the host, which does not affect them"
_BY_HOST = "the host", "lateness of the host's request for each sample"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Overview:
    """A recording, with its outliers and the drift of its signals."""

    recording: Recording
    """Recording of the overview."""
    outliers: Mapping[str, Vector]
    """Times of the outliers in s, by output; outputs that could not be searched are left out."""
    drift: Mapping[str, Drift]
    """Drift of each rate, and of each channel without a rate, by output.

    If samples with unknown u divide the recording into experiments, the names end in " 1", " 2" …
    """
    reasons: Mapping[str, str]
    """Reasons why outputs were not searched, by output; the name "outliers" means all outputs."""

    def rows(self) -> list[tuple[str, str]]:
        """Return the rows of a table: the name of a quantity and its value as text."""
        rec = self.recording
        first = rec.description.channels[0]
        hidden = "dead band" if first.turns else "out of range"
        return [
            _input_row(rec),
            *((channel.name, _motion(rec, channel)) for channel in rec.description.channels),
            ("missing", f"{rec.missing} of {plural(rec.N, 'sample')}"),
            (hidden, f"{plural(rec.hidden, 'sample')} without {first.name}"),
            *((f"outliers, {name}", _outliers(times)) for name, times in self.outliers.items()),
            *((f"drift, {name}", str(slope)) for name, slope in self.drift.items()),
            *((f"not looked at, {name}", why) for name, why in self.reasons.items()),
        ]

    def facts(self) -> dict[str, Any]:
        """Return the overview as a dict for JSON."""
        rec = self.recording
        return {
            "sha256": rec.sha256,
            "samples": rec.N,
            "missing": rec.missing,
            "invalid": rec.hidden,
            "outliers": {name: times.tolist() for name, times in self.outliers.items()},
            "drift": {
                name: {"rate": d.rate, "std": d.std, "unit": f"{d.unit}/s"}
                for name, d in self.drift.items()
            },
            "not_looked_at": dict(self.reasons),
        }

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of u, the channels and their rates, with the outliers marked."""
        from armrig.plots.layout import figure_of
        from armrig.recordings.figures import plot_overview

        return figure_of(plot_overview(self.recording, self.outliers, ax=ax))


def overview(recording: Recording) -> Overview:
    """Search the channels for outliers, and the channels without a rate and the rates for a drift.

    The angle of a turning shaft is not searched for a drift: its slope is the response to the mean
    of u.
    """
    has_input, channels = np.isfinite(recording.u), recording.description.channels
    reasons = _reasons(recording)

    def each(names: Iterable[str], search: Callable[[Dataset], Any]) -> Iterator[tuple[str, Any]]:
        for name in names:
            if name not in reasons:
                try:
                    yield name, search(recording.dataset(name))
                except ValueError as err:
                    reasons[name] = str(err)

    searched = () if "outliers" in reasons else tuple(recording.channels)
    outliers = {
        name: recording.t[has_input][wrong]
        for name, wrong in each(searched, lambda data: data.valid & ~hampel(data).valid)
    }
    # No such signal integrates: springs hold an arm, and the back-EMF limits the rate. In a
    # recording as short as the swing after a step, a test for an integrator is unreliable.
    drifting = (channel.rate or channel.name for channel in channels)
    drifts = {
        f"{name} {i}" if len(lines) > 1 else name: line
        for name, lines in each(drifting, partial(drift, integrator=False))
        for i, line in enumerate(lines, 1)
    }
    return Overview(
        recording=recording,
        outliers=MappingProxyType(outliers),
        drift=MappingProxyType(drifts),
        reasons=MappingProxyType(reasons),
    )


def _reasons(recording: Recording) -> dict[str, str]:
    """Return the reasons why outputs cannot be searched, by output; "outliers" means all."""
    channels, reasons = recording.description.channels, {}
    if len(channels) > 1 and not second_moves(recording):
        second = channels[1]  # each step of a reading at rest looks like an outlier
        held = f": the {second.body} was removed or held" if second.body else ""
        reasons[second.name] = f"{second.name} is constant{held}"
    changes = int(np.count_nonzero(np.diff(recording.u[np.isfinite(recording.u)])))
    if changes < _MIN_INPUT_CHANGES:
        reasons["outliers"] = (
            f"u changes {plural(changes, 'time')}; with fewer than {_MIN_INPUT_CHANGES} changes a "
            "model cannot distinguish an outlier from the swing after a change: look at the figure"
        )
        # In 13 of 40 emulated steps without a drift, the search found a positive drift of the rate.
        text = "u changes too rarely: the errors of the model would look like a drift"
        reasons |= {channel.rate: text for channel in channels if channel.rate}
    return reasons


def _motion(rec: Recording, channel: DeviceChannel) -> str:
    """Return the range of a channel, or the turns and the speed of a turning shaft."""
    y, valid = rec.channel(channel.name)
    if not channel.turns:
        return f"{_range(y)} {channel.unit}"
    turned = np.ptp(y[valid]) / tau if valid.any() else 0.0
    n = max(1, round(_RATE_INTERVAL_S / rec.Ts))
    speed = f"{_range((y[n:] - y[:-n]) / (n * rec.Ts))} rad/s over {_RATE_INTERVAL_S:g} s"
    return f"the {channel.body or 'shaft'} turned {turned:.1f} times, at {speed}"


def _input_row(rec: Recording) -> tuple[str, str]:
    signal = rec.description.input
    u, unit = signal.value(rec.u), signal.unit
    return signal.name, f"{_range(u)} {unit}, {digits(float(np.nanmean(u)), 3)} {unit} on average"


def _range(x: Vector) -> str:
    x = x[np.isfinite(x)]
    return f"{digits(x.min(), 3)} to {digits(x.max(), 3)}" if x.size else "not known"


def _outliers(times: Vector) -> str:
    if not times.size:
        return "none"
    first = ", ".join(f"{t:g} s" for t in times[:5])
    return f"{times.size}, at {first}" + (" …" if times.size > 5 else "")


def contents_facts(rec: Recording) -> dict[str, Any]:
    """Return the contents of a recording, and how well it was sampled, as a dict for JSON."""
    return {
        "sha256": rec.sha256,
        "manifest": rec.manifest,
        "emulated": rec.manifest.emulated,
        "outcome": rec.outcome,
        "recovered": rec.recovered,
        "samples": int(rec.samples.size),
        "missing": rec.missing,
        "invalid": rec.hidden,
        "truncated": rec.truncated,
        "damage": rec.damage,
        "sampling": sampling_statistics(rec),
        "causes": disturbances(rec),
        "calibration": rec.calibration,
        "remarks": [f.text for f in (*calibration_doubts(rec), *_hash_remarks(rec))],
        "verdict": data_verdict(rec).facts(),
        "gaps": rec.gaps,
        "events": rec.events,
        "notes": rec.notes,
    }


def contents_rows(rec: Recording, *, verbose: bool) -> Iterator[tuple[str, str]]:
    """Yield the rows of a table of the contents, with the verdict on the data as the first row."""
    manifest, timing = rec.manifest, sampling_statistics(rec)
    details = ", ".join(f"{k} {v}" for k, v in manifest.details.items())
    verdict = data_verdict(rec)
    yield "verdict", verdict.summary
    yield "recording", str(rec.path)
    if verbose:
        yield "sha256", rec.sha256
    yield "rig", f"{manifest.rig}{', emulated' * manifest.emulated}: {rec.description.title}"
    yield "run", f"{manifest.run_id}, {manifest.started}"
    if manifest.owner:
        yield "owner", _clip(manifest.owner)
    yield (
        "experiment",
        _clip(f"{manifest.experiment}: {details}" if details else manifest.experiment),
    )
    yield "samples", _sample_count(rec)
    yield "outcome", outcome_text(rec)
    if rec.recovered is not None:
        yield "recovered", _recovery_text(rec.recovered)
    yield "calibrated", calibration_text(rec)
    for remark in (*calibration_doubts(rec), *_hash_remarks(rec)):
        yield "remark", remark.text
    of_interval = "spread of the sampling interval, by the device's clock"
    yield "jitter", _percentiles(timing.jitter, 0, of_interval)
    if verbose:
        pacer, late = _BY_DEVICE if manifest.pacing == "scheduled" else _BY_HOST
        yield "paced by", pacer
        yield "lateness", _percentiles(timing.lateness, 1, late)
    if verbose and (causes := disturbances(rec).texts()):
        yield "disturbances", "; ".join(f"{name}: {text}" for name, text in causes.items())
    notes = [_clip(f"at {note.t:.2f} s, {note.owner}: {note.text}") for note in rec.notes]
    for name, texts, most in (("gap", gap_lines(rec.gaps), _MAX_GAPS), ("note", notes, _MAX_NOTES)):
        lines = texts if verbose else texts[:most]
        yield from ((name, text) for text in lines)
        if more := len(texts) - len(lines):
            yield name, f"{more} more; --verbose shows them"
    if rec.truncated:
        yield "damage", rec.damage
    for finding in verdict.findings if verbose else ():
        yield finding.about, finding.text


def outcome_text(rec: Recording) -> str:
    """Return the outcome of the run as text, with a remark if the file is cut off or damaged."""
    if not rec.truncated:
        return rec.outcome.outcome if rec.outcome else "not known: the file does not contain it"
    state = "is cut off" if rec.cut_off else "is damaged"
    writing = ", or is still being written" if rec.path.suffix == ".active" else ""
    if rec.outcome:
        return f"of the run: {rec.outcome.outcome}; but the file {state}"
    return f"not known: the file {state} before the outcome{writing}"


def calibration_text(rec: Recording) -> str:
    """Return the date and time of the calibration, or where the scales are from."""
    if not rec.description.is_calibrated:
        return "by its description"
    made = rec.calibration.made if rec.calibration else None
    return "no" if made is None else made.date[:16].replace("T", " ")


def calibration_doubts(rec: Recording) -> Iterator[Finding]:
    """Yield the doubts about the calibration; the description of another rig has its scales."""
    if rec.description.is_calibrated:
        yield from doubts_of_calibration(rec.calibration, rec.manifest)


def _hash_remarks(rec: Recording) -> Iterator[Finding]:
    """Yield a note if attachments of an older file could not be compared with a hash."""
    if rec.unhashed:
        text = f"The manifest, by armrig {rec.manifest.armrig}, contains no hash of "
        yield good("attachments", f"{text}{join_names(rec.unhashed)}: an exchange is not found.")


def _clip(text: str) -> str:
    return text if len(text) <= _MAX_TEXT else f"{text[:_MAX_TEXT]}…; --json shows all of it"


def _sample_count(rec: Recording) -> str:
    """Return the numbers of samples as text; for a truncated file, also the time of its end."""
    turns = rec.description.channels[0].turns
    why = "an angle (dead band, and the sample after)" if turns else f"a valid {rec.first}"
    text = f"{rec.samples.size} at {rec.Ts:g} s, {rec.missing} missing, {rec.hidden} without {why}"
    every = rec.manifest.every
    text += f"; the dataset has Ts {every * rec.Ts:g} s" if every > 1 else ""
    if rec.truncated:
        text += f"; up to {rec.N * rec.Ts:g} s of {rec.asked_s:g} s"
    return text


def _recovery_text(how: Recovered) -> str:
    cut_off = f", the last {how.cut_off_bytes} B were cut off" if how.cut_off_bytes else ""
    cut_off += f"; {how.damage}" if how.damage else ""
    when = how.when[:19].replace("T", " ")
    return f"{when} by armrig {how.armrig}: {how.kept_bytes} B were kept{cut_off}"


def _percentiles(spread: Spread, decimals: int, meaning: str) -> str:
    """Return the percentiles of a time, and the meaning of this time."""
    if spread.n == 0:
        return "too few samples"
    p50, p99 = f"{spread.p50:.{decimals}f}", f"{spread.p99:.{decimals}f}"
    return f"p50 {p50}, p99 {p99}, max {spread.max:.0f} µs; {meaning}"
