"""The unit as it is installed, before systemd's own judges."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from tools import needs

UNIT = Path(__file__).parents[2] / "deploy" / "systemd" / "armrigd@.service"
MOST_EXPOSED = 1.0
"""Of 10, by `systemd-analyze security`."""

pytestmark = needs("systemd-analyze")


@pytest.fixture
def unit(tmp_path: Path) -> Path:
    """Give the unit with the program of this environment, which must exist to be judged."""
    program = Path(sys.executable).with_name("armrigd")
    path = tmp_path / UNIT.name
    text = UNIT.read_text(encoding="utf-8")
    path.write_text(text.replace("/opt/armrig/bin/armrigd", str(program)), encoding="utf-8")
    return path


def _analyze(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["systemd-analyze", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=60,
        check=False,
    )


def test_systemd_finds_no_fault_in_the_unit(unit: Path) -> None:
    """No unknown key, no value that it does not take, nothing that is missing."""
    verified = _analyze("verify", "--man=no", str(unit.with_name("armrigd@1.service")))

    assert (verified.returncode, verified.stdout) == (0, "")


def test_the_unit_is_exposed_to_little(unit: Path) -> None:
    """The score that docs/service.md gives, and no more than the gate."""
    judged = _analyze("security", "--offline=true", "--no-pager", str(unit))

    found = re.search(r"Overall exposure level for \S+: ([0-9.]+)", judged.stdout)
    assert found, judged.stdout
    assert float(found[1]) <= MOST_EXPOSED


def test_the_unit_starts_nothing_that_a_small_system_has_not() -> None:
    """Our program and the shell: an empty Debian has no kill, which is part of procps."""
    started = re.findall(r"^Exec\w+=[-@:+!]*(\S+)", UNIT.read_text(encoding="utf-8"), re.MULTILINE)

    assert set(started) == {"/opt/armrig/bin/armrigd", "/bin/sh"}
