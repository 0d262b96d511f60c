"""Judgement of whether a recording's data can be used for an identification."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from math import isnan, nan
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.errors import InputError
from armrig_core.recording_file.manifest import Manifest
from armrig_core.rig.calibration import Calibration
from armrig_core.rig.description import Description

from armrig.data.dataset import Dataset
from armrig.data.finding import Finding, few_samples, lines_of, warning
from armrig.numerics.quantities import digits, join_names, plural
from armrig.numerics.regressors import whitening
from armrig.recordings import findings

if TYPE_CHECKING:
    from armrig.recordings.recording import Recording


_STRETCH_S = 1.0  # length of the intervals to which straight lines are fitted
_START_S = 3.0  # s; in longer runs, the first second (start of the motion) is left out
_MIN_LINE_SAMPLES = 4
_NOISE_ORDER = 10
STALE_DAYS = 30
"""Largest age of a calibration at the time of a recording, in days, before it counts as stale."""
_MIN_TURN_RAD = 0.5  # least rotation from which the direction is judged
NO_MODEL = ("step", "staircase")
"""Kinds of experiments with little excitation; reports show them but estimate no models."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class DataVerdict:
    """Result of `data_verdict`; its repr is a text with all findings."""

    recording: str
    """Hash of the recording."""
    findings: tuple[Finding, ...]
    """Findings of the checks, in the order of the checks."""
    signal_rad: float
    """Rms deviation of a turning shaft from straight lines, one line for each second, in rad; the
    power of the noise is subtracted. For another first channel, the deviation from its mean. This
    number, `noise_rad` and `step_rad` are then in the unit of the channel."""
    noise_rad: float
    """Standard deviation of the part of the first channel that no ARX model explains, in rad."""
    step_rad: float
    """Step of the converter, converted to rad of the first channel."""
    hidden_share: float
    """Share of the arrived samples without a valid first channel, such as in the dead band."""
    missing_share: float
    """Share of the samples that did not arrive."""

    @property
    def usable(self) -> bool:
        """True if models can be identified from the data."""
        return all(f.level != "unusable" for f in self.findings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Texts of the findings whose level is not good; unusable findings first."""
        return tuple(f.text for x in ("unusable", "warning") for f in self.findings if f.level == x)

    @property
    def summary(self) -> str:
        """Verdict in one line."""
        if not self.usable:
            return f"the data cannot be used: {self.warnings[0]}"
        if self.warnings:
            return f"the data can be used, with care: {'; '.join(self.warnings)}"
        if isnan(self.signal_rad):
            return "the data have enough samples, and the input moves"
        return (
            f"the data are good: signal to noise {digits(self.signal_rad / self.noise_rad, 2)} to 1"
        )

    def facts(self) -> dict[str, Any]:
        """Return all fields, for JSON."""
        findings = ({"level": f.level, "about": f.about, "text": f.text} for f in self.findings)
        return {"usable": self.usable} | asdict(self) | {"findings": tuple(findings)}

    def __repr__(self) -> str:
        """Describe the verdict and all findings, one finding per line."""
        care = ", with care" if self.warnings else ""
        outcome = f"can be used{care}" if self.usable else "cannot be used"
        return f"recording {self.recording[:12]}: {outcome}\n{lines_of(self.findings, '?')}"


def data_verdict(recording: Recording) -> DataVerdict:
    """Judge the data of a recording: run, samples, input, angles, signal, timing and turns.

    The noise is that of an ARX model of order 10 or less, close to the standard deviation of a
    white noise on the angle. It is at least the step of the converter divided by sqrt(12). In runs
    longer than 3 s, the signal is that after the first second, in which a shaft starts to turn.

    Parameters
    ----------
    recording : Recording
        Recording to judge. If its file is damaged, the samples before the damage are judged.

    Returns
    -------
    DataVerdict
        Findings, their summaries `usable` and `warnings`, and the numbers that were judged.

    Examples
    --------
    >>> verdict = armrig.data_verdict(armrig.example_recording())
    >>> verdict.usable, verdict.warnings
    (True, ())
    >>> print(verdict)
    recording 2ac691c3170e: can be used
      samples  all 3000 samples arrived
      ...
    """
    count = recording.samples.size
    if recording.is_imported:  # nothing is known about a sensor or a clock
        unknown = dict.fromkeys(("signal_rad", "noise_rad", "step_rad", "hidden_share"), nan)
        return DataVerdict(
            recording=recording.sha256,
            findings=tuple(findings.check_run(recording)),
            missing_share=recording.missing / recording.N,
            **unknown,
        )
    valid_count = np.count_nonzero(recording.valid & np.isfinite(recording.u))
    seen = recording.dataset() if valid_count >= findings.TOO_FEW else None
    step = _step(recording)
    noise = max(_noise(seen), step / 12**0.5) if seen else float("nan")
    first = recording.description.channels[0]
    signal = _signal(seen, noise, lines=first.turns) if seen else float("nan")
    checks = [*findings.check_run(recording), findings.check_first(recording)]
    checks += filter(None, [findings.check_step(recording)])
    checks += findings.check_second(recording)
    if seen:
        checks += findings.check_signal(recording, signal, noise, step)
        checks += findings.check_timing(recording, seen, noise)
    return DataVerdict(
        recording=recording.sha256,
        findings=(*checks, *findings.check_turns(recording)),
        signal_rad=signal,
        noise_rad=noise,
        step_rad=step,
        hidden_share=recording.hidden / count if count else float("nan"),
        missing_share=recording.missing / recording.N if recording.N else float("nan"),
    )


def _step(r: Recording) -> float:
    """Return the converter's step in the unit of the first channel."""
    described = r.description
    counts = r.samples[described.channels[0].counts_field]
    per_count = described.conversions[0].step(float(counts.mean()) if counts.size else 0.0)
    if described.is_calibrated:
        per_count = (r.calibration or Calibration()).channels[0].rad_per_count
    return abs(per_count) * findings.converter_step(r)


def _signal(data: Dataset, noise: float, *, lines: bool) -> float:
    """Return `DataVerdict.signal_rad`: the deviation from `lines`, or from the mean."""
    if not lines:
        return float(np.sqrt(max(float(np.nanvar(data.y)) - noise**2, 0.0)))
    n = max(8, round(_STRETCH_S / data.Ts))
    moving = data[n:] if data.N * data.Ts > _START_S else data
    squares, count = 0.0, 0
    for part in moving.experiments():
        # Intervals overlap by half: a step at an edge is in the middle of the next interval.
        for a in range(0, max(part.N - n // 2, 1), n // 2):
            y, t = part.y[a : a + n], part.t[a : a + n]
            there = np.isfinite(y)
            if np.count_nonzero(there) < _MIN_LINE_SAMPLES:
                continue
            t, y = t[there] - t[there].mean(), y[there] - y[there].mean()
            squares += float(np.sum((y - (t @ y) / (t @ t) * t) ** 2))
            count += y.size
    return float(np.sqrt(max(squares / count - noise**2, 0.0))) if count else 0.0


def _noise(data: Dataset) -> float:
    """Return the standard deviation of the residuals of an ARX model; 0 for too few samples."""
    parts = [(d.u, d.y - np.nanmean(d.y)) for d in data.experiments() if d.valid.any()]
    model = whitening(parts, min(_NOISE_ORDER, max(1, data.N // 20)))
    e = np.concatenate([model.residuals(u, y) for u, y in parts])
    e = e[np.isfinite(e)]
    return float(np.sqrt(np.mean(e**2))) if e.size > 4 * _NOISE_ORDER else 0.0


def doubts(recording: Recording) -> Iterator[Finding]:
    """Yield the doubts about a recording: too few samples, or a reversed sensor or motor."""
    name, first = recording.name, recording.description.channels[0]
    yield from few_samples(int(np.isfinite(recording.u).sum()) // recording.manifest.every, name)
    angle = recording[first.name][np.isfinite(recording[first.name])]
    # No voltage is negative.
    turned = float(angle[-1] - angle[0]) if recording.description.arm and angle.size else 0.0
    if turned < -_MIN_TURN_RAD:
        text = f"{name}: {first.name} falls although the voltage is positive, so its potentiometer "
        text += "or the motor's wires are reversed; run `armrig calibrate`"
        yield warning("direction", text)


def warnings_of(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return the doubts about recordings for models, and about the calibrations, as sentences."""
    modelled = [r for r in recordings if r.manifest.kind not in NO_MODEL]
    data_doubts = [finding for r in modelled for finding in doubts(r)]
    return tuple(f"{f.text}." for f in (*data_doubts, *different_calibrations(recordings)))


def emulation(recordings: Sequence[Recording]) -> list[str]:
    """Return a list of one sentence on the emulated recordings; empty if there are none."""
    names = [r.name for r in recordings if r.manifest.emulated]
    where = f" in {join_names(names)}" if 0 < len(names) < len(recordings) else ""
    text = f"The rig was emulated{where}: these are not measurements of a real rig."
    return [text] if names else []


def early_ends(recordings: Sequence[Recording]) -> Iterator[Finding]:
    """Yield a finding for each recording of a fixed length that ended early, with the reason."""
    for r in recordings:
        if (why := findings.early_end(r)) and r.manifest.samples:
            text = f"{r.name} ended early, after {r.samples.size} of {r.manifest.samples} "
            yield warning("run", f"{text}samples: {why}")


def different_calibrations(recordings: Sequence[Recording]) -> Iterator[Finding]:
    """Yield one finding with the groups of recordings if their calibrations differ."""
    use: dict[tuple[object, ...] | None, list[str]] = {}
    for r in recordings:
        values = r.calibration.conversion if r.calibration else None
        use.setdefault(values, []).append(r.name)
    if len(use) > 1:
        groups = "; ".join(join_names(names) for names in use.values())
        text = f"The recordings were made with {len(use)} different calibrations ({groups}): their "
        text += "angles and voltages cannot be compared; use one for all, `--calibration FILE`"
        yield warning("calibrations", text)


def doubts_of_calibration(calibration: Calibration | None, manifest: Manifest) -> Iterator[Finding]:
    """Yield the doubts about the calibration that reads a recording, each a full sentence."""
    if calibration is None:
        text = "The recording has no calibration: the daemon computed its angles."
        yield warning("no calibration", text)
        return
    made, uid = calibration.made, str(manifest.device.get("uid", ""))
    if made is None:
        text = "The rig was not calibrated: its angles use configured values that were never "
        yield warning("not calibrated", f"{text}measured (see `armrig calibrate`).")
        return
    if uid != made.device_uid:
        text = f"The calibration is of another device: it was made on {made.device_uid or 'none'}, "
        text += f"the recording was made on {uid or 'a device without an id'}."
        yield warning("device", text)
    elif manifest.rig != made.rig:
        text = f"The calibration is of rig {made.rig}, and the recording is of rig {manifest.rig}."
        yield warning("rig", text)
    try:
        age = datetime.fromisoformat(manifest.started) - datetime.fromisoformat(made.date)
    except (ValueError, TypeError):  # not a date, or only one of the two has an offset
        yield warning("age", "The age of the calibration is not known.")
        return
    if age > timedelta(days=STALE_DAYS):  # negative if the rig was calibrated after the recording
        text = (
            f"The calibration was {plural(age.days, 'day')} old, more than {STALE_DAYS} days: "
            "calibrate "
        )
        yield warning("age", f"{text}the rig again.")


def doubts_of_estimation(
    r: Recording,
    way_out: str = "a model from it is poor; identify from a telegraph (`armrig collect blackbox`)",
) -> Iterator[Finding]:
    """Yield a finding if a recording excites too few frequencies for any model."""
    if r.manifest.kind in NO_MODEL:
        kind = f"{r.name} is a {r.manifest.kind}, which excites few frequencies"
        yield warning("experiment", f"{kind}: {way_out}")


def doubts_of_pair(
    first: Recording, other: Recording, *, one_plant: bool = True
) -> Iterator[Finding]:
    """Yield the doubts about validating the models of `first` with `other`.

    If `one_plant` is False, only one recording may be of the whole rig. Raises InputError if the
    recordings have no output in common, or describe a signal differently.
    """
    way_out = "a fit on it says little; validate on another telegraph (`armrig collect blackbox "
    yield from doubts_of_estimation(other, f"{way_out}--validation`)")
    pair = (first, other)
    a, b = (r.name for r in pair)
    if difference := _different_descriptions(first.description, other.description):
        raise InputError(
            f"{a} is of a rig '{first.description.title}', {b} of a rig "
            f"'{other.description.title}': {difference}; choose recordings of one description"
        )
    rigs = [(r.manifest.rig, r.manifest.device.get("uid")) for r in pair]
    body = first.description.channels[0].body or "first part"
    alone = [r.manifest.kind == "greybox" for r in pair]
    if rigs[0] != rigs[1]:
        rig_a, rig_b = (f"rig {rig}" + (f" (device {uid})" if uid else "") for rig, uid in rigs)
        text = f"{a} is of {rig_a}, {b} of {rig_b}: a model of one "
        yield warning("rig", f"{text}rig does not describe another rig")
    else:
        yield from different_calibrations(pair)
    if one_plant and alone[0] != alone[1]:
        rig_a, rig_b = (f"the {body} alone" if part else "the whole rig" for part in alone)
        yield warning("plant", f"{a} is of {rig_a}, {b} of {rig_b}: they are two plants")


def _different_descriptions(ours: Description, theirs: Description) -> str:
    """Return why signals of the same name are not the same quantity; "" for equal signals."""
    common = [name for name in ours.outputs if name in theirs.outputs]
    if not common:
        return "no output has the same name"
    keys = ["name", "unit", "per_volt", "turning", "rate"]
    if not (ours.is_calibrated or theirs.is_calibrated):  # a calibration converts the arm's
        keys += ["zero_counts", "per_count"]
    signals: list[tuple[str, object, object]] = [("input", ours.input, theirs.input)]
    signals += [(name, ours.outputs[name], theirs.outputs[name]) for name in common]
    for name, our, their in signals:
        for key in keys:
            values = getattr(our, key, None), getattr(their, key, None)
            if values[0] != values[1]:
                return f"their descriptions give {name} {key} = {values[0]!r} and {values[1]!r}"
    return ""


def all_doubts(recordings: Sequence[Recording], *, one_plant: bool = True) -> list[Finding]:
    """Return the doubts about each recording, about pairs of recordings, and about calibrations.

    A pair is the first recording that is no step or staircase, and a later such recording.
    """
    all_findings = [finding for r in recordings for finding in doubts(r)]
    excited = [r for r in recordings if r.manifest.kind not in NO_MODEL]
    for n, other in enumerate(excited[1:]):
        # Only the second recording validates the first; later ones may be of the chassis alone.
        all_findings += doubts_of_pair(excited[0], other, one_plant=one_plant and n == 0)
    # The calibrations of all recordings are compared at once, unless several rigs explain them.
    all_findings = [f for f in all_findings if f.about != "calibrations"]
    of_one_rig = all(f.about != "rig" for f in all_findings)
    return [*all_findings, *(different_calibrations(recordings) if of_one_rig else ())]
