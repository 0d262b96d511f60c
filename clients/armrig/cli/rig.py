"""The commands about a rig: status, watch, stop, reset, note, lab, dashboard."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from itertools import chain, islice
from math import degrees, isfinite, nan
from pathlib import Path
from shlex import quote
from threading import Event
from typing import TYPE_CHECKING, Annotated, Any

from armrig_core.process.loading import end_at_ctrl_c
from armrig_core.process.options import argument, preset
from armrig_core.process.printable import plural, printable
from armrig_core.process.signal_pipe import until_signal
from armrig_core.rig.channels import DeviceChannel, channel
from armrig_core.rig.emulated import SOCKET_PREFIX
from armrig_core.telemetry.topics import PLAYED
from armrig_protocol.messages import Flag

import armrig
from armrig.cli.options import Connect, Json, RigId
from armrig.cli.printing import (
    echo,
    fold,
    inform,
    print_json,
    print_result,
    print_table,
    say,
    takes_styles,
    tell_error,
)

if TYPE_CHECKING:
    from armrig_core.commands.commands import StatusReport
    from armrig_core.telemetry.telemetry import Sample
    from rich.text import Text

    from armrig.dashboard.serving import Served
    from armrig.rig.client import Rig
    from armrig.rig.session import NoReplyError

_DRIVEN = frozenset({"armed", "active"})
"""Phases in which an input may drive the motor."""
_STOP_REPORT_S = 1.0
"""Longest wait, in s, for the status that follows a stop."""
_STATUS_INTERVAL_S = 0.02


def status(rig: RigId = "1", connect: Connect = None, json: Json = False) -> None:
    """Show the state of the daemon and the rig."""
    from armrig.rig.status import status_rows

    with open_rig(rig, connect) as opened:
        report = opened.status()
    if json:
        print_json(report)
        return
    print_table(*status_rows(report))
    if report.phase == "safe" and not report.line:
        _say_next(_next_of(report), rig, connect, report)


def watch(
    rig: RigId = "1",
    connect: Connect = None,
    count: int | None = preset(
        None, "Number of samples and gaps after which the command ends.", "no limit", min=1
    ),
    json: Json = False,
) -> None:
    """Show the live samples and the gaps until Ctrl-C.

    With --json each line has the fields of a sample, or of a gap: k_first, count, reason and more.
    """
    with open_rig(rig, connect) as opened:
        samples: Iterator[Any] = islice(opened.stream("sample"), count)
        with suppress(KeyboardInterrupt):  # Ctrl-C is the normal end
            if json:
                for sample in samples:
                    is_gap = isinstance(sample, armrig.LiveGap)
                    print_json(sample if is_gap else sample._asdict())
                return
            if rig.startswith(PLAYED):  # no daemon, so no status: the samples have the names
                first = next(samples)
                channels, samples = _channels_of(first), chain([first], samples)
            else:
                channels = opened.status().described.channels
            with opened.arrivals("control") as decisions:
                _watch(samples, channels, DecisionNote(decisions))


def stop(
    rig: RigId = "1",
    connect: Connect = None,
    by: str = preset(
        "",
        "Name of the person who stops the rig, for the recording.",
        "this user's name",
        names="--owner",
    ),
    json: Json = False,
) -> None:
    """Stop the rig at 0 V, even if another person is the owner.

    The command prints the state of the motor after the stop, as the device reports it.

    With --json the command prints {"rig": "1", "stopped": true}. If the daemon of this machine is
    dead, the command runs `armrigd estop` instead, which stops the device itself. If nobody answers
    or the device does not confirm the stop, the exit code is 1.
    """
    from armrig.rig.session import NoReplyError

    try:
        with open_rig(rig, connect) as opened:
            opened.stop(by)
            after = "" if json else _state_after_stop(opened)
    except NoReplyError as err:
        after = f"motor: {_stop_without_daemon(rig, err)}"
    if json:
        print_json({"rig": rig, "stopped": True})
    else:
        say(f"rig {rig}, {after}", bold=True)


def _state_after_stop(rig: Rig) -> str:
    """Return the state of the motor or input, once a status reports that the run has ended."""
    status, end_s = None, time.monotonic() + _STOP_REPORT_S
    with suppress(armrig.RigError):  # the stop is confirmed: a missing status is no failed stop
        status = rig.status()
        while status.phase in _DRIVEN and time.monotonic() < end_s:
            time.sleep(_STATUS_INTERVAL_S)
            status = rig.status()
    name = "motor" if status is None or status.described.arm else "input"
    return f"{name}: {(status and status.motor) or 'stop sent'}"


def _stop_without_daemon(rig: str, err: NoReplyError) -> str:
    """Stop the device of a dead daemon, and return the state of the motor; raise if that fails."""
    from armrig_core.access.daemon_lock import daemon_at

    from armrig.rig.session import NoReplyError

    facts = daemon_at(err.endpoint)
    if facts is None:
        way_out = "whether the motor turns is unknown here; if it does, use the emergency switch"
        raise NoReplyError(f"{err}; {way_out}") from err
    if facts.is_alive:
        raise err
    dead = f"its daemon (process {facts.pid}) is dead"
    device = ("--port", facts.port, "--baud", str(facts.baud))
    done = subprocess.run(
        [sys.executable, "-m", "armrig_daemon", "estop", "--rig", rig, *device],
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise NoReplyError(f"rig {rig}: {dead}; {done.stderr.strip()}") from err
    return f"at 0 V by `armrigd estop`; {dead}; start it again, then `armrig reset`"


def reset(rig: RigId = "1", connect: Connect = None, json: Json = False) -> None:
    """Clear a latched fault. The rig is then at 0 V and has no owner.

    The fault remains if its cause remains; `armrig status` shows fault and cause.

    With --json the command prints {"rig": "1", "was_latched": true}, or false if no fault was
    latched.
    """
    with open_rig(rig, connect) as opened:
        was_latched = opened.reset()
    text = f"rig {rig} was reset" if was_latched else f"rig {rig}: no fault is latched"
    print_result({"rig": rig, "was_latched": was_latched}, text, json=json)
    if not json:
        _say_next("status", rig, connect)


def note(
    text: Annotated[str, argument("TEXT", "Text of the note, 1 to 500 characters.", False)],
    rig: RigId = "1",
    connect: Connect = None,
    owner: str = preset("", "Author of the note.", "this user's name"),
    json: Json = False,
) -> None:
    """Write a note into the current recording.

    `armrig info`, the report and the dashboard show the note.

    With --json the command prints {"rig": "1", "recorded": true}, or false if no run is being
    recorded.
    """
    with open_rig(rig, connect) as opened:
        is_recorded = opened.note(text, owner)
    missing = "no run is being recorded, so the note is not in a recording"
    text = f"rig {rig}: {'the note is in the recording' if is_recorded else missing}"
    print_result({"rig": rig, "recorded": is_recorded}, text, json=json)


def _next_of(status: StatusReport) -> str:
    """Return the name of the next command: the kind of rig decides."""
    if not status.described.arm:
        return "collect step other"
    return "collect greybox" if status.arm_removed else "collect step"


def _say_next(name: str, rig: str, connect: str | None, report: StatusReport | None = None) -> None:
    from armrig.cli.next_step import option_for_rig, say_next
    from armrig.recordings.files.origin import Origin

    origin = Origin.of_status(report) if report else None
    say_next(name, origin, rig=option_for_rig(rig, connect))


@contextmanager
def open_rig(rig: str, connect: str | None) -> Iterator[Any]:
    """Yield the rig; if the daemon refuses a request, the error names the command to type next."""
    from armrig.rig.replies import RefusedError, refusal_sentence, reset_command

    with armrig.Rig(rig, connect=connect) as opened:
        try:
            yield opened
        except RefusedError as err:
            raise RefusedError(refusal_sentence(err, reset_command(rig, connect))) from err


_Channels = Sequence[DeviceChannel]
_COLUMNS = (12, 10)
"""Widths of the columns of the channels."""


def _channels_of(sample: Sample) -> _Channels:
    """Return the channels that the names of a sample's fields contain."""
    names = sample._fields
    fields = ((names[i], names[i + 4].removesuffix("_counts")) for i in (4, 5))
    used = ((field, name) for field, name in fields if not field.startswith("unused_"))
    return [channel(i, name, field[len(name) + 1 :]) for i, (field, name) in enumerate(used)]


