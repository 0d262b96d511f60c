"""Guards over the readings."""

from __future__ import annotations

import pytest
from armrig_daemon.emulator.guards import NOTHING_SEEN, at_rail, watch
from armrig_protocol.messages import Cause


def causes(readings: list[tuple[int, int]], *, rail_ticks: int = 0, turns: int = 0) -> list[Cause]:
    """Return the cause at each reading."""
    guards, verdicts = NOTHING_SEEN, []
    for y0, y1 in readings:
        guards, cause = watch(guards, y0, y1, rail_ticks=rail_ticks, turns=turns)
        verdicts.append(cause)
    return verdicts


@pytest.mark.parametrize(("y", "rail"), [(0, 1), (63, 1), (64, 0), (65471, 0), (65472, 1)])
def test_a_rail_is_the_outermost_1024th(y: int, rail: int) -> None:
    assert at_rail(y) == bool(rail)


@pytest.mark.parametrize("channel", [0, 1])
def test_rails_in_a_row_trip(channel: int) -> None:
    rail, good = (
        [(0, 30_000), (30_000, 30_000)]
        if channel == 0
        else [
            (30_000, 65_535),
            (30_000, 30_000),
        ]
    )

    verdicts = causes([rail, rail, good, rail, rail, rail], rail_ticks=3)

    assert verdicts == [Cause.NONE] * 5 + [Cause.ADC_RAIL]


def test_rails_of_two_channels_do_not_add_up() -> None:
    theta_1, alpha, both = (10, 30_000), (30_000, 65_500), (10, 65_500)

    verdicts = causes([theta_1, both, alpha, theta_1, both, both], rail_ticks=3)

    assert verdicts == [Cause.NONE] * 2 + [Cause.NONE] * 3 + [Cause.ADC_RAIL]


def test_rail_guard_of_0_ticks_is_off() -> None:
    assert set(causes([(0, 0)] * 1000)) == {Cause.NONE}


@pytest.mark.parametrize("direction", [1, -1])
def test_turns_are_counted_through_the_wrap_in_either_direction(direction: int) -> None:
    """Two turns in steps of 1/16 trip at the 32nd step, not before."""
    readings = [(direction * step * 4096 % 65536, 30_000) for step in range(33)]

    verdicts = causes(readings, turns=200)

    assert verdicts == [Cause.NONE] * 32 + [Cause.REV_LIMIT]


def test_an_oscillation_does_not_count_as_a_revolution() -> None:
    assert set(causes([(0, 30_000), (16_000, 30_000)] * 50, turns=100)) == {Cause.NONE}
