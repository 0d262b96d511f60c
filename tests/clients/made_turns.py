"""Readings of a shaft that turns and of a shaft at rest, as a track gives them."""

from __future__ import annotations

import gzip
from math import tau

import numpy as np
from armrig.physics.calibration_readings import Readings

D, LOW, HIGH = 68_000.0, 900.0, 64_000.0


def made_turns(
    *, direction: int = 1, noise: float = 0.0, seed: int = 0, omega: tuple[float, ...] = (1.9, 3.7)
) -> Readings:
    """Return a run at these speeds in rad/s, one for each volt, as a track with D, LOW, HIGH."""
    rng = np.random.default_rng(seed)
    t = np.arange(1200 * len(omega)) * 0.01
    rate = np.repeat(omega, 1200)
    place = D / 3 + direction * D / tau * np.cumsum(rate) * 0.01
    place = (place - LOW) % D + LOW
    read = np.rint((place + noise * rng.standard_normal(t.size)) / 64) * 64
    counts = np.where(place > HIGH, 0.0, np.clip(read, 0, 65472))
    u = np.repeat(np.arange(1.0, 1 + len(omega)), 1200)
    return Readings(t=t, u=u, first=counts, second=np.full(t.size, 32768.0))


def stored_readings(data: bytes) -> dict[str, Readings]:
    """Return the readings of each recording, by its name, from the samples of a calibration."""
    found: dict[str, list[list[float]]] = {}
    for line in gzip.decompress(data).decode().splitlines()[1:]:
        name, *fields = line.split(",")
        found.setdefault(name, []).append([float(field) for field in fields])
    tables = {name: np.array(rows).T for name, rows in found.items()}
    return {
        name: Readings(t=t_us * 1e-6, u=u, first=theta_1, second=alpha)
        for name, (t_us, u, theta_1, alpha) in tables.items()
    }


def still(counts: float = 20_000.0, noise: float = 30.0, N: int = 300) -> Readings:
    """Return a rest."""
    rng = np.random.default_rng(3)
    read = np.rint((counts + noise * rng.standard_normal((2, N))) / 64) * 64
    t = np.arange(N) * 0.01
    return Readings(t=t, u=np.zeros(N), first=read[0], second=read[1])