def _heading(channels: _Channels) -> str:
    headings = (
        f"{f'{c.name} [{_degrees(c)[0]}]':>{width}}"
        for c, width in zip(channels, _COLUMNS, strict=False)
    )
    return f"{'k':>10} {'u [V]':>8} {' '.join(headings)} {'late [µs]':>10}"


def _degrees(channel: DeviceChannel) -> tuple[str, float]:
    """Return the unit in which a person reads a channel, and the factor to this unit."""
    return ("°", degrees(1.0)) if channel.unit == "rad" else (channel.unit, 1.0)


class DecisionNote:
    """Text on the run in control that a sample belongs to, from the stream `control`."""

    def __init__(self, decisions: Callable[[], list[Any]]) -> None:
        """Store the function that returns the new messages of the stream."""
        from armrig.recordings.decisions import DecisionCounts

        self._decisions = decisions
        self._waiting: list[Any] = []  # a decision comes before its sample
        self._none = self._counts = DecisionCounts()
        self._r = nan

    def of(self, sample: Sample) -> str:
        """Return r and the share of decisions at a limit; "" for a sample without a decision."""
        self._waiting += self._decisions()
        due = [decision for decision in self._waiting if decision.k <= sample.k]
        self._waiting = self._waiting[len(due) :]
        if not sample.flags & Flag.RUN:
            self._counts = self._none
            return ""
        if due:
            self._counts, self._r = self._counts.with_messages(due), due[-1].r
        return f" r {self._r:.4g}, {self._counts.at_limit}" if self._counts.decisions else ""


