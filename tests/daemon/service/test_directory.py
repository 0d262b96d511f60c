"""The folder of the recordings, looked at before a run."""

from __future__ import annotations

from pathlib import Path

from armrig_daemon.service.directory import check_directory


def test_a_directory_that_cannot_take_it_is_said_before_the_run(tmp_path: Path) -> None:
    """Missing is made; too small is told."""
    assert check_directory(tmp_path / "new" / "er", 1000) == ""
    assert "MB free" in check_directory(tmp_path, 10**18)
    file = tmp_path / "file"
    file.touch()
    assert "set [recording] directory" in check_directory(file / "below", 1)
