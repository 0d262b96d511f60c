"""The command `armrigd`: run the daemon, emulate a rig, or print a configuration."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, NoReturn

import msgspec
import typer
from armrig_core.endpoint import distrust, endpoint, socket_directory
from armrig_core.held_up import held_up
from armrig_core.printable import printable
from armrig_core.recording_directory import installed
from armrig_core.volts import U_MAX_V
from armrig_protocol.messages import WATCHDOG_MAX_MS

from armrig_daemon.config import Config, Device

_START_S = 15.0  # on a busy machine a program takes seconds to load
# Nothing breaks when an emulated motor turns on, and a busy machine stalls its emulator, too.
_FOR_EMULATED: dict[str, dict[str, Any]] = {
    "device": {"watchdog_ms": WATCHDOG_MAX_MS},
    "emulator": {"tolerates_stalls": True},
}

app = typer.Typer(
    help="Drive a control laboratory's rig at a fixed sampling time.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@app.command()
def run(
    config: Annotated[
        Path | None, typer.Option(help="Configuration (TOML), in place of the installed ones.")
    ] = None,
    emulate: Annotated[bool, typer.Option("--emulate", help="Drive an emulated rig.")] = False,
    port: Annotated[str | None, typer.Option(help="Serial port.")] = None,
    rig: Annotated[str | None, typer.Option(help="Name of the rig: a-z, 0-9 and -.")] = None,
    parent: Annotated[int | None, typer.Option(hidden=True)] = None,
) -> None:
    """Run the daemon until SIGTERM or Ctrl-C; the motor ends at 0 V."""
    from armrig_daemon import config as configuration
    from armrig_daemon.loop.realtime import end_with_parent
    from armrig_daemon.service.service import Service

    if parent is not None:  # of `armrig lab`, which may be killed and cannot tell us then
        end_with_parent(parent)
    overrides: dict[str, dict[str, Any]] = {}
    below = _FOR_EMULATED if emulate else {}
    if port is not None:
        overrides["device"] = {"port": port}
    if rig is not None:
        overrides["rig"] = {"id": rig}
    paths = [config] if config is not None else installed()
    try:
        loaded = configuration.load(paths, os.environ, overrides, below=below)
        directory = configuration.recordings(loaded)
        where = endpoint(loaded.rig.id, PurePosixPath(_socket_directory()))
    except ValueError as err:
        _refuse(str(err))
    os.umask(0o027)  # the group may read a recording, and nobody but us change it
    if not emulate:
        raise typer.Exit(Service(loaded, where, directory).run())
    with _emulated(loaded) as (device, stalls_fd):
        raise typer.Exit(Service(device, where, directory, stalls_fd).run())


@app.command()
def emulate(
    port: Annotated[Path, typer.Option(help="Link to make; pyserial opens it as a port.")],
    config: Annotated[Path | None, typer.Option(help="TOML with a table [emulator].")] = None,
    trace: Annotated[
        Path | None, typer.Option(help="File for each change of the motor voltage.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all noise and of the boot ids.")] = None,
    baud: Annotated[int | None, typer.Option(help="Speed of the emulated wire.")] = None,
    settings: Annotated[str | None, typer.Option(hidden=True)] = None,
    stalls_fd: Annotated[int | None, typer.Option(hidden=True)] = None,
) -> None:
    """Emulate a rig behind a pseudo-terminal until SIGTERM or Ctrl-C."""
    from armrig_daemon.emulator.line import PortError
    from armrig_daemon.emulator.pty import emulate as run_emulator
    from armrig_daemon.emulator.settings import EmulatorSettings, load

    try:
        if settings is not None:  # from `armrigd run --emulate`, which we shall not outlive
            from armrig_daemon.loop.realtime import end_with_parent

            end_with_parent()
            chosen = msgspec.json.decode(settings, type=EmulatorSettings)
        else:
            chosen = EmulatorSettings() if config is None else load(config)
        given = {"seed": seed, "baud": baud}
        given = {key: value for key, value in given.items() if value is not None}
        chosen = msgspec.structs.replace(chosen, **given)
        started = "" if settings is not None else _started(port, chosen.baud)
        tell = _say_stall if stalls_fd is None else partial(_write_stall, stalls_fd)
        code = run_emulator(port, chosen, trace=trace, started=started, held_up=tell)
    except (ValueError, PortError) as err:
        _refuse(str(err))
    raise typer.Exit(code)


@app.command("config")
def show_config(
    example: Annotated[
        bool, typer.Option("--example", help="Print every key, commented out, with its default.")
    ] = False,
) -> None:
    """Print a complete configuration to begin with; redirect it into a file."""
    from armrig_daemon.configuration_reference import example as example_text

    if not example:
        _refuse("config: --example is needed: `armrigd config --example > armrig.toml`")
    typer.echo(example_text())


@app.command()
def virtual(
    directory: Annotated[Path, typer.Option(help="Where the recordings go.")],
    config: Annotated[
        Path | None, typer.Option(help="Configuration (TOML), in place of the installed ones.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**63 - 1, help="Of noise, names and times.")] = 1,
) -> None:
    """Play runs on an emulated rig in virtual time, and record them.

    Each line of the standard input is a run, as JSON: {"u": [1.5, 1.5, …], "experiment": "step"}.
    Each line of the standard output is a recording.

    The same seed, runs and configuration give the same bytes.
    """
    from armrig_daemon import config as configuration
    from armrig_daemon.service.virtual_service import (
        VirtualRunError,
        VirtualService,
        requests_of,
    )

    paths = [config] if config is not None else installed()
    try:
        loaded = configuration.load(paths, os.environ, {}, below=_FOR_EMULATED)
        service = VirtualService(loaded, directory.absolute(), seed=seed)
        for request in requests_of(sys.stdin.buffer.read()):
            typer.echo(service.record(request))
    except (ValueError, VirtualRunError, OSError) as err:
        _refuse(str(err))


def _started(port: Path, baud: int) -> str:
    """Return what a person is told of an emulated rig."""
    speed = "" if baud == Device().baud else f"ARMRIG_DEVICE_BAUD={baud} "
    return (
        f"armrigd: an emulated rig behind {port}, {baud} baud, 0 to {U_MAX_V:g} V; "
        f"drive it with `{speed}armrigd run --port {port}`, end it with Ctrl-C"
    )


def _say_stall(ns: int) -> None:
    """Tell a person how long the emulator was held up."""
    with suppress(OSError):  # nobody reads it any more
        print(f"armrigd: {held_up(ns)}", file=sys.stderr, flush=True)


def _write_stall(fd: int, ns: int) -> None:
    """Tell the daemon, which may be stalled itself: it is not waited for."""
    with suppress(OSError):
        os.write(fd, b"%d\n" % ns)


def _socket_directory() -> Path:
    """Return the directory of the sockets, made for this user and group alone."""
    path = Path(socket_directory(os.environ, uid=os.getuid(), temporary=tempfile.gettempdir()))
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.lstat()
    except OSError as err:
        _refuse(f"{path}: {err.strerror}; set XDG_RUNTIME_DIR to a directory of yours")
    if wrong := distrust(found, owners={os.getuid()}):
        # In a temporary directory anybody could have made it, and would sit on our socket.
        _refuse(f"{path}: {wrong}; set XDG_RUNTIME_DIR to a directory of yours")
    return path


@contextmanager
def _emulated(config: Config) -> Iterator[tuple[Config, int]]:
    """Start an emulator with these settings; give the configuration that drives it.

    And a descriptor of lines: for how many ns its device's clock stood still.
    """
    link = _socket_directory() / f"{config.rig.id}-{os.getpid()}.tty"
    settings = msgspec.structs.replace(config.emulator, baud=config.device.baud)
    program = [sys.executable, "-m", "armrig_daemon", "emulate", "--port", str(link)]
    program += ["--settings", msgspec.json.encode(settings).decode()]
    stalls_out, stalls_in = os.pipe()
    os.set_blocking(stalls_in, False)
    try:
        child = subprocess.Popen([*program, "--stalls-fd", str(stalls_in)], pass_fds=(stalls_in,))
    finally:
        os.close(stalls_in)
    try:
        until = time.monotonic() + _START_S
        while not link.exists():
            if child.poll() is not None or time.monotonic() > until:
                _refuse(f"the emulator did not start behind {link}")
            time.sleep(0.01)
        device = msgspec.structs.replace(config.device, port=str(link))
        yield msgspec.structs.replace(config, device=device), stalls_out
    finally:
        child.terminate()
        child.wait()
        os.close(stalls_out)


def _refuse(message: str) -> NoReturn:
    typer.echo(printable(f"armrigd: {message}", keep="\n"), err=True)
    raise typer.Exit(1)


def main() -> None:
    """Run the command line."""
    app()


if __name__ == "__main__":
    main()
