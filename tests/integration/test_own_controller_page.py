"""docs/own-controller.md: its programs control the emulated rig that the page names."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig.rig.local_daemon import running

from tests.clients import pages


@pytest.mark.timed
def test_the_programs_of_the_page_print_the_output_shown_there(
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A voltage that comes late lengthens the period of the relay test by a sample or two."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("s")))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.chdir(tmp_path)

    with running(["--emulate", "--rig-file", "rc"], rig="1", log=tmp_path / "log"):
        compared = pages.run(pages.DOCS / "own-controller.md", capsys, atol=0.6)

    assert compared == 2
