"""Data of the chassis alone: exact, and through the emulator's plant with friction."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from armrig.data.dataset import Dataset
from armrig.physics.grey_box.physical_models import Model, Physics
from armrig.physics.systems import ArmParameters, chassis
from armrig_daemon.emulator import plant
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Make = Callable[..., Dataset]
Ts = 2e-3


def angle(u: Vector, p: ArmParameters, model: Model = chassis, output: str = "theta_1") -> Vector:
    """Return an output without friction but b_1."""
    return Physics(model=model, fixed=p, outputs=(output,)).simulate({}, u, Ts)


def rubbing(u: Vector, p: ArmParameters, coulomb_nm: float) -> Vector:
    """Return the angle of the emulator's chassis with Coulomb friction."""
    built = plant.build(p, arm_removed=True, coulomb_nm=coulomb_nm)
    x, y = plant.REST, np.empty(u.size)
    for k, volts in enumerate(u.tolist()):
        y[k] = x[0]
        x = plant.advance(built, x, volts, round(Ts * 1e9))
    return y
