"""A step that its client ends when the outputs have settled."""

from __future__ import annotations

import json
from pathlib import Path

import armrig
import pytest
from armrig.cli import main
from armrig_core.commands.codes import OutcomeCode
from armrig_core.rig.description import path_of

from tests.integration.processes import Bench, wait_for


def test_a_step_ends_when_the_output_has_settled(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    bench.configure(more=f'[rig]\nfile = "{path_of(Path("rc"))}"')
    bench.emulate()
    bench.serve()
    step = ["collect", "step", "--until", "settled", "--seconds", "600", "--Ts", "0.01"]

    assert main([*step, "--connect", bench.endpoint, "--json"]) == 0

    recording = armrig.load(json.loads(capsys.readouterr().out)["recording"])
    assert recording.outcome is not None
    assert recording.outcome.code == OutcomeCode.STOPPED
    assert 300 <= recording.N < 6000
    assert not any("ended early" in text for text in armrig.data_verdict(recording).warnings)
    wait_for(lambda: bench.volts() == 0)


def test_a_longer_wait_for_settling_needs_a_word(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["collect", "step", "--until", "settled", "--seconds", "4000"]) == 1

    assert "--seconds 4000: give --yes, too" in capsys.readouterr().err
