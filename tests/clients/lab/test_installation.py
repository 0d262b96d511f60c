"""The service's files below a root of the test's own; a real systemd has them in tests/systemd."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from armrig.cli import main
from armrig.lab import installation
from armrig.lab.installation import (
    SHIPPED,
    UNITS,
    Unit,
    files,
    installing,
    uninstalling,
    units_of,
)

UNIT = "etc/systemd/system/armrigd@.service"
ROUTER = "etc/systemd/system/armrig-router.service"
RECORDER = "etc/systemd/system/armrig-recorder.service"


class Commands:
    """Takes the commands, and looks which files there were at each."""

    def __init__(self, root: Path) -> None:
        self.given: list[str] = []
        self.files: list[int] = []
        self._root = root

    def __call__(self, command: Sequence[str]) -> None:
        self.given.append(" ".join(command))
        self.files.append(sum(path.is_file() for path in self._root.rglob("*")))


@pytest.fixture
def commands(tmp_path: Path) -> Commands:
    return Commands(tmp_path)


def _contents(root: Path) -> dict[str, str]:
    return {str(p.relative_to(root)): p.read_text() for p in root.rglob("*") if p.is_file()}


def test_the_files_of_the_rig_service_are_installed(tmp_path: Path, commands: Commands) -> None:
    before = os.umask(0o077)  # of a careful administrator
    try:
        installing(tmp_path).carry_out(commands)
    finally:
        os.umask(before)

    assert set(_contents(tmp_path)) == {
        UNIT,
        "etc/udev/rules.d/70-armrig.rules",
        "etc/sysusers.d/armrig.conf",
        "etc/tmpfiles.d/armrig.conf",
    }
    assert commands.given == [
        f"systemd-sysusers --root={tmp_path}",
        f"systemd-tmpfiles --root={tmp_path} --create armrig.conf",
    ]
    assert set(commands.files) == {4}
    modes = {path.stat().st_mode & 0o777 for path in tmp_path.rglob("*") if path.is_file()}
    assert modes == {0o644}


@pytest.mark.parametrize(
    ("part", "own"),
    [
        ("router", {ROUTER, "etc/sysusers.d/armrig-router.conf"}),
        ("recorder", {RECORDER, "etc/sysusers.d/armrig-recorder.conf"}),
    ],
)
def test_a_machine_without_rigs_gets_the_files_of_its_part(
    part: installation.Part, own: set[str], tmp_path: Path, commands: Commands
) -> None:
    installing(tmp_path, [part]).carry_out(commands)

    assert set(_contents(tmp_path)) == {
        *own,
        "etc/sysusers.d/armrig.conf",
        "etc/tmpfiles.d/armrig.conf",
    }


def test_each_deployed_file_belongs_to_a_part(tmp_path: Path) -> None:
    of_parts = [file for part in UNITS for file in files(tmp_path, [part])]

    deployed = Path(__file__).parents[3] / "deploy"
    assert {file.path.name for file in of_parts} == {p.name for p in deployed.glob("*/*")}
    assert {file.path for file in of_parts} == {file.path for file in files(tmp_path)}


def test_an_installation_renews_the_installed_parts(tmp_path: Path, commands: Commands) -> None:
    installing(tmp_path, ["router", "recorder"]).carry_out(commands)
    (tmp_path / ROUTER).write_text("[Unit]\n")

    plan = installing(tmp_path)

    written = [str(file.path.relative_to(tmp_path)) for file in plan.written]
    assert written == [ROUTER, UNIT, "etc/udev/rules.d/70-armrig.rules"]


def test_a_changed_file_is_shown_before_its_replacement(tmp_path: Path, commands: Commands) -> None:
    installing(tmp_path).carry_out(commands)
    unit = tmp_path / UNIT
    kept = unit.with_name("kept")
    kept.write_text(unit.read_text().replace("WatchdogSec=10", "WatchdogSec=99"))
    unit.unlink()
    unit.symlink_to(kept)

    plan = installing(tmp_path)

    shown = [*plan.lines()]
    assert shown[0] == f"replace  {unit}"
    assert [line.strip() for line in shown[2:4]] == ["-WatchdogSec=99", "+WatchdogSec=10"]
    plan.carry_out(commands)
    assert not unit.is_symlink()
    assert "WatchdogSec=99" in kept.read_text()


def test_an_uninstallation_removes_the_installed_files(tmp_path: Path, commands: Commands) -> None:
    installing(tmp_path, UNITS).carry_out(commands)
    own = tmp_path / "etc/armrig/1.toml"
    own.parent.mkdir()
    own.write_text("[device]\n")
    wants = tmp_path / "etc/systemd/system/multi-user.target.wants"
    wants.mkdir()
    units = ("armrigd@1.service", "armrig-router.service", "armrig-recorder.service")
    for unit in units:
        (wants / unit).symlink_to("/nowhere")
    commands.given.clear()

    uninstalling(tmp_path).carry_out(commands)

    assert commands.given == [f"systemctl --root={tmp_path} disable {' '.join(units)}"]
    assert _contents(tmp_path) == {"etc/armrig/1.toml": "[device]\n"}


def test_a_changed_file_is_removed_and_named(tmp_path: Path, commands: Commands) -> None:
    installing(tmp_path).carry_out(commands)
    (tmp_path / UNIT).write_text("[Unit]\n")

    plan = uninstalling(tmp_path)
    shown = [line for line in plan.lines() if line.startswith("remove")]
    plan.carry_out(commands)

    assert f"remove   {tmp_path / UNIT}, which was changed" in shown
    assert sum("which was changed" in line for line in shown) == 1
    assert _contents(tmp_path) == {}


@pytest.fixture
def python(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], None]:
    """Give a function that moves the environment of Python, and its base."""

    def at(prefix: str, base: str) -> None:
        for name, folder in (("prefix", prefix), ("base_prefix", base)):
            monkeypatch.setattr(sys, name, folder)

    return at


def test_the_unit_of_this_machine_starts_the_program_of_this_installation(
    python: Callable[[str, str], None],
) -> None:
    """A root that does not run gets the path of the documentation."""
    python("/srv/armrig-2", "/usr")

    units = {file.path.name: file.text for file in files(Path("/"))}

    unit = units["armrigd@.service"]
    assert "ExecStart=/srv/armrig-2/bin/armrigd run --system --rig %i" in unit
    assert "ExecStart=/srv/armrig-2/bin/armrig router" in units["armrig-router.service"]
    assert "ExecStart=/srv/armrig-2/bin/armrig record" in units["armrig-recorder.service"]
    assert "/opt/armrig" not in "".join(units.values())
    (other,) = (file for file in files(Path("/mnt")) if file.path.name == "armrigd@.service")
    assert f"ExecStart={SHIPPED} run" in other.text


@pytest.mark.parametrize(
    ("prefix", "base", "says"),
    [
        (
            "/home/student/armrig/.venv",
            "/usr",
            "/home/student/armrig/.venv/bin/armrigd: the service cannot see /home;",
        ),
        (
            "/opt/armrig",
            "/root/.local/share/uv/python/3.12",
            "/root/.local/share/uv/python/3.12: the service cannot see /root;",
        ),
    ],
)
def test_a_program_that_the_sandbox_hides_is_refused(
    prefix: str,
    base: str,
    says: str,
    python: Callable[[str, str], None],
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A checkout in a home folder, and a Python in it: the unit would fail at each start."""
    python(prefix, base)

    assert main(["service", "install", "--dry-run"]) == 1
    said = capsys.readouterr().err
    assert says in said
    assert "install armrig into /opt/armrig with /usr/bin/python3" in said


