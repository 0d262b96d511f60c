"""The service's view of its rig, and its reasons against arming."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig_core.commands.commands import OutputRange
from armrig_core.rig.calibration import Calibration, Made, Potentiometer
from armrig_core.rig.description import builtin
from armrig_core.telemetry.telemetry import Sample
from armrig_daemon.config import ArmSettings, Config, Limits
from armrig_daemon.pipe import Distribution, State, Timing
from armrig_daemon.service.rig_view import RigView
from armrig_protocol.messages import Flag
from msgspec.structs import replace

from tests.daemon.odd_bench import CONFIG

HELD = State(t_host_ns=5, phase="armed", reason="", owner="a test", ts_us=20_000, device={"x": 1})
S = 1_000_000_000
TURNS_ON = Calibration(alpha=Potentiometer(wraps=True))


@pytest.fixture
def rig(tmp_path: Path) -> RigView:
    """Return the view of a rig without any report."""
    return RigView(Config(), "unixsock-stream/s", tmp_path)


def test_a_status_contains_the_newest_report_of_the_loop(rig: RigView) -> None:
    status = rig.status(None)
    assert not rig.is_known
    assert (status.phase, status.owner, status.host, status.Ts) == ("init", "", {}, 0.01)

    rig.state = State(t_host_ns=1, phase="safe", reason="", owner="", ts_us=0, device={})
    rig.host = {"fifo": 80}
    rig.state = HELD
    status = rig.status(None)

    assert rig.is_known
    assert (rig.state, rig.host) == (HELD, {"fifo": 80})
    assert (status.phase, status.owner, status.device) == ("armed", "a test", {"x": 1})
    assert (status.host, status.Ts) == ({"fifo": 80}, 0.02)


def test_a_status_contains_the_limits_in_force(tmp_path: Path) -> None:
    """Those of the configuration and of the description, without a removed part."""
    limits = Limits(revolutions=3, alpha_rad=0.5)
    told = []

    for arm in (ArmSettings(), ArmSettings(removed=True)):
        told.append(RigView(Config(limits=limits, arm=arm), "s", tmp_path).status(None).limits)
    heater = RigView(Config(), "s", tmp_path, builtin("heater")).status(None).limits

    turns = {"theta_1": OutputRange(turns=3)}
    assert told == [turns | {"alpha": OutputRange(low=-0.5, high=0.5)}, turns]
    assert heater == {"T1": OutputRange(high=70), "T2": OutputRange(high=70)}
    assert RigView(Config(), "s", tmp_path).status(None).limits == {}


@pytest.mark.parametrize(
    ("config", "is_kept"),
    [
        (Config(), True),
        (Config(arm=ArmSettings(removed=True)), False),
        (Config(calibration=TURNS_ON), False),
    ],
)
def test_alpha_at_the_end_of_its_range_prevents_arming_unless_the_arm_is_removed(
    config: Config, is_kept: bool, tmp_path: Path
) -> None:
    rig = RigView(config, "nowhere", tmp_path)
    for k, flags in enumerate((0, Flag.ADC1_RAIL)):
        rig.note_sample(Sample(k, k * S, k * S, k * S // 1000, 0.0, 0.0, 0.0, 0.0, 0, 0, flags))

    refusal = rig.objection()
    assert (refusal is not None) == is_kept
    assert refusal is None or refusal.error.startswith("alpha reads 0 of 65535")


def test_timing_is_published_with_the_cpu_pressure(rig: RigView) -> None:
    none = Distribution(p50=0, p90=0, p99=0, p999=0, max=0, n=0, missed=0)
    loop = dict.fromkeys(
        ("wake_lateness_us", "device_tick_error_us", "link_round_trip_us", "queue_depth"), none
    )
    rig.note_load(12.5, 3, "load 0.3 on 2 processors")

    published = rig.note_timing(Timing(t_host_ns=1, **loop))

    assert (published.cpu_pressure_percent, published.run_queue) == (12.5, 3)


@pytest.mark.parametrize("is_measured", [True, False])
def test_a_status_contains_the_configured_values(tmp_path: Path, is_measured: bool) -> None:
    """The path of the configured calibration stays while another calibration is in force."""
    made = Made(
        date="2026-11-20", rig="lab-2", device_uid="17", armrig="0.2.0", file="/etc/armrig/c.toml"
    )
    measured = replace(CONFIG.calibration, made=made if is_measured else None)
    rig = RigView(replace(CONFIG, calibration=measured), "unixsock-stream/s", tmp_path)

    before = rig.status(None)
    rig.state = replace(HELD, owner_checked="user ada", fault="late", motor="m", remedy="r")
    rig.note_calibration(replace(TURNS_ON, made=replace(made, date="2026-12-01", file="")))
    after = rig.status(None)

    file = "/etc/armrig/c.toml" if is_measured else ""
    assert (before.calibration_file, after.calibration_file) == (file, file)
    assert (before.calibration == "/etc/armrig/c.toml, made 2026-11-20") == is_measured
    assert "made 2026-12-01; in force until armrigd ends" in after.calibration
    assert (before.rig, before.u_min, before.u_max, before.Ts) == ("lab-2", 0.2, 4.4, 0.008)
    assert (before.endpoint, before.recordings) == ("unixsock-stream/s", str(tmp_path))
    assert (after.owner_checked, after.fault, after.motor, after.remedy) == (
        *("user ada", "late"),
        *("m", "r"),
    )


def test_a_status_reports_a_removed_arm_and_a_silent_port(tmp_path: Path) -> None:
    rig = RigView(Config(arm=ArmSettings(removed=True)), "unixsock-stream/s", tmp_path)
    assert (rig.line, rig.status(None).arm_removed) == ("", True)

    rig.state = replace(HELD, line="no answer; check the cable")

    assert rig.line == rig.status(None).line == "/dev/armrig: no answer; check the cable"
    assert not RigView(CONFIG, "unixsock-stream/s", tmp_path).status(None).arm_removed
