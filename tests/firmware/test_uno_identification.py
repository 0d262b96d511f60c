"""From the Uno's binary through loop, recorder and loading to a model: the true arm comes back."""

from __future__ import annotations

from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig_core.commands.commands import RunRequest
from armrig_daemon.config import Config
from armrig_daemon.service.virtual_service import VirtualService

from tests.clients.handout_plant import sampled_arm
from tests.firmware.uno_host import switch_on
from tests.sampling import sampled
from tests.tools import needs

pytestmark = needs("cc", "make", "simavr")
N, Ts = 3000, 0.01
OMEGA = np.geomspace(0.5, 60, 200)


@pytest.mark.exhaustive
@pytest.mark.parametrize("pacing", sampled(["scheduled", "exchange"]))
def test_the_estimated_frequency_response_equals_that_of_the_arm(
    pacing: str, tmp_path: Path
) -> None:
    """OE of 30 s at 100 Hz in lock-step: within 5 % rms over 0.5 to 60 rad/s."""
    assert error_of_oe(pacing, tmp_path) < 0.05


def error_of_oe(pacing: str, folder: Path) -> float:
    """Return the rms of G/G_0 - 1 of a model of a run on the binary, G_0 the emulated arm's."""
    service = VirtualService(Config(), folder, seed=1, switch_on=switch_on)
    u = armrig.telegraph(N, 0.05, low=0.0, high=5.0, seed=1)
    path = service.record(
        RunRequest(lease="0" * 32, n=0, u=u.tolist(), experiment="blackbox", pacing=pacing)
    )

    data = armrig.load(path).dataset(output="theta_1")
    fit = armrig.oe(data, nb=4, nf=4, nk=1, integrator=True)

    B, F = sampled_arm(Ts)
    x = np.exp(-1j * OMEGA * Ts)
    true = np.polyval(B[::-1], x) / np.polyval(F[::-1], x)
    return float(np.sqrt(np.mean(np.abs(fit.frequency_response(OMEGA).G / true - 1) ** 2)))
