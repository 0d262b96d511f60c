"""The command `armrig service`: installation and removal of the systemd services."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from armrig_core.errors import OperationError

from armrig.cli.options import Json, agree, echo, print_json

if TYPE_CHECKING:
    from armrig.lab.installation import Part, Plan

_HELP = {"help_option_names": ["-h", "--help"]}
app = typer.Typer(
    help="Install, remove or show the systemd service of the rigs.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
Root = Annotated[
    Path,
    typer.Option(
        "--root",
        metavar="DIR",
        help="Root folder of the system; a folder other than / contains an offline system.",
    ),
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Show the plan only.")]
Yes = Annotated[bool, typer.Option("--yes", help="Do not ask.")]
_SYSTEM = Path("/")
_NEXT: dict[Part, str] = {
    "rig": (
        "each rig needs its file, such as /etc/armrig/1.toml with [device] port, then\n"
        "  systemctl enable --now armrigd@1\n"
        "and each operator must join the group: adduser NAME armrig"
    ),
    "router": (
        "the router needs router.pem and access.toml in /etc/armrig, then\n"
        "  systemctl enable --now armrig-router"
    ),
    "recorder": (
        "the recorder needs recorder.pem in /etc/armrig, and recorder.env with the line\n"
        "  ARMRIG_CLIENT_CONNECT=tls/lab.example.edu:7447, then\n"
        "  systemctl enable --now armrig-recorder"
    ),
}
"""For each part, what the administrator must do after its installation."""
_NOT_STARTED: dict[Part, str] = {
    "rig": "no rig is served: systemctl enable --now armrigd@1",
    "router": "no router runs: systemctl enable --now armrig-router",
    "recorder": "no recorder runs: systemctl enable --now armrig-recorder",
}


@app.command(context_settings=_HELP, epilog="Example: armrig service install --dry-run")
def install(
    router: Annotated[bool, typer.Option("--router", help="Install a lab's router.")] = False,
    recorder: Annotated[
        bool, typer.Option("--recorder", help="Install the recorder of all rigs of a router.")
    ] = False,
    root: Root = _SYSTEM,
    dry_run: DryRun = False,
    yes: Yes = False,
) -> None:
    """Install the service of the rigs, or of the router (--router) or recorder (--recorder).

    Before any change the command shows each new file, and the differences of each changed file. An
    existing installation is updated.
    """
    from armrig.lab.installation import installing

    chosen: dict[Part, bool] = {"router": router, "recorder": recorder}
    parts = [part for part, is_chosen in chosen.items() if is_chosen] or ["rig"]
    if _carry_out(installing(root.absolute(), parts), root, dry_run=dry_run, yes=yes):
        echo("\n".join(f"installed; {_NEXT[part]}" for part in parts))


@app.command(context_settings=_HELP, epilog="Example: armrig service uninstall --dry-run")
def uninstall(root: Root = _SYSTEM, dry_run: DryRun = False, yes: Yes = False) -> None:
    """Stop all rigs at 0 V and remove the service, the router and the recorder.

    Configurations, recordings, drop-ins and users stay.
    """
    from armrig.lab.installation import uninstalling

    plan = uninstalling(root.absolute())
    if not (plan.first or plan.removed):
        echo("\n".join([*plan.lines(), "nothing is installed"]))
        return
    if _carry_out(plan, root, dry_run=dry_run, yes=yes):
        left = ["/etc/armrig", "the recordings in /var/lib", *map(str, plan.kept)]
        echo(f"removed; {', '.join(left)} and the users stay")


@app.command(context_settings=_HELP, epilog="Example: armrig service status")
def status(root: Root = _SYSTEM, json: Json = False) -> None:
    """Show the installed files, and the state of each rig, the router and the recorder."""
    from armrig.lab.installation import files, parts_of, units_of

    parts = parts_of(root.absolute()) or {"rig"}
    states = {str(file.path): file.state for file in files(root.absolute(), parts)}
    units = units_of(root.absolute())
    if json:
        of_rigs = [unit for unit in units if unit.rig]
        others = {unit.part: unit for unit in units if not unit.rig}
        print_json({"files": states, "rigs": of_rigs, **others})
        return
    echo("\n".join(f"{state:9}  {path}" for path, state in states.items()))
    for unit in units:
        start = "starts with the machine" if unit.enabled else "does not start with the machine"
        how = f"{unit.active}: {unit.status}" if unit.status else unit.active
        echo(f"{unit.title}: {', '.join(part for part in (how, start) if part)}")
    for part, hint in _NOT_STARTED.items():
        if part in parts - {unit.part for unit in units}:
            echo(hint)


def _carry_out(plan: Plan, root: Path, *, dry_run: bool, yes: bool) -> bool:
    """Show a plan, and carry it out if the user agrees; return True if it was carried out."""
    from armrig.lab.installation import run_command

    echo("\n".join(plan.lines()))
    if dry_run:
        return False
    if root == _SYSTEM and os.geteuid() != 0:
        raise OperationError(
            "only root may do this: repeat it with sudo and the full path of armrig"
        )
    agree("Do this?", yes=yes)
    plan.carry_out(run_command)
    return True
