"""The installed units, judged by systemd's own checks."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.tools import needs

ROOT = Path(__file__).parents[2]
UNITS = sorted((ROOT / "deploy" / "systemd").glob("*.service"))
SERVICE, ACCESS = (
    (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8") for page in ("service", "access")
)
OVER_NETWORK = ("armrig-recorder.service", "armrig-router.service")
WITHOUT_NETWORK = (
    "PrivateNetwork=yes\nIPAddressDeny=any\nRestrictAddressFamilies=~AF_INET AF_INET6\n"
)
FOR_A_LAB = "IPAddressDeny=any\nIPAddressAllow=localhost 192.0.2.0/24\n"
MOST_EXPOSED = 1.0
"""Exposure of 10, by `systemd-analyze security`."""

pytestmark = needs("systemd-analyze")


@pytest.fixture(params=UNITS, ids=lambda path: path.stem)
def unit(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Give a unit with the program of this environment, which must exist to be judged."""
    return _with_our_program(request.param, tmp_path)


def _with_our_program(unit: Path, folder: Path) -> Path:
    path = folder / unit.name
    text = unit.read_text(encoding="utf-8")
    programs = f"{Path(sys.executable).parent}/"
    path.write_text(text.replace("/opt/armrig/bin/", programs), encoding="utf-8")
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


def _score(unit: Path, *, more: str = "") -> float:
    text = unit.read_text(encoding="utf-8")
    unit.write_text(text.replace("\n[Install]", f"{more}\n[Install]"), encoding="utf-8")
    judged = _analyze("security", "--offline=true", "--no-pager", str(unit))
    found = re.search(r"Overall exposure level for \S+: ([0-9.]+)", judged.stdout)
    assert found, judged.stdout
    return float(found[1])


def test_systemd_finds_no_fault_in_the_unit(unit: Path) -> None:
    verified = _analyze("verify", "--man=no", str(unit.with_name(unit.name.replace("@", "@1"))))

    assert (verified.returncode, verified.stdout) == (0, "")


def test_the_unit_has_a_low_exposure_level(unit: Path) -> None:
    more = WITHOUT_NETWORK if unit.name in OVER_NETWORK else ""

    assert _score(unit, more=more) <= MOST_EXPOSED


@pytest.mark.parametrize("name", OVER_NETWORK)
def test_the_exposure_level_of_a_network_unit_equals_the_page(name: str, tmp_path: Path) -> None:
    unit = _with_our_program(ROOT / "deploy" / "systemd" / name, tmp_path)

    as_installed, for_a_lab = _score(unit), _score(unit, more=FOR_A_LAB)

    assert f"is {as_installed} for the router and for the recorder" in SERVICE
    assert f"`IPAddressAllow=` lowers (improves) the score to {for_a_lab}" in SERVICE


def test_the_exposure_level_of_a_network_daemon_equals_the_page(tmp_path: Path) -> None:
    unit = _with_our_program(ROOT / "deploy" / "systemd" / "armrigd@.service", tmp_path)
    (network,) = re.findall(r"```ini\n\[Service\]\n(.*?)```", ACCESS, re.DOTALL)

    scores = _score(unit), _score(unit, more=network)

    assert "reports increases from {} to {}:".format(*scores) in ACCESS


def test_a_unit_starts_only_programs_of_a_minimal_system() -> None:
    """An empty Debian has no kill, which is part of procps."""
    text = "".join(unit.read_text(encoding="utf-8") for unit in UNITS)
    started = re.findall(r"^Exec\w+=[-@:+!]*(\S+)", text, re.MULTILINE)

    assert set(started) == {"/opt/armrig/bin/armrigd", "/opt/armrig/bin/armrig", "/bin/sh"}
