"""Checks before a motor may turn: the rehearsal, and the state of the rig."""

from __future__ import annotations

import armrig
import numpy as np
import pytest
from armrig.rig.replies import RefusedError, RunEndedError
from armrig_core.commands.commands import RunAccepted
from armrig_core.commands.rehearsal import rehearse

from tests.integration.processes import Bench


def test_a_run_predicted_to_exceed_a_limit_is_refused(bench: Bench) -> None:
    bench.configure(more="adc_noise_v = 0.0\n[limits]\nrevolutions = 1.5")
    bench.emulate()
    bench.serve()
    u = armrig.telegraph(400, 0.1, low=1.0, high=4.0, seed=1)
    turns = rehearse(u, 0.02).revolutions
    answers: list[RunAccepted] = []

    with bench.rig() as rig:
        rig.arm("a test", Ts=0.02)  # not the configured one
        next(rig.stream("sample"))  # so that it is known where the chassis stands
        with pytest.raises(RefusedError) as refusal:
            rig.run(u)
        untouched = {volts for _, volts in bench.voltage_changes()}
        recording = armrig.load(rig.run(u[:80], accepted=answers.append))

    assert untouched == {0.0}
    assert f"turns theta_1 by up to {turns:.3g} turns" in str(refusal.value)
    assert "theta_1.turns = 1.5 is reached at u[" in str(refusal.value)
    (found,) = (answer.rehearsal for answer in answers)
    assert found is not None
    assert found.revolutions == rehearse(u[:80], 0.02).revolutions
    assert found.theta_1_rad == pytest.approx(recording.theta_1[0] + found.turned_rad, abs=0.02)
    assert recording.manifest.rehearsal == found
    turned = np.nanmax(np.abs(recording.theta_1 - recording.theta_1[0]))
    assert turned == pytest.approx(2 * np.pi * found.revolutions, abs=0.1)
    assert np.nanmax(np.abs(recording.alpha)) == pytest.approx(found.alpha_rad, abs=0.02)


def test_a_measured_output_above_its_limit_stops_a_run_at_0_v(bench: Bench) -> None:
    """One output, so that the rules of a reading that is not used reach the loop, too."""
    one = (
        '[rig]\nname = "one"\n[outputs.turned]\nunit = "mm"\nper_count = 0.001\n'
        "zero_counts = 32768\nhigh = 20.0\nsamples = 3\n"
    )
    file = bench.folder / "one.toml"
    file.write_text(f"{one}[model]\nA = [[-1.0]]\nB = [[15.0]]\nC = [[1.0]]\n")
    bench.configure(more='adc_noise_v = 0.0\n[rig]\nfile = "one.toml"')
    bench.emulate()
    file.write_text(one)  # without a model there is no rehearsal, which would refuse the run
    bench.serve()

    with bench.rig() as rig:
        rig.arm("a test", Ts=0.02)
        with pytest.raises(RunEndedError, match=r"turned = .* mm is above 20 mm"):
            rig.run([2.0] * 400)
        status = rig.status()

    (path,) = bench.recordings.glob("*.mcap")
    recording = armrig.load(path)
    outside = recording.channel("turned").y > 20.0
    assert status.fault == "output"
    assert status.reason.startswith("turned = ")
    assert status.reason.endswith(" mm is above 20 mm")
    assert recording.outcome is not None
    assert recording.outcome.outcome == status.reason
    assert 3 <= outside.sum() <= 6  # the samples between the STOP and its answer
    assert bench.voltage_changes()[-1][1] == 0.0
