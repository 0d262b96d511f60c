"""Spinners and bars during long work."""

from __future__ import annotations

import time
import warnings
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from armrig.cli import printing
from armrig.cli.printing import MIN_WAIT_S, estimating, remaining, spinner
from armrig.cli.results import write_plot
from rich.console import Console

from tests.integration.processes import wait_for


def test_a_spinner_shows_its_task_and_the_remaining_time_after_a_while() -> None:
    out = StringIO()
    terminal = Console(file=out, force_terminal=True, width=100)

    with spinner("estimating", terminal, after_s=60):
        pass
    quick = out.getvalue()
    with spinner("estimating", terminal, after_s=0.0) as count:
        wait_for(lambda: "estimating …" in out.getvalue())
        count(10, 40, "OE[2 2 1]")
        wait_for(lambda: "30 of 40 remain, " in out.getvalue())

    assert quick == ""
    assert "estimating OE[2 2 1] …" in out.getvalue()


def test_slow_work_into_a_pipe_prints_its_progress_from_time_to_time(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with spinner("estimating") as count:
        count(10, 40, "OE[2 2 1]")
    quick = capsys.readouterr()
    monkeypatch.setattr(printing, "PROGRESS_INTERVAL_S", 0.01)
    with spinner("estimating") as count:
        count(10, 40, "OE[2 2 1]")
        time.sleep(0.3)  # the next model takes long

    slow = capsys.readouterr()
    assert (quick.out, quick.err, slow.out) == ("", "", "")
    assert slow.err.count("estimating OE[2 2 1]: 30 of 40 remain, ") > 1


@pytest.mark.parametrize(
    ("done", "elapsed_s", "told"),
    [
        (0, 0.0, "40 of 40 remain"),
        (10, 6.0, "30 of 40 remain, 1.7/s, about 18 s"),
        (1, 10.0, "39 of 40 remain, 0.1/s, about 6 min"),
        (40, 9.0, "0 of 40 remain"),
    ],
)
def test_the_remaining_time_is_extrapolated_from_the_finished_share(
    done: int, elapsed_s: float, told: str
) -> None:
    assert remaining(done, 40, elapsed_s) == told


@pytest.mark.exhaustive
def test_a_slow_figure_shows_a_spinner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")

    write_plot(tmp_path / "slow.png", slow=lambda **_: time.sleep(MIN_WAIT_S + 0.3))

    assert "drawing …" in capsys.readouterr().err


def test_an_estimation_prints_no_warning_of_a_library_and_names_its_orders() -> None:
    with estimating("na and nb"):
        assert np.isinf(np.exp(np.float64(1e4)))
        warnings.warn("overflow on the way", RuntimeWarning, stacklevel=1)

    with pytest.raises(UserWarning, match="of another kind"), estimating("na and nb"):
        warnings.warn("of another kind", UserWarning, stacklevel=1)
    with pytest.raises(ValueError, match="lower na and nb"), estimating("na and nb"):
        np.linalg.cholesky(-np.eye(2))
