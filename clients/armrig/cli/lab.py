"""The commands that show a rig live: lab, which starts it with its daemon, and dashboard."""

from __future__ import annotations

import os
import sys
import time
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from math import degrees, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from armrig_core.process.loading import end_at_ctrl_c
from armrig_core.process.printable import printable
from armrig_core.process.signal_pipe import until_signal

from armrig.cli.next_step import naming, next_line
from armrig.cli.options import Connect, Json, RigId, chosen, option
from armrig.cli.printing import echo, folded, inform, print_json, takes_styles

if TYPE_CHECKING:
    import subprocess

    from armrig_core.commands.commands import StatusReport
    from rich.text import Text

    from armrig.dashboard.serving import Served
    from armrig.rig.client import Rig

Port = Annotated[str | None, option("--port DEVICE", "Serial port of the rig.", "an emulated rig")]
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")
_STATUS_INTERVAL_S = 0.5
_VIEW_INTERVAL_S = 0.1
_BLANK = "–"


class _Lab(NamedTuple):
    """Rig and page of a lab."""

    rig: str
    """Port of the rig, or "an emulated rig"."""
    url: str
    """URL of the dashboard; "" without a dashboard."""


def lab(
    port: Port = None,
    config: Path | None = chosen(
        None, "--config TOML", "Configuration file, in place of the installed files."
    ),
    rig: RigId = "1",
    page: bool = chosen(
        True,
        "--dashboard/--no-dashboard",
        "Also serve the dashboard, and open it if there is a screen; not with --json.",
    ),
    json: Json = False,
) -> None:
    """Start a rig with its daemon, and show it live until Ctrl-C.

    Without --port the rig is emulated. In a second terminal, commands such as `armrig collect` use
    this rig (with --rig, if it is not rig 1). At the end the motor is at 0 V.

    With --json the command prints a line at each change of the phase, with the fields of
    `armrig status --json`. In phase "safe" the rig is ready.
    """
    what = "an emulated rig" if port is None else port
    if not json:
        inform(f"starting {what} …", dim=True)
    import platformdirs

    from armrig.rig.client import Rig
    from armrig.rig.local_daemon import running

    log = Path(platformdirs.user_state_dir("armrig")) / f"lab-{rig}.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    arguments = ["--rig", rig, *(["--emulate"] if port is None else ["--port", port])]
    arguments += [] if config is None else ["--config", str(config)]
    with (
        running(arguments, rig=rig, log=log) as daemon,
        Rig(rig) as opened,
        _page(rig) if page and not json else nullcontext("") as url,
    ):
        try:
            _show(opened, daemon, log, _Lab(what, url), json=json)
        except KeyboardInterrupt:
            inform("ending: the motor goes to 0 V")
            raise


@contextmanager
def _page(rig: str) -> Iterator[str]:
    """Serve the dashboard, and open it in a browser if there is a screen."""
    from armrig.dashboard.serving import Settings, dashboard

    with dashboard(Settings(rig=rig)) as served:
        if sys.stdout.isatty() and any(name in os.environ for name in _SCREENS):
            webbrowser.open(served.browser_url)
        yield served.url


def _show(rig: Rig, daemon: subprocess.Popen[bytes], log: Path, lab: _Lab, *, json: bool) -> None:
    """Print a message when the rig is ready; on a terminal, show the newest sample live."""
    from armrig.rig.local_daemon import require_running

    shown = told = ""
    status, asked_s = rig.status(), time.monotonic()
    # Computed once: the commands of later recordings print their own next command.
    after = next_line("lab chassis" if status.arm_removed else "lab", rig=naming(status.rig))
    with rig.arrivals("sample") as newest, _view(json=json) as (say, draw):
        sample = None
        while True:
            require_running(daemon, log)
            if time.monotonic() - asked_s >= _STATUS_INTERVAL_S:
                status, asked_s = rig.status(), time.monotonic()
            sample = (newest() or [sample])[-1]
            how = f"{status.phase} {status.reason} {status.line}"
            now = how if json else _sentence(status, lab, after)
            if now and now != told:
                say(status if json else now)
                told = now
            if (view := _lines(status, sample)) != shown:
                draw(view)
                shown = view
            time.sleep(_VIEW_INTERVAL_S)