def _watch(samples: Any, channels: _Channels, note: DecisionNote) -> None:
    """Show the newest sample on a terminal; print a line for each sample for a program."""

    def line(sample: Any) -> str:
        is_gap = isinstance(sample, armrig.LiveGap)
        return _sample_line(sample, channels) + ("" if is_gap else note.of(sample))

    if not sys.stdout.isatty():
        echo(_heading(channels))
        for sample in samples:
            echo(line(sample))
        return
    from rich.console import Console
    from rich.live import Live

    with Live(console=Console(), refresh_per_second=10) as live:
        for sample in samples:
            live.update(f"{_heading(channels)}\n{line(sample)}")


def _sample_line(sample: Any, channels: _Channels) -> str:
    if isinstance(sample, armrig.LiveGap):
        return f"{sample.k_first:>10} {sample.count} missing: {sample.reason}"
    late = (sample.t_host_ns - sample.t_sched_ns) / 1e3
    values = zip(channels, (sample.value_0, sample.value_1), _COLUMNS, strict=False)
    readings = (f"{y * _degrees(c)[1]:>{width}.2f}" for c, y, width in values)
    return f"{sample.k:>10} {sample.u_applied_v:>8.3f} {' '.join(readings)} {late:>10.1f}"


_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")
_LAB_STATUS_INTERVAL_S = 0.5
_VIEW_INTERVAL_S = 0.1
_BLANK = "–"


