"""Doubts about recordings for their intended use."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import armrig
import msgspec
import numpy as np
import pytest
from armrig.recordings.recording import Recording
from armrig.recordings.usability import (
    all_doubts,
    different_calibrations,
    doubts_of_estimation,
    doubts_of_pair,
    early_ends,
)
from armrig_core.calibration import Calibration, Driver
from armrig_core.manifest import Outcome

from tests.clients.made_recordings import of_the_arm, written


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return armrig.load(
        written(tmp_path_factory.mktemp("sound"), of_the_arm(armrig.telegraph(600, 0.05)))
    )


def changed(recording: Recording, **fields: Any) -> Recording:
    return replace(recording, manifest=msgspec.structs.replace(recording.manifest, **fields))


def test_sound_recordings_of_one_rig_have_nothing_against_them(sound: Recording) -> None:
    """The handout requires a recording of the chassis alone, too."""
    step, chassis = (changed(sound, experiment=name) for name in ("step", "greybox-chassis"))

    assert all_doubts([step, sound, sound]) == all_doubts([sound, sound, chassis]) == []


def test_each_doubt_names_its_reason_and_the_file(sound: Recording) -> None:
    other_rig = changed(sound, rig="2")
    other_device = changed(sound, device=sound.manifest.device | {"uid": "9999"})
    calibration = msgspec.structs.replace(sound.calibration or Calibration(), driver=Driver(gain=2))
    chassis = changed(sound, experiment="greybox-monday")

    for other, said in (
        (other_rig, "of rig 1 (device 0001)"),
        (other_device, "a model of one rig does not describe another rig"),
        (replace(sound, calibration=calibration), "different calibrations"),
        (chassis, "are two plants"),
    ):
        [text] = all_doubts([sound, other])
        told_of_both = all_doubts([sound, other], one_plant=False)
        assert told_of_both == ([] if "two plants" in text else [text])
        assert said in text
        assert sound.path.name in text


def test_recordings_of_several_calibrations_are_grouped(sound: Recording) -> None:
    def named(name: str, gain: float) -> Recording:
        return replace(
            sound,
            path=sound.path.with_name(name),
            calibration=Calibration(driver=Driver(gain=gain)),
        )

    of_three = [named("a", 1.0), named("b", 2.0), named("c", 1.0), named("d", 3.0)]

    assert different_calibrations([]) == different_calibrations(of_three[::2]) == []
    [two] = different_calibrations(of_three[:3])
    [three] = different_calibrations(of_three)
    assert "with 2 different calibrations (a and c; b): their angles" in two
    assert "with 3 different calibrations (a and c; b; d): their angles" in three


@pytest.mark.parametrize(
    ("experiment", "is_poor"),
    [("step", True), ("staircase-monday", True), ("stepper", False), ("blackbox-step", False)],
)
def test_a_step_is_poor_for_estimation_and_says_little_in_validation(
    sound: Recording, experiment: str, is_poor: bool
) -> None:
    kind = experiment.partition("-")[0]
    step = changed(sound, experiment=experiment)

    estimated, validated = doubts_of_estimation(step), doubts_of_pair(sound, step)

    assert len(estimated) == len(validated) == is_poor
    for text in (*estimated, *validated):
        assert text.startswith(f"{step.path.name} is a {kind}, which excites few frequencies")
    assert doubts_of_pair(step, sound) == []


def test_a_run_ends_early_before_the_end_of_an_input_that_it_had(sound: Recording) -> None:
    def ended(code: str, **fields: Any) -> Recording:
        outcome = Outcome(outcome=f"it was {code}", samples=9, missing=0, code=code)
        return changed(replace(sound, outcome=outcome), **fields)

    n = sound.samples.size
    stopped, unknown = ended("stopped", samples=700), replace(sound, outcome=None)
    remote = ended("stopped", samples=0)

    assert early_ends([sound, ended("complete"), ended("continued"), remote]) == []
    assert early_ends([sound, stopped, unknown]) == [
        f"{sound.path.name} ended early, after {n} of 700 samples: it was stopped.",
        f"{sound.path.name} ended early, after {n} of 600 samples: the reason is not recorded.",
    ]


@pytest.mark.parametrize(("fall", "is_reversed"), [(0.0, False), (0.49, False), (0.51, True)])
def test_an_angle_may_fall_by_half_a_radian(
    sound: Recording, fall: float, is_reversed: bool
) -> None:
    """A chassis at rest shows no direction, and neither does a touch by hand."""
    theta_1 = np.linspace(1.0, 1.0 - fall, sound.N)
    ends = np.r_[np.nan, theta_1, np.nan][: sound.N + 1]

    assert bool(all_doubts([replace(sound, theta_1=theta_1)])) is is_reversed
    assert bool(all_doubts([replace(sound, theta_1=ends)])) is is_reversed


def test_a_reversed_sensor_and_too_few_samples_are_reported(
    sound: Recording, tmp_path: Path
) -> None:
    """The voltage is never negative, so the angle of a reversed sensor falls."""
    [reversed_] = all_doubts([replace(sound, theta_1=-sound.theta_1)])
    short = armrig.load(written(tmp_path, of_the_arm(armrig.telegraph(50, 0.2))))
    [few] = [t for t in all_doubts([short]) if "record 300" in t]

    assert "reversed" in reversed_
    assert "50 samples" in few
