"""Runs in control: requested, rehearsed, recorded, verified and replayed to the last bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import armrig
import msgspec
import numpy as np
import pytest
from armrig.recordings.files import replay as replay_module
from armrig.recordings.files.control_run import control_run
from armrig.recordings.files.replay import replay
from armrig.recordings.files.verification import check_control, verify
from armrig_core.commands.commands import ControlRequest
from armrig_core.control.control_law import ControlLaw
from armrig_core.errors import FileError, InputError, OperationError
from armrig_core.recording_file.manifest import CONTROLLER, REFERENCE
from armrig_core.rig.description import builtin
from armrig_core.telemetry.telemetry import Sample
from armrig_daemon.config import Config, Limits
from armrig_daemon.decisions.state import Publish
from armrig_daemon.pipe import RunEnded
from armrig_daemon.service.plan import RunPlan, plan_of
from armrig_daemon.service.virtual_service import LEASE, VirtualService, requests_of

from tests.clients.recordings.test_exchanged_attachments import rewritten
from tests.core.control.laws import arm_law, arm_monitor

STEP = [2.0] * 150 + [4.0] * 150


MONITORED = arm_law(monitor=arm_monitor(prelude=50))


def request(law: ControlLaw, reference: list[float] = STEP, **changes: object) -> ControlRequest:
    return ControlRequest(lease=LEASE, n=0, law=law, reference=reference, **changes)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a recording of the arm's speed under a law of order 5."""
    service = VirtualService(Config(), tmp_path_factory.mktemp("run"), seed=1)
    return service.record(request(MONITORED))


def test_the_speed_of_the_emulated_arm_follows_its_reference(path: Path) -> None:
    """The mean speed of the last second is 4 rad/s, to 0.05 rad/s."""
    theta_1 = armrig.load(path).theta_1

    assert (theta_1[-1] - theta_1[-101]) == pytest.approx(4.0, abs=0.05)


def test_the_loop_closes_without_a_jump_at_its_reference(path: Path) -> None:
    """During the prelude, the law has followed the samples and the applied voltage."""
    run = control_run(armrig.load(path))
    assert run is not None
    changes = np.abs(np.diff(run.u))

    assert changes[48] == 0.0
    assert 0.0 < changes[49] < changes[60:149].max() < 0.2


def test_a_recording_contains_law_reference_and_each_decision(path: Path) -> None:
    recording, run = armrig.load(path), control_run(armrig.load(path))

    assert run is not None
    assert run.law == MONITORED
    assert recording.manifest.controller_sha256 == run.law.sha256
    np.testing.assert_array_equal(run.r, STEP)
    np.testing.assert_array_equal(run.u, recording.samples["u_cmd_v"])
    assert not run.predicted.any()
    assert run.facts()["decisions"] == len(STEP)
    assert run.facts()["monitored"]


def test_a_run_without_a_monitor_says_so(tmp_path: Path) -> None:
    """A program reads the fact, and a person the words."""
    service = VirtualService(Config(), tmp_path, seed=1)
    unwatched = service.record(request(arm_law(), [2.0, 2.5], unmonitored=True))

    recordings = [armrig.load(unwatched), armrig.load(service.record(request(MONITORED)))]
    runs = [control_run(recording) for recording in recordings]

    assert [run.facts()["monitored"] for run in runs if run] == [False, True]
    text = ", velocity 2 to 2.5 rad/s, without a monitor; input at its limit in 0 % of samples"
    assert runs[0] is not None
    assert runs[0].summary == f"law {arm_law().sha256[:12]}{text}"
    assert runs[1] is not None
    assert "monitor" not in runs[1].summary


def test_a_control_run_is_replayed_to_the_last_bit(path: Path) -> None:
    result = replay(path)

    assert (result.difference, result.samples) == ("", len(STEP))


