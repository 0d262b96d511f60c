"""Every command line of README and docs/ is one: commands and options are there, by that name."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer
from armrig.cli import app as armrig
from armrig_daemon.command_line import app as armrigd

ROOT = Path(__file__).parents[3]
# A decision may speak of a command that was not made.
PAGES = [ROOT / "README.md", ROOT / "ARCHITECTURE.md", *sorted(ROOT.glob("docs/*.md"))]
PROGRAMS = {"armrig": armrig(), "armrigd": armrigd}
_BLOCK = re.compile(r"```(\w*)\n(.*?)```", re.DOTALL)
_SPAN = re.compile(r"(?<!`)`(armrigd? [^`\n]+)`")
_END = {"|", ">", "2>", "&&", ";", "&", "||"}


def _lines(page: Path) -> Iterator[str]:
    """Iterate over the command lines of a page: those of its blocks, and those in its sentences."""
    text = page.read_text(encoding="utf-8")
    for language, block in _BLOCK.findall(text):
        for line in block.splitlines() if language == "sh" else ():
            found = re.match(r"(?:\$ |sudo |next: |[A-Z_]+=\S+ )*(armrigd? [a-z-].*)", line)
            if found:
                yield found[1]
    yield from _SPAN.findall(_BLOCK.sub("", text))


@cache
def _command(program: str) -> Any:
    return typer.main.get_command(PROGRAMS[program])


def _words(line: str) -> list[str]:
    """Return the words of the command, up to where the shell's own begin."""
    words = shlex.split(line, comments=True)
    end = next((i for i, word in enumerate(words) if word in _END), len(words))
    return [word for word in words[:end] if word not in ("…", "F…")]


def refused(line: str) -> str:
    """Return click's refusal of a line, without running it; "" if the line is accepted."""
    program, *words = _words(line)
    command = _command(program)
    while words and hasattr(command, "commands") and not words[0].startswith("-"):
        name = words.pop(0)
        if name == "COMMAND":
            return ""
        if name not in command.commands:
            return f"there is no {name}"
        command = command.commands[name]
    try:
        context = command.context_class(command, **command.context_settings)
        _, rest, _ = command.make_parser(context).parse_args(words)
    except typer.BadParameter.__base__ as err:  # click's UsageError
        named = type(err).__name__ == "BadOptionUsage" and line.split()[-1].startswith("--")
        return "" if named else err.format_message()  # a sentence names an option without its value
    return f"superfluous: {' '.join(rest)}" if rest else ""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_line_of_a_page_is_valid(page: Path) -> None:
    said = {line: refused(line) for line in _lines(page)}

    assert {line: why for line, why in said.items() if why} == {}


def test_the_lines_of_the_pages_are_found_and_a_wrong_one_is_refused() -> None:
    assert sum(len(list(_lines(page))) for page in PAGES) > 100
    assert refused("armrig validate a.csv --model m.json -o f.png") == ""
    assert "there is no plto" in refused("armrig plto @last")
    assert "--figure" in refused("armrig plot @last --figure f.png")
    assert "superfluous" in refused("armrig plot @last another")
