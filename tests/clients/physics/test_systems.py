"""The physics as python-control systems."""

from __future__ import annotations

import pytest
from armrig.physics.systems import ArmParameters, beside_the_handout, chassis


def test_the_chassis_responds_with_its_time_constant_and_gain() -> None:
    """G = K / (s (1 + s tau)) with K = 1.8623 rad/(s V) and 1/tau = 52.836 1/s."""
    s = 3.0j

    G = chassis(ArmParameters())(s)

    assert pytest.approx(1.8623 / (s * (1 + s / 52.836)), rel=1e-4) == G


@pytest.mark.parametrize(
    ("changes", "names"),
    [
        ({}, ["handout"]),
        ({"J_2": 0.004}, ["handout", "J_2=0.004"]),
        ({"J_2": 0.004, "b_1": 0.01}, ["handout", "J_2=0.004", "b_1=0.01", "both"]),
        (
            {"J_1": 0.002, "J_2": 0.004, "N": 60.0},
            ["handout", "J_1=0.002", "J_2=0.004", "N=60", "all"],
        ),
    ],
)
def test_each_case_has_the_name_of_its_change(changes: dict[str, float], names: list[str]) -> None:
    p = ArmParameters(**changes)

    cases = beside_the_handout(p)

    assert list(cases) == names
    assert cases["handout"] == ArmParameters()
    assert cases[names[-1]] == p
