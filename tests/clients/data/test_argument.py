"""Functions of data take a recording, and their messages show how to give orders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest

from tests.clients.made_recordings import of_the_arm, written


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return a recording of the arm."""
    folder: Path = tmp_path_factory.mktemp("argument")
    return armrig.load(written(folder, of_the_arm(armrig.telegraph(600, 0.05))))


def test_estimators_and_tests_take_a_recording_for_its_dataset(recording: Any) -> None:
    data = recording.dataset()
    fit = armrig.arx(recording, na=4, nb=4)

    assert fit.theta.tolist() == armrig.arx(data=data, na=4, nb=4).theta.tolist()
    tested = armrig.residuals(fit, recording)
    assert tested.whiteness == armrig.residuals(fit, data).whiteness
    assert armrig.compare(recording, fit)[0].fit_percent == armrig.compare(data, fit)[0].fit_percent
    assert armrig.hampel(recording).N == data.N
    assert repr(armrig.advice(recording)) == repr(armrig.advice(data))


def test_orders_by_position_are_answered_with_their_names(recording: Any) -> None:
    call: Any = armrig.arx
    with pytest.raises(TypeError, match=r"by name: arx\(data, na=4, nb=4, nk=1\)"):
        call(recording, [4, 4, 1])
    with pytest.raises(TypeError, match=r"arx\(data, na=4, nb=4, nk=1\)"):
        call(recording, 4, 4, 1)


def test_what_is_no_data_is_answered_with_what_is() -> None:
    call: Any = armrig.oe
    with pytest.raises(TypeError, match=r"data is a ndarray: give a Dataset.*armrig\.load"):
        call(np.zeros(100), nb=1, nf=1)


def test_poles_print_as_a_table_with_deviations(recording: Any) -> None:
    lines = repr(armrig.arx(recording, na=4, nb=4).poles()).splitlines()

    assert len(lines) == 5
    assert lines[0].split() == ["real", "±", "imaginary", "±", "modulus", "angle"]
    assert all(len(line.split()) == 6 for line in lines)
