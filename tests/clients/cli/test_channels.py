"""Names of signals in options and in a model, and notes about the columns of a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig import Signals
from armrig.cli import recorded_data
from armrig.data.level import far_from_zero


def _about(mean: float, n: int = 20) -> Any:
    """Return n values of standard deviation 1 about a mean."""
    return mean + np.resize([1.0, -1.0], n)


def test_a_mean_is_far_from_zero_from_two_standard_deviations_on() -> None:
    assert far_from_zero([_about(0), _about(-2.1)])
    assert far_from_zero([_about(2.1), _about(0)])
    assert not far_from_zero([_about(1.9), _about(-1.9)])
    assert not far_from_zero([_about(9, n=18), _about(9)])
    assert not far_from_zero([_about(9), np.full(20, 9.0)])


def test_the_option_for_the_means_is_offered_for_each_signal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    recorded_data.hint_at_means([("y", _about(5))], [("u", _about(0)), ("v", _about(1))])
    one = capsys.readouterr().err
    recorded_data.hint_at_means(
        [("y", _about(0)), ("z", _about(-4))], [("u", _about(0))], may_offset=True
    )
    two = capsys.readouterr().err
    recorded_data.hint_at_means([("y", _about(1))], [("u", _about(1))])

    assert one == (
        "armrig: the mean of y is 5, the mean of u is 0, the mean of v is 1; if y is not 0 at "
        "u = v = 0, subtract the means with --detrend\n"
    )
    assert "the mean of z is -4" in two
    assert "if y and z are not 0 at u = 0, estimate a level with --offset, or subtract" in two
    assert capsys.readouterr().err == ""


def test_the_signals_of_a_table_are_listed_with_what_is_missing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    y = np.arange(12.0).reshape(6, 2)
    y[2, 1] = y[3] = np.nan
    signals = Signals(u=np.zeros((6, 1)), y=y, Ts=0.25, outputs=("p", "q"), inputs=("v",))

    recorded_data.tell_of_reading(
        Path("f.csv"), signals, ["outputs p, q", "inputs v"], "values are missing"
    )

    assert capsys.readouterr().err == (
        "armrig: f.csv has 6 samples: models from so few samples are poor; record 300 or more\n"
        "f.csv: 6 samples, 0.25 s apart; outputs p, q; inputs v; 3 values are missing\n"
    )
