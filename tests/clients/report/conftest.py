"""Fixtures of the report tests: a study of three recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from armrig.recordings.files.loading import load
from armrig.recordings.recording import Recording
from armrig.report.sections import Section
from armrig.report.study import Study, study
from armrig.report.study_sections import study_contents


@pytest.fixture(scope="session")
def done(three_recordings: tuple[Path, Path, Path]) -> Study:
    """Give a study of a step, a telegraph and a telegraph for validation."""
    return study([load(path) for path in three_recordings])


def at_rest(recording: Recording) -> Recording:
    """Return a recording whose arm did not move."""
    samples = recording.samples.copy()
    samples["alpha_counts"] = 32768
    return replace(recording, samples=samples)


def section_of(study: Study, title: str) -> Section:
    """Return a section of the report of a study."""
    return next(s for s in study_contents(study, ()).sections if s.title == title)
