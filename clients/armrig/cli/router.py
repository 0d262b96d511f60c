"""The command router, which connects clients to the rigs of a lab."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from armrig_core.signal_pipe import until_signal

from armrig.cli.options import inform

Listen = Annotated[
    str, typer.Option("--listen", metavar="ENDPOINT", help="Endpoint for rigs and clients.")
]
Certificate = Annotated[
    Path,
    typer.Option("--certificate", help="Certificate file of the router, from `armrig pki router`."),
]
Names = Annotated[Path, typer.Option("--names", help="Access list, from `armrig pki`.")]


def router(
    listen: Listen = "tls/0.0.0.0:7447",
    certificate: Certificate = Path("router.pem"),
    names: Names = Path("access.toml"),
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
