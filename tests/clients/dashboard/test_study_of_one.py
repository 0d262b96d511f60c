"""Description of one recording for the page."""

from __future__ import annotations

from math import inf
from pathlib import Path

import numpy as np
import pytest
from armrig.dashboard.study_of_one import csv, curves, facts
from armrig.recordings.loading import load

from tests.clients.made_recordings import note, recorded, sample, written


@pytest.mark.parametrize(("start", "k"), [(0.995, 100), (1.999, -1), (1e6, -1)])
def test_a_part_without_a_sample_is_the_next_one_or_the_last(
    three_recordings: tuple[Path, Path, Path], start: float, k: int
) -> None:
    path = three_recordings[0]
    recording = load(path)
    shown = curves(path, start, start + 0.001)

    assert shown["u"][0] == [pytest.approx(recording.t[k])]
    assert shown["u"][1] == shown["u"][2] == [pytest.approx(recording.u[k], abs=1e-4)]


def test_a_part_as_csv_has_the_page_s_quantities(three_recordings: tuple[Path, Path, Path]) -> None:
    path = three_recordings[0]
    recording = load(path)
    header, *rows = csv(path, 1.0, 1.5).decode().splitlines()
    k = np.flatnonzero((recording.t >= 1.0) & (recording.t <= 1.5))

    assert header == "t [s],u [V],theta_1 counted [deg],alpha [deg]"
    shown = np.array([[float(text) for text in row.split(",")] for row in rows])
    angles = np.degrees([recording.theta_1[k], recording.alpha[k]])
    expected = np.column_stack([recording.t[k], recording.u[k], *angles])
    np.testing.assert_allclose(shown, expected, atol=6e-5)


def test_an_infinite_voltage_is_not_drawn(tmp_path: Path) -> None:
    """One value of the pair would be null in JSON, and the page needs both."""
    samples = [sample(k, u_applied_v=inf if k == 70 else 1.0) for k in range(5000)]

    _, least, largest = curves(written(tmp_path, recorded(samples)), None, None)["u"]

    assert {*least, *largest} == {1.0}


def test_the_notes_of_a_recording_are_listed(tmp_path: Path) -> None:
    notes = [note(k % 20, f"<b>{k}") for k in range(150)]
    path = written(tmp_path, recorded([*(sample(k) for k in range(40)), *notes]))

    found = facts(path)

    assert len(found["notes"]) == 100
    assert found["more_notes"] == 50
    assert found["notes"][5] == (pytest.approx(0.05, abs=1e-4), "Ada", "<b>5")
