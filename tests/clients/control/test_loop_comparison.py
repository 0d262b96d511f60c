"""A recorded run in control next to its prediction by a model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig_core.commands.commands import ControlRequest
from armrig_core.control.control_law import ControlLaw
from armrig_core.errors import InputError
from armrig_core.rig.arm import ArmParameters
from armrig_core.rig.description import builtin
from armrig_daemon.config import Config
from armrig_daemon.service.virtual_service import LEASE, VirtualService

from tests.core.control.laws import arm_law

STEP = [2.0] * 150 + [4.0] * 150


def recorded(
    folder: Path, law: ControlLaw, reference: list[float], rig: str = "arm"
) -> armrig.Recording:
    described = None if rig == "arm" else builtin(rig)
    service = VirtualService(
        Config(),
        folder,
        seed=1,
        description=described,
    )
    request = ControlRequest(lease=LEASE, n=0, law=law, reference=reference, unmonitored=True)
    return armrig.load(service.record(request))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> armrig.Recording:
    return recorded(tmp_path_factory.mktemp("run"), arm_law(), STEP)


def test_the_emulated_arm_does_what_its_own_model_predicts(recording: armrig.Recording) -> None:
    found = armrig.control.compare_loop(recording, armrig.physics.arm(ArmParameters()))

    assert found.z.shape == (300,)
    error = (found.z - found.predicted[0])[10:-10]
    assert abs(np.nanmean(error)) < 0.02
    np.testing.assert_allclose(found.u[200:], found.predicted_u[0][200:], atol=0.1)
    [(measured, model)] = found.steps()
    assert (model.at, model.before, model.after) == (1.5, 2.0, 4.0)
    assert model.overshoot == pytest.approx(3.3, abs=1.0)
    assert measured.overshoot == pytest.approx(model.overshoot, abs=3.0)
    assert measured.settling == pytest.approx(model.settling, abs=0.05)
    assert found.limited_share == 0.0


def test_a_model_of_another_gain_does_not_predict_the_run(recording: armrig.Recording) -> None:
    """The law's integral action gives the same speed at the end, by another voltage."""
    other = armrig.physics.arm(ArmParameters(K_m=1.1 * ArmParameters().K_m))

    right = armrig.control.compare_loop(recording, armrig.physics.arm(ArmParameters()))
    wrong = armrig.control.compare_loop(recording, other)

    at_end = [abs(np.mean((found.u - found.predicted_u[0])[250:])) for found in (right, wrong)]
    assert at_end[0] < 0.02 < 0.1 < at_end[1]


def test_a_band_contains_the_draws_of_a_fit(recording: armrig.Recording) -> None:
    found = armrig.control.compare_loop(recording, armrig.physics.arm(ArmParameters()), draws=0)

    low, high = found.band()

    np.testing.assert_array_equal(low, high)
    assert found.doubts


def test_a_change_that_is_not_held_is_no_step(tmp_path: Path) -> None:
    dither = [2.0 + 0.1 * (-1) ** (k // 10) for k in range(150)]
    run = recorded(tmp_path, arm_law(), dither + [2.0] * 60 + [3.0] * 60)

    found = armrig.control.compare_loop(run, armrig.physics.arm(ArmParameters()))

    assert [(one.before, one.after) for one, _ in found.steps()] == [(2.0, 3.0)]


@pytest.mark.parametrize(("gap", "error"), [(220, -1.4), (165, 0.0), (151, 0.0)])
def test_noise_next_to_missing_samples_does_not_prolong_the_settling(
    recording: armrig.Recording, gap: int, error: float
) -> None:
    """The mean over 15 samples is below 5 % of the step, and that over fewer is not."""
    found = armrig.control.compare_loop(recording, armrig.physics.arm(ArmParameters()), draws=0)
    z = found.predicted[0].copy()
    z[gap : gap + 20] = np.nan
    z[gap + 20] += error

    [(measured, model)] = replace(found, z=z).steps()

    assert measured.overshoot == pytest.approx(model.overshoot, abs=0.1)
    assert measured.settling == pytest.approx(model.settling, abs=0.02)


def test_a_step_without_a_measured_sample_has_no_figures(recording: armrig.Recording) -> None:
    found = armrig.control.compare_loop(recording, armrig.physics.arm(ArmParameters()), draws=0)

    [(measured, _)] = replace(found, z=np.full_like(found.z, np.nan)).steps()

    assert np.isnan(measured.overshoot)
    assert np.isinf(measured.settling)


def test_a_recording_without_a_law_is_refused() -> None:
    with pytest.raises(InputError, match="is no run in control: it has no law"):
        armrig.control.compare_loop(armrig.example_recording(), armrig.physics.arm(ArmParameters()))


def test_a_model_without_an_output_of_the_law_is_refused(recording: armrig.Recording) -> None:
    data = armrig.example_recording().dataset("alpha")
    fit = armrig.oe(data, nb=3, nf=3)

    with pytest.raises(InputError, match="the law uses theta_1, and the model has alpha"):
        armrig.control.compare_loop(recording, fit)


def test_the_comparison_is_a_figure_of_two_panels(recording: armrig.Recording) -> None:
    figure = armrig.control.compare_loop(recording, armrig.physics.arm(ArmParameters())).plot()

    z, u = figure.axes
    assert {text.get_text() for text in z.get_legend().get_texts()} >= {"measured", "predicted"}
    assert "[V]" in u.get_ylabel()


def test_the_command_needs_a_model_that_the_law_does_not_name(
    recording: armrig.Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["design", "compare", str(recording.path)]) == 1

    assert "the law does not name its model: give --model" in capsys.readouterr().err


def test_the_command_refuses_a_run_without_a_law(capsys: pytest.CaptureFixture[str]) -> None:
    path = armrig.example_recording().path

    assert main(["design", "compare", str(path), "--json"]) == 1

    assert "is no run in control" in capsys.readouterr().err


@pytest.mark.parametrize("k", [[0, 10**15], [5, 4], [7, 7]])
def test_decisions_that_are_not_of_the_run_are_refused(
    k: list[int], recording: armrig.Recording
) -> None:
    """They may come from a damaged file, and ask for any amount of memory."""
    assert recording.decisions is not None
    found = {name: values[:2] for name, values in recording.decisions().items()}
    other = replace(recording, decisions=lambda: {**found, "k": np.array(k, np.float64)})

    with pytest.raises(InputError, match="its decisions are not those of a run of 300 samples"):
        armrig.control.compare_loop(other, armrig.physics.arm(ArmParameters()))
