"""Fixtures of the report tests: a study of three recordings."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig.recordings.files.loading import load
from armrig.report.study import Study, study


@pytest.fixture(scope="session")
def done(three_recordings: tuple[Path, Path, Path]) -> Study:
    """Give a study of a step, a telegraph and a telegraph for validation."""
    return study([load(path) for path in three_recordings])
