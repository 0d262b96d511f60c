"""The command router: the way to all rigs of a lab."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from armrig_core.signal_pipe import until_signal

from armrig.cli.options import tell

Listen = Annotated[
    str, typer.Option("--listen", metavar="ENDPOINT", help="Where rigs and people reach it.")
]
Certificate = Annotated[
    Path, typer.Option("--certificate", help="Its credential, by `armrig pki router`.")
]
Names = Annotated[Path, typer.Option("--names", help="The access list, by `armrig pki`.")]


def router(
    listen: Listen = "tls/0.0.0.0:7447",
    certificate: Certificate = Path("router.pem"),
    names: Names = Path("access.toml"),
) -> None:
    """Be the router of a lab, through which its rigs are reached, until Ctrl-C.

    A rig connects to it by [access] router of its configuration, people by --connect; who may do
    what says the access list. It keeps nothing, and may be started anew at any time: rigs, clients
    and recorders connect again by themselves.
    """
    with until_signal() as ended:
        from armrig.lab.router import open_router

        session, people = open_router(listen, certificate, names)
        with session:
            tell(
                f"router at {listen}: {len(people.rigs)} rigs, {len(people.operators)} may drive "
                f"and {len(people.observers)} may watch; Ctrl-C ends it"
            )
            ended.wait()
