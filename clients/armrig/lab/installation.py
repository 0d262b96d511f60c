"""Installation and removal of armrig's systemd services: files and commands."""

from __future__ import annotations

import fnmatch
import re
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from difflib import unified_diff
from pathlib import Path
from typing import Literal

from armrig_core.errors import InputError, OperationError

SHIPPED = "/opt/armrig/bin/armrigd"
"""Path of the daemon in the shipped unit; `armrig` is in the same folder."""
_FOLDERS = {
    "systemd": "etc/systemd/system",
    "udev": "etc/udev/rules.d",
    "sysusers.d": "etc/sysusers.d",
    "tmpfiles.d": "etc/tmpfiles.d",
}
_HIDDEN_FOLDERS = ("/home", "/root", "/tmp", "/var/tmp", "/run/user")  # in the unit's sandbox
_DROP_INS = "armrig*.service.d/*.conf"
_NETWORK = re.compile(
    r"(?im)^\s*(PrivateNetwork\s*=\s*(n|no|f|false|off|0)\s*$|IPAddressAllow\s*=[ \t]*\S"
    r"|RestrictAddressFamilies\s*=.*\bAF_INET)"
)
_SYSTEM = Path("/")
_UDEV = Path("/run/udev/control")  # exists if udev runs; some containers have no udev

FileState = Literal["installed", "differs", "missing"]
Part = Literal["rig", "router", "recorder"]
"""Parts of a machine's service: the rigs' daemons, a lab's router, the recorder of all rigs."""
UNITS: dict[Part, str] = {
    "rig": "armrigd@.service",
    "router": "armrig-router.service",
    "recorder": "armrig-recorder.service",
}
_RIG_PARTS: tuple[Part, ...] = ("rig",)
_PART_OF: dict[str, Part] = {
    **{unit: part for part, unit in UNITS.items()},
    "70-armrig.rules": "rig",
    "armrig-router.conf": "router",
    "armrig-recorder.conf": "recorder",
}
"""Part of the service that needs a file, by file name; all parts need the other files."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceFile:
    """A file of the service."""

    path: Path
    """Path of the installed file."""
    text: str
    """Content of the file."""
    part: Part | None = None
    """The part that needs the file; None if all parts need it."""

    @property
    def state(self) -> FileState:
        """State of the installed file, compared with `text`."""
        if not self.path.exists():
            return "missing"
        return "installed" if self._there() == self.text else "differs"

    def difference(self) -> list[str]:
        """Return the changes to the installed file, as lines of a diff."""
        there = self._there().splitlines()
        lines = unified_diff(there, self.text.splitlines(), "there", "new", n=0, lineterm="")
        return list(lines)[2:]

    def _there(self) -> str:
        return self.path.read_text(encoding="utf-8", errors="replace")


@dataclass(frozen=True, slots=True, kw_only=True)
class InstallationPlan:
    """Steps of an installation, carried out in the order of the fields."""

    first: tuple[tuple[str, ...], ...] = ()
    """Commands before the changes of files."""
    written: tuple[ServiceFile, ...] = ()
    removed: tuple[ServiceFile, ...] = ()
    last: tuple[tuple[str, ...], ...] = ()
    """Commands after the changes of files."""
    kept: tuple[Path, ...] = ()
    """Drop-ins of the machine's administrator, which a later installation uses again."""

    def lines(self) -> Iterator[str]:
        """Yield the description of the plan as lines of text."""
        yield from (f"run      {' '.join(command)}" for command in self.first)
        for file in self.written:
            if file.state == "differs":
                yield f"replace  {file.path}"
                yield from (f"         {line}" for line in file.difference())
            else:
                yield f"write    {file.path}"
                yield from (f"         {line}".rstrip() for line in file.text.splitlines())
        for file in self.removed:
            changed = ", which was changed" if file.state == "differs" else ""
            yield f"remove   {file.path}{changed}"
        yield from (f"run      {' '.join(command)}" for command in self.last)
        for path in self.kept:
            # systemd ignores a broken link.
            text = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
            opens = ", which opens the network" if _NETWORK.search(text) else ""
            yield f"keep     {path}{opens}"

    def carry_out(self, run: Callable[[Sequence[str]], None]) -> None:
        """Carry out the plan; `run` runs a command and raises an exception if the command fails."""
        for command in self.first:
            run(command)
        for file in self.written:
            file.path.parent.mkdir(parents=True, exist_ok=True)
            new = file.path.with_name(f".{file.path.name}.new")
            new.write_text(file.text, encoding="utf-8")
            new.chmod(0o644)
            new.replace(file.path)  # a link, such as the link of a masked unit, is not followed
        for file in self.removed:
            file.path.unlink(missing_ok=True)
        for command in self.last:
            run(command)


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """Service of a rig, of the router or of the recorder."""

    part: Part
    rig: str
    """Id of the rig; "" for the router and the recorder."""
    enabled: bool
    """True if the service starts with the machine."""
    active: str
    """State in systemd: active, inactive, failed, …"""
    status: str
    """Status text of the daemon."""

    @property
    def name(self) -> str:
        """Name in systemd, such as armrigd@1.service."""
        return UNITS[self.part].replace("@", f"@{self.rig}")

    @property
    def title(self) -> str:
        """Name of the service in printed texts, such as `rig 1`, `router` or `recorder`."""
        return f"rig {self.rig}" if self.rig else self.part


