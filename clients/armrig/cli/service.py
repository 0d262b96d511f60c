"""The command `armrig service`: the daemon as a service of systemd, installed and taken away."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armrig.cli.options import Json, agree, echo, print_json

if TYPE_CHECKING:
    from armrig.rig.installation import Plan

_HELP = {"help_option_names": ["-h", "--help"]}
app = typer.Typer(
    help="Have systemd run the daemon of each rig: install that, take it away, or say how it is.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
Root = Annotated[
    Path, typer.Option("--root", metavar="DIR", help="A system's root that is not running.")
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Show what would be done, and do nothing.")]
Yes = Annotated[bool, typer.Option("--yes", help="Do it without asking.")]
_SYSTEM = Path("/")


@app.command(context_settings=_HELP, epilog="Example: armrig service install --dry-run")
def install(root: Root = _SYSTEM, dry_run: DryRun = False, yes: Yes = False) -> None:
    """Install the unit, the rules of boards' names, and the user; all of it is shown before."""
    from armrig.rig.installation import installing

    if not _carry_out(installing(root.absolute()), root, dry_run=dry_run, yes=yes):
        return
    echo(
        "installed; each rig needs its file, such as /etc/armrig/1.toml with [device] port, then\n"
        "  systemctl enable --now armrigd@1\n"
        "and who is to operate it joins the group: adduser NAME armrig"
    )


@app.command(context_settings=_HELP, epilog="Example: armrig service uninstall --dry-run")
def uninstall(root: Root = _SYSTEM, dry_run: DryRun = False, yes: Yes = False) -> None:
    """Stop all rigs at 0 V and take the service away.

    Configurations, recordings and the user armrig stay.
    """
    from armrig.rig.installation import uninstalling

    plan = uninstalling(root.absolute())
    if not [*plan.lines()]:
        echo("nothing is installed")
        return
    if _carry_out(plan, root, dry_run=dry_run, yes=yes):
        echo("taken away; /etc/armrig, /var/lib/armrig and the user armrig are left")


@app.command(context_settings=_HELP, epilog="Example: armrig service status")
def status(root: Root = _SYSTEM, json: Json = False) -> None:
    """Say which files are installed, and how the service of each rig is."""
    from armrig.rig.installation import files, units_of

    states = {str(file.path): file.state for file in files(root.absolute())}
    units = units_of(root.absolute())
    if json:
        print_json({"files": states, "rigs": units})
        return
    echo("\n".join(f"{state:9}  {path}" for path, state in states.items()))
    for unit in units:
        start = "starts with the machine" if unit.enabled else "does not start with the machine"
        how = f"{unit.active}: {unit.status}" if unit.status else unit.active
        echo(f"rig {unit.rig}: {', '.join(part for part in (how, start) if part)}")
    if not units:
        echo("no rig is served: systemctl enable --now armrigd@1")


def _carry_out(plan: Plan, root: Path, *, dry_run: bool, yes: bool) -> bool:
    """Show a plan and, where it is agreed to, carry it out; return whether it was."""
    from armrig.rig.installation import run_command

    echo("\n".join(plan.lines()))
    if dry_run:
        return False
    if root == _SYSTEM and os.geteuid() != 0:
        msg = "only root may do this: the same with sudo, and the whole path of armrig"
        raise RuntimeError(msg)
    agree("Do this?", yes=yes)
    plan.carry_out(run_command)
    return True
