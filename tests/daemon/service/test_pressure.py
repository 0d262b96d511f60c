"""Pressure stall information, and the messages about a busy host."""

from __future__ import annotations

import os
from math import isnan
from pathlib import Path

import pytest
from armrig_core.commands.codes import RefusalCode
from armrig_daemon.pipe import Distribution, Timing
from armrig_daemon.service.host import pressure
from msgspec.structs import replace

QUIET = Distribution(p50=0, p90=0, p99=0, p999=0, max=0, n=100, missed=0)


def _written(path: Path, total_us: int) -> Path:
    path.write_text(f"some avg10=1.00 avg60=0.50 avg300=0.10 total={total_us}\nfull avg10=0.00\n")
    return path


def test_the_stalled_share_refers_to_the_time_since_the_last_reading(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.25 s stalled in 1 s are 25 %, and 0.3 s in the next 0.5 s are 60 %."""
    now = [10**9]
    monkeypatch.setattr(pressure, "monotonic_ns", lambda: now[0])
    watch = pressure.Pressure(_written(tmp_path / "cpu", 1_000_000))

    now[0] += 10**9
    _written(tmp_path / "cpu", 1_250_000)

    share, runnable = watch.read()
    assert share == pytest.approx(25.0)
    assert runnable >= 1  # we are
    now[0] += 5 * 10**8
    _written(tmp_path / "cpu", 1_550_000)
    assert watch.read()[0] == pytest.approx(60.0)
    assert isnan(watch.read()[0])  # no time has passed


@pytest.mark.parametrize("text", ["", "some avg10=0.00\n", None])
def test_a_kernel_without_pressure_information_is_not_an_error(
    tmp_path: Path, text: str | None
) -> None:
    path = tmp_path / "cpu"
    if text is not None:
        path.write_text(text)

    assert isnan(pressure.Pressure(path).read()[0])


def test_a_late_host_is_refused_with_a_temporary_code() -> None:
    timing = _timing(replace(QUIET, p99=264e3, p999=264e3, max=264e3, missed=26))

    refusal = pressure.untimely(timing, 250, "load 3 on 2 processors")

    assert refusal is not None
    assert (refusal.code, refusal.passes) == (RefusalCode.LATE, True)
    assert refusal.parameters == {"late_ms": 264, "most_ms": 100}
    error = refusal.error
    assert "264 ms late in the last second, at most 100 ms" in error
    assert "load 3 on 2 processors" in error
    assert "`armrig doctor`" in error
    assert error.endswith(": try again")


@pytest.mark.parametrize(
    ("text", "share"),
    [
        ("some avg10=97.30 avg60=0.50", ", a task waited for a processor in 97 % of the last 10 s"),
        ("", ""),
        (None, ""),
    ],
)
def test_the_load_is_reported_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str | None, share: str
) -> None:
    path = tmp_path / "cpu"
    if text is not None:
        path.write_text(text)
    monkeypatch.setattr(pressure.os, "getloadavg", lambda: (3.42, 1.0, 0.5))

    n = len(os.sched_getaffinity(0))
    assert pressure.load(path) == f"load 3.4 on {n} processor{'s' * (n > 1)}{share}"


def test_an_unknown_load_is_not_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def untold() -> tuple[float, float, float]:
        raise OSError

    monkeypatch.setattr(pressure.os, "getloadavg", untold)

    assert pressure.load(tmp_path / "cpu") == "load not reported by this kernel"


def _timing(lateness_us: Distribution) -> Timing:
    return Timing(
        t_host_ns=0,
        wake_lateness_us=lateness_us,
        device_tick_error_us=QUIET,
        link_round_trip_us=QUIET,
        queue_depth=QUIET,
    )
