"""The command that serves one page over a live rig: dashboard."""

from __future__ import annotations

import threading
from typing import Annotated

import typer

from armrig.cli.options import Connect, Json, RigId, echo, print_json

Port = Annotated[
    int | None,
    typer.Option(
        "--port",
        min=1,
        max=65_535,
        help="Port on this machine.",
        show_default="8807, or a free one",
    ),
]
Browser = Annotated[bool, typer.Option("--open", help="Open it in the browser.")]


def dashboard(
    rig: RigId = "1",
    connect: Connect = None,
    port: Port = None,
    browser: Browser = False,
    json: Json = False,
) -> None:
    """Show a rig live in a browser, and drive it there, until Ctrl-C.

    The address that it prints may command the rig: who has it, may.

    With --json it prints {"url": …}.
    """
    import webbrowser

    from armrig.dashboard.serving import Settings
    from armrig.dashboard.serving import dashboard as serving

    with serving(Settings(rig=rig, connect=connect, port=port)) as served:
        if json:
            print_json({"url": served.url})
        else:
            echo(
                f"rig {rig}: {served.url}\nwho has this address may command the rig; Ctrl-C ends it"
            )
        if browser:
            webbrowser.open(served.url)
        threading.Event().wait()