def parts_of(root: Path) -> set[Part]:
    """Return the parts that have at least one installed file."""
    return {file.part for file in files(root) if file.part and file.state != "missing"}


def files(root: Path, parts: Collection[Part] = UNITS.keys()) -> list[ServiceFile]:
    """Return the files of these parts of the service, with their paths below `root`.

    Raises ValueError if `root` is /, and the service could not start the `armrigd` of this
    installation.
    """
    shipped = SHIPPED.removesuffix("d")
    program = _program().removesuffix("d") if root == _SYSTEM else shipped
    shipped_files = []
    for path in sorted(_deploy().glob("*/*")):
        part = _PART_OF.get(path.name)
        if part is None or part in parts:
            text = path.read_text(encoding="utf-8").replace(shipped, program)
            there = root / _FOLDERS[path.parent.name] / path.name
            shipped_files.append(ServiceFile(path=there, text=text, part=part))
    return shipped_files


def installing(root: Path, parts: Collection[Part] = _RIG_PARTS) -> InstallationPlan:
    """Return the plan that installs these parts and updates the parts already installed.

    The plan does not change files that are up to date.
    """
    at = _at(root)
    last = [("systemd-sysusers", *at), ("systemd-tmpfiles", *at, "--create", "armrig.conf")]
    wanted = files(root, {*parts, *parts_of(root)})
    return InstallationPlan(
        written=tuple(file for file in wanted if file.state != "installed"),
        last=(*last, *_reloading(root)),
    )


def uninstalling(root: Path) -> InstallationPlan:
    """Return the plan that removes the service; drop-ins of the administrator are kept."""
    units = tuple(unit.name for unit in units_of(root))
    now = ("--now",) if root == _SYSTEM else ()
    there = tuple(file for file in files(root) if file.state != "missing")
    return InstallationPlan(
        first=(("systemctl", *_at(root), "disable", *now, *units),) if units else (),
        removed=there,
        last=tuple(_reloading(root)) if there else (),
        kept=tuple(sorted((root / _FOLDERS["systemd"]).glob(_DROP_INS))),
    )


def units_of(root: Path) -> list[Unit]:
    """Return the enabled services; if `root` is /, also the services that systemd has loaded."""
    folder = root / _FOLDERS["systemd"]
    patterns = [name.replace("@", "@*") for name in UNITS.values()]
    wanted = [path.name for path in folder.glob("*.wants/*")]
    enabled = {name for pattern in patterns for name in fnmatch.filter(wanted, pattern)}
    loaded = set()
    if root == _SYSTEM:
        listed = _output("systemctl", "list-units", "--all", "--plain", "--no-legend", *patterns)
        loaded = {line.split()[0] for line in listed.splitlines()}
    units = [_unit(name, name in enabled, root) for name in sorted(enabled | loaded)]
    return sorted(units, key=lambda unit: [*UNITS].index(unit.part))


def _unit(name: str, enabled: bool, root: Path) -> Unit:
    states = ["", ""]
    if root == _SYSTEM:
        asked = ("--property=ActiveState", "--property=StatusText")
        states = [
            line.split("=", 1)[1]
            for line in sorted(_output("systemctl", "show", name, *asked).splitlines())
        ]
    part = _PART_OF.get(name, "rig")
    rig = name.removeprefix("armrigd@").removesuffix(".service") if part == "rig" else ""
    return Unit(part=part, rig=rig, enabled=enabled, active=states[0], status=states[1])


def run_command(command: Sequence[str]) -> None:
    """Run a command, and show its output.

    Raises RuntimeError if the command does not exist, or fails.
    """
    try:
        code = subprocess.run(command, check=False).returncode
    except FileNotFoundError as err:
        raise OperationError(
            f"{command[0]}: not found; the service needs systemd (`apt install systemd`)"
        ) from err
    if code != 0:
        raise OperationError(f"{' '.join(command)}: ended with {code}")


def _deploy() -> Path:
    """Return the folder of the service's files, in the wheel or in the checkout."""
    wheel = Path(__file__).parents[1] / "deploy"
    return wheel if wheel.is_dir() else Path(__file__).parents[3] / "deploy"


def _program() -> str:
    program = Path(sys.prefix) / "bin" / "armrigd"
    # A virtual environment's interpreter is elsewhere: uv and pyenv keep it in a home folder.
    for needed in (program, Path(sys.base_prefix)):
        hidden = next((top for top in _HIDDEN_FOLDERS if needed.is_relative_to(top)), "")
        if hidden:
            raise InputError(
                f"{needed}: the service cannot see {hidden}; install armrig into "
                "/opt/armrig with /usr/bin/python3, and run "
                "`/opt/armrig/bin/armrig service install`"
            )
    return str(program)


def _at(root: Path) -> tuple[str, ...]:
    return () if root == _SYSTEM else (f"--root={root}",)


def _reloading(root: Path) -> list[tuple[str, ...]]:
    """Return the commands after which the running system uses the changed files."""
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
