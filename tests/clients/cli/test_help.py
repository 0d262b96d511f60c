"""Help, and answers to mistyped commands."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import pytest
from armrig.cli import _HEADINGS, main
from armrig.cli import app as armrig_app
from armrig.cli.physics import PARAMETERS
from armrig_core.rig.arm import ArmParameters
from armrig_daemon.command_line import app as armrigd_app
from typer.main import get_command


def test_each_command_is_under_one_heading(capsys: pytest.CaptureFixture[str]) -> None:
    names = [name for modules in _HEADINGS.values() for name in " ".join(modules.values()).split()]

    assert main(["-h"]) == 0

    shown = capsys.readouterr().out
    assert sorted(names) == sorted(get_command(armrig_app()).commands)
    assert re.findall(r"^(\w+):$", shown, re.MULTILINE) == ["Options", *_HEADINGS]
    assert re.findall(r"^  (\w+) ", shown.partition("\nRig:")[2], re.MULTILINE) == names
    assert "..." not in shown.partition("\nRig:")[2]


def test_the_help_names_every_parameter_of_the_rig() -> None:
    assert re.split(", | or ", PARAMETERS) == [field.name for field in fields(ArmParameters)]


def test_a_help_ends_with_the_default_of_its_option() -> None:
    """In words, or as the value that a person would type; brackets contain only limits."""
    entries = dict(_options_of(get_command(armrig_app()), "armrig")) | dict(
        _options_of(get_command(armrigd_app), "armrigd")
    )

    assert not [name for name, text in entries.items() if "[default" in text]
    assert entries["armrig integrate --tolerance"].endswith("step. Default: 0.001")
    assert entries["armrig identify --max-order"].endswith("if needed  [1<=x<=100]")
    assert entries["armrig lab --dashboard"].endswith("Default: --dashboard")
    assert entries["armrig pki router --host"].endswith("repeatable.  [required]")
    local = "otherwise the daemon on this machine"
    assert entries["armrig status --connect"].endswith(local)


def _options_of(command: Any, path: str) -> Iterator[tuple[str, str]]:
    """Yield the help of each option of a command and its commands, by command and option."""
    context = command.make_context(path, [], resilient_parsing=True)
    for option in command.params:
        if record := option.get_help_record(context):
            yield f"{path} {option.opts[-1]}", record[1]
    for name, other in getattr(command, "commands", {}).items():
        yield from _options_of(other, f"{path} {name}")
