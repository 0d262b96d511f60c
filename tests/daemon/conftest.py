"""The folder of the configurations, on a machine of a test."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig_core.recording_file import recording_directory
from armrig_daemon import config


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give the machine's folder of configurations; the user has none."""
    folder = tmp_path / "etc"
    folder.mkdir()
    for module in (recording_directory, config):
        monkeypatch.setattr(module, "SYSTEM", folder / "armrig.toml")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "user"))
    return folder
