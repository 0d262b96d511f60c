"""Functions of data take a recording, and their messages show how to give orders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import armrig
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
