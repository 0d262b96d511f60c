"""Help, and answers to mistyped commands."""

from __future__ import annotations

import re
from dataclasses import fields

import pytest
from armrig.cli import _HEADINGS, main
from armrig.cli import app as armrig_app
from armrig.cli.physics import PARAMETERS
from armrig_core.rig.arm import ArmParameters
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