def lab(
    port: str | None = preset(
        None, "Serial port of the rig.", "none, the rig is emulated", metavar="DEVICE"
    ),
    config: Path | None = preset(
        None, "Configuration file to use instead of the installed files.", metavar="TOML"
    ),
    rig: RigId = "1",
    rig_file: Path | None = preset(
        None,
        "Description of the rig: a file, or a name of `armrig rigs`.",
        "the configuration's [rig] file, otherwise the arm",
        metavar="TOML",
    ),
    page: bool = preset(
        True,
        "Also serve the dashboard, and open it if there is a screen; not with --json.",
        "--dashboard",
        names="--dashboard/--no-dashboard",
    ),
    json: Json = False,
) -> None:
    """Start a rig with its daemon, and show it live until Ctrl-C.

    Without --port the rig is emulated. In a second terminal, commands such as `armrig collect` use
    this rig (with --rig, if it is not rig 1). At the end the motor is at 0 V.

    With --json the command prints a line at each change of the phase, with the fields of
    `armrig status --json`. In phase "safe" the rig is ready.
    """
    from armrig.cli.next_step import option_for_rig
    from armrig.lab.avrdude import usb_boards

    source = "an emulated rig" if port is None else port
    if not json:
        inform(f"starting {source} …", dim=True)
    import platformdirs

    from armrig.lab.avrdude import refuse_leonardo
    from armrig.rig.local_daemon import running

    if port is not None:
        refuse_leonardo(port, usb_boards())
    log = Path(platformdirs.user_state_dir("armrig")) / f"lab-{rig}.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    flags = {"--port": port, "--config": config, "--rig-file": rig_file}
    options = [str(x) for pair in flags.items() if pair[1] is not None for x in pair]
    emulated = ["--emulate"] if port is None else []
    again = f"armrig lab{option_for_rig(rig)}{''.join(f' {quote(option)}' for option in options)}"
    with (
        running(["--rig", rig, *emulated, *options], rig=rig, log=log) as daemon,
        armrig.Rig(rig) as opened,
        _page(rig, again, rig_file) if page and not json else nullcontext("") as url,
    ):
        try:
            _show(opened, daemon, log, source, url, json=json)
        except armrig.RigError as err:
            if not url or daemon.poll() is None:
                raise
            tell_error(f"{err}; the page stays until Ctrl-C; in another terminal: {again}")
            Event().wait()  # Ctrl-C ends it
        except KeyboardInterrupt:
            inform("ending: the motor goes to 0 V")
            raise


@contextmanager
def _page(rig: str, command: str, rig_file: Path | None = None) -> Iterator[str]:
    """Serve the dashboard, and open it in a browser if there is a screen."""
    import webbrowser

    from armrig.dashboard.serving import DashboardSettings, dashboard

    settings = DashboardSettings(rig=rig, command=command, starts_daemon=True, rig_file=rig_file)
    with dashboard(settings) as served:
        if sys.stdout.isatty() and any(name in os.environ for name in _SCREENS):
            webbrowser.open(served.browser_url)
        yield served.url


def _show(
    rig: Rig, daemon: subprocess.Popen[bytes], log: Path, source: str, url: str, *, json: bool
) -> None:
    """Print a message when the rig is ready; on a terminal, show the newest sample live."""
    from armrig.cli.next_step import next_line
    from armrig.recordings.files.origin import Origin
    from armrig.rig.local_daemon import require_running
    from armrig.rig.session import NoReplyError

    last_view = last_message = ""
    status, asked_s = rig.status(), time.monotonic()
    # Computed once: the commands of later recordings print their own next command.
    after = next_line(_next_of(status), Origin.of_status(status))
    with rig.arrivals("sample") as newest, _view(json=json) as (say, draw):
        sample, silence = None, ""
        while True:
            require_running(daemon, log)
            if time.monotonic() - asked_s >= _LAB_STATUS_INTERVAL_S:
                try:
                    status, silence = rig.status(), ""
                except NoReplyError as err:
                    require_running(daemon, log)
                    if not url:
                        raise
                    silence = f"{err}; Ctrl-C ends the lab"  # a page outlives a frozen daemon
                asked_s = time.monotonic()
            sample = (newest() or [sample])[-1]
            how = f"{status.phase} {status.reason} {status.line}"
            now = how if json else silence or _sentence(status, source, url, after, log)
            if now and now != last_message:
                say(status if json else now)
                last_message = now
            if (view := _lines(status, sample)) != last_view:
                draw(view)
                last_view = view
            time.sleep(_VIEW_INTERVAL_S)


def _sentence(status: StatusReport, source: str, url: str, after: str, log: Path) -> str:
    """Return a message: the rig is ready, or has a problem; "" if the rig is not yet ready."""
    if status.phase == "safe":
        alone = "; the arm is removed ([arm] removed)" if status.arm_removed else ""
        page = f"in a browser: {url}\n" if url else ""
        return (
            f"rig ready, 0 V: {source}, rig {status.rig}; Ctrl-C ends the lab\n{page}"
            f"recordings go to {status.recordings}{alone}\n"
            f"in a second terminal:\n{after}"
        )
    if status.reason:
        from armrig.rig.replies import reset_command

        return f"{status.reason}; {status.remedy}, then {reset_command(status.rig, None)}"
    # The emulator prints there why it ended, such as a wrong model file.
    why = f"; {log} says why" if status.line.startswith(SOCKET_PREFIX) else ""
    return f"not ready: {status.line}{why}; Ctrl-C ends the lab" if status.line else ""