def test_a_router_and_a_recorder_are_shown_together_and_a_dry_run_needs_no_agreement(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["service", "install", "--root", str(tmp_path), "--dry-run", "--yes"]

    assert main([*given, "--recorder", "--router"]) == 0

    said = capsys.readouterr().out
    for name in (ROUTER, RECORDER):
        assert f"write    {tmp_path / name}\n" in said
    assert f"write    {tmp_path / UNIT}\n" not in said
    assert "installed; " not in said
    assert not [*tmp_path.iterdir()]


def test_the_state_of_each_part_is_reported(
    tmp_path: Path, commands: Commands, capsys: pytest.CaptureFixture[str]
) -> None:
    installing(tmp_path, ["router", "recorder"]).carry_out(commands)
    wants = tmp_path / "etc/systemd/system/multi-user.target.wants"
    wants.mkdir()
    (wants / "armrig-router.service").symlink_to("/nowhere")

    assert main(["service", "status", "--root", str(tmp_path)]) == 0

    said = capsys.readouterr().out.splitlines()
    assert said[-2:] == [
        "router: starts with the machine",
        "no recorder runs: systemctl enable --now armrig-recorder",
    ]
    assert {line.split()[0] for line in said[:-2]} == {"installed"}
    assert not any("armrigd@" in line for line in said)


def test_no_file_is_written_without_consent(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["service", "install", "--root", str(tmp_path)]) == 1

    assert "--yes agrees, --dry-run only shows the plan" in capsys.readouterr().err
    assert not [*tmp_path.iterdir()]


def test_a_service_that_is_loaded_and_not_enabled_is_listed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told = {
        "list-units": "armrigd@7.service loaded active running Rig 7's daemon\n",
        "show": "StatusText=sampling\nActiveState=active\n",
    }
    monkeypatch.setattr(installation, "_output", lambda *words: told[words[1]])

    units = [unit for unit in units_of(Path("/")) if unit.rig == "7"]

    assert units == [Unit(part="rig", rig="7", enabled=False, active="active", status="sampling")]


def test_a_failed_or_missing_command_is_reported() -> None:
    with pytest.raises(RuntimeError, match=r"^false: ended with 1$"):
        installation.run_command(["false"])
    with pytest.raises(RuntimeError, match=r"^no-such-command: not found; the service needs syst"):
        installation.run_command(["no-such-command"])


def test_a_dangling_drop_in_does_not_count_as_installed(tmp_path: Path) -> None:
    installing(tmp_path).carry_out(lambda _: None)
    drop_ins = tmp_path / "etc/systemd/system/armrigd@1.service.d"
    (drop_ins / "a.conf").mkdir(parents=True)
    (drop_ins / "b.conf").symlink_to("nowhere")

    shown = [*uninstalling(tmp_path).lines()]

    assert shown[-2:] == [f"keep     {drop_ins / name}" for name in ("a.conf", "b.conf")]


@pytest.mark.parametrize(
    ("text", "opens"),
    [
        ("PrivateNetwork=no\n", True),
        ("RestrictAddressFamilies=AF_INET AF_INET6\n", True),
        ("IPAddressAllow=192.0.2.0/24\n", True),
        ("  PrivateNetwork = No\n", True),  # systemd reads it so, too
        ("PrivateNetwork=false\n", True),
        ("PrivateNetwork=off\n", True),
        ("PrivateNetwork=0\n", True),
        ("# PrivateNetwork=no\nCPUSchedulingPriority=80\n", False),
        ("PrivateNetwork=yes\n", False),
        ("PrivateNetwork=1\n", False),
        ("PrivateNetwork=on\n", False),
        ("IPAddressAllow=\n", False),
        ("RestrictAddressFamilies=AF_UNIX\n", False),
    ],
)
def test_an_uninstallation_keeps_and_names_a_drop_in(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, opens: bool
) -> None:
    drop_in = tmp_path / "etc/systemd/system/armrigd@1.service.d/override.conf"
    drop_in.parent.mkdir(parents=True)
    drop_in.write_text(f"[Service]\n{text}")
    installing(tmp_path).carry_out(lambda _: None)
    said = f"keep     {drop_in}{', which opens the network' * opens}"

    assert main(["service", "uninstall", "--root", str(tmp_path), "--dry-run"]) == 0
    assert said in capsys.readouterr().out.splitlines()
    uninstalling(tmp_path).carry_out(lambda _: None)

    assert drop_in.exists()
    assert main(["service", "uninstall", "--root", str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines() == [said, "nothing is installed"]
