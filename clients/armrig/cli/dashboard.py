"""The command dashboard, which serves a page that shows and drives a live rig."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Annotated

import typer
from armrig_core.loading import end_at_ctrl_c
from armrig_core.signal_pipe import SignalPipe, until_signal

from armrig.cli.options import Connect, Json, RigId, echo, inform, print_json

if TYPE_CHECKING:
    from armrig.dashboard.serving import Served

Port = Annotated[
    int | None,
    typer.Option(
        "--port",
        min=1,
        max=65_535,
        help="TCP port on this machine.",
        show_default="8807, or a free one",
    ),
]
Browser = Annotated[bool, typer.Option("--open", help="Open the page in the browser.")]
Share = Annotated[
    bool,
    typer.Option("--share", help="Let visitors on this network watch and stop the rig, over TLS."),
]
Foxglove = Annotated[
    bool, typer.Option("--foxglove", help="Also serve the streams to Foxglove on this machine.")
]


def dashboard(
    rig: RigId = "1",
    connect: Connect = None,
    port: Port = None,
    browser: Browser = False,
    share: Share = False,
    for_foxglove: Foxglove = False,
    json: Json = False,
) -> None:
    """Serve a page that shows and drives a rig, until Ctrl-C.

    Anybody who has the printed address may command the rig. With the address of --share, visitors
    may watch and stop the rig.

    With --json the command prints {"url": …, "shared_url": …, "foxglove": …, "layouts": …}.
    """
    if not json:
        inform("starting the dashboard …", dim=True)
    has_loaded = end_at_ctrl_c("armrig")  # these imports take seconds on a busy machine
    import_module("armrig.dashboard.serving")
    has_loaded()
    with until_signal() as ended:
        _serve(
            *(ended, rig, connect, port),
            browser=browser,
            share=share,
            for_foxglove=for_foxglove,
            json=json,
        )


def _serve(
    ended: SignalPipe,
    rig: str,
    connect: str | None,
    port: int | None,
    *,
    browser: bool,
    share: bool,
    for_foxglove: bool,
    json: bool,
) -> None:
    """Serve the dashboard until the process receives a signal."""
    import webbrowser
    from contextlib import ExitStack

    from armrig.dashboard.serving import Settings
    from armrig.dashboard.serving import dashboard as serving
    from armrig.dashboard.share import own_address

    address = own_address() if share else None
    with ExitStack() as opened:
        settings = Settings(rig=rig, connect=connect, port=port, share=address)
        served = opened.enter_context(serving(settings))
        streams = layouts = ""
        if for_foxglove:
            from armrig.dashboard.foxglove import LAYOUTS, foxglove

            layouts = str(LAYOUTS)
            streams = opened.enter_context(foxglove(rig=rig, connect=connect))
        if json:
            urls = {"url": served.url, "shared_url": served.shared_url or None}
            print_json(urls | {"foxglove": streams or None, "layouts": layouts or None})
        else:
            _say(rig, served, streams, layouts)
        if browser:
            webbrowser.open(served.browser_url)
        ended.wait()


def _say(rig: str, served: Served, streams: str, layouts: str) -> None:
    """Print the addresses of the page, each with the rights that it gives."""
    echo(f"rig {rig}: {served.url}")
    echo("anybody with this address may command the rig; Ctrl-C ends the dashboard")
    if served.shared_url:
        from armrig.dashboard.share import qr_code

        echo(f"to watch and stop: {served.shared_url}")
        echo(qr_code(served.shared_url))
        echo("the browser warns about the certificate, which this machine made; its SHA-256 is")
        echo(served.fingerprint)
    if streams:
        echo(f"for Foxglove, to watch: {streams}")
        echo(f"layouts for Foxglove and PlotJuggler: {layouts}")
