"""The service's view of its rig, and its reasons against arming."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from armrig_core.calibration import Calibration, Potentiometer
from armrig_core.telemetry import Sample
from armrig_daemon.config import ArmSettings, Config
from armrig_daemon.pipe import Distribution, Host, State, Timing
from armrig_daemon.service.rig_view import RigView
from armrig_protocol.messages import Flag

HELD = State(t_host_ns=5, phase="armed", reason="", owner="a test", ts_us=20_000, device={"x": 1})
S = 1_000_000_000
TURNS_ON = Calibration(alpha=Potentiometer(wraps=True))


@pytest.fixture
def rig(tmp_path: Path) -> RigView:
    """Return the view of a rig without any report."""
    return RigView(Config(), "unixsock-stream/s", tmp_path)


def test_before_the_loop_has_spoken_nothing_is_known(rig: RigView) -> None:
    status = rig.status(None)

    assert not rig.is_known
    assert (status.phase, status.owner, status.host, status.Ts) == ("init", "", {}, 0.01)


def test_a_status_has_the_newest_report_of_the_loop(rig: RigView) -> None:
    rig.note_state(State(t_host_ns=1, phase="safe", reason="", owner="", ts_us=0, device={}))
    rig.note_host(Host(granted={"fifo": 80}))
    rig.note_state(HELD)
    status = rig.status(None)

    assert rig.is_known
    assert (rig.state, rig.host) == (HELD, {"fifo": 80})
    assert (status.phase, status.owner, status.device) == ("armed", "a test", {"x": 1})
    assert (status.host, status.Ts) == ({"fifo": 80}, 0.02)


@pytest.mark.parametrize(
    ("config", "is_kept"),
    [
        (Config(), True),
        (Config(arm=ArmSettings(removed=True)), False),
        (Config(calibration=TURNS_ON), False),
    ],
)
def test_alpha_at_the_end_of_its_range_keeps_from_arming_where_there_is_one(
    config: Config, is_kept: bool, tmp_path: Path
) -> None:
    rig = RigView(config, "nowhere", tmp_path)
    for k, flags in enumerate((0, Flag.ADC1_RAIL)):
        rig.note_sample(Sample(k, k * S, k * S, k * S // 1000, 0.0, 0.0, 0.0, 0.0, 0, 0, flags))

    refusal = rig.objection()
    assert (refusal is not None) == is_kept
    assert refusal is None or refusal.error.startswith("alpha reads 0 of 65535")


def test_a_second_s_timing_is_published_with_what_the_machine_was_doing(
    rig: RigView, monkeypatch: pytest.MonkeyPatch
) -> None:
    none = Distribution(p50=0, p90=0, p99=0, p999=0, max=0, n=0, missed=0)
    loop = dict.fromkeys(
        ("wake_lateness_us", "device_tick_error_us", "link_round_trip_us", "queue_depth"), none
    )
    monkeypatch.setattr(rig, "_pressure", SimpleNamespace(read=lambda: (12.5, 3)))

    published = rig.note_timing(Timing(t_host_ns=1, **loop))

    assert (published.cpu_pressure_percent, published.run_queue) == (12.5, 3)
