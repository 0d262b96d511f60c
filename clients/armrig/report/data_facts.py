"""What a report says of its data: what they rest on, and what was done to them."""

from __future__ import annotations

from armrig_core.calibration import Driver

from armrig.data.dataset import Dataset
from armrig.numerics.quantities import NBSP, number, percent
from armrig.recordings.calibration.staleness import calibrated
from armrig.report.study import Study

_SCALE = "theta_1_rad_per_count"


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
