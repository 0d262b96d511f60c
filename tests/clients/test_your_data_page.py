"""docs/your-data.md: every line of Python and of the shell runs, and its output begins as shown."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
from armrig.cli import main

from tests.clients import pages

PAGE = pages.DOCS / "your-data.md"
_BLOCK = re.compile(r"```(python|sh|text)\n(.*?)```", re.DOTALL)


@pytest.mark.exhaustive
def test_every_line_of_the_page_runs_and_prints_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    commands = compared = 0
    printed = ""

    for language, text in _BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        if language == "text":
            assert printed.startswith(text)
            compared += 1
            continue
        if language == "python":
            exec(compile(text, str(PAGE), "exec"), names)
        for line in text.splitlines() if language == "sh" else []:
            assert main(shlex.split(line)[1:]) == 0, line
            commands += 1
        printed = capsys.readouterr().out

    assert (commands, compared) == (8, 7)
    assert (tmp_path / "heater.png").stat().st_size > 0


def test_every_kind_of_file_of_the_page_is_read() -> None:
    from armrig.data.files.suffixes import DATA

    table = "".join(x for x in PAGE.read_text(encoding="utf-8").splitlines() if x.startswith("| `"))

    assert set(re.findall(r"`(\.[a-z]+)`", table)) == set(DATA)
