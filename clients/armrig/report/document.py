"""A study as a typeset PDF; figures are matplotlib's, text and tables are typst's."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from importlib import resources
from importlib.metadata import version
from math import isnan
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import typst

from armrig.data.dataset import Dataset
from armrig.models.equation import letters
from armrig.models.fit import Fit
from armrig.models.markup import typst_form
from armrig.models.model import Model
from armrig.numerics.quantities import (
    NBSP,
    error,
    fixed,
    microseconds,
    milliseconds,
    number,
    p_value,
    percent,
    places,
    power,
)
from armrig.numerics.whiteness import WHITE_LEVEL
from armrig.recordings.calibration.staleness import calibrated
from armrig.recordings.jitter import SamplingStatistics, Spread
from armrig.recordings.recording import Recording
from armrig.recordings.timing_disturbances import Disturbances
from armrig.report.conclusions import abstract, conclusions, listed
from armrig.report.figures import DETAIL_S, write_figures
from armrig.report.study import STAIRCASE, STEP, Assessed, AssessedFit, Study, kind_of

_SCALE = "theta_1_rad_per_count"


class ReportError(RuntimeError):
    """The report cannot be typeset."""


def report(study: Study, output: str | Path, *, remarks: Sequence[str] = ()) -> Path:
    """Typeset a study as a PDF at `output`, and return the path.

    Parameters
    ----------
    remarks : sequence of str
        Sentences that a reader must know beside the recordings' own, such as what was emulated.

    Raises
    ------
    ReportError
        The compiler refuses, which is a fault of this module.
    OSError
        The PDF cannot be written.
    """
    output = Path(output)
    with tempfile.TemporaryDirectory(prefix="armrig-report-") as directory:
        root = Path(directory)
        write_figures(study, root)
        (root / "data.json").write_text(json.dumps(content(study, remarks)), encoding="utf-8")
        template = (
            resources.files("armrig.report").joinpath("report.typ").read_text(encoding="utf-8")
        )
        (root / "report.typ").write_text(template, encoding="utf-8")
        fonts = Path(mpl.get_data_path()) / "fonts" / "ttf"
        try:
            pdf = typst.compile(
                str(root / "report.typ"),
                root=str(root),
                font_paths=[str(fonts)],
                ignore_system_fonts=True,
            )
        except RuntimeError as err:
            msg = f"the report cannot be typeset: {err}"
            raise ReportError(msg) from err
    output.write_bytes(pdf)
    return output


def content(study: Study, remarks: Sequence[str]) -> dict[str, Any]:
    """Return what the template says, as text: see report.typ."""
    manifest = study.recording_of(study.estimation.source).manifest
    truncated = [
        f"{r.path.name} is not whole: {r.damage}." for r in study.recordings if r.truncated
    ]
    return {
        "title": "Black-box identification of the rig",
        "subtitle": f"rig {manifest.rig}, recorded {manifest.started[:16].replace('T', ' ')}",
        "version": version("armrig"),
        "date": datetime.now(tz=UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "summary": abstract(study),
        "recordings": [
            {"role": role(study, r), "file": r.path.name, "sha256": r.sha256}
            for r in study.recordings
        ],
        "facts": _facts(study),
        "remarks": [*remarks, *truncated],
        "chain": _shared_facts(study),
        "timing": [*_timing_rows(study.timing), *_causes_rows(study.causes)],
        "data": _data_text(study),
        "treatment": treatment(study),
        "step": _step_caption(study),
        "orders": _orders(study),
        "structure": _structure(study),
        "models": [_model(m, study.reference) for m in study.estimated],
        "estimation": " ".join(_estimation(m) for m in study.estimated),
        "fits": [
            [
                row.name,
                percent(row.fit_percent),
                error(row.rms_error, study.validation.unit),
                "–" if row.velocity_fit_percent is None else percent(row.velocity_fit_percent),
            ]
            for row in (m.comparison for m in study.models)
        ],
        "percent": _percent_warning(study),
        "physics": _physics(study),
        "tested": [m.name for m in study.estimated],
        "tests": _test_rows(study),
        "captions": _captions(study),
        "verdict": conclusions(study),
    }


def role(study: Study, recording: Recording) -> str:
    """Return what a recording was used for."""
    if kind_of(recording) in (STEP, STAIRCASE):
        return kind_of(recording)
    if recording.sha256 == study.estimation.source:
        return "estimation and validation" if study.halves else "estimation"
    return "validation" if recording.sha256 == study.validation.source else "not used"


def _facts(study: Study) -> list[list[str]]:
    rows: list[list[str]] = []
    recordings = study.recordings

    def row(name: str, value: Callable[[Recording], str]) -> None:
        values = [value(r) for r in recordings]
        if any(values):
            rows.append([name, *(v or "–" for v in values)])

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


def _outcome(recording: Recording) -> str:
    ended = recording.outcome.outcome if recording.outcome else ""
    if recording.truncated:
        what = "file cut off" if recording.cut_off else "file damaged"
        return f"{ended}, but the {what}" if ended else what
    return ended or "not known"


def _input_range(recording: Recording) -> str:
    u = recording.u[np.isfinite(recording.u)]
    return f"{u.min():.2f} to {u.max():.2f} V" if u.size else ""


def _shared_facts(study: Study) -> list[str]:
    manifest = study.recording_of(study.estimation.source).manifest
    said = []
    for what, facts in (("Device", manifest.device), ("Host", manifest.host)):
        text = ", ".join(f"{k} {v}" for k, v in facts.items() if v not in ("", None, [], {}))
        if text:
            said.append(f"{what}: {text}.")
    said.append(f"Recorded by armrig {manifest.armrig}, protocol {manifest.protocol}.")
    return said


def _timing_rows(timing: Sequence[SamplingStatistics]) -> list[list[str]]:
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


def _causes_rows(found: Sequence[Disturbances]) -> list[list[str]]:
    def row(name: str, value: Callable[[Disturbances], str]) -> list[str]:
        return [name, *(value(c) if c.seconds else "–" for c in found)]

    return [
        row("garbage collections of the loop", lambda c: str(c.collections)),
        row(
            "processor wanted by others, worst second",
            lambda c: "–" if isnan(c.cpu_pressure_percent) else f"{c.cpu_pressure_percent:.0f} %",
        ),
        row("most tasks runnable", lambda c: "–" if c.run_queue < 0 else str(c.run_queue)),
        row(
            "device's clock slow by",
            lambda c: (
                "–"
                if isnan(c.drift_ppm)
                else f"({fixed(c.drift_ppm, 1)} ± {c.drift_std_ppm:.1f}) · 10⁻⁶"
            ),
        ),
    ]


def _percentiles(spread: Spread) -> str:
    return f"{number(spread.p50)}, {number(spread.p99)}, {microseconds(spread.p999)}"


def _orders(study: Study) -> str:
    """Return the orders, together where the models share them."""
    values: dict[str, set[int]] = {}
    for m in study.estimated:
        for name, n in m.fit.orders.items():
            values.setdefault(name, set()).add(n)
    if any(len(found) > 1 for found in values.values()):
        return "; ".join(f"{m.name} {_assigned(m.fit.orders)}" for m in study.estimated)
    orders = {name: n for name, (n,) in values.items()}
    nk = orders.pop("nk")
    if len(set(orders.values())) == 1:
        return f"{' = '.join(orders)} = {next(iter(orders.values()))}, nk = {nk}"
    return _assigned(orders | {"nk": nk})


def _assigned(orders: Mapping[str, int]) -> str:
    return ", ".join(f"{name} = {n}" for name, n in orders.items())


def _model(m: AssessedFit, reference: Assessed) -> dict[str, Any]:
    """Return the table of a model's coefficients, the reference beside one of the same form."""
    same = letters(m.fit) == letters(reference.model)
    beside = reference.model if same else None
    caption = f"{m.name} model and its standard deviations."
    if same:
        caption = f"{m.name} model, its standard deviations, and the coefficients of the physical "
        caption += "model."
    return {
        "name": m.name,
        "equation": typst_form(m.fit),
        "header": [m.name, "estimate", "σ", "σ robust", *([reference.name] if same else [])],
        "rows": _coefficients(m.fit, beside),
        "caption": caption,
    }


