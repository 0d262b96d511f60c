"""Usability of recordings: each fault and doubt is reported, a sound recording has none."""

from __future__ import annotations

from dataclasses import replace
from math import tau
from pathlib import Path
from typing import Any

import armrig
import msgspec
import numpy as np
import pytest
from armrig.cli import main
from armrig.data.finding import FEW_SAMPLES, Finding
from armrig.numerics.quantities import NBSP, digits
from armrig.recordings.files.loading import load
from armrig.recordings.findings import (
    check_first,
    check_run,
    check_signal,
    check_step,
    check_timing,
    check_turns,
    step_options,
)
from armrig.recordings.jitter import fastest_rate, sampling_statistics
from armrig.recordings.recording import Recording
from armrig.recordings.usability import (
    DataVerdict,
    all_doubts,
    data_verdict,
    different_calibrations,
    doubts_of_estimation,
    doubts_of_pair,
    early_ends,
    warnings_of,
)
from armrig.validation.advice import examine_fit_of
from armrig_core.commands.commands import Rehearsal
from armrig_core.recording_file.manifest import Outcome
from armrig_core.rig.calibration import Calibration, Driver
from armrig_protocol.messages import Flag
from numpy.typing import NDArray

from tests.clients.made_recordings import (
    POT,
    gap,
    manifest,
    of_the_arm,
    recorded,
    sample,
    with_channel,
    written,
)
from tests.clients.odd_recording import odd_recording


def judged(directory: Path, u: NDArray[np.float64], **options: Any) -> DataVerdict:
    return data_verdict(load(written(directory, of_the_arm(u, **options))))


def by_hand(directory: Path, messages: list[Any], **about: Any) -> Recording:
    whole = manifest(samples=len(messages), **about)
    return load(written(directory, recorded(messages, manifest=whole)))


