"""A model sample by sample finds what moves the chassis."""

from __future__ import annotations

import re

import numpy as np
from armrig.dashboard.feed import LiveModel
from armrig.excitation import telegraph
from armrig.numerics.polynomial import filtered
from armrig_core.rig.arm import ArmParameters, arm_matrices

from tests.clients.handout_plant import sampled_arm

TS = 0.01


def _samples(N: int) -> np.ndarray:
    """Return samples of the handout's arm under a telegraph, without noise, alpha left out."""
    k, u = np.arange(N), telegraph(N, 0.05, 0.5, 4.5, 1)
    theta_1 = np.degrees(filtered(*sampled_arm(TS), u)) % 360
    return np.column_stack([k, k * TS, u, theta_1, np.zeros(N)])


def _poles() -> list[complex]:
    A, _, _ = arm_matrices(ArmParameters())
    return [complex(s) for s in np.linalg.eigvals(A) if abs(s) > 1e-6]


def test_a_live_model_estimates_the_natural_frequency_of_the_arm() -> None:
    model = LiveModel(TS)
    model.take(_samples(1500))
    said = " ".join(model.lines())
    swing = max(abs(s) for s in _poles() if s.imag) / (2 * np.pi)
    slow = min(-s.real for s in _poles() if not s.imag)

    found = re.search(r"([\d.]+) Hz", said)
    constant = re.search(r"time constant ([\d.]+) s", said)
    assert found
    assert constant
    assert abs(float(found[1]) / swing - 1) < 0.02
    assert abs(float(constant[1]) * slow - 1) < 0.02


def test_a_missing_sample_does_not_change_a_live_model() -> None:
    whole, some = LiveModel(TS), LiveModel(TS)
    samples = _samples(1500)
    whole.take(samples)
    some.take(np.delete(samples, [400, 401, 900], axis=0))

    assert [line[:12] for line in some.lines()] == [line[:12] for line in whole.lines()]
    assert some.lines()[1:] == whole.lines()[1:]


def test_a_live_model_at_rest_requests_an_input() -> None:
    model = LiveModel(TS)
    assert "play an input" in model.lines()[0]
    rest = np.zeros((200, 5))
    rest[:, 0] = np.arange(200)
    model.take(rest)
    assert "play an input" in model.lines()[0]
