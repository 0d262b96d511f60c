"""The service of this machine: which files and commands install it, and which take it away."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from difflib import unified_diff
from pathlib import Path
from typing import Literal

SHIPPED = "/opt/armrig/bin/armrigd"
"""The program that the unit names as it is shipped."""
_FOLDERS = {
    "systemd": "etc/systemd/system",
    "udev": "etc/udev/rules.d",
    "sysusers.d": "etc/sysusers.d",
    "tmpfiles.d": "etc/tmpfiles.d",
}
_UNSEEN = ("/home", "/root", "/tmp", "/var/tmp", "/run/user")  # by the unit's sandbox
_UNITS = "armrigd@*.service"
_SYSTEM = Path("/")
_UDEV = Path("/run/udev/control")  # there where udev runs, which in a container it may not

FileState = Literal["installed", "differs", "missing"]


@dataclass(frozen=True, slots=True, kw_only=True)
class File:
    """A file of the service."""

    path: Path
    """Where it is installed."""
    text: str
    """What is installed there."""

    @property
    def state(self) -> FileState:
        """Whether it is there, and is what we would write."""
        if not self.path.exists():
            return "missing"
        return "installed" if self._there() == self.text else "differs"

    def difference(self) -> list[str]:
        """Return what would change in the file that is there, as lines of a diff."""
        there = self._there().splitlines()
        lines = unified_diff(there, self.text.splitlines(), "there", "new", n=0, lineterm="")
        return list(lines)[2:]

    def _there(self) -> str:
        return self.path.read_text(encoding="utf-8", errors="replace")


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What is to be done, in this order."""

    first: tuple[tuple[str, ...], ...] = ()
    """Commands before any file changes."""
    written: tuple[File, ...] = ()
    removed: tuple[File, ...] = ()
    last: tuple[tuple[str, ...], ...] = ()
    """Commands after it."""

    def lines(self) -> Iterator[str]:
        """Iterate over what a person is shown before anything is done."""
        yield from (f"run      {' '.join(command)}" for command in self.first)
        for file in self.written:
            if file.state == "differs":
                yield f"replace  {file.path}"
                yield from (f"         {line}" for line in file.difference())
            else:
                yield f"write    {file.path}"
        for file in self.removed:
            changed = ", which was changed" if file.state == "differs" else ""
            yield f"remove   {file.path}{changed}"
        yield from (f"run      {' '.join(command)}" for command in self.last)

    def carry_out(self, run: Callable[[Sequence[str]], None]) -> None:
        """Do it; `run` runs a command and raises where it fails."""
        for command in self.first:
            run(command)
        for file in self.written:
            file.path.parent.mkdir(parents=True, exist_ok=True)
            new = file.path.with_name(f".{file.path.name}.new")
            new.write_text(file.text, encoding="utf-8")
            new.chmod(0o644)
            new.replace(file.path)  # a link, such as that of a masked unit, is not followed
        for file in self.removed:
            file.path.unlink(missing_ok=True)
        for command in self.last:
            run(command)


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """The service of one rig."""

    rig: str
    enabled: bool
    """It starts with the machine."""
    active: str
    """As systemd says: active, inactive, failed, …"""
    status: str
    """What the daemon says of itself."""


def files(root: Path) -> list[File]:
    """Return the files of the service, as they are installed below `root`.

    Raises
    ------
    ValueError
        Of this machine: the unit could not start the program of this installation.
    """
    program = _program() if root == _SYSTEM else SHIPPED
    found = []
    for path in sorted(_deploy().glob("*/*")):
        text = path.read_text(encoding="utf-8").replace(SHIPPED, program)
        found.append(File(path=root / _FOLDERS[path.parent.name] / path.name, text=text))
    return found


def installing(root: Path) -> Plan:
    """Return what installs the service; twice is as once."""
    at = _at(root)
    last = [("systemd-sysusers", *at), ("systemd-tmpfiles", *at, "--create", "armrig.conf")]
    return Plan(
        written=tuple(file for file in files(root) if file.state != "installed"),
        last=(*last, *_reloading(root)),
    )


def uninstalling(root: Path) -> Plan:
    """Return what takes the service away; configurations, recordings and the user stay."""
    units = tuple(f"armrigd@{unit.rig}.service" for unit in units_of(root))
    now = ("--now",) if root == _SYSTEM else ()
    there = tuple(file for file in files(root) if file.state != "missing")
    return Plan(
        first=(("systemctl", *_at(root), "disable", *now, *units),) if units else (),
        removed=there,
        last=tuple(_reloading(root)) if there else (),
    )


def units_of(root: Path) -> list[Unit]:
    """Return the services that are enabled or, on this machine, loaded."""
    folder = root / _FOLDERS["systemd"]
    enabled = {path.name for path in folder.glob(f"*.wants/{_UNITS}")}
    loaded = set()
    if root == _SYSTEM:
        listed = _output("systemctl", "list-units", "--all", "--plain", "--no-legend", _UNITS)
        loaded = {line.split()[0] for line in listed.splitlines()}
    return [_unit(name, name in enabled, root) for name in sorted(enabled | loaded)]


def _unit(name: str, enabled: bool, root: Path) -> Unit:
    shown = ["", ""]
    if root == _SYSTEM:
        asked = ("--property=ActiveState", "--property=StatusText")
        shown = [
            line.split("=", 1)[1]
            for line in sorted(_output("systemctl", "show", name, *asked).splitlines())
        ]
    rig = name.removeprefix("armrigd@").removesuffix(".service")
    return Unit(rig=rig, enabled=enabled, active=shown[0], status=shown[1])


def run_command(command: Sequence[str]) -> None:
    """Run a command whose output a person sees.

    Raises
    ------
    RuntimeError
        It is not there, or fails.
    """
    try:
        code = subprocess.run(command, check=False).returncode
    except FileNotFoundError as err:
        msg = f"{command[0]}: not found; the service needs systemd (`apt install systemd`)"
        raise RuntimeError(msg) from err
    if code != 0:
        msg = f"{' '.join(command)}: ended with {code}"
        raise RuntimeError(msg)


def _deploy() -> Path:
    """Return the folder of the files: in the wheel, or of the checkout."""
    wheel = Path(__file__).parents[1] / "deploy"
    return wheel if wheel.is_dir() else Path(__file__).parents[3] / "deploy"


def _program() -> str:
    program = Path(sys.prefix) / "bin" / "armrigd"
    # Of a virtual environment the interpreter lies elsewhere: uv and pyenv keep theirs in a home.
    for needed in (program, Path(sys.base_prefix)):
        hidden = next((top for top in _UNSEEN if needed.is_relative_to(top)), "")
        if hidden:
            msg = f"{needed}: the service sees nothing of {hidden}; install armrig into "
            msg += "/opt/armrig with /usr/bin/python3, and run its armrig service install"
            raise ValueError(msg)
    return str(program)


def _at(root: Path) -> tuple[str, ...]:
    return () if root == _SYSTEM else (f"--root={root}",)


def _reloading(root: Path) -> list[tuple[str, ...]]:
    """Return what makes the running system read its files anew."""
    if root != _SYSTEM:
        return []
    commands: list[tuple[str, ...]] = [("systemctl", "daemon-reload")]
    if _UDEV.exists():
        commands.append(("udevadm", "control", "--reload"))
        commands.append(("udevadm", "trigger", "--subsystem-match=tty", "--subsystem-match=misc"))
    return commands


def _output(*command: str) -> str:
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout
    except FileNotFoundError:
        return ""