def swinging(n: int, **changes: Any) -> list[Any]:
    """Return samples of an angle that swings by a rad under an input that switches."""
    made = []
    for k in range(n):
        counts = round(32768 + np.sin(tau * k / 50) / POT.rad_per_count)
        volts = 1.0 + (k // 25) % 2
        fields = {"counts_0": counts, "value_0": POT.value(counts)}
        made.append(sample(k, u_cmd_v=volts, u_applied_v=volts, **fields)._replace(**changes))
    return made


def levels(verdict: DataVerdict) -> dict[str, str]:
    return {f.about: f.level for f in verdict.findings}


def test_a_sound_recording_has_no_findings(tmp_path: Path) -> None:
    found = judged(tmp_path, armrig.telegraph(3000, 0.05))

    assert found.usable
    assert found.warnings == ()
    assert {type(x) for x in found.facts().values()} <= {bool, str, tuple, float}
    assert "the data are good" in found.summary
    step = 64 * POT.rad_per_count
    assert found.step_rad == step
    # Noise of half a step, rounded to steps (a twelfth of the square); the residuals have more.
    assert np.hypot(0.5, 12**-0.5) * step < found.noise_rad < 2 * step
    assert found.hidden_share == pytest.approx(8 / 360 + 0.01, abs=0.005)
    assert found.missing_share == 0
    signal = next(finding for finding in found.findings if finding.about == "signal")
    assert f"({found.noise_rad / step:.2g} steps of the converter)" in signal.text


def test_the_signal_does_not_count_its_noise_nor_the_start(tmp_path: Path) -> None:
    found = judged(tmp_path, np.full(1000, 2.0))

    assert found.signal_rad == 0
    assert not found.usable
    assert "the input never changes" in found.summary


def test_the_inputs_of_the_handout_have_no_warnings(tmp_path: Path) -> None:
    for u in (armrig.white_noise(3000), armrig.step(500, at=100), armrig.staircase(3000)):
        assert judged(tmp_path, u).warnings == ()


def stepped(directory: Path, start: float, at: float, seconds: float) -> Recording:
    """Return the recording of a step of a chassis that rests at `start`, in rad."""
    u = np.where(np.arange(round(seconds / 0.01)) < round(at / 0.01), 0.5, 4.5)
    return load(written(directory, of_the_arm(u, experiment="step", start=start)))


Hidden = list[tuple[Recording, Finding]]


@pytest.fixture(scope="module")
def hidden(tmp_path_factory: pytest.TempPathFactory) -> Hidden:
    """Return the steps of a turn of starts whose rise the dead band hides."""
    directory = tmp_path_factory.mktemp("steps")
    every = (stepped(directory, float(start), 1.0, 2.0) for start in np.arange(0, tau, 0.1))
    return [(r, found) for r in every if (found := check_step(r)) is not None]


def test_a_step_hidden_by_the_dead_band_is_reported_with_the_time_to_step(
    hidden: Hidden, tmp_path: Path
) -> None:
    for first, found in hidden:
        verdict = data_verdict(first)
        assert levels(verdict)["step"] == "warning"
        assert found.text in verdict.summary
        _, at, _, seconds = step_options(found.numbers).split()
        rest = first.theta_1[first.valid][-1] + 0.6  # the motor brakes it within a few 0.1 s
        assert check_step(stepped(tmp_path, rest, float(at), float(seconds))) is None
    assert 2 <= len(hidden) <= 10


def test_missing_samples_are_reported_and_many_cause_a_warning(tmp_path: Path) -> None:
    """One in a hundred may be missing."""
    u = armrig.telegraph(1000, 0.05)

    few = judged(tmp_path, u, missing=slice(500, 505))
    many = judged(tmp_path, u, missing=slice(500, 515))

    assert levels(few)["samples"] == "good"
    assert levels(many)["samples"] == "warning"
    assert many.missing_share == pytest.approx(0.015)
    assert "15 of 1000 samples are missing" in many.summary


def test_jitter_beyond_the_noise_of_the_angle_causes_a_warning(tmp_path: Path) -> None:
    """At 10 rad/s, a millisecond is a hundredth of a rad."""
    rng = np.random.default_rng(1)

    def late(std_us: float) -> Recording:
        made = swinging(400)
        jitter = (std_us * rng.standard_normal(400)).astype(int)
        moved = [
            s._replace(t_device_us=s.t_device_us + int(j))
            for s, j in zip(made, jitter, strict=True)
        ]
        return by_hand(tmp_path, moved)

    assert levels(data_verdict(late(10)))["timing"] == "good"
    assert levels(data_verdict(late(2000)))["timing"] == "warning"


def test_alpha_at_a_rail_is_reported_as_clipped(tmp_path: Path) -> None:
    """The angle alpha has no dead band to pass through."""
    made = swinging(200)
    made[10:14] = [s._replace(flags=s.flags | int(Flag.ADC1_RAIL)) for s in made[10:14]]

    found = data_verdict(by_hand(tmp_path, made))

    assert "alpha was at the end of its track in 4 of 200 samples" in found.summary
    assert found.usable


def test_an_angle_without_a_valid_sample_is_unusable(tmp_path: Path) -> None:
    """A wire is loose, or the chassis is in the dead band."""
    found = data_verdict(by_hand(tmp_path, swinging(100, flags=int(Flag.ADC0_RAIL))))

    assert not found.usable
    assert "no sample of 100 shows theta_1" in repr(found)
    assert np.isnan(found.signal_rad)
    assert b'"usable":false' in msgspec.json.encode(found.facts())


def test_fewer_than_20_samples_are_unusable(tmp_path: Path) -> None:
    found = data_verdict(by_hand(tmp_path, swinging(19)))

    assert not found.usable
    assert f"19 samples are too few; record {FEW_SAMPLES} or more" in found.summary


@pytest.mark.parametrize("N", [FEW_SAMPLES - 1, FEW_SAMPLES])
def test_all_verdicts_on_the_number_of_samples_have_one_limit(
    N: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    u = armrig.telegraph(N, 0.2)
    recording = load(written(tmp_path, of_the_arm(u, missing=slice(50, 60))))
    data, table = recording.dataset(), tmp_path / "data.csv"
    rows = (f"{t:.2f},{u},{y}" for t, u, y in zip(data.t, data.u, data.y, strict=True))
    table.write_text("\n".join(["t,u,y", *rows]))

    verdicts = [
        data_verdict(recording).findings,
        all_doubts([recording]),
        armrig.advice(data).findings,
        tuple(examine_fit_of(data, armrig.arx(data, na=1, nb=1))),
    ]
    codes = [main([command, str(table)]) for command in ("check", "hints")]

    short = N < FEW_SAMPLES
    warned = [[f.level for f in found if "samples" in f.numbers] for found in verdicts]
    assert warned == [["warning"] * short] * len(verdicts)
    assert codes == [0, 0]
    assert capsys.readouterr().err.count(f"{N} samples: models from so few") == 2 * short
    assert len(warnings_of([recording])) == short


def test_unusable_findings_precede_warnings(tmp_path: Path) -> None:
    found = data_verdict(by_hand(tmp_path, swinging(100)))
    levels = ("warning", "good", "unusable", "warning", "unusable")
    every = tuple(
        Finding(level=level, about=f"no {n}", text=f"text {n}") for n, level in enumerate(levels)
    )

    mixed = replace(found, findings=every)
    doubtful = replace(found, findings=tuple(f for f in every if f.level != "unusable"))

    assert mixed.warnings == ("text 2", "text 4", "text 0", "text 3")
    assert (mixed.usable, doubtful.usable) == (False, True)
    assert mixed.summary == "the data cannot be used: text 2"
    assert doubtful.summary == "the data can be used, with care: text 0; text 3"
    assert repr(mixed).splitlines()[1:] == [
        *("? no 0  text 0", "  no 1  text 1", "! no 2  text 2", "? no 3  text 3"),
        "! no 4  text 4",
    ]


@pytest.mark.parametrize(
    ("moves", "told_on", "level", "said"),
    [
        (True, True, "unusable", "remove the rotating part"),
        (True, False, "warning", "remove the rotating part"),
        (False, True, "warning", "removed = true"),
        (False, False, "good", "is removed"),
    ],
)
def test_a_greybox_recording_must_be_without_the_arm(
    moves: bool, told_on: bool, level: str, said: str, tmp_path: Path
) -> None:
    made = [s._replace(counts_1=32768 + 64 * (k % 9) * moves) for k, s in enumerate(swinging(200))]
    rehearsal = Rehearsal(revolutions=1.0, alpha_rad=0.2 * told_on, turned_rad=1.0)
    about = {"experiment": "greybox-monday", "rehearsal": rehearsal}

    found = data_verdict(by_hand(tmp_path, made, **about))

    (arm,) = (f for f in found.findings if f.about == "arm")
    assert arm.level == level
    assert said in arm.text


def test_a_gap_without_a_recorded_voltage_is_evaluated(tmp_path: Path) -> None:
    made = swinging(200)
    del made[100:103]
    messages = [gap(0, 5, 0.0), *made[5:]]
    whole = recorded(messages, manifest=manifest(k_first=0, samples=200))

    found = data_verdict(load(written(tmp_path, whole)))

    assert found.missing_share == pytest.approx(8 / 200)


def test_the_time_to_step_does_not_depend_on_the_sign_of_the_angle(hidden: Hidden) -> None:
    """A reversed potentiometer changes the sign of the angle, not the place of its dead band."""
    mirrored = [check_step(with_channel(r, "theta_1", -r.theta_1)) for r, _ in hidden]

    assert mirrored == [found for _, found in hidden]
    for r, found in hidden:
        ends = [100 + round(t / r.Ts) for t in (found.numbers["begins_s"], found.numbers["ends_s"])]
        assert r.valid[ends].all()
        assert not r.valid[ends[0] + 1 : ends[1]].any()
        assert [*found.numbers.values()][:2] == pytest.approx(r.t[ends] - 1.0)


def test_each_finding_reports_its_figures(tmp_path: Path) -> None:
    path = tmp_path / "odd.mcap"
    path.write_bytes(odd_recording())
    odd = load(path)
    data, rows = odd.dataset(), np.arange(odd.N)
    moved = sampling_statistics(odd).std_us * 1e-3 * fastest_rate(data)
    asleep = with_channel(odd, "theta_1", valid=odd.valid & ~((rows >= 310) & (rows < 336)))
    lost = (rows >= 310) & (rows < 336)
    unseen = with_channel(odd, "theta_1", valid=odd.valid & ~lost)
    silent = replace(unseen, present=odd.present & ~lost)
    poor = with_channel(odd, "theta_1", valid=odd.valid & (rows % 4 > 0))
    three, four = (replace(odd, turns_unknown=tuple(range(21, 21 + 20 * n, 20))) for n in (3, 4))
    damaged = replace(odd, truncated=True, damage="a bit has flipped")

    [jitter] = check_timing(odd, data, noise=1e-6)
    said = {
        "asleep": [check_first(asleep)],
        "silent": [check_first(silent)],
        "poor": [check_first(poor)],
        "three": check_turns(three),
        "four": check_turns(four),
        "damaged": check_run(damaged),
        "stopped": check_run(odd),
        "unknown": check_run(replace(odd, outcome=None)),
        "cut": check_run(replace(damaged, cut_off=True)),
        "wide": check_signal(replace(odd, u=np.linspace(0.5, 4.5, odd.N)), 0.0299, 0.01, 0.004),
        "quiet": check_signal(odd, 0.0299, 0.01, 0.004),
        "loud": check_signal(odd, 0.03, 0.01, 0.004),
        "nothing": check_signal(odd, 0.0029, 0.01, 0.004),
    }
    texts = {name: next(iter(found)) for name, found in said.items()}

    assert f"varies by 51.5{NBSP}µs and moves theta_1 by {moved:.3g}{NBSP}mrad" in jitter.text
    assert texts["quiet"].text.endswith("; use levels with a larger difference")
    assert texts["wide"].text.endswith(
        f"; record longer, such as {digits(4 * odd.N * odd.Ts, 2)} s"
    )
    assert texts["asleep"].text.startswith("theta_1 is hidden for 1.3 s without a break")
    assert texts["silent"].text.startswith("theta_1 is hidden in ")  # missing, and not hidden
    share = 100 * poor.hidden / 497
    assert f"hidden in {share:.1f}{NBSP}% of the samples" in texts["poor"].text
    assert "too many for a dead band" in texts["poor"].text
    assert "unknown from 1.05, 2.05, 3.05 s on" in texts["three"].text
    assert "unknown from 1.05, 2.05, 3.05, … s on" in texts["four"].text
    assert texts["damaged"].text == "the file is damaged: a bit has flipped"
    assert texts["stopped"].text == "the run ended early: stopped by bob"
    assert texts["unknown"].text == "the run ended early: the reason is not recorded"
    assert texts["cut"].text == "the file is cut off: it contains 25.9 of 30 s"
    levels = [texts[name].level for name in ("nothing", "quiet", "loud")]
    assert levels == ["unusable", "warning", "good"]
    assert texts["quiet"].text.startswith("signal to noise 3 to 1: theta_1 deviates from a steady")
    assert f"29.9{NBSP}mrad rms" in texts["quiet"].text
    assert f"is 10{NBSP}mrad (2.5 steps of the converter); use levels" in texts["quiet"].text


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return armrig.load(
        written(tmp_path_factory.mktemp("sound"), of_the_arm(armrig.telegraph(600, 0.05)))
    )


def changed(recording: Recording, **fields: Any) -> Recording:
    return replace(recording, manifest=msgspec.structs.replace(recording.manifest, **fields))


def test_sound_recordings_of_one_rig_have_no_findings(sound: Recording) -> None:
    """The handout requires a recording of the chassis alone, too."""
    step, chassis = (changed(sound, experiment=name) for name in ("step", "greybox-chassis"))

    assert all_doubts([step, sound, sound]) == all_doubts([sound, sound, chassis]) == []


def test_each_finding_names_its_reason_and_its_file(sound: Recording) -> None:
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
        [found] = all_doubts([sound, other])
        told_of_both = all_doubts([sound, other], one_plant=False)
        assert told_of_both == ([] if found.about == "plant" else [found])
        assert said in found.text
        assert sound.path.name in found.text


def test_recordings_of_several_calibrations_are_grouped(sound: Recording) -> None:
    def named(name: str, gain: float) -> Recording:
        return replace(
            sound,
            name=name,
            calibration=Calibration(driver=Driver(gain=gain)),
        )

    of_three = [named("a", 1.0), named("b", 2.0), named("c", 1.0), named("d", 3.0)]

    assert [*different_calibrations([]), *different_calibrations(of_three[::2])] == []
    [two] = different_calibrations(of_three[:3])
    [three] = all_doubts(of_three)
    other_rigs = all_doubts([changed(r, rig=r.name) for r in of_three])
    assert "with 2 different calibrations (a and c; b): their angles" in two.text
    assert "with 3 different calibrations (a and c; b; d): their angles" in three.text
    assert [found.about for found in other_rigs] == ["rig"] * 3


@pytest.mark.parametrize(
    ("experiment", "is_poor"),
    [("step", True), ("staircase-monday", True), ("stepper", False), ("blackbox-step", False)],
)
def test_a_step_is_a_poor_input_for_estimation_and_validation(
    sound: Recording, experiment: str, is_poor: bool
) -> None:
    kind = experiment.partition("-")[0]
    step = changed(sound, experiment=experiment)

    estimated, validated = [*doubts_of_estimation(step)], [*doubts_of_pair(sound, step)]

    assert len(estimated) == len(validated) == is_poor
    for found in (*estimated, *validated):
        assert found.text.startswith(f"{step.path.name} is a {kind}, which excites few frequencies")
    assert [*doubts_of_pair(step, sound)] == []


def test_an_incomplete_run_is_reported_unless_its_length_is_unknown(sound: Recording) -> None:
    def ended(code: str, **fields: Any) -> Recording:
        outcome = Outcome(outcome=f"it was {code}", samples=9, missing=0, code=code)
        return changed(replace(sound, outcome=outcome), **fields)

    n = sound.samples.size
    stopped, unknown = ended("stopped", samples=700), replace(sound, outcome=None)
    remote = ended("stopped", samples=0)

    assert [*early_ends([sound, ended("complete"), ended("continued"), remote])] == []
    assert "run" not in [found.about for found in check_run(ended("continued"))]
    assert [found.text for found in early_ends([sound, stopped, unknown])] == [
        f"{sound.path.name} ended early, after {n} of 700 samples: it was stopped",
        f"{sound.path.name} ended early, after {n} of 600 samples: the reason is not recorded",
    ]


@pytest.mark.parametrize(("fall", "is_reversed"), [(0.0, False), (0.49, False), (0.51, True)])
def test_a_measured_angle_may_fall_by_half_a_radian_without_a_finding(
    sound: Recording, fall: float, is_reversed: bool
) -> None:
    """A chassis at rest shows no direction, and neither does a touch by hand."""
    theta_1 = np.linspace(1.0, 1.0 - fall, sound.N)
    ends = np.r_[np.nan, theta_1, np.nan][: sound.N + 1]

    assert bool(all_doubts([with_channel(sound, "theta_1", theta_1)])) is is_reversed
    assert bool(all_doubts([with_channel(sound, "theta_1", ends)])) is is_reversed


def test_a_reversed_sensor_and_too_few_samples_are_reported(
    sound: Recording, tmp_path: Path
) -> None:
    """The voltage is never negative, so the angle of a reversed sensor falls."""
    [reversed_] = all_doubts([with_channel(sound, "theta_1", -sound.theta_1)])
    short = armrig.load(written(tmp_path, of_the_arm(armrig.telegraph(50, 0.2))))
    [few] = [found for found in all_doubts([short]) if found.about == "samples"]

    assert "reversed" in reversed_.text
    assert "50 samples" in few.text
