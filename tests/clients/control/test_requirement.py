"""A requirement on a step: in the file of a law, judged on the model and on a run."""

from __future__ import annotations

from math import inf, nan

import armrig
import msgspec
import pytest
from armrig.control.requirement import Requirement, requirement_of
from armrig_core.errors import InputError

MET = {"overshoot": 4.0, "settling": 0.22}


def test_figures_within_the_bounds_meet_the_requirement() -> None:
    requirement = Requirement(overshoot=4.0, settling=0.3)

    assert requirement.misses(MET) == []
    text = "The run meets the requirement: overshoot at most 4 %, 5 % settling at most 0.3 s."
    assert requirement.sentence(MET, "The run") == text


@pytest.mark.parametrize(
    ("settling", "text"), [(0.4, "0.4 s"), (inf, "not reached"), (nan, "not known")]
)
def test_a_figure_beyond_its_bound_is_named(settling: float, text: str) -> None:
    requirement = Requirement(overshoot=4.0, settling=0.3)

    said = requirement.sentence(MET | {"settling": settling}, "The run")

    assert said.endswith(f": 5 % settling {text}.")
    assert "misses the requirement (overshoot at most 4 %, 5 % settling at most 0.3 s)" in said


@pytest.mark.parametrize("bounds", [{"overshoot": -1.0}, {"settling": 0.0}, {"settling": nan}])
def test_a_bound_that_no_loop_meets_is_refused(bounds: dict[str, float]) -> None:
    with pytest.raises(InputError, match="must be"):
        Requirement(**bounds)


@pytest.mark.parametrize(
    "requirement", [None, 3, {}, {"rise": 1.0}, {"settling": "a"}, {"overshoot": -1.0}]
)
def test_a_file_without_a_requirement_has_none(requirement: object) -> None:
    assert requirement_of({"requirement": requirement}) is None


def test_the_check_of_a_law_says_whether_the_model_meets_its_requirement() -> None:
    arm = armrig.physics.arm(armrig.physics.ArmParameters())
    law = armrig.control.place(arm, [-18 + 18j, -18 - 18j, -42], rate=True, Ts=0.01)

    met, missed = (
        armrig.control.check_law(
            msgspec.structs.replace(law, design=law.design | {"requirement": {"settling": s}}),
            arm,
            draws=0,
        ).verdict
        for s in (0.3, 0.2)
    )

    assert met.endswith("meets the requirement: 5 % settling at most 0.3 s.")
    assert missed.endswith("(5 % settling at most 0.2 s): 5 % settling 0.22 s.")