def _lines(status: StatusReport, sample: Any) -> str:
    """Return the live view: phase and owner, newest sample, and run."""
    who = f"owner {status.owner}" if status.owner else "no owner"
    lines = [f"rig {status.rig}: {status.phase}, {who}"]
    if sample is not None:
        channels = status.described.channels
        values = zip(channels, (sample.value_0, sample.value_1), strict=False)
        readings = [f"{c.name} {_reading_text(c, y)}" for c, y in values]
        lines.append("   ".join([f"u {sample.u_applied_v:.3f} V", *readings]))
    last = status.last_run
    if last is not None:
        how = f"recorded, {last.outcome}" if last.finished else "recording"
        lines.append(f"{how}: {plural(last.samples, 'sample')}, {Path(last.recording).name}")
    return "\n".join(lines)


def _reading_text(channel: DeviceChannel, x: float) -> str:
    """Return a value with its unit; an angle is in degrees."""
    if not isfinite(x):
        return _BLANK
    return f"{degrees(x):.1f}°" if channel.unit == "rad" else f"{x:.4g} {channel.unit}"


def _between_words(text: str, columns: int) -> str:
    """Return the text, folded to the terminal's width; lines that the user copies stay unfolded."""
    lines = printable(text, keep="\n").splitlines()
    return "\n".join(
        x if x.startswith(("next: ", "in a browser: ")) else fold(x, columns) for x in lines
    )


def _embolden(text: Text) -> Text:
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
                _embolden(Text(_between_words(text, console.width))), soft_wrap=True
            ),
            lambda text: live.update(Text(_between_words(text, console.width))),
        )


def dashboard(
    rig: RigId = "1",
    connect: Connect = None,
    port: int | None = preset(
        None,
        "TCP port of the page on this machine.",
        "8807 if it is free, otherwise a free port",
        min=1,
        max=65_535,
    ),
    browser: bool = preset(False, "Open the page in the browser.", names="--open"),
    share: bool = preset(False, "Let visitors on this network watch and stop the rig, over TLS."),
    for_foxglove: bool = preset(
        False, "Also serve the streams to Foxglove on this machine.", names="--foxglove"
    ),
    json: Json = False,
) -> None:
    """Serve a page that shows and drives a rig, until Ctrl-C.

    Anybody who has the printed address may command the rig. With the address of --share, visitors
    may watch and stop the rig.

    With --json the command prints {"url": …, "shared_url": …, "foxglove": …, "layouts": …}.
    """
    from armrig_core.rig.description import builtin

    from armrig.dashboard.serving import DashboardSettings

    if not json:
        inform("starting the dashboard …", dim=True)
    # `until_signal` only notes the first Ctrl-C, and the imports take seconds on a busy machine.
    has_loaded = end_at_ctrl_c("armrig")
    from armrig.dashboard.serving import dashboard as serving

    has_loaded()
    with until_signal() as ended, ExitStack() as opened:
        from armrig.dashboard.share import own_address

        address = own_address() if share else None
        settings = DashboardSettings(rig=rig, connect=connect, port=port, share=address)
        served = opened.enter_context(serving(settings))
        streams = written = ""
        if for_foxglove:
            import platformdirs

            from armrig.dashboard.foxglove import foxglove, layouts

            described = builtin("arm")  # if no daemon answers yet
            with suppress(armrig.RigError), armrig.Rig(rig, connect=connect) as live:
                described = live.status().described
            folder = Path(platformdirs.user_state_dir("armrig")) / f"layouts-{rig}"
            folder.mkdir(parents=True, exist_ok=True)
            for name, text in layouts(rig, described).items():
                (folder / name).write_text(text, encoding="utf-8")
            written = str(folder)
            streams = opened.enter_context(foxglove(described, rig=rig, connect=connect))
        if json:
            urls = {"url": served.url, "shared_url": served.shared_url or None}
            print_json(urls | {"foxglove": streams or None, "layouts": written or None})
        else:
            _say_addresses(rig, served, streams, written)
        if browser:
            import webbrowser

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