def _coefficients(fit: Fit, beside: Model | None) -> list[list[str]]:
    rows = []
    theirs = dict(zip(beside.names, beside.theta, strict=True)) if beside else {}
    for name, value, std, robust in zip(fit.names, fit.theta, fit.std, fit.std_robust, strict=True):
        decimals = places(float(std))
        row = [name, fixed(float(value), decimals), fixed(float(std), decimals)]
        row.append(fixed(float(robust), decimals))
        if beside:
            row.append(fixed(float(theirs[name]), decimals) if name in theirs else "–")
        rows.append(row)
    return rows


def _structure(study: Study) -> str:
    """Return what was known beforehand of the models' structure."""
    integrating = sorted({m.fit.integrating.upper() for m in study.estimated if m.fit.integrator})
    if not integrating:
        return ""
    return (
        f"The angle integrates the voltage, so {listed(integrating)} "
        f"{'has' if len(integrating) == 1 else 'have'} the factor 1 − q⁻¹ by construction; initial "
        "state and input offset of each experiment are estimated with the model. Samples in the "
        "dead band of the potentiometer, and the one after, count as missing."
    )


def _estimation(model: AssessedFit) -> str:
    fit = model.fit
    trust = (
        "white: σ holds"
        if fit.whiteness >= WHITE_LEVEL
        else "coloured, and then σ is too small a claim: trust σ robust, which allows for it"
    )
    # The estimator says of coloured residuals what stands here already.
    warned = "".join(
        f" {w[:1].upper()}{w[1:].rstrip('.')}." for w in fit.warnings if "std" not in w
    )
    converged = "" if fit.converged else " The search did not converge."
    return (
        f"{model.name}: loss {power(fit.loss)} {fit.unit}², "
        f"FPE {power(fit.fpe)} {fit.unit}², AIC {number(fit.aic)}; "
        f"residuals on the estimation data are {trust}.{converged}{warned}"
    )


