"""Readings that prevent arming, and readings that do not."""

from __future__ import annotations

from math import nan

import pytest
from armrig_core.commands.codes import RefusalCode
from armrig_core.rig.description import builtin
from armrig_core.telemetry.channels import CHANNELS
from armrig_core.telemetry.telemetry import Sample
from armrig_daemon.service.readings import ReadingSummary, objection, start_rad, update_readings
from armrig_protocol.messages import Flag

MS = 1_000_000


def _objection(readings: ReadingSummary) -> str:
    found = objection(readings, CHANNELS, turns_per_volt_s=0.3)
    if found is None:
        return ""
    passes = found.error.endswith(": try again")
    assert found.code == (RefusalCode.STALE if passes else RefusalCode.READINGS)
    assert found.passes == passes
    return found.error


def test_a_rig_without_a_reading_is_not_armed() -> None:
    assert _objection(ReadingSummary()) == "no sample has come from the rig yet: try again"
    assert _objection(update_readings(ReadingSummary(), _sample(0))) == ""


def test_the_newest_angle_is_the_start_of_a_rehearsal() -> None:
    railed = _sample(10)._replace(value_0=nan)
    assert start_rad(update_readings(ReadingSummary(), _sample(0))) == 0.5
    assert start_rad(update_readings(ReadingSummary(), railed)) is None
    assert start_rad(ReadingSummary()) is None


def _sample(t_ms: float, *, y0: int = 20_000, u: float = 0.0, flags: int = 0) -> Sample:
    t_ns = round(t_ms * MS)
    return Sample(0, t_ns, t_ns, t_ns // 1000, 0.5, 0.0, u, u, y0, 32768, flags)


@pytest.mark.parametrize(("t_ms", "named"), [(209.999, False), (210, True)])
def test_alpha_at_the_end_of_its_range_for_0_2_s_prevents_arming(t_ms: float, named: bool) -> None:
    for flags in (0, int(Flag.ADC1_RAIL)):
        readings = update_readings(
            update_readings(ReadingSummary(), _sample(0)), _sample(10, flags=0)
        )
        if flags:
            readings = update_readings(ReadingSummary(), _sample(10, flags=flags))
        readings = update_readings(readings, _sample(t_ms, flags=int(Flag.ADC1_RAIL)))
        assert bool(_objection(readings)) == named


def test_a_thermometer_at_the_end_of_its_range_prevents_arming() -> None:
    """An open or a shorted sensor; no turns are counted, because the heater has no motor."""
    channels = builtin("heater").channels
    for number, rail in enumerate((Flag.ADC0_RAIL, Flag.ADC1_RAIL)):
        readings = update_readings(ReadingSummary(volt_s=99.0), _sample(10))
        readings = update_readings(readings, _sample(210, flags=int(rail)))._replace(volt_s=99.0)

        found = objection(readings, channels, turns_per_volt_s=0.0)

        assert found is not None
        assert found.error.startswith(f"T{number + 1} reads ")


@pytest.mark.parametrize(("counts", "end"), [(0, "low"), (65_535, "high")])
def test_the_refusal_at_an_end_of_a_range_names_the_key_of_this_end(counts: int, end: str) -> None:
    channels = builtin("heater").channels
    railed = _sample(210, flags=int(Flag.ADC0_RAIL))._replace(value_0=nan, counts_0=counts)

    readings = update_readings(update_readings(ReadingSummary(), _sample(0)), railed)
    found = objection(readings, channels, turns_per_volt_s=0.0, is_described=True)

    assert found is not None
    assert found.error.endswith(
        f"give valid_rail = '{end}' to [outputs.T1] in the rig's description"
    )


@pytest.mark.parametrize(("turn", "named"), [(0.9999, False), (1.0, True)])
def test_theta_1_is_reported_stuck_after_one_driven_turn(turn: float, named: bool) -> None:
    driven = ReadingSummary(newest=_sample(0), volt_s=turn)

    assert bool(objection(driven, CHANNELS, turns_per_volt_s=1.0)) == named


@pytest.mark.parametrize(("counts", "moved"), [(256, False), (257, True), (-256, False)])
def test_readings_within_256_counts_count_as_no_motion(counts: int, moved: bool) -> None:
    before = update_readings(
        update_readings(ReadingSummary(), _sample(0, u=3.0)), _sample(10, u=3.0)
    )

    after = update_readings(before, _sample(20, y0=20_000 + counts))

    y0 = 20_000 + counts
    assert before.volt_s == pytest.approx(0.02)
    assert after.volt_s == pytest.approx(0.0 if moved else 0.04)
    span = (y0, y0) if moved else (min(20_000, y0), max(20_000, y0))
    assert (after.least, after.greatest) == span
    assert (after.newest, after.inside_ns) == (_sample(20, y0=y0), (20 * MS, 20 * MS))


@pytest.mark.parametrize(
    ("apart_ms", "volts", "volt_s"),
    [(200, 3.0, 0.4), (200.001, 3.0, 0.0), (0, 3.0, 0.0), (100, 1.0, 0.0), (100, 1.1, 0.01)],
)
def test_only_voltages_above_friction_count_as_driving(
    apart_ms: float, volts: float, volt_s: float
) -> None:
    first = update_readings(ReadingSummary(), _sample(1000, u=volts))

    assert update_readings(first, _sample(1000 + apart_ms)).volt_s == pytest.approx(volt_s)
