"""Pressure stall information, as a share of the time between two looks."""

from __future__ import annotations

from math import isnan
from pathlib import Path

import pytest
from armrig_daemon import pressure


def _written(path: Path, total_us: int) -> Path:
    path.write_text(f"some avg10=1.00 avg60=0.50 avg300=0.10 total={total_us}\nfull avg10=0.00\n")
    return path


def test_the_share_is_that_of_the_time_since_the_last_look(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.25 s stalled in 1 s is 25 %."""
    now = [10**9]
    monkeypatch.setattr(pressure, "monotonic_ns", lambda: now[0])
    watch = pressure.Pressure(_written(tmp_path / "cpu", 1_000_000))

    now[0] += 10**9
    _written(tmp_path / "cpu", 1_250_000)

    share, runnable = watch.read()
    assert share == pytest.approx(25.0)
    assert runnable >= 1  # we are


@pytest.mark.parametrize("text", ["", "some avg10=0.00\n", None])
def test_a_kernel_that_does_not_tell_is_no_error(tmp_path: Path, text: str | None) -> None:
    """NaN says that it is not known."""
    path = tmp_path / "cpu"
    if text is not None:
        path.write_text(text)

    assert isnan(pressure.Pressure(path).read()[0])
