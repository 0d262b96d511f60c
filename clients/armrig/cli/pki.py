"""The commands on the certificates and the router of a lab: pki, router."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from armrig_core.process.options import CommandGroup, argument, group, option, preset
from armrig_core.process.signal_pipe import until_signal

from armrig.cli.options import Json
from armrig.cli.printing import (
    inform,
    print_result,
)
from armrig.numerics.quantities import plural

if TYPE_CHECKING:
    from armrig.lab.pki import Issued


pki = CommandGroup("Make certificates for rigs and for people on a network.", no_args_is_help=True)
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
    force: bool = preset(False, "Replace an existing file.")
    json: Json = False


Issuing = Annotated[_Issuing, group(_Issuing)]


@pki.add("pki ca")
def ca(
    directory: Directory = _PKI,
    days: Days = 3650,
    force: bool = preset(
        False, "Replace an existing authority; all its certificates become invalid."
    ),
    json: Json = False,
) -> None:
    """Make a certificate authority, which signs all certificates, and an empty access list."""
    from armrig.lab.pki import ACCESS_LIST, make_authority

    path = make_authority(directory, days=days, force=force)
    print_result(
        {"path": path},
        f"{path}: made; keep {path.with_suffix('.key')} private, because with it "
        "anybody can make operators",
        f"{directory / ACCESS_LIST}: the access list, still empty",
        json=json,
    )


@pki.add("pki rig 1 --host rig-1.lab.example.edu")
def rig(
    *,
    name: Annotated[str, argument("ID", "Id of the rig.")],
    host: list[str] | None = preset(
        None,
        "Host name or address that clients use; repeatable.",
        "none, clients connect through a router",
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
    _say_issued(issued, json=issuing.json)


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

    _say_issued(renewed(issuing.directory, name, days=issuing.days), json=issuing.json)


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
    effect = "this takes effect when the daemons of the rigs have this file and are restarted"
    text = f"{name}: revoked in {directory / ACCESS_LIST}; {effect}"
    print_result({"name": name, "revoked": True}, text, json=json)


@pki.add("pki list", "list")
def list_issued(directory: Directory = _PKI, json: Json = False) -> None:
    """List the certificates with name, purpose and expiry date."""
    from armrig.lab.pki import list_certificates

    certificates = list_certificates(directory)
    lines = [
        f"{certificate.name:40} {certificate.role:10} until {certificate.expires:%Y-%m-%d}"
        for certificate in certificates
    ]
    lines = lines or [f"{directory}: no certificates yet"]
    print_result([certificate._asdict() for certificate in certificates], *lines, json=json)


def _say_issued(issued: Issued, *, json: bool) -> None:
    use = _USES.get(issued.role, "set it as [client] certificate")
    print_result(
        issued._asdict(),
        f"{issued.path}: {issued.name}, {issued.role}, until {issued.expires:%Y-%m-%d}",
        f"the file contains the key, so only the owner of the file may read it; {use}",
        json=json,
    )


def router(
    listen: str = preset("tls/0.0.0.0:7447", "Endpoint for rigs and clients.", metavar="ENDPOINT"),
    certificate: Path = preset(
        Path("router.pem"), "Certificate file of the router, from `armrig pki router`."
    ),
    names: Path = preset(Path("access.toml"), "Access list, from `armrig pki`."),
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
                f"router at {listen}: {plural(len(people.rigs), 'rig')}, {len(people.operators)} "
                f"may drive and {len(people.observers)} may watch; Ctrl-C ends the router"
            )
            ended.wait()
