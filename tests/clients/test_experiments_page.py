"""docs/experiments.md: every line of Python runs, and prints what stands below it."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from armrig.cli import main
from armrig_core.commands import commands

from tests.clients import pages
from tests.clients.fake_daemon import FakeDaemon

PAGE = pages.DOCS / "experiments.md"


@pytest.mark.exhaustive
def test_every_line_of_the_page_prints_the_output_shown_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from matplotlib import pyplot as plt

    pages.record_all("experiments.py", tmp_path)
    monkeypatch.chdir(tmp_path)

    compared = pages.run(PAGE, capsys, atol=1e-6)

    plt.close("all")
    assert compared == 13


def test_every_command_of_the_page_is_valid(daemon: FakeDaemon, where: str) -> None:
    text = PAGE.read_text(encoding="utf-8")
    lines = re.findall(r"^armrig .+$|`(armrig collect [a-z]+ --.+?)`", text, re.MULTILINE)
    blocks = re.findall(r"```sh\n(.+?)\n```", text)

    for line in (*blocks, *filter(None, lines)):
        assert main([*shlex.split(line)[1:], "--connect", where]) == 0

    played = [r.experiment for r in daemon.asked if isinstance(r, commands.RunRequest)]
    names = ["step-first", "blackbox-monday", "blackbox-validation-monday"]
    assert played == [*names, *["bla"] * 4]


def test_every_figure_of_the_page_exists() -> None:
    shown = set(re.findall(r"\]\(figures/(.+?)\)", PAGE.read_text(encoding="utf-8")))

    assert shown == {path.name for path in (PAGE.parent / "figures").glob("experiments-*.svg")}
