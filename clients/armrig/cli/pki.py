"""The command `armrig pki`: certificates for rigs on a network and for their users."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armrig.cli.options import Json, echo, print_json

if TYPE_CHECKING:
    from armrig.lab.pki import Issued

_HELP = {"help_option_names": ["-h", "--help"]}
app = typer.Typer(
    help="Make certificates for rigs and for people on a network.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
Directory = Annotated[
    Path, typer.Option("--directory", help="Folder of the authority, whose key must stay private.")
]
Days = Annotated[int, typer.Option("--days", min=1, max=36500, help="Validity, in days.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing file.")]
ForceAuthority = Annotated[
    bool,
    typer.Option(
        "--force", help="Replace an existing authority; all its certificates become invalid."
    ),
]
Operator = Annotated[
    str,
    typer.Argument(
        metavar="NAME",
        help="Name of a person: a-z, 0-9 and -; the rig shows this name as the owner.",
    ),
]
Observer = Annotated[str, typer.Argument(metavar="NAME", help="Name of a person: a-z, 0-9 and -.")]
Renewed = Annotated[
    str,
    typer.Argument(
        metavar="NAME",
        help="Name of a person, a rig or a router, as in `armrig pki list`, such as rig-1.",
    ),
]
Revoked = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="Name of a person or a rig, as in `armrig pki list`, such as rig-1."
    ),
]
_PKI = Path("pki")


@app.command(context_settings=_HELP, epilog="Example: armrig pki ca")
def ca(
    directory: Directory = _PKI,
    days: Days = 3650,
    force: ForceAuthority = False,
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


@app.command(
    context_settings=_HELP, epilog="Example: armrig pki rig 1 --host rig-1.lab.example.edu"
)
def rig(
    name: Annotated[str, typer.Argument(metavar="ID", help="Id of the rig.")],
    host: Annotated[
        list[str] | None,
        typer.Option(
            "--host",
            help="Host name or address that clients use; repeatable.",
            show_default="none, only through a router",
        ),
    ] = None,
    directory: Directory = _PKI,
    days: Days = 365,
    force: Force = False,
    json: Json = False,
) -> None:
    """Make the certificate of a rig's daemon, for clients and for a router."""
    from armrig.lab.pki import issue_to_rig

    issued = issue_to_rig(directory, name, host or (), days=days, force=force)
    _say(issued, "[access] certificate", json)


@app.command(context_settings=_HELP, epilog="Example: armrig pki router --host lab.example.edu")
def router(
    host: Annotated[
        list[str],
        typer.Option("--host", help="Host name or address that rigs and people use; repeatable."),
    ],
    directory: Directory = _PKI,
    days: Days = 365,
    force: Force = False,
    json: Json = False,
) -> None:
    """Make the certificate of a lab's router."""
    from armrig.lab.pki import issue_to_router

    _say(issue_to_router(directory, host, days=days, force=force), "armrig router's", json)


@app.command(context_settings=_HELP, epilog="Example: armrig pki operator anna")
def operator(
    name: Operator,
    directory: Directory = _PKI,
    days: Days = 365,
    force: Force = False,
    json: Json = False,
) -> None:
    """Make the certificate of a person who may drive and watch the rigs."""
    from armrig.lab.pki import issue_to_person

    issued = issue_to_person(directory, name, "operators", days=days, force=force)
    _say(issued, "[client] certificate", json)


@app.command(context_settings=_HELP, epilog="Example: armrig pki observer wall-screen")
def observer(
    name: Observer,
    directory: Directory = _PKI,
    days: Days = 365,
    force: Force = False,
    json: Json = False,
) -> None:
    """Make the certificate of a person who may watch the rigs."""
    from armrig.lab.pki import issue_to_person

    issued = issue_to_person(directory, name, "observers", days=days, force=force)
    _say(issued, "[client] certificate", json)


@app.command(context_settings=_HELP, epilog="Example: armrig pki renew rig-1")
def renew(
    name: Renewed,
    directory: Directory = _PKI,
    days: Days = 365,
    json: Json = False,
) -> None:
    """Renew the key and the certificate of a rig, a router or a person."""
    from armrig.lab.pki import renew as renewed

    issued = renewed(directory, name, days=days)
    where = {"rig": "[access] certificate", "router": "armrig router's"}
    _say(issued, where.get(issued.role, "[client] certificate"), json)


@app.command(context_settings=_HELP, epilog="Example: armrig pki revoke anna")
def revoke(name: Revoked, directory: Directory = _PKI, json: Json = False) -> None:
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


@app.command("list", context_settings=_HELP, epilog="Example: armrig pki list")
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


def _say(issued: Issued, key: str, json: bool) -> None:
    if json:
        print_json({**issued._asdict(), "path": str(issued.path)})
        return
    echo(f"{issued.path}: {issued.name}, {issued.role}, until {_day(issued.expires)}")
    named = f"set it as {key}" if key.startswith("[") else f"give it as {key} --certificate"
    echo(f"the file contains the key, so only the owner of the file may read it; {named}")


def _day(when: datetime) -> str:
    return f"{when:%Y-%m-%d}"
