"""From the emulated rig through loop, recording and loading to a model: the true one comes back.

The loop and the device run in virtual time; everything else is what a user runs.
"""

from __future__ import annotations

from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig_core.commands.commands import RunRequest
from armrig_daemon.config import Config
from armrig_daemon.service.virtual_service import LEASE, VirtualService
from numpy.typing import NDArray

from tests.clients.handout_plant import sampled_arm

SEEDS = range(10)
N, Ts = 3000, 0.01
OMEGA = np.geomspace(0.5, 60, 200)


def _recorded(seed: int, folder: Path) -> armrig.Dataset:
    """Play a telegraph on the emulated rig; return its recording's data."""
    u = armrig.telegraph(N, 0.05, low=0.0, high=5.0, seed=seed)
    service = VirtualService(Config(), folder, seed=seed)
    path = service.record(RunRequest(lease=LEASE, n=0, u=u.tolist(), experiment="blackbox"))
    return armrig.load(path).dataset(output="theta_1")


def _true() -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Return b1 … b4, f1 … f4 of the exactly discretised plant, and its frequency response."""
    B, F = sampled_arm(Ts)
    x = np.exp(-1j * OMEGA * Ts)
    return np.r_[B[1:], F[1:]], np.polyval(B[::-1], x) / np.polyval(F[::-1], x)


@pytest.fixture(scope="module")
def fits(tmp_path_factory: pytest.TempPathFactory) -> list[armrig.Fit]:
    """Return the OE model of the whole plant from each seed's recording."""
    folder = tmp_path_factory.mktemp("through")
    data = [_recorded(seed, folder) for seed in SEEDS]
    return [armrig.oe(d, nb=4, nf=4, nk=1, integrator=True) for d in data]


@pytest.mark.exhaustive
def test_the_estimated_frequency_response_equals_that_of_the_plant(fits: list[armrig.Fit]) -> None:
    """Within 5 % rms over 0.5 to 60 rad/s, in every seed."""
    _, G = _true()

    errors = [np.sqrt(np.mean(np.abs(f.frequency_response(OMEGA).G / G - 1) ** 2)) for f in fits]

    assert max(errors) < 0.05, np.round(errors, 4)


@pytest.mark.exhaustive
def test_every_coefficient_is_within_3_sigma(fits: list[armrig.Fit]) -> None:
    """In at least 9 of 10 seeds each."""
    true, _ = _true()
    names = ("b1", "b2", "b3", "b4", "f1", "f2", "f3", "f4")
    inside = np.zeros(len(names), dtype=int)
    for fit in fits:
        at = [fit.names.index(name) for name in names]
        inside += np.abs(fit.theta[at] - true) <= 3 * fit.std[at]

    assert (inside >= 9).all(), dict(zip(names, inside, strict=True))


@pytest.mark.exhaustive
def test_the_standard_deviations_are_not_too_large(fits: list[armrig.Fit]) -> None:
    """Over seeds the estimates scatter as reported."""
    true, _ = _true()
    at = [fits[0].names.index(name) for name in ("b1", "b2", "b3", "b4")]

    scatter = np.sqrt(np.mean([(f.theta[at] - true[:4]) ** 2 for f in fits], axis=0))
    reported = np.mean([f.std[at] for f in fits], axis=0)

    # Ten seeds: the ratio's own standard deviation is 1 / sqrt(20) = 0.22.
    assert np.all(scatter / reported > 1 - 3 * 0.22)
    assert np.all(scatter / reported < 1 + 3 * 0.22)
