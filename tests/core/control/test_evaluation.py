"""The evaluation of a law meets its equations to the last bit."""

from __future__ import annotations

from math import inf, nan, tau
from typing import Any

import pytest
from armrig_core.control.evaluation import Latch, LawState, Program, begin, decide, observe
from armrig_core.rig.description import builtin

from tests.core.control import write_vectors
from tests.core.control.golden import VECTORS, cases, differences
from tests.core.control.laws import arm_law

RIG = Latch(rest_code=100)
R = [1.0] * 100


def _law(**changes: Any) -> Program:
    """Return the law v = y1[k-1], with F = 0."""
    fields = {
        "law_sha256": "",
        "Ts_us": 10_000,
        "rows": ((0.0, 0.0, 0.0, 1.0),),
        "v_row": (1.0, 0.0),
        "u0": 0.0,
        "x0": (0.0,),
        "predictions": ((0.0,),),
        "channels": (0,),
        "y0": (0.0,),
        "turning": (False,),
        "lo_code": 0,
        "hi_code": 65535,
        "slew": 0,
        "input_delay": 0,
        "most_blind": 20,
        "most_limited": 0,
        "tracked": None,
        "most_error": 0.0,
        "most_astray": 0,
    }
    return Program(**{**fields, **changes})


@pytest.mark.parametrize("case", cases(), ids=lambda case: case["name"])
def test_the_evaluation_gives_the_bits_of_the_equations(case: dict[str, Any]) -> None:
    assert differences(case) == []


def test_the_golden_vectors_are_those_of_the_equations() -> None:
    """After a change of the script, `python -m tests.core.control.write_vectors` writes them."""
    assert VECTORS.read_text() == write_vectors.text()


def _played(law: Program, ticks: list[tuple[float, ...] | None]) -> tuple[LawState, list[float]]:
    """Return the state and the voltages after ticks whose samples are None if they are missing."""
    state, v = begin(law), []
    for k, values in enumerate(ticks):
        state, command = decide(law, state, k, R, RIG)
        v.append(command.v)
        if values is not None:
            state = observe(law, state, k, values, R, RIG)
    return state, v


@pytest.mark.parametrize("lost", [nan, inf, -inf])
def test_a_value_that_is_not_finite_is_a_missing_one(lost: float) -> None:
    state, _ = _played(_law(), [(1.0,), (lost,), (lost,)])

    assert (state.y, state.blind, state.is_finite) == ((0.0,), 2, True)


def test_without_a_prediction_the_newest_value_stays() -> None:
    _, v = _played(_law(predictions=None), [(1.0,), (nan,), (nan,), (2.0,), None, None])

    assert v == [0.0, 1.0, 1.0, 1.0, 2.0, 2.0]


def test_a_sample_after_the_last_code_of_the_law_has_rest() -> None:
    """The run was stopped: the daemon sends rest, and samples arrive until the device stops."""
    law = _law(rows=((0.0, 0.0, 1.0, 0.0),))
    state, _ = _played(law, [(1.0,)] * 3)

    for k in (3, 5):
        state = observe(law, state, k, (1.0,), R, RIG)

    assert state.k == 6
    assert state.x == (100 / 65535 * 5.0,)


def test_a_turning_output_is_counted_from_its_first_sample() -> None:
    """The shaft starts at 6 rad and turns by 0.2 rad in each sample, in all 3 rad."""
    law = _law(turning=(True,), predictions=((1.0,),))

    state, v = _played(law, [((6 + 0.2 * k) % tau,) for k in range(16)])

    assert v[-1] == pytest.approx(14 * 0.2)
    assert state.zeros == (6.0,)


def test_a_law_that_overflows_does_not_raise() -> None:
    """The prediction is infinite: the angle cannot be unwrapped."""
    rows, F = ((1e200, 0.0, 0.0, 1e200),), ((1e200,),)
    law = _law(rows=rows, x0=(1e300,), turning=(True,), predictions=F)

    state, v = _played(law, [(1.0,), (2.0,)])
    state, command = decide(law, state, 2, R, RIG)

    assert not state.is_finite
    assert v[0] == 1e300
    assert command == (RIG.rest_code, command.v, False, False, False, 0)


@pytest.mark.parametrize(
    ("slew", "slew_of_rig", "most"),
    [(3000, 0, 3000), (0, 2000, 2000), (3000, 2000, 2000), (1000, 2000, 1000)],
)
def test_the_smaller_slew_holds_against_every_code_that_the_device_may_hold(
    slew: int, slew_of_rig: int, most: int
) -> None:
    """Samples 1 and 2 have not arrived: the device may hold the code of sample 0, 1 or 2."""
    law = _law(rows=(), v_row=(5.0,), x0=(), predictions=None, slew=slew)
    latch, state, codes = Latch(rest_code=0, slew=slew_of_rig), begin(law), []
    for k in range(3):
        state, command = decide(law, state, k, R, latch)
        codes.append(command.code)
        if k == 0:
            state = observe(law, state, 0, (0.0,), R, latch)

    assert codes == [most, 2 * most, 2 * most]
    assert command.is_slewed


def test_a_tick_without_its_sample_is_not_committed() -> None:
    """Tick 2 is decided without sample 1, which arrives later and is used for tick 3."""
    law = _law(predictions=((0.5,),))
    state, _ = _played(law, [(1.0,), None])
    state, blind = decide(law, state, 2, R, RIG)
    state = observe(law, state, 1, (4.0,), R, RIG)
    state = observe(law, state, 2, (5.0,), R, RIG)
    _, seeing = decide(law, state, 3, R, RIG)

    assert (blind.v, blind.predicted) == (0.5, 1)
    assert (seeing.v, seeing.predicted) == (5.0, 0)


def test_a_program_has_codes_for_voltages_and_channels_for_names() -> None:
    law = arm_law(lo=1.0, hi=4.0, slew=0.5).program(builtin("arm"))

    assert (law.lo_code, law.hi_code, law.slew) == (13107, 52428, 6553)
    assert (law.channels, law.turning, len(law.rows[0])) == ((0, 1), (True, False), 9)
