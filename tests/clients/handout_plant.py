"""The handout's arm, whose truth is known, and readers of real data sets."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.excitation import telegraph
from armrig.numerics.polynomial import apply_filter
from armrig.physics.systems import transfer
from armrig_core.rig.arm import ArmParameters, arm_matrices
from numpy.typing import NDArray

Vector = NDArray[np.float64]
POTENTIOMETER_RANGE = np.deg2rad(352.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class HandoutPlant:
    """The handout's arm from u to theta_1, held and sampled every 10 ms."""

    B: Vector
    F: Vector
    Ts: float = 0.01

    @property
    def theta(self) -> Vector:
        """b1 … b4 f1 … f4."""
        return np.concatenate([self.B[1:], self.F[1:]])

    def angle(self, u: Vector) -> Vector:
        """Return theta_1 in rad for u in V, from rest at 0."""
        return apply_filter(self.B, self.F, u)

    def dataset(self, seed: int, N: int = 3000, std: float = 5e-3) -> Dataset:
        """Telegraph 0/5 V, p = 0.05, white noise on the angle."""
        rng = np.random.default_rng(seed)
        u = telegraph(N, 0.05, 0.0, 5.0, seed=rng)
        y = self.angle(u) + std * rng.standard_normal(N)
        return Dataset(u=u, y=y, Ts=self.Ts, output="theta_1", unit="rad")

    def through_potentiometer(self, data: Dataset, seed: int) -> Dataset:
        """Quantise to 10 bits of 352°, lose the 8° dead band and the sample after, and 2 %."""
        rng = np.random.default_rng([seed, 1])
        turn, angle = np.divmod(data.y + rng.uniform(0, 2 * np.pi), 2 * np.pi)
        dead = angle >= POTENTIOMETER_RANGE
        dead[1:] |= dead[:-1].copy()
        lsb = POTENTIOMETER_RANGE / 1024
        y = (np.floor(angle / lsb) + 0.5) * lsb + 2 * np.pi * turn
        valid = ~dead & (rng.random(data.N) > 0.02)
        return Dataset(u=data.u, y=y, Ts=data.Ts, valid=valid, output=data.output, unit=data.unit)

    def relative_error(self, omega: Vector, G: NDArray[np.complex128]) -> float:
        """Return the relative rms error of a frequency response."""
        x = np.exp(-1j * omega * self.Ts)
        truth = np.polyval(self.B[::-1], x) / np.polyval(self.F[::-1], x)
        return float(np.sqrt(np.mean(np.abs(G / truth - 1) ** 2)))


def sampled_arm(Ts: float) -> tuple[Vector, Vector]:
    """Return B and F of the handout's arm from a held u to theta_1."""
    A, B, C = arm_matrices(ArmParameters())
    return transfer(A, B, C[0], Ts)


def converted(data: Dataset, seed: int) -> Dataset:
    """Return the angle as a 10-bit converter of 352° gives it; the dead band is missing."""
    resolution = POTENTIOMETER_RANGE / 1024
    noise = 0.5 * np.random.default_rng(seed).standard_normal(data.N)
    y = np.round(data.y / resolution + noise) * resolution
    return data.replaced(step=None, y=y, valid=np.mod(data.y, 2 * np.pi) < POTENTIOMETER_RANGE)


@pytest.fixture(scope="session")
def plant() -> HandoutPlant:
    """Return the exactly discretised handout plant."""
    B, F = sampled_arm(0.01)
    return HandoutPlant(B=B, F=F)


@pytest.fixture(scope="session")
def reference() -> Callable[[str], NDArray[np.float64]]:
    """Return a reader of the real data sets, which skips if these are missing."""

    def read(name: str) -> NDArray[np.float64]:
        beside = Path(__file__).resolve().parents[3] / "shared" / "reference"
        folder = Path(os.environ.get("ARMRIG_REFERENCE_DATA", beside))
        if not (folder / name).is_file():
            pytest.skip("no reference data: set ARMRIG_REFERENCE_DATA to their folder")
        return np.loadtxt(folder / name)

    return read
