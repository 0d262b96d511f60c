"""The numbers of a report: each under its own name, in its own unit, of its own recording."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from armrig.numerics.whiteness import Whiteness
from armrig.recordings.jitter import SamplingStatistics, Spread
from armrig.recordings.recording import Recording
from armrig.report.conclusions import abstract, conclusions
from armrig.report.document import content
from armrig.report.model_facts import estimations, model_table, residual_rows
from armrig.report.recording_facts import facts, shared_facts, timing_rows
from armrig.report.study import AssessedFit, Study
from armrig_core.rig.calibration import Calibration, Figure, Made

from tests.clients.models.made_fits import changed

TIMING = SamplingStatistics(
    Ts_us=10_000.0,
    mean_us=9_999.5,
    std_us=21.0,
    least_us=9_900.0,
    greatest_us=10_200.0,
    jitter=Spread(n=999, p50=1.0, p90=2.0, p99=3.0, p999=4.0, max=5.0),
    lateness=Spread(n=999, p50=11.0, p90=12.0, p99=13.0, p999=14.0, max=15.0),
    samples=1000,
    missing=7,
    longest_gap=6,
)


def with_tests(m: AssessedFit, **p_values: float) -> AssessedFit:
    """Return a model whose residual tests came out so."""
    return replace(m, tests=replace(m.tests, **p_values))


def calibrated(r: Recording, date: str, figures: dict[str, Figure]) -> Recording:
    """Return a recording that was read with a calibration."""
    made = Made(date=date, rig="1", device_uid="0001", armrig="0.1.0", figures=figures)
    return replace(r, calibration=Calibration(made=made))


def test_each_coefficient_has_its_two_deviations_in_their_columns(done: Study) -> None:
    fit, d = done.best.fit, done.best.fit.theta.size
    fit = replace(fit, covariance=np.eye(d) * 0.01**2, covariance_robust=np.eye(d) * 0.03**2)

    table = model_table(replace(done.best, fit=fit), done.reference)

    physics = dict(zip(done.reference.model.names, done.reference.model.theta, strict=True))
    assert table["header"] == ["OE", "estimate", "σ", "σ robust", "physics"]
    for row, name, value in zip(table["rows"], fit.names, fit.theta, strict=True):
        expected = [f"{value:.3f}", "0.010", "0.030", f"{physics[name]:.3f}"]
        assert row == [name, *(text.replace("-", "−") for text in expected)]


def test_the_loss_and_the_criteria_are_reported_by_their_names(done: Study) -> None:
    """FPE = loss (N + d)/(N - d), and AIC."""
    fit = changed(done.best.fit, loss=2.5e-5)

    said = estimations(replace(done, estimated=(replace(done.best, fit=fit),)))

    d = fit.fpe / fit.loss
    assert said.startswith(f"OE: loss 2.50·10⁻⁵ rad², FPE {2.5 * d:.2f}·10⁻⁵ rad², AIC −")
    assert f"AIC {fit.aic:.0f}".replace("-", "−") in said


def p_of(value: float) -> Whiteness:
    return Whiteness(p_value=value, test="portmanteau test")


def test_each_p_value_is_in_the_row_of_its_test(done: Study) -> None:
    arx, oe = done.estimated
    p = {"white": p_of(0.11), "ljung_box": 0.22, "missing_dynamics": 0.33, "feedback": 0.44}
    other = {"white": p_of(0.51), "ljung_box": 0.62, "missing_dynamics": 0.73, "feedback": 0.84}
    judged = replace(done, estimated=(with_tests(arx, **p), with_tests(oe, **other)))

    rows = [row[:-1] for row in residual_rows(judged)]

    assert rows == [
        ["white", "0.110", "0.510"],
        ["no correlation with past input", "0.330", "0.730"],
        ["no correlation with future input", "0.440", "0.840"],
    ]


def test_the_fits_are_of_angle_and_rate_in_their_columns(done: Study) -> None:
    best = done.best
    row = replace(best.comparison, fit_percent=99.5, rms_error=0.02, velocity_fit_percent=55.0)

    told = content(replace(done, estimated=(replace(best, comparison=row),)), [])["fits"]

    assert told[0] == ["OE", "99.50\xa0%", "20\xa0mrad", "55\xa0%"]


def test_the_facts_of_each_recording_are_in_its_column(done: Study) -> None:
    rows = {name: values for name, *values in facts(done)}

    assert rows["experiment"] == ["step", "blackbox", "blackbox"]
    assert rows["samples at Ts"] == ["200 at 10\xa0ms", "1500 at 10\xa0ms", "1200 at 10\xa0ms"]
    assert rows["length"] == ["2.0 s", "15.0 s", "12.0 s"]
    assert rows["input"] == [f"{r.u.min():.2f} to {r.u.max():.2f} V" for r in done.recordings]
    assert rows["missing samples"] == ["0", "0", "5"]


def test_the_facts_of_a_run_are_those_of_its_manifest(done: Study) -> None:
    step, *others = done.recordings
    manifest = msgspec.structs.replace(
        step.manifest,
        run_id="",
        pacing="scheduled",
        started="2026-02-03T04:05:06.789+01:00",
        details={"at": 50, "seed": 7},
    )
    damaged = replace(step, manifest=manifest, truncated=True, cut_off=False)
    unknown = replace(damaged, truncated=False, outcome=None)

    rows = {n: v for n, *v in facts(replace(done, recordings=(damaged, unknown, *others)))}

    assert rows["run"] == [step.short_hash] * 2 + [f"@{r.manifest.run_id}" for r in others]
    assert rows["SHA-256"] == [step.sha256[:12]] * 2 + [r.sha256[:12] for r in others]
    assert rows["paced by"] == ["the device"] * 2 + ["the host"] * 2
    assert rows["made with"][:2] == ["at = 50, seed = 7"] * 2
    assert rows["started"][0] == "2026-02-03 04:05:06"
    assert rows["outcome"][:2] == ["complete, but the file damaged", "not known"]
    assert rows["in the dead band, or just after"] == [str(r.hidden) for r in (step, step, *others)]


def test_the_timing_of_a_recording_is_reported_by_its_names() -> None:
    """Jitter is measured by the device's clock, lateness by the host's."""
    rows = dict(timing_rows([TIMING]))

    assert rows == {
        "requested sampling time": "10000\xa0µs",
        "mean interval": "9999.50 µs",
        "standard deviation of the interval": "21\xa0µs",
        "shortest … longest interval": "9900 … 10200\xa0µs",
        "jitter p50, p99, p99.9": "1, 3, 4\xa0µs",
        "largest jitter": "5\xa0µs",
        "lateness p50, p99, p99.9": "11, 13, 14\xa0µs",
        "largest lateness": "15\xa0µs",
        "missing samples, longest gap": "7, 6",
    }


def test_shared_facts_are_those_of_the_estimation_recording(done: Study) -> None:
    step, *others = done.recordings
    device = {**step.manifest.device, "uid": "9999"}
    other = replace(step, manifest=msgspec.structs.replace(step.manifest, device=device))

    said = shared_facts(replace(done, recordings=(other, *others)))

    assert "uid 0001" in said[0]


def test_the_worse_of_two_calibrations_is_reported(done: Study) -> None:
    step, first, second = done.recordings
    scale = "theta_1_rad_per_count"
    good = {scale: Figure(value=1e-4, std=1e-7), "driver_gain": Figure(value=1.0, std=1e-3)}
    poor = {scale: Figure(value=1e-4, std=5e-7)}

    for a, b in ((good, poor), (poor, good)):
        recordings = (
            step,
            calibrated(first, "2026-11-19T04:00:00+01:00", a),
            calibrated(second, "2026-11-20T04:00:00+01:00", b),
        )
        said = str(content(replace(done, recordings=recordings), [])["data"])
        assert "of 2026-11-19 04:00 and of 2026-11-20 04:00, accurate to 0.5\xa0%" in said
        assert "no meter was read" in said


def test_the_share_of_hidden_estimation_data_is_a_percentage(done: Study) -> None:
    share = 100 * done.estimation.missing / done.estimation.N
    assert f"{share:.1f}" != f"{100 * done.validation.missing / done.validation.N:.1f}"

    said = content(done, [])["data"]

    assert f" {share:.1f}\xa0% of the estimation data have no angle" in said


def test_the_abstract_counts_what_the_models_were_estimated_from(done: Study) -> None:
    best = replace(
        done.best,
        comparison=replace(done.best.comparison, rms_error=0.004),
        deviation=np.full_like(done.best.deviation, 0.025),
    )

    said = abstract(replace(done, estimated=(done.estimated[0], best)))

    assert said.startswith("An ARX and an OE model")
    assert "were estimated from 1500 samples at 10\xa0ms." in said
    assert "with an rms error of 4\xa0mrad" in said
    assert said.endswith("by a median of 2.5\xa0%.")


def test_the_error_of_each_model_is_reported(done: Study) -> None:
    arx, oe = (
        replace(m, comparison=replace(m.comparison, rms_error=error))
        for m, error in zip(done.estimated, (0.03, 0.002), strict=True)
    )
    far = replace(done.reference, comparison=replace(done.reference.comparison, rms_error=0.05))

    said = conclusions(replace(done, estimated=(arx, oe), reference=far))[0]

    assert said == (
        "In a simulation of the 12 s of validation data the rms error is 2\xa0mrad (OE), "
        "30\xa0mrad (ARX), 50\xa0mrad (the physical model)."
    )


def test_the_jitter_is_that_of_the_validation_recording(done: Study) -> None:
    timing = tuple(replace(TIMING, std_us=std) for std in (101.0, 202.0, 303.0))

    said = " ".join(conclusions(replace(done, timing=timing)))

    assert "has a standard deviation of 303\xa0µs" in said


@pytest.mark.parametrize(
    ("white", "free", "ending"),
    [
        (0.5, 0.5, "nothing speaks against its structure."),
        (0.005, 0.5, "look at its noise model, though one correct model in a hundred fails"),
        (0.5, 0.005, "look at its orders and its delay, though one correct model in a hundred"),
        (0.0005, 0.5, "look at its noise model."),
        (0.5, 0.0005, "look at its orders and its delay."),
    ],
)
def test_the_verdict_on_residuals_suggests_what_to_check(
    done: Study, white: float, free: float, ending: str
) -> None:
    judged = with_tests(done.best, white=p_of(white), missing_dynamics=free)

    said = conclusions(replace(done, estimated=(judged,)))[1]

    assert said.partition(": ")[2].startswith(ending)
