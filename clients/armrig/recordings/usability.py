"""What a recording's data are good for, before anything is identified from them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from armrig.data.dataset import Dataset
from armrig.data.finding import Finding
from armrig.data.treatment.whitening import whitening
from armrig.recordings.findings import (
    TOO_FEW,
    check_angle,
    check_arm,
    check_input,
    check_run,
    check_samples,
    check_signal,
    check_step,
    check_timing,
    check_turns,
    converter_step,
)

if TYPE_CHECKING:
    from armrig.recordings.recording import Recording

_STRETCH_S = 1.0  # length of a stretch that one straight line is fitted to
_STARTED_S = 3.0  # a longer run is judged without its first second, in which the chassis starts
_FEWEST = 4  # samples that a line is fitted to
_ORDER = 10


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class DataVerdict:
    """What `data_verdict` found; its repr says it in words."""

    recording: str
    """Hash of the recording."""
    findings: tuple[Finding, ...]
    """What each check found."""
    signal_rad: float
    """Effective value of theta_1 about a straight line over each second, in rad."""
    noise_rad: float
    """Standard deviation of what the past and the input do not explain in theta_1, in rad."""
    step_rad: float
    """One step of the converter, in rad."""
    hidden_share: float
    """Share of the samples that came and show no theta_1: dead band, and the sample after."""
    missing_share: float
    """Share of the samples that did not come."""

    @property
    def usable(self) -> bool:
        """Models can be identified from the data."""
        return all(f.level != "unusable" for f in self.findings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is not good, unusable first."""
        ranked = [f for level in ("unusable", "warning") for f in self.findings if f.level == level]
        return tuple(f.text for f in ranked)

    @property
    def summary(self) -> str:
        """The outcome in one line."""
        if not self.usable:
            return f"the data cannot be used: {self.warnings[0]}"
        if self.warnings:
            return f"the data can be used, with care: {'; '.join(self.warnings)}"
        return f"the data are good: signal to noise {self.signal_rad / self.noise_rad:.2g} to 1"

    def facts(self) -> dict[str, Any]:
        """Return all of it, for JSON."""
        return {"usable": self.usable, **asdict(self)}

    def __repr__(self) -> str:
        """Say it in a few lines."""
        outcome = "can be used" if self.usable else "cannot be used"
        if self.usable and self.warnings:
            outcome += ", with care"
        width = max(len(f.about) for f in self.findings)
        signs = {"good": " ", "warning": "?", "unusable": "!"}
        rows = [f"{signs[f.level]} {f.about:{width}}  {f.text}" for f in self.findings]
        return "\n".join([f"recording {self.recording[:12]}: {outcome}", *rows])


def data_verdict(recording: Recording) -> DataVerdict:
    """Judge the data of a recording: run, rails, signal against noise, samples, timing, turns.

    The signal is what theta_1 does beside turning steadily: its effective value about a straight
    line, over stretches of 1 s, with the noise's power taken off and without the first second, in
    which the chassis starts. The noise is what an ARX model of order 10 leaves of theta_1, which
    for white noise on the angle comes near to that noise, or, if that is more, a step of the
    converter over sqrt(12).

    Parameters
    ----------
    recording : Recording
        Any; a damaged one is judged by what is whole.

    Returns
    -------
    DataVerdict
        `usable`, `warnings`, and its figures; the repr says it in words.
    """
    came = recording.samples.size
    known = np.count_nonzero(recording.valid & np.isfinite(recording.u))
    seen = recording.dataset() if known >= TOO_FEW else None
    step = _step(recording)
    noise = max(_noise(seen), step / 12**0.5) if seen else float("nan")
    signal = _signal(seen, noise) if seen else float("nan")
    findings = [
        *check_run(recording),
        *check_samples(recording),
        *check_input(recording),
        *check_angle(recording),
        *check_step(recording),
        *check_arm(recording),
        *(check_signal(signal, noise, step) if seen else ()),
        *(check_timing(recording, seen, noise) if seen else ()),
        *check_turns(recording),
    ]
    return DataVerdict(
        recording=recording.sha256,
        findings=tuple(findings),
        signal_rad=signal,
        noise_rad=noise,
        step_rad=step,
        hidden_share=recording.hidden / came if came else float("nan"),
        missing_share=recording.missing / recording.N if recording.N else float("nan"),
    )


def _step(r: Recording) -> float:
    """Return one step of the converter in rad of theta_1; by the default calibration if unknown."""
    from armrig_core.calibration import Potentiometer

    pot = r.calibration.theta_1 if r.calibration else Potentiometer()
    return abs(pot.rad_per_count) * converter_step(r)


def _signal(data: Dataset, noise: float) -> float:
    """Return the effective value about a line over each second, less the noise's power."""
    n = max(8, round(_STRETCH_S / data.Ts))
    moving = data[n:] if data.N * data.Ts > _STARTED_S else data
    squares, known = 0.0, 0
    for part in moving.experiments():
        # Stretches overlap by half: a step at the edge of one lies in the middle of another.
        for a in range(0, max(part.N - n // 2, 1), n // 2):
            y, t = part.y[a : a + n], part.t[a : a + n]
            there = np.isfinite(y)
            if np.count_nonzero(there) < _FEWEST:
                continue
            t, y = t[there] - t[there].mean(), y[there] - y[there].mean()
            squares += float(np.sum((y - (t @ y) / (t @ t) * t) ** 2))
            known += y.size
    return float(np.sqrt(max(squares / known - noise**2, 0.0))) if known else 0.0


def _noise(data: Dataset) -> float:
    """Return the standard deviation of the residuals of an ARX model; 0 for too few samples."""
    parts = [(d.u, d.y - np.nanmean(d.y)) for d in data.experiments() if d.valid.any()]
    model = whitening(parts, min(_ORDER, max(1, data.N // 20)))
    e = np.concatenate([model.residuals(u, y) for u, y in parts])
    e = e[np.isfinite(e)]
    return float(np.sqrt(np.mean(e**2))) if e.size > 4 * _ORDER else 0.0
