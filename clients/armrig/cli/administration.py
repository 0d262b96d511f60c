"""The commands for the administrator of a lab: service, pki, router."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from armrig_core.errors import OperationError
from armrig_core.process.signal_pipe import until_signal

from armrig.cli.options import Commands, Json, argument, chosen, group, option
from armrig.cli.printing import agree, echo, inform, print_json
from armrig.lab import installation

if TYPE_CHECKING:
    from armrig.lab.installation import Part, Plan
    from armrig.lab.pki import Issued

service = Commands("Install, remove or show the systemd service of the rigs.", no_args_is_help=True)
Root = Annotated[
    Path,
    option(
        "--root DIR", "Root folder of the system; a folder other than / contains an offline system."
    ),
]
DryRun = Annotated[bool, option("--dry-run", "Show the plan only.")]
Yes = Annotated[bool, option("--yes", "Do not ask.")]
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


@service.add("service install --dry-run")
def install(
    router: bool = chosen(False, "--router", "Install a lab's router."),
    recorder: bool = chosen(False, "--recorder", "Install the recorder of all rigs of a router."),
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
        echo("\n".join(f"installed; {_NEXT[part]}" for part in parts))


@service.add("service uninstall --dry-run")
def uninstall(root: Root = _SYSTEM, dry_run: DryRun = False, yes: Yes = False) -> None:
    """Stop all rigs at 0 V and remove the service, the router and the recorder.

    Configurations, recordings, drop-ins and users stay.
    """
    plan = installation.uninstalling(root.absolute())
    if not (plan.first or plan.removed):
        echo("\n".join([*plan.lines(), "nothing is installed"]))
        return
    if _carry_out(plan, root, dry_run=dry_run, yes=yes):
        left = ["/etc/armrig", "the recordings in /var/lib", *map(str, plan.kept)]
        echo(f"removed; {', '.join(left)} and the users stay")


@service.add("service status")
def status(root: Root = _SYSTEM, json: Json = False) -> None:
    """Show the installed files, and the state of each rig, the router and the recorder."""
    parts = installation.parts_of(root.absolute()) or {"rig"}
    states = {str(file.path): file.state for file in installation.files(root.absolute(), parts)}
    units = installation.units_of(root.absolute())
    if json:
        others = {unit.part: unit for unit in units if not unit.rig}
        print_json({"files": states, "rigs": [unit for unit in units if unit.rig], **others})
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
    echo("\n".join(plan.lines()))
    if dry_run:
        return False
    if root == _SYSTEM and os.geteuid() != 0:
        raise OperationError(
            "only root may do this: repeat it with sudo and the full path of armrig"
        )
    agree("Do this?", yes=yes)
    plan.carry_out(installation.run_command)
    return True


pki = Commands("Make certificates for rigs and for people on a network.", no_args_is_help=True)
_PKI = Path("pki")
_USES = {
    "rig": "set it as [access] certificate",
    "router": "give it as armrig router's --certificate",
}
"""Use of a certificate by its role; the certificates of people have another use."""
Directory = Annotated[
    Path, option("--directory", "Folder of the authority, whose key must stay private.")
]
Days = Annotated[int, option("--days", "Validity, in days.", min=1, max=36500)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Issuing:
    """Options of the commands that make a certificate."""

    directory: Directory = _PKI
    days: Days = 365
    force: bool = chosen(False, "--force", "Replace an existing file.")
    json: Json = False


Issuing = Annotated[_Issuing, group(_Issuing)]


@pki.add("pki ca")
def ca(
    directory: Directory = _PKI,
    days: Days = 3650,
    force: bool = chosen(
        False, "--force", "Replace an existing authority; all its certificates become invalid."
    ),
    json: Json = False,
) -> None:
    """Make a certificate authority, which signs all certificates, and an empty access list."""
    from armrig.lab.pki import ACCESS_LIST, make_authority

    path = make_authority(directory, days=days, force=force)
    if json:
        print_json({"path": str(path)})
        return
    echo(
        f"{path}: made; keep {path.with_suffix('.key')} private, because with it "
        "anybody can make operators"
    )
    echo(f"{directory / ACCESS_LIST}: the access list, still empty")


@pki.add("pki rig 1 --host rig-1.lab.example.edu")
def rig(
    *,
    name: Annotated[str, argument("ID", "Id of the rig.")],
    host: list[str] | None = chosen(
        None,
        "--host",
        "Host name or address that clients use; repeatable.",
        "none, only through a router",
    ),
    issuing: Issuing,
) -> None:
    """Make the certificate of a rig's daemon, for clients and for a router."""
    from armrig.lab.pki import issue_to_rig

    _issue(issue_to_rig, issuing, name, host or ())