def test_a_sample_that_arrives_together_with_the_end_of_the_run_is_not_of_the_run(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The confirmation of a stop and the answer to the last EXCHANGE may be read at once."""
    step = replay_module.core_step.step
    last = Sample._make(armrig.load(path).samples[-1].tolist())

    def with_a_late_sample(*arguments: Any) -> Any:
        state, actions = step(*arguments)
        ends = any(isinstance(getattr(a, "record", None), RunEnded) for a in actions)
        return state, [*actions, Publish(last)] if ends else actions

    monkeypatch.setattr(replay_module.core_step, "step", with_a_late_sample)

    assert replay(path).difference == ""


def test_a_control_run_passes_verification(path: Path) -> None:
    result = verify(path)

    assert result.passed
    (text,) = (check.text for check in result.checks if check.about == "input")
    assert text == "by the law in 300 decisions, input at its limit in 0 % of samples"


@pytest.mark.parametrize("name", [CONTROLLER, REFERENCE])
def test_another_law_or_reference_is_found_by_its_hash(
    name: str, path: Path, tmp_path: Path
) -> None:
    def change(attachment: str, data: bytes) -> bytes:
        return data + b" " if attachment == name else data

    other = rewritten(path, tmp_path / "other.mcap", change)

    with pytest.raises(FileError, match=f"'{name}' is not that of this run"):
        armrig.load(other)


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"k": np.arange(300) + 1_000_000}, "reference has 300 values"),
        ({"r": np.zeros(300)}, "is not the attached one"),
        ({"u": np.zeros(300)}, "is not that of the law"),
        ({"reference_n": np.repeat([0, 7], [100, 200])}, "is not the attached one"),
    ],
)
def test_a_decision_that_differs_from_the_samples_fails_verification(
    changes: dict[str, np.ndarray], part: str, path: Path
) -> None:
    recording, run = armrig.load(path), control_run(armrig.load(path))
    assert run is not None
    fields = {name: getattr(run, name) for name in type(run).__slots__} | changes

    result = check_control(recording, type(run)(**fields), np.array(STEP))

    assert result.level == "unusable"
    assert part in result.text


def test_a_reference_that_a_command_has_set_passes_verification(path: Path) -> None:
    recording, run = armrig.load(path), control_run(armrig.load(path))
    assert run is not None
    changes = {
        "r": np.array(STEP[:200] + [3.0] * 100),
        "reference_n": np.repeat([0, 7], [200, 100]),
    }
    changed = type(run)(**{name: getattr(run, name) for name in type(run).__slots__} | changes)

    assert check_control(recording, changed, np.array(STEP)).level == "good"
    assert "2 to 4 rad/s, set by 1 command" in changed.summary


def test_the_same_law_has_the_same_hash_for_whole_and_decimal_numbers() -> None:
    assert arm_law(u0=0, hi=5).sha256 == arm_law(u0=0.0, hi=5.0).sha256


@pytest.mark.parametrize(
    ("law", "reference", "part"),
    [
        (arm_law(Ts=0.02), STEP, "the law has Ts = 0.02 s, and the run 0.01 s"),
        (arm_law(hi=4.9), STEP, "the law's limits are 0 to 4.9 V; the rig allows 0 to 4.5 V"),
        (arm_law(hi=4.0), [9.0], r"r[0] = 9 rad/s: the law allows 0 to 8"),
        (
            arm_law(gain=40.0, hi=4.0, monitor=arm_monitor()),
            STEP,
            "the closed loop of the law and the rig's model is unstable",
        ),
        (
            arm_law(hi=4.0, monitor=arm_monitor(B=(0.0,) * 5)),
            STEP,
            "alpha differs from the law's monitor (its simulation gate)",
        ),
        (
            arm_law(hi=4.0),
            STEP,
            "the law has no monitor, so a stuck sensor drives the rig to full input: design the "
            "law by `armrig design`, or give model= to armrig.control.control_law; "
            "unmonitored=True (--unmonitored) allows this law",
        ),
        (arm_law(hi=4.0, input="power"), STEP, "the rig's input is u"),
    ],
)
def test_a_law_that_does_not_fit_the_rig_is_refused_before_anything_moves(
    law: ControlLaw, reference: list[float], part: str, tmp_path: Path
) -> None:
    service = VirtualService(Config(limits=Limits(u_max_v=4.5)), tmp_path, seed=1)

    with pytest.raises((InputError, OperationError)) as err:
        service.record(request(law, reference))

    assert part in str(err.value)
    assert not [*tmp_path.glob("*.mcap")]


@pytest.mark.parametrize(
    ("fields", "part"),
    [
        ({"law": {}}, "missing required field"),
        ({"reference": []}, "length >= 1"),
        ({"reference": ["x"]}, "Expected `float`, got `str`"),
        ({"pacing": "scheduled"}, "Invalid enum value 'scheduled'"),
        ({"dead_man": None}, "Expected `float`, got `null`"),
        ({"dead_man": 0.1}, ">= 0.5"),
    ],
)
def test_a_malformed_command_is_refused(fields: dict[str, object], part: str) -> None:
    text = msgspec.to_builtins(request(arm_law())) | fields

    refusal = plan_of(
        lambda: msgspec.json.encode(text),
        0.01,
        Config(),
        builtin("arm"),
        command=ControlRequest.name,
    )

    assert not isinstance(refusal, RunPlan)
    assert refusal.error.startswith("control: ")
    assert part in refusal.error


def test_a_run_in_virtual_time_is_one_of_control_if_it_has_a_law() -> None:
    fields = msgspec.to_builtins(request(arm_law()))
    (made,) = requests_of(msgspec.json.encode({k: fields[k] for k in ("law", "reference")}))

    assert made == request(arm_law())
