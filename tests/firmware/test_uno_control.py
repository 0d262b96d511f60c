"""Runs in control on the Uno's binary, replayed to the last bit."""

from __future__ import annotations

from pathlib import Path

import armrig
import pytest
from armrig.recordings.files.replay import replay
from armrig_core.commands.commands import ControlRequest
from armrig_daemon.config import Config
from armrig_daemon.service.virtual_service import LEASE, VirtualService

from tests.core.control.laws import arm_law, arm_monitor
from tests.firmware.uno_host import switch_on
from tests.sampling import sampled
from tests.tools import needs

pytestmark = needs("cc", "make", "simavr")


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", sampled(range(20)))
def test_the_speed_of_the_arm_is_controlled_and_the_run_is_replayed(
    seed: int, tmp_path: Path
) -> None:
    service = VirtualService(Config(), tmp_path, seed=seed, switch_on=switch_on)
    reference = [2.0] * 100 + [3.0 + 0.1 * seed] * 150

    law = arm_law(monitor=arm_monitor(prelude=25))
    path = service.record(ControlRequest(lease=LEASE, n=0, law=law, reference=reference))

    theta_1 = armrig.load(path).theta_1
    assert theta_1[-1] - theta_1[-51] == pytest.approx(reference[-1] / 2, abs=0.05)
    result = replay(path)
    assert (result.difference, result.samples) == ("", 250)
