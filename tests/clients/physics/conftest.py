"""Data of the chassis alone, made as a test wants them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.excitation import telegraph
from armrig.physics.systems import ArmParameters

from tests.clients.chassis_data import Make, Ts, angle, rubbing


@pytest.fixture(scope="session")
def make() -> Make:
    """Return a maker of data: telegraph 0.5/4.5 V by default, white noise on the angle."""

    @cache
    def made(
        seed: int = 1,
        N: int = 5000,
        std: float = 2e-3,
        low: float = 0.5,
        high: float = 4.5,
        p: ArmParameters | None = None,
        coulomb_nm: float = 0.0,
        offset: float = 0.0,
        shift: float = 0.0,
    ) -> Dataset:
        rng = np.random.default_rng([seed, 5])
        u = telegraph(N, 0.02, low, high, seed=rng) - shift  # below 0 no rig is driven
        p = ArmParameters() if p is None else p
        y = rubbing(u - offset, p, coulomb_nm) if coulomb_nm else angle(u - offset, p)
        y = y + std * rng.standard_normal(N)
        return Dataset(u=u, y=y, Ts=Ts, output="theta_1", unit="rad")

    return made
