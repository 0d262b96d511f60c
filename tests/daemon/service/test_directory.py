"""Checks of the recordings' folder before a run."""

from __future__ import annotations

from pathlib import Path

from armrig_core.codes import RefusalCode
from armrig_daemon.service.directory import check_directory


def test_a_directory_without_room_is_reported_before_the_run(tmp_path: Path) -> None:
    assert check_directory(tmp_path / "new" / "er", 1000) is None
    small = check_directory(tmp_path, 10**18)
    assert small is not None
    assert small.code == RefusalCode.NO_ROOM
    assert "MB free" in small.error
    file = tmp_path / "file"
    file.touch()
    missing = check_directory(file / "below", 1)
    assert missing is not None
    assert "set [recording] directory" in missing.error
