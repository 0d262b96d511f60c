"""Help, and answers to mistyped commands."""

from __future__ import annotations

import re
from dataclasses import fields

import pytest
from armrig.cli import main
from armrig.cli.parameters import PARAMETERS
from armrig_core.arm import ArmParameters
from armrig_daemon.command_line import app as armrigd_app
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
    "typed", ["stpo", "sto", "resett", "colect", "callibrate", "demoo", "benhc", "stpp", "falsh"]
)
def test_a_mistyped_command_is_never_answered_with_one_that_acts(
    typed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([typed]) == 2

    said = capsys.readouterr().err.replace(f"'{typed}'", "")
    assert not re.search(r"stop|reset|collect|calibrate|demo|flash", said)


def test_a_mistyped_command_is_answered_with_one_that_reads(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["stats"]) == 2

    assert "did you mean status?" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["", "run", "conformance"])
def test_armrigd_has_h(command: str) -> None:
    done = CliRunner().invoke(armrigd_app, [*command.split(), "-h"])

    assert done.exit_code == 0
    assert done.output.startswith("Usage:")


def test_the_help_names_every_parameter_of_the_rig() -> None:
    assert re.split(", | or ", PARAMETERS) == [field.name for field in fields(ArmParameters)]
