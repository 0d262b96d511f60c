"""docs/from-matlab.md: all its Python runs, in blocks and in tables, and its commands are taken."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import armrig
import pytest
from armrig.cli import main

from tests.clients import pages

PAGE = pages.DOCS / "from-matlab.md"
_TEXT = PAGE.read_text(encoding="utf-8")
_CELLS = [line.split(" | ")[1:] for line in _TEXT.splitlines() if line.startswith("| `")]
_PYTHON = re.compile(r"`((?:armrig|control|fit|data|z|print)\b[.\[(][^`]*)`")
_COMMAND = re.compile(r"`(armrig \w+ [^`…]+)`")


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Give the names that the page's blocks define, run in an empty folder."""
    folder = tmp_path_factory.mktemp("page")
    names: dict[str, Any] = {"folder": folder}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for block in re.findall(r"```python\n(.*?)```", _TEXT, re.DOTALL):
            exec(compile(block, str(PAGE), "exec"), names)
    names["signals"] = armrig.Signals(u=names["u"], y=names["y"], Ts=0.1)
    return names


def test_every_code_block_prints_the_text_below_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    assert pages.run(PAGE, capsys, atol=2e-3) == 4


@pytest.mark.exhaustive
def test_every_expression_of_the_tables_runs(
    names: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    from matplotlib import pyplot as plt

    monkeypatch.chdir(names["folder"])
    found = [text for row in _CELLS for cell in row for text in _PYTHON.findall(cell)]

    for text in found:
        eval(text, names)

    plt.close("all")
    assert len(found) > len(_CELLS) > 30


@pytest.mark.exhaustive
def test_every_command_of_the_page_runs(
    names: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(names["folder"])
    commands = [c for c in _COMMAND.findall(_TEXT.split("## The app")[1]) if "report" not in c]

    for command in commands:
        assert main(shlex.split(command)[1:]) == 0, command

    assert len(commands) == 4
    assert (names["folder"] / "validation.png").stat().st_size > 0
