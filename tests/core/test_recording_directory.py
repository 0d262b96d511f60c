"""Folders in which a client looks for recordings."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig_core.recording_file import recording_directory
from armrig_core.recording_file.recording_directory import VARIABLE, directory_to_look_in


@pytest.fixture
def service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give the folder of a service; the user has no recordings yet."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "own"))
    folder = tmp_path / "service"
    monkeypatch.setattr(recording_directory, "OF_SERVICE", folder)
    folder.mkdir()
    return folder


def test_the_configured_folder_precedes_those_of_user_and_service(
    service: Path, tmp_path: Path
) -> None:
    away = tmp_path / "away"

    assert directory_to_look_in([], {VARIABLE: str(away)}) == away
    assert directory_to_look_in([], {}) == service
    service.rmdir()
    assert directory_to_look_in([], {}) == recording_directory.directory_of("")
    service.mkdir()
    recording_directory.directory_of("").mkdir(parents=True)
    assert directory_to_look_in([], {}) == recording_directory.directory_of("")


def test_a_configuration_that_cannot_be_read_is_reported_with_its_path(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"{tmp_path}: Is a directory"):
        directory_to_look_in([tmp_path], {})


def test_a_home_of_an_unknown_user_is_refused() -> None:
    with pytest.raises(ValueError, match="= '~nobody-is-called-so/runs': there is no such user"):
        recording_directory.directory_of("~nobody-is-called-so/runs")
