"""A fault of armrig's own looks like one, and a user's mistake looks like a mistake."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig.cli import main
from armrig.rig.client import Rig

from tests.clients.fake_daemon import FakeDaemon


@pytest.fixture(autouse=True)
def _its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put the files that name a fault into a folder of the test."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


def _faulty(*_: Any) -> None:
    np.zeros(2) + np.zeros(3)  # a ValueError


@pytest.mark.parametrize("options", [[], ["--debug"]], ids=["plain", "debug"])
def test_an_error_of_numpy_is_an_internal_error(
    options: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("armrig.catalogue", _faulty)

    code = main([*options, "ls", str(tmp_path)])

    *traceback, line = capsys.readouterr().err.splitlines()
    found = re.fullmatch(
        r"armrig: internal error, please report it with (.+\.txt): "
        r"ValueError: operands could not be broadcast together with shapes \(2,\) \(3,\) ",
        line + " ",
    )
    assert code == 1
    assert found is not None
    assert "in _faulty" in Path(found[1]).read_text()
    assert any("in _faulty" in text for text in traceback) == bool(options)


def test_an_internal_error_stops_the_rig_that_the_command_holds(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Rig, "_wait_for_end", _faulty)
    where = f"unixsock-stream/{tmp_path / 'rig.sock'}"

    with FakeDaemon(where) as daemon:
        code = main(["collect", "step", "--seconds", "3", "--connect", where])

    assert code == 1
    assert "internal error" in capsys.readouterr().err
    assert daemon.names() == ["arm", "run", "stop"]
