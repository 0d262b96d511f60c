"""Systems whose truth is known, shared by the tests of estimates without a structure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.excitation import telegraph
from armrig.numerics.polynomial import apply_filter
from numpy.typing import NDArray

from tests.clients.handout_plant import sampled_arm

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Arm:
    """The handout's arm from u to theta_1, held and sampled."""

    B: Vector
    F: Vector
    Ts: float

    def dataset(self, u: Vector, std: float = 0.0, seed: int = 1) -> Dataset:
        """Return the arm's response to u, with white noise on the angle."""
        y = apply_filter(self.B, self.F, u)
        y += std * np.random.default_rng([seed, 7]).standard_normal(u.size)
        return Dataset(
            u=u, y=y, Ts=self.Ts, output="theta_1", unit="rad", source="abcdef0123456789"
        )

    def telegraph(self, seed: int = 1, N: int = 3000, std: float = 5e-3) -> Dataset:
        """Return telegraph data, 0/5 V, p = 0.05."""
        return self.dataset(telegraph(N, 0.05, 0.0, 5.0, seed=seed), std, seed)

    def steps(self, std: float = 1e-3) -> Dataset:
        """Return ten holds of one second each."""
        n = round(1 / self.Ts)
        return self.dataset(np.tile(np.repeat([0.5, 4.5], n), 5), std)

    def rate(self, n: int) -> Vector:
        """Return the impulse response (n,) of (theta_1(t) - theta_1(t-1))/Ts."""
        return apply_filter(self.B, np.cumsum(self.F)[:-1], np.eye(1, n)[0]) / self.Ts

    def response(self, omega: Vector) -> NDArray[np.complex128]:
        """Return G at omega in rad/s."""
        x = np.exp(-1j * omega * self.Ts)
        return np.asarray(np.polyval(self.B[::-1], x) / np.polyval(self.F[::-1], x))


def arm_sampled(Ts: float) -> Arm:
    B, F = sampled_arm(Ts)
    return Arm(B=B, F=F, Ts=Ts)


@pytest.fixture(scope="session")
def arm() -> Arm:
    return arm_sampled(0.01)


@pytest.fixture(scope="session")
def sampled() -> Callable[[float], Arm]:
    return arm_sampled


@dataclass(frozen=True, slots=True, kw_only=True)
class Second:
    """y = (q^-1 + 0.5 q^-2)/(1 - 1.2 q^-1 + 0.6 q^-2) u, Ts 1 s."""

    def response(self, omega: Vector) -> NDArray[np.complex128]:
        """Return G at omega in rad/s."""
        x = np.exp(-1j * omega)
        return np.asarray((x + 0.5 * x**2) / (1 - 1.2 * x + 0.6 * x**2))

    def g(self, n: int) -> Vector:
        return apply_filter([0, 1, 0.5], [1, -1.2, 0.6], np.eye(1, n)[0])

    def dataset(
        self,
        rng: np.random.Generator,
        N: int = 1000,
        *,
        u_pole: float = 0.0,
        v_pole: float = 0.0,
        std: float = 1.0,
        missing: float = 0.0,
    ) -> Dataset:
        """Return data with AR(1) input and AR(1) output noise."""
        u, v = (
            apply_filter([1.0], [1.0, -pole], rng.standard_normal(N + 200))[200:]
            for pole in (u_pole, v_pole)
        )
        y = apply_filter([0, 1, 0.5], [1, -1.2, 0.6], u) + std * v
        return Dataset(u=u, y=y, Ts=1.0, valid=rng.random(N) >= missing)


@pytest.fixture(scope="session")
def second() -> Second:
    return Second()