def _sentence(status: StatusReport, lab: _Lab, after: str) -> str:
    """Return a message: the rig is ready, or has a problem; "" if the rig is not yet ready."""
    if status.phase == "safe":
        alone = "; the arm is removed ([arm] removed)" if status.arm_removed else ""
        page = f"in a browser: {lab.url}\n" if lab.url else ""
        return (
            f"rig ready, 0 V: {lab.rig}, rig {status.rig}; Ctrl-C ends the lab\n{page}"
            f"recordings go to {status.recordings}{alone}\n"
            f"in a second terminal:\n{after}"
        )
    if status.reason:
        from armrig.rig.replies import reset_command

        return f"{status.reason}; {status.remedy}, then {reset_command(status.rig, None)}"
    return f"not ready: {status.line}; Ctrl-C ends the lab" if status.line else ""


def _lines(status: StatusReport, sample: Any) -> str:
    """Return the live view: phase and owner, newest sample, and run."""
    who = f"owner {status.owner}" if status.owner else "no owner"
    lines = [f"rig {status.rig}: {status.phase}, {who}"]
    if sample is not None:
        lines.append(
            f"u {sample.u_applied_v:.3f} V   theta_1 {_angle(sample.theta_1_rad)}   "
            f"alpha {_angle(sample.alpha_rad)}"
        )
    last = status.last_run
    if last is not None:
        how = f"recorded, {last.outcome}" if last.finished else "recording"
        lines.append(f"{how}: {last.samples} samples, {Path(last.recording).name}")
    return "\n".join(lines)


def _angle(x: float) -> str:
    return f"{degrees(x):.1f}°" if isfinite(x) else _BLANK


def _between_words(text: str, columns: int) -> str:
    """Return the text, folded to the terminal's width; lines that the user copies stay unfolded."""
    lines = printable(text, keep="\n").splitlines()
    return "\n".join(
        x if x.startswith(("next: ", "in a browser: ")) else folded(x, columns) for x in lines
    )


def _headed(text: Text) -> Text:
    if takes_styles():
        text.stylize("bold", 0, len(text.plain.partition("\n")[0]))
    return text


@contextmanager
def _view(*, json: bool) -> Iterator[tuple[Callable[[Any], None], Callable[[str], None]]]:
    """Yield two functions: print a line, and draw the live view on a terminal."""
    if json or not sys.stdout.isatty():
        yield print_json if json else echo, lambda _: None
        return
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console = Console()
    with Live(console=console, refresh_per_second=10, transient=True) as live:
        yield (
            lambda text: console.print(
                _headed(Text(_between_words(text, console.width))), soft_wrap=True
            ),
            lambda text: live.update(Text(_between_words(text, console.width))),
        )


def dashboard(
    rig: RigId = "1",
    connect: Connect = None,
    port: int | None = chosen(
        None, "--port", "TCP port on this machine.", "8807, or a free one", min=1, max=65_535
    ),
    browser: bool = chosen(False, "--open", "Open the page in the browser."),
    share: bool = chosen(
        False, "--share", "Let visitors on this network watch and stop the rig, over TLS."
    ),
    for_foxglove: bool = chosen(
        False, "--foxglove", "Also serve the streams to Foxglove on this machine."
    ),
    json: Json = False,
) -> None:
    """Serve a page that shows and drives a rig, until Ctrl-C.

    Anybody who has the printed address may command the rig. With the address of --share, visitors
    may watch and stop the rig.

    With --json the command prints {"url": …, "shared_url": …, "foxglove": …, "layouts": …}.
    """
    if not json:
        inform("starting the dashboard …", dim=True)
    # `until_signal` only notes the first Ctrl-C, and the imports take seconds on a busy machine.
    has_loaded = end_at_ctrl_c("armrig")
    import armrig.dashboard.serving  # noqa: F401 - used below

    has_loaded()
    with until_signal() as ended, ExitStack() as opened:
        from armrig.dashboard.serving import Settings
        from armrig.dashboard.serving import dashboard as serving
        from armrig.dashboard.share import own_address

        address = own_address() if share else None
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
            _say_addresses(rig, served, streams, layouts)
        if browser:
            webbrowser.open(served.browser_url)
        ended.wait()


def _say_addresses(rig: str, served: Served, streams: str, layouts: str) -> None:
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
