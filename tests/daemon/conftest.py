"""The folder of the configurations, and a line without a device, for a test."""

from __future__ import annotations

import os
from collections.abc import Iterator
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


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    """Give the device's end of a line, and the name of the other end."""
    master, slave = os.openpty()
    yield master, os.ttyname(slave)
    os.close(master)
    os.close(slave)