def _percent_warning(study: Study) -> str:
    if study.reference.comparison.velocity_fit_percent is None:
        return ""
    return (
        "The percentage of the angle flatters every model, because the ramp dominates its "
        "variation: read the rms error. The percentage of the velocity is that of differences, "
        "and the measured ones carry the converter's noise twice, so that even the true system "
        "would not reach 100 %."
    )


def _physics(study: Study) -> str:
    first, *others = (_deviation(m, study) for m in study.ranked)
    name, (median, most, at) = study.best.name, first
    text = (
        "The physical model is the handout's: two inertias, a spring and a DC motor, with its "
        "parameters as given, sampled exactly for a held input; nothing in it was fitted. From "
        f"{study.omega[0]:g} to {study.omega[-1]:.0f} rad/s the {name} model differs from it by "
        f"{median} (median) and at most {most}, at {at}"
    )
    for m, (median, most, at) in zip(study.ranked[1:], others, strict=True):
        text += f"; the {m.name} model by {median} and {most}, at {at}"
    return f"{text}."


def _deviation(m: AssessedFit, study: Study) -> tuple[str, str, str]:
    """Return median and greatest deviation from the physics, and where that is."""
    at = float(study.omega[np.argmax(m.deviation)])
    median, most = float(np.median(m.deviation)), float(np.max(m.deviation))
    return percent(100 * median), percent(100 * most), f"{number(at)} rad/s"


def _test_rows(study: Study) -> list[list[str]]:
    tests = [m.tests for m in study.estimated]
    return [
        ["white", *(p_value(t.whiteness) for t in tests), "noise model or orders"],
        [
            "no correlation with past input",
            *(p_value(t.missing_dynamics) for t in tests),
            "orders or delay",
        ],
        [
            "no correlation with future input",
            *(p_value(t.feedback) for t in tests),
            "feedback in the experiment, or delay too large",
        ],
    ]


def _data_text(study: Study) -> str:
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
    made = [c.made for c in calibrations.values() if c and c.made]
    if len(made) < len(calibrations):
        return (
            "The rad and the volt rest on configured values that nobody has measured: what is in "
            "these units, the gain of a model too, is as good as they are."
        )
    scales = [m.figures[_SCALE] for m in made if _SCALE in m.figures]
    known = max((s.std / abs(s.value) for s in scales if s.value), default=None)
    angle = f"The rad is that of the calibration of {' and of '.join(calibrations)}"
    if known is not None:
        angle += f", known to {percent(100 * known)} (one standard deviation)"
    volt = (
        "the volt that of a meter at the motor's terminals"
        if all("driver_gain" in m.figures for m in made)
        else "the volt that of the codes: no meter was read at the motor's terminals"
    )
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


def _step_caption(study: Study) -> str | None:
    steps = [r for r in study.recordings if kind_of(r) == STEP]
    if not steps:
        return None
    return f"Chassis angle after a step of the motor's voltage (recording {steps[0].short_hash})."


def _captions(study: Study) -> dict[str, str]:
    estimation, validation = study.estimation.source[:12], study.validation.source[:12]
    halves = ": first and second half of one recording" if study.halves else ""
    return {
        "data": f"Estimation data (left, recording {estimation}) and validation data (right, "
        f"recording {validation}){halves}: chassis angle with its turns counted, and the voltage "
        "that the device applied. Shaded: dead band, or a missing sample.",
        "fits": f"Simulation of the validation data (recording {validation}). "
        f"{study.note[0].upper()}{study.note[1:]}.",
        "compare": f"Angle measured and simulated on the validation data (recording {validation}), "
        "and the errors, on a scale that is linear in the middle and logarithmic beyond.",
        "velocity": f"Detail of {DETAIL_S:g} s: rate of the angle from differences (recording "
        f"{validation}). The models are simulated from the beginning of the data, as above.",
        "bode": "Frequency response from voltage to angle, with 95 % bands, linearised or, where "
        "that is poor, sampled from the covariance of the parameters; dots: spectral analysis of "
        f"the estimation data, 95 % bars. Recording {estimation}. Phase modulo 360°.",
        "step_poles": "Left: answer to a unit step with 95 % bands. Right: poles (×) and zeros "
        "(○) with 95 % regions (bars for real roots, ellipses, dotted where sampled); a square "
        "holds a pole and a zero that cannot be told apart (1 %). "
        f"Models from recording {estimation}.",
        "tests": f"Tests of the one-step residuals on the validation data (recording {validation}),"
        " with the uncertainty of the estimated models allowed for.",
        "residuals": "Correlation of the residuals with themselves (above) and with the input "
        f"(below) on recording {validation}. Grey: 99 % of the values if the hypothesis is true.",
    }
