"""The commands that install armrig as a service: service."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from armrig_core.errors import OperationError
from armrig_core.process.options import CommandGroup, option, preset

from armrig.cli.options import Json
from armrig.cli.printing import (
    agree,
    print_result,
    say,
)
from armrig.lab import installation

if TYPE_CHECKING:
    from armrig.lab.installation import InstallationPlan, Part


service = CommandGroup(
    "Install, remove or show the systemd service of the rigs.", no_args_is_help=True
)
Root = Annotated[
    Path,
    option(
        "--root DIR", "Root folder of the system; a folder other than / contains an offline system."
    ),
]
DryRun = Annotated[bool, option("--dry-run", "Show the plan only.")]
Yes = Annotated[bool, option("--yes", "Do not ask.")]
_SYSTEM = Path("/")
_UNITS: dict[Part, str] = {
    "rig": "armrigd@1",
    "router": "armrig-router",
    "recorder": "armrig-recorder",
}
_NEEDED: dict[Part, str] = {
    "rig": "each rig needs its file, such as /etc/armrig/1.toml with [device] port",
    "router": "the router needs router.pem and access.toml in /etc/armrig",
    "recorder": (
        "the recorder needs recorder.pem in /etc/armrig, and recorder.env with the line\n"
        "  ARMRIG_CLIENT_CONNECT=tls/lab.example.edu:7447"
    ),
}
"""For each part, the files that the administrator must add after its installation."""


@service.add("service install --dry-run")
def install(
    router: bool = preset(False, "Install a lab's router."),
    recorder: bool = preset(False, "Install the recorder of all rigs of a router."),
    root: Root = _SYSTEM,
    dry_run: DryRun = False,
    yes: Yes = False,
) -> None:
    """Install the service of the rigs, or of the router (--router) or recorder (--recorder).

    Before any change the command shows each new file, and the differences of each changed file. An
    existing installation is updated.
    """
    chosen: dict[Part, bool] = {"router": router, "recorder": recorder}
    parts = [part for part, is_chosen in chosen.items() if is_chosen] or ["rig"]
    if _carry_out(installation.installing(root.absolute(), parts), root, dry_run=dry_run, yes=yes):
        for part in parts:
            say(f"installed; {_NEEDED[part]}, then\n  systemctl enable --now {_UNITS[part]}")
        if "rig" in parts:
            say("and each operator must join the group: adduser NAME armrig")


@service.add("service uninstall --dry-run")
def uninstall(root: Root = _SYSTEM, dry_run: DryRun = False, yes: Yes = False) -> None:
    """Stop all rigs at 0 V and remove the service, the router and the recorder.

    Configurations, recordings, drop-ins and users stay.
    """
    plan = installation.uninstalling(root.absolute())
    if not (plan.first or plan.removed):
        say("\n".join([*plan.lines(), "nothing is installed"]))
        return
    if _carry_out(plan, root, dry_run=dry_run, yes=yes):
        left = ["/etc/armrig", "the recordings in /var/lib", *map(str, plan.kept)]
        say(f"removed; {', '.join(left)} and the users stay")


@service.add("service status")
def status(root: Root = _SYSTEM, json: Json = False) -> None:
    """Show the installed files, and the state of each rig, the router and the recorder."""
    parts = installation.parts_of(root.absolute()) or {"rig"}
    states = {str(file.path): file.state for file in installation.files(root.absolute(), parts)}
    units = installation.units_of(root.absolute())
    lines = [f"{state:9}  {path}" for path, state in states.items()]
    for unit in units:
        start = "starts with the machine" if unit.enabled else "does not start with the machine"
        how = f"{unit.active}: {unit.status}" if unit.status else unit.active
        lines.append(f"{unit.title}: {', '.join(part for part in (how, start) if part)}")
    missing = parts - {unit.part for unit in units}
    for part in (part for part in _UNITS if part in missing):
        problem = "no rig is served" if part == "rig" else f"no {part} runs"
        lines.append(f"{problem}: systemctl enable --now {_UNITS[part]}")
    facts = {"files": states, "rigs": [unit for unit in units if unit.rig]}
    print_result(facts | {u.part: u for u in units if not u.rig}, *lines, json=json)


def _carry_out(plan: InstallationPlan, root: Path, *, dry_run: bool, yes: bool) -> bool:
    """Show a plan, and carry it out if the user agrees; return True if it was carried out."""
    say("\n".join(plan.lines()))
    if dry_run:
        return False
    if root == _SYSTEM and os.geteuid() != 0:
        raise OperationError(
            "only root may do this: repeat it with sudo and the full path of armrig"
        )
    agree("Do this?", yes=yes)
    plan.carry_out(installation.run_command)
    return True