@pki.add("pki router --host lab.example.edu", "router")
def of_router(
    host: Annotated[
        list[str], option("--host", "Host name or address that rigs and people use; repeatable.")
    ],
    issuing: Issuing,
) -> None:
    """Make the certificate of a lab's router."""
    from armrig.lab.pki import issue_to_router

    _issue(issue_to_router, issuing, host)


@pki.add("pki operator anna")
def operator(
    name: Annotated[
        str,
        argument("NAME", "Name of a person: a-z, 0-9 and -; the rig shows this name as the owner."),
    ],
    issuing: Issuing,
) -> None:
    """Make the certificate of a person who may drive and watch the rigs."""
    from armrig.lab.pki import issue_to_person

    _issue(issue_to_person, issuing, name, "operators")


@pki.add("pki observer wall-screen")
def observer(
    name: Annotated[str, argument("NAME", "Name of a person: a-z, 0-9 and -.")], issuing: Issuing
) -> None:
    """Make the certificate of a person who may watch the rigs."""
    from armrig.lab.pki import issue_to_person

    _issue(issue_to_person, issuing, name, "observers")


def _issue(issue: Callable[..., Issued], issuing: _Issuing, *whom: Any) -> None:
    issued = issue(issuing.directory, *whom, days=issuing.days, force=issuing.force)
    _say(issued, json=issuing.json)


@pki.add("pki renew rig-1")
def renew(
    name: Annotated[
        str,
        argument(
            "NAME", "Name of a person, a rig or a router, as in `armrig pki list`, such as rig-1."
        ),
    ],
    issuing: Annotated[_Issuing, group(_Issuing, ("directory", "days", "json"))],
) -> None:
    """Renew the key and the certificate of a rig, a router or a person."""
    from armrig.lab.pki import renew as renewed

    _say(renewed(issuing.directory, name, days=issuing.days), json=issuing.json)


@pki.add("pki revoke anna")
def revoke(
    name: Annotated[
        str, argument("NAME", "Name of a person or a rig, as in `armrig pki list`, such as rig-1.")
    ],
    directory: Directory = _PKI,
    json: Json = False,
) -> None:
    """Revoke all rights of a name permanently."""
    from armrig.lab.pki import ACCESS_LIST
    from armrig.lab.pki import revoke as revoked

    revoked(directory, name)
    if json:
        print_json({"name": name, "revoked": True})
        return
    echo(
        f"{name}: revoked in {directory / ACCESS_LIST}; this takes effect when the daemons of the "
        "rigs have this file and are restarted"
    )


@pki.add("pki list", "list")
def list_issued(directory: Directory = _PKI, json: Json = False) -> None:
    """List the certificates with name, purpose and expiry date."""
    from armrig.lab.pki import issued

    found = issued(directory)
    if json:
        print_json([{**i._asdict(), "path": str(i.path)} for i in found])
        return
    for one in found:
        echo(f"{one.name:40} {one.role:10} until {_day(one.expires)}")
    if not found:
        echo(f"{directory}: no certificates yet")


def _say(issued: Issued, *, json: bool) -> None:
    if json:
        print_json({**issued._asdict(), "path": str(issued.path)})
        return
    echo(f"{issued.path}: {issued.name}, {issued.role}, until {_day(issued.expires)}")
    named = _USES.get(issued.role, "set it as [client] certificate")
    echo(f"the file contains the key, so only the owner of the file may read it; {named}")


def _day(when: datetime) -> str:
    return f"{when:%Y-%m-%d}"


def router(
    listen: str = chosen("tls/0.0.0.0:7447", "--listen ENDPOINT", "Endpoint for rigs and clients."),
    certificate: Path = chosen(
        Path("router.pem"),
        "--certificate",
        "Certificate file of the router, from `armrig pki router`.",
    ),
    names: Path = chosen(Path("access.toml"), "--names", "Access list, from `armrig pki`."),
) -> None:
    """Run the router of a lab, until Ctrl-C. Clients reach the rigs through it.

    A rig connects if its configuration names the router in [access]. A client connects with
    --connect. The access list contains the rights of each name. The router keeps no state and may
    be restarted at any time: rigs, clients and recorders connect again by themselves.
    """
    with until_signal() as ended:
        from armrig.lab.router import open_router

        session, people = open_router(listen, certificate, names)
        with session:
            inform(
                f"router at {listen}: {len(people.rigs)} rigs, {len(people.operators)} may drive "
                f"and {len(people.observers)} may watch; Ctrl-C ends the router"
            )
            ended.wait()
