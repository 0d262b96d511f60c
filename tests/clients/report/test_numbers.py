"""The numbers of a report: each under its own name, in its own unit, of its own recording."""

from __future__ import annotations

from dataclasses import replace

import msgspec
from armrig.numerics.quantities import microseconds
from armrig.recordings.jitter import sampling_statistics
from armrig.recordings.recording import Recording
from armrig.report.model_facts import conclusions
from armrig.report.recording_facts import facts, setup_sentences
from armrig.report.study import Study
from armrig_core.rig.calibration import Calibration, Made, MeasuredValue

from tests.clients.report.conftest import section_of


def calibrated(r: Recording, date: str, figures: dict[str, MeasuredValue]) -> Recording:
    """Return a recording that was read with a calibration."""
    made = Made(date=date, rig="1", device_uid="0001", armrig="0.1.0", figures=figures)
    return replace(r, calibration=Calibration(made=made))


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
    assert rows["paced by"] == ["the device"] * 2 + ["the host"] * 2
    assert rows["made with"][:2] == ["at = 50, seed = 7"] * 2
    assert rows["started"][0] == "2026-02-03 04:05:06"
    assert rows["outcome"][:2] == [
        "of the run: complete; but the file is damaged",
        "not known: the file does not contain it",
    ]
    assert rows["in the dead band, or just after"] == [str(r.hidden) for r in (step, step, *others)]


def test_shared_facts_are_those_of_the_estimation_recording(done: Study) -> None:
    step, *others = done.recordings
    device = {**step.manifest.device, "uid": "9999"}
    other = replace(step, manifest=msgspec.structs.replace(step.manifest, device=device))

    said = setup_sentences(replace(done, recordings=(other, *others)))

    assert "uid 0001" in said[0]


def test_the_worse_of_two_calibrations_is_reported(done: Study) -> None:
    step, first, second = done.recordings
    scale = "theta_1_rad_per_count"
    good = {
        scale: MeasuredValue(value=1e-4, std=1e-7),
        "driver_gain": MeasuredValue(value=1.0, std=1e-3),
    }
    poor = {scale: MeasuredValue(value=1e-4, std=5e-7)}

    for a, b in ((good, poor), (poor, good)):
        recordings = (
            step,
            calibrated(first, "2026-11-19T04:00:00+01:00", a),
            calibrated(second, "2026-11-20T04:00:00+01:00", b),
        )
        said = section_of(replace(done, recordings=recordings), "Data").paragraphs[0]
        assert "of 2026-11-19 04:00 and of 2026-11-20 04:00, accurate to 0.5\xa0%" in said
        assert "no meter was read" in said


def test_the_share_of_hidden_estimation_data_is_a_percentage(done: Study) -> None:
    share = 100 * done.estimation.missing / done.estimation.N
    assert f"{share:.1f}" != f"{100 * done.validation.missing / done.validation.N:.1f}"

    said = section_of(done, "Data").paragraphs[0]

    assert f" {share:.1f}\xa0% of the estimation data have no θ₁" in said


def test_the_jitter_is_that_of_the_validation_recording(done: Study) -> None:
    *others, validation = (microseconds(sampling_statistics(r).std_us) for r in done.recordings)
    assert validation not in others

    said = " ".join(conclusions(done))

    assert f"has a standard deviation of {validation}. " in said
