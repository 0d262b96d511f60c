"""Help, and answers to mistyped commands."""

from __future__ import annotations

import re
from dataclasses import fields

import pytest
from armrig.cli import _HEADINGS, main
from armrig.cli import app as armrig_app
from armrig.cli.parameters import PARAMETERS
from armrig_core.arm import ArmParameters
from armrig_daemon.command_line import app as armrigd_app
from typer.main import get_command
from typer.testing import CliRunner

COMMANDS = [
    "demo",
    "status",
    "watch",
    "stop",
    "reset",
    "note",
    "calibrate",
    "doctor",
    "glossary",
    "info",
    "recover",
    "replay",
    "identify",
    "validate",
    "compare",
    "check",
    "greybox",
    "split",
    "simulate",
    "integrate",
    "report",
    "batch identify",
    "batch validate",
    "batch verify",
    "batch report",
    "flash",
    "service install",
    "service uninstall",
    "service status",
    "pki ca",
    "pki rig",
    "pki router",
    "pki operator",
    "pki observer",
    "pki renew",
    "pki revoke",
    "pki list",
]
COLLECTS = [f"collect {kind}" for kind in ("blackbox", "greybox", "step", "staircase", "bla")]


@pytest.mark.parametrize("command", [*COMMANDS, *COLLECTS])
def test_every_command_has_h_and_an_example(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command.split(), "-h"]) == 0

    assert f"Example: armrig {command}" in re.sub(r"\s+", " ", capsys.readouterr().out)


@pytest.mark.parametrize("command", ["batch", "pki", "service"])
def test_what_has_commands_below_it_lists_them_in_lines(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, "-h"]) == 0
    listed = capsys.readouterr().out
    assert main([command]) == 2
    shown = capsys.readouterr()
    assert (shown.out, shown.err) == (listed, "")


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("stpo", "stop"),
        ("colect", "collect"),
        ("stats", "status"),
        ("identfy", "identify"),
        ("collect stepp", "step"),
        ("pki rigg", "rig"),
    ],
)
def test_a_mistyped_command_is_answered_with_the_nearest(
    typed: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(typed.split()) == 2

    assert f"did you mean {meant}" in capsys.readouterr().err


def test_each_command_is_under_one_heading(capsys: pytest.CaptureFixture[str]) -> None:
    places = [place for line in _HEADINGS.values() for place in line.split()]
    names = [place.partition(".")[2] for place in places]

    assert main(["-h"]) == 0

    shown = capsys.readouterr().out
    assert sorted(names) == sorted(get_command(armrig_app()).commands)
    assert re.findall(r"^(\w+):$", shown, re.MULTILINE) == ["Options", *_HEADINGS]
    assert re.findall(r"^  (\w+) ", shown.partition("\nRig:")[2], re.MULTILINE) == names
    assert "..." not in shown.partition("\nRig:")[2]


@pytest.mark.parametrize("command", ["", "run", "conformance"])
def test_armrigd_has_h(command: str) -> None:
    done = CliRunner().invoke(armrigd_app, [*command.split(), "-h"])

    assert done.exit_code == 0
    assert done.output.startswith("Usage:")


def test_the_help_names_every_parameter_of_the_rig() -> None:
    assert re.split(", | or ", PARAMETERS) == [field.name for field in fields(ArmParameters)]
