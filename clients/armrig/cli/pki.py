"""The command `armrig pki`: certificates for a rig on the network and those who use it."""

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
    help="Make certificates for rigs, and for who may drive or watch them over the network.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
Directory = Annotated[
    Path, typer.Option("--directory", help="Folder of the authority; its key must stay private.")
]
Days = Annotated[int, typer.Option("--days", min=1, max=36500, help="How long it counts.")]
Force = Annotated[bool, typer.Option("--force", help="Replace the one that is there.")]
Name = Annotated[str, typer.Argument(help="Of a-z, 0-9 and -; the rig names whoever drives it so.")]
_PKI = Path("pki")


@app.command(context_settings=_HELP)
def ca(
    directory: Directory = _PKI, days: Days = 3650, force: Force = False, json: Json = False
) -> None:
    """Make an authority, which signs all others, and an empty access list."""
    from armrig.lab.pki import ACCESS_LIST, make_authority

    path = make_authority(directory, days=days, force=force)
    if json:
        print_json({"path": str(path)})
        return
    echo(f"{path}: made; whoever has {path.with_suffix('.key')} can make operators: keep it")
    echo(f"{directory / ACCESS_LIST}: who may do what, empty yet")


@app.command(context_settings=_HELP)
def rig(
    name: Annotated[str, typer.Argument(metavar="ID", help="Id of the rig.")],
    host: Annotated[
        list[str] | None,
        typer.Option(
            "--host",
            help="Name or address under which clients reach it.",
            show_default="none, only through a router",
        ),
    ] = None,
    directory: Directory = _PKI,
    days: Days = 365,
    force: Force = False,
    json: Json = False,
) -> None:
    """Make the certificate that a rig's daemon shows, to clients and to a router."""
    from armrig.lab.pki import issue_to_rig

    issued = issue_to_rig(directory, name, host or (), days=days, force=force)
    _say(issued, "[access] certificate", json)


@app.command(context_settings=_HELP)
def router(
    host: Annotated[
        list[str],
        typer.Option("--host", help="Name or address under which rigs and people reach it."),
    ],
    directory: Directory = _PKI,
    days: Days = 365,
    force: Force = False,
    json: Json = False,
) -> None:
    """Make the certificate that a lab's router shows."""
    from armrig.lab.pki import issue_to_router

    _say(issue_to_router(directory, host, days=days, force=force), "armrig router's", json)


@app.command(context_settings=_HELP)
def operator(
    name: Name,
    directory: Directory = _PKI,
    days: Days = 365,
    force: Force = False,
    json: Json = False,
) -> None:
    """Make the certificate of somebody who may drive the rigs, and watch."""
    from armrig.lab.pki import issue_to_person

    issued = issue_to_person(directory, name, "operators", days=days, force=force)
    _say(issued, "[client] certificate", json)


@app.command(context_settings=_HELP)
def observer(
    name: Name,
    directory: Directory = _PKI,
    days: Days = 365,
    force: Force = False,
    json: Json = False,
) -> None:
    """Make the certificate of somebody who may watch the rigs."""
    from armrig.lab.pki import issue_to_person

    issued = issue_to_person(directory, name, "observers", days=days, force=force)
    _say(issued, "[client] certificate", json)


@app.command(context_settings=_HELP)
def renew(
    name: Annotated[str, typer.Argument(help="As `armrig pki list` names it, such as rig-1.")],
    directory: Directory = _PKI,
    days: Days = 365,
    json: Json = False,
) -> None:
    """Make a new key and certificate for a rig, router or person before the old one expires."""
    from armrig.lab.pki import renew as renewed

    issued = renewed(directory, name, days=days)
    where = {"rig": "[access] certificate", "router": "armrig router's"}
    _say(issued, where.get(issued.role, "[client] certificate"), json)


@app.command(context_settings=_HELP)
def revoke(name: Name, directory: Directory = _PKI, json: Json = False) -> None:
    """Take all rights from a name, for good."""
    from armrig.lab.pki import ACCESS_LIST
    from armrig.lab.pki import revoke as revoked

    revoked(directory, name)
    if json:
        print_json({"name": name, "revoked": True})
        return
    echo(
        f"{name}: revoked in {directory / ACCESS_LIST}; it counts once that file is where the "
        "rigs' daemons read it, and they are started anew"
    )


@app.command("list", context_settings=_HELP)
def list_issued(directory: Directory = _PKI, json: Json = False) -> None:
    """Show who has a certificate, what for, and until when."""
    from armrig.lab.pki import issued

    found = issued(directory)
    if json:
        print_json([{**i._asdict(), "path": str(i.path)} for i in found])
        return
    for one in found:
        echo(f"{one.name:40} {one.role:10} until {_day(one.expires)}")
    if not found:
        echo(f"{directory}: nobody has a certificate yet")


def _say(issued: Issued, key: str, json: bool) -> None:
    if json:
        print_json({**issued._asdict(), "path": str(issued.path)})
        return
    echo(f"{issued.path}: {issued.name}, {issued.role}, until {_day(issued.expires)}")
    named = f"name it as {key}" if key.startswith("[") else f"give it as {key} --certificate"
    echo(f"it holds the key: only its owner may read it; {named}")


def _day(when: datetime) -> str:
    return f"{when:%Y-%m-%d}"
