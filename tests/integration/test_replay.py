"""`armrig replay`: a real run through the very function that decided it."""

from __future__ import annotations

import armrig
import pytest
from armrig.recordings.files.replay import replay

from tests.integration.processes import Bench
from tests.sampling import sampled


@pytest.mark.parametrize("pacing", sampled(["scheduled", "exchange"]))
def test_replay_repeats_the_decisions_of_a_real_run(served: Bench, pacing: str) -> None:
    u = armrig.telegraph(400, 0.1, low=0.0, high=5.0, seed=1)
    with served.rig() as rig:
        rig.arm("a test", Ts=0.005)
        path = rig.run(u, pacing=pacing)

    found = replay(path)

    assert found.difference == ""
    assert found.samples == armrig.load(path).samples.size
    # A tick that a stall of this machine costs is asked for by no frame.
    assert found.frames > (10 if pacing == "scheduled" else found.samples)
    assert found.seconds > 1.9
