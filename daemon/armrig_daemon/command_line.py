"""The commands of `armrigd`."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import msgspec
import typer
from armrig_core.access.endpoint import endpoint, require_trusted, socket_directory
from armrig_core.errors import InputError, OperationError
from armrig_core.process.options import option, preset, with_options
from armrig_core.process.printable import brief, printable
from armrig_core.process.signal_pipe import block_signals
from armrig_core.rig.emulated import stall_sentence
from armrig_core.rig.volts import U_MAX_V
from armrig_protocol.messages import WATCHDOG_MAX_MS

from armrig_daemon.config import EX_CONFIG, Config
from armrig_daemon.config import DeviceTable as DeviceSettings

if TYPE_CHECKING:
    from armrig_core.process.line_writer import LineWriter

    from armrig_daemon.conformance.line import Line
    from armrig_daemon.conformance.rule import Rule
    from armrig_daemon.emulator.uno import Uno

# An emulated motor breaks nothing, and a busy machine stalls the emulator as well as the daemon.
_EMULATION_DEFAULTS: dict[str, dict[str, Any]] = {
    "device": {"watchdog_ms": WATCHDOG_MAX_MS},
    "emulator": {"tolerates_stalls": True},
}

_ConfigFile = Annotated[
    Path | None,
    option("--config", "Configuration file (TOML).", "the installed configuration files"),
]
_Port = Annotated[
    str | None,
    option("--port DEVICE", "Serial port of the device.", "the configuration's [device] port"),
]
_Rig = Annotated[
    str | None, option("--rig", "Id of the rig: a-z, 0-9 and -.", "the configuration's [rig] id")
]
_RigFile = Annotated[
    Path | None,
    option(
        "--rig-file",
        "Description of the rig: a file (TOML), or a name of `armrig rigs`.",
        "the configuration's [rig] file, otherwise the arm",
    ),
]
_System = Annotated[
    bool,
    option(
        "--system",
        "Read the machine's files only, including /etc/armrig/RIG.toml, as the service does.",
    ),
]
_Firmware = Annotated[
    bool,
    option(
        "--firmware",
        "Run the Uno's firmware in the simulator simavr; `make fil` in a checkout builds the "
        "necessary program, which no wheel contains.",
    ),
]
_Hex = Annotated[
    Path | None,
    option(
        "--hex",
        "Firmware for simavr (Intel HEX); implies --firmware.",
        "the shipped firmware",
    ),
]

app = typer.Typer(
    help="Drive a control laboratory's rig at a fixed sampling time.",
    context_settings={"help_option_names": ["--help", "-h"], "max_content_width": 100},
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@app.command()
@with_options
def run(
    config: _ConfigFile = None,
    emulate: bool = preset(False, "Drive an emulated rig."),
    port: _Port = None,
    rig: _Rig = None,
    rig_file: _RigFile = None,
    system: _System = False,
    parent: int | None = preset(None, "", hidden=True),
) -> None:
    """Run the daemon until SIGTERM or Ctrl-C.

    When the daemon has ended, the motor is at 0 V.
    """
    from armrig_daemon.service.host.emulated_rig import emulator_process

    try:
        from armrig_core.process.open_files import require

        # With less, the daemon would start, and die when numpy is loaded during the first arming.
        require("armrigd run", memory_mib=2048, files=64)
    except OperationError as err:
        _refuse(str(err), EX_CONFIG)
    with block_signals():  # Python may ignore an exception during an import
        from armrig_core.process.line_writer import LineWriter
        from armrig_core.process.realtime import end_with_parent
        from armrig_core.recording_file.recording_directory import directory_of
        from armrig_core.rig.description import require_model

        from armrig_daemon import config as configuration
        from armrig_daemon.service.host.systemd import Notifier
        from armrig_daemon.service.service import Service

    if parent is not None:  # the parent is `armrig lab`, which may be killed without a message
        end_with_parent(parent)
    notifier = Notifier(os.environ)
    below = _EMULATION_DEFAULTS if emulate else {}
    load = _configuration(config, port, rig, below, system=system, rig_file=rig_file)
    try:
        loaded = load()
        described = configuration.description_of(loaded)
        directory = directory_of(loaded.recording.directory)
        if emulate and not (described.arm or described.equations):
            require_model(described)
        where = endpoint(loaded.rig.id, PurePosixPath(_socket_directory()))
        _check_no_file(Path(where.partition("/")[2]))
    except ValueError as err:
        _refuse(str(err), EX_CONFIG)
    log = LineWriter()
    os.umask(0o027)  # the group may read a recording; only the daemon's user may change it
    of_systemd = notifier, load if notifier.is_asked else None
    if not emulate:
        service = Service(
            loaded, where, directory, None, *of_systemd, description=described, log=log
        )
        _end(service.run(), log)
    try:
        with emulator_process(loaded, _socket_directory(), log.relay()) as (device, stalls_fd):
            service = Service(
                device, where, directory, stalls_fd, *of_systemd, description=described, log=log
            )
            code = service.run()
    except OperationError as err:
        log.close()
        _refuse(str(err))
    _end(code, log)


def _end(code: int, log: LineWriter) -> NoReturn:
    """End the process before zenoh's threads use the ended interpreter, which would abort it.

    No stream is flushed, because a terminal may stand still.
    """
    log.close()
    os._exit(code)


@app.command()
@with_options
def estop(
    config: _ConfigFile = None,
    port: _Port = None,
    rig: _Rig = None,
    system: _System = False,
    baud: int = preset(0, "", hidden=True),
    after_failure: bool = preset(
        False, "Send ESTOP only if the daemon failed; for systemd's ExecStopPost."
    ),
) -> None:
    """Stop the motor of a rig whose daemon is dead: send ESTOP to the device.

    The device stays stopped until `armrig reset` or until it boots; some devices boot when a daemon
    opens their port. The exit code is 0 only if the device confirmed the stop within 1 s.

    If a daemon has opened the port, the command sends nothing: use `armrig stop`.
    """
    from armrig_core.process.journal import log_prefix

    from armrig_daemon.loop.estop import estop as send_estop
    from armrig_daemon.loop.link import LinkError, TakenPortError

    if after_failure and not _has_failed(os.environ):
        return
    try:
        # `armrig stop` knows port and speed: then no fault in a configuration prevents the stop.
        if not (port and baud):
            loaded = _configuration(config, port, rig, {}, system=system)()
            rig, port, baud = loaded.rig.id, loaded.device.port, loaded.device.baud
        stopped = send_estop(port, baud)
    except InputError as err:
        _refuse(f"estop: nothing sent: {err}", EX_CONFIG)
    except TakenPortError as err:
        _refuse(f"estop: nothing sent: {_holder(rig or '1', port or '', err)}")
    except LinkError as err:
        _refuse(f"estop: nothing sent: {err}; without a host, a device stops the motor by itself")
    if not stopped:
        _refuse(
            f"estop: sent to {port}, no answer: check that the motor stands still; "
            "without a host, a device stops the motor by itself"
        )
    begin = log_prefix("info", fd=1) or "armrigd: "
    typer.echo(f"{begin}estop: {port} is in ESTOP, 0 V; `armrig reset` ends ESTOP")


def _holder(rig: str, port: str, err: Exception) -> str:
    """Return a sentence on the holder of the device's port, and on the way to stop the motor."""
    from armrig_core.access.daemon_lock import absolute, read_facts

    where = Path(socket_directory(os.environ, uid=os.getuid(), temporary=tempfile.gettempdir()))
    with suppress(InputError, OSError):
        require_trusted(where.lstat(), owners={os.getuid()})
        facts = read_facts(where / f"{rig}.sock")
        if facts is not None and facts.is_alive and facts.port == absolute(port):
            ends = f"`armrig stop` or `kill {facts.pid}` stops the motor"
            return f"the daemon of rig {rig} (process {facts.pid}) has opened {port}: {ends}"
    return f"{err}; `armrig stop` stops the motor of a running daemon"


def _has_failed(environ: Mapping[str, str]) -> bool:
    """Return whether systemd reports that the service failed after it began to drive a rig."""
    ended = environ.get("SERVICE_RESULT", ""), environ.get("EXIT_STATUS", "")
    return ended[0] != "success" and ended != ("exit-code", str(EX_CONFIG))


def _configuration(
    config: Path | None,
    port: str | None,
    rig: str | None,
    below: Mapping[str, Mapping[str, Any]],
    *,
    system: bool,
    rig_file: Path | None = None,
) -> Callable[[], Config]:
    """Return a function that reads the configuration; the options override its values."""
    from armrig_core.rig.description import path_of

    from armrig_daemon.config import load, load_installed

    overrides: dict[str, dict[str, Any]] = {}
    if port is not None:
        overrides["device"] = {"port": port}
    if rig is not None:
        overrides["rig"] = {"id": rig}
    if rig_file is not None:
        overrides.setdefault("rig", {})["file"] = str(path_of(rig_file).absolute())
    if config is None:
        return partial(load_installed, os.environ, overrides, system=system, below=below)
    return partial(load, [config], os.environ, overrides, below=below)


@app.command()
@with_options
def emulate(
    port: Annotated[
        Path,
        option("--port", "Port to create: a path (a link to a pseudo-terminal), or unix:PATH."),
    ],
    config: Path | None = preset(
        None, "File (TOML) with a table [emulator], and [rig] file.", "none"
    ),
    trace: Path | None = preset(
        None, "File to write, with a line for each change of the voltage.", "none"
    ),
    seed: int | None = preset(
        None, "Seed of all noise and of the boot ids.", "the file's [emulator] seed, otherwise 1"
    ),
    baud: int | None = preset(
        None,
        "Speed of the emulated line, in bit/s.",
        "the file's [emulator] baud, otherwise 500000",
    ),
    rig_file: _RigFile = None,
    firmware: _Firmware = False,
    image: _Hex = None,
    settings: str | None = preset(None, "", hidden=True),
    stalls_fd: int | None = preset(None, "", hidden=True),
    parent: int | None = preset(None, "", hidden=True),
) -> None:
    """Emulate a rig at a pseudo-terminal or a socket until SIGTERM or Ctrl-C."""
    from armrig_core.rig.description import builtin

    try:
        from armrig_core.process.open_files import require

        require("armrigd emulate", memory_mib=512, files=16)
        from armrig_core.process.line_writer import LineWriter
        from armrig_core.process.toml_file import convert
        from armrig_core.rig.description import path_of, read_description

        from armrig_daemon.emulator.device import Device
        from armrig_daemon.emulator.real_time import emulate as run_emulator
        from armrig_daemon.emulator.settings import EmulatorSettings, load

        if settings is not None:  # from `armrigd run --emulate`; the emulator ends with it
            from armrig_core.process.realtime import end_with_parent

            end_with_parent(parent)
            used = msgspec.json.decode(settings, type=EmulatorSettings)
        else:
            used, file = (EmulatorSettings(), None) if config is None else load(config)
            rig_file = rig_file or file
        described = read_description(path_of(rig_file)) if rig_file else builtin("arm")
        overrides = {"seed": seed, "baud": baud, "arm_removed": described.arm_removed or None}
        overrides = {key: value for key, value in overrides.items() if value is not None}
        used = convert(msgspec.to_builtins(used) | overrides, EmulatorSettings)
        started = "" if settings is not None else _announcement(port, used.baud)
        lines = LineWriter()
        report_stall = partial(_say_stall, lines)
        if stalls_fd is not None:
            report_stall = partial(_write_stall, stalls_fd)
        device = _firmware(image) if firmware or image else Device
        switch_on = partial(device, description=described)
        code = run_emulator(
            port,
            used,
            switch_on=switch_on,
            trace=trace,
            started=started,
            held_up=report_stall,
            say=lines.put,
        )
        lines.close()
    except (ValueError, OperationError) as err:
        _refuse(str(err), EX_CONFIG)
    raise typer.Exit(code)


@app.command("config")
@with_options
def show_config(
    example: bool = preset(False, "Print all keys, commented out, with their defaults."),
    check: Path | None = preset(None, "File to check, together with the files that it names."),
) -> None:
    """Print an example of a configuration, or check a configuration.

    --check reads /etc/armrig/ID.toml in the same way as the service of rig ID. It reads any other
    file in the same way as `armrigd run --config`. The exit code is 78 if the daemon would refuse
    the file. Run the command as the daemon's user to check that this user may read the keys.
    """
    from armrig_daemon.configuration_reference import example as example_text

    if check is not None:
        _check_file(check)
    elif example:
        typer.echo(example_text())
    else:
        for_example = "for example `armrigd config --example > armrig.toml`"
        _refuse(f"config: give --example or --check FILE, {for_example}")


def _check_file(file: Path) -> None:
    """Print a configuration's rig and networks; after an error, exit with the daemon's code."""
    from armrig_core.recording_file.recording_directory import SYSTEM, directory_of

    from armrig_daemon.config import load, load_installed
    from armrig_daemon.service.access import networks_of
    from armrig_daemon.service.sentences import line_and_limits, network_notice

    path = file.absolute()
    try:
        if path.parent == SYSTEM.parent and path != SYSTEM:
            # A service does not have the variables of this shell.
            config = load_installed({}, {"rig": {"id": path.stem}}, system=True)
        else:
            config = load([file], os.environ, {})
        directory_of(config.recording.directory)
        ways = [
            network_notice(way, datetime.now(UTC)) for way in networks_of(config) if way is not None
        ]
    except ValueError as err:
        _refuse(str(err), EX_CONFIG)
    rig = f"{file}: rig {config.rig.id}, {line_and_limits(config)}"
    sentences = [rig, *(text for _, text in ways)]
    typer.echo(printable("; ".join(sentences)))


@app.command()
@with_options
def conformance(
    device: str | None = preset(
        None, "Serial port of the device, such as /dev/ttyACM0.", metavar="DEVICE"
    ),
    firmware: _Firmware = False,
    image: _Hex = None,
    baud: int = preset(DeviceSettings().baud, "Speed of the line, in bit/s."),
    motor_unplugged: bool = preset(False, "Confirm that the motor is unplugged; do not ask."),
    json: bool = preset(False, "Print JSON."),
) -> None:
    """Test a device against every rule of PROTOCOL.md; unplug the motor first.

    The test takes a minute. With --firmware, the device is the Uno's firmware in simavr, and the
    test also checks its pins.

    The exit code is 0 only if no rule is broken. After the test, the device is at 0 V.
    """
    from armrig_daemon.conformance import suite
    from armrig_daemon.conformance.host import Broken, LineHost
    from armrig_daemon.conformance.rule import Result
    from armrig_daemon.conformance.suite import run as try_rules
    from armrig_daemon.loop.link import LinkError

    is_simulated = firmware or image is not None
    if is_simulated == (device is not None):
        of_uno = "--firmware for the firmware of the Uno in simavr"
        _refuse(f"conformance: give either --device DEVICE, or {of_uno}", 2)
    if not is_simulated:
        _confirm_that_the_motor_is_unplugged(motor_unplugged)
    columns = shutil.get_terminal_size().columns if sys.stdout.isatty() else 0

    def print_result(result: Result) -> None:
        if not json:
            typer.echo(suite.line_of(result, columns))

    try:
        with ExitStack() as stack:
            for number in (signal.SIGTERM, signal.SIGHUP):
                stack.callback(signal.signal, number, signal.signal(number, _interrupt))
            line, rules = _line_and_rules(device, image, baud, stack)
            host = LineHost(line, baud)
            results = try_rules(host, print_result, rules)
    except (LinkError, OperationError) as err:
        _refuse(f"conformance: {err}")
    except Broken as err:
        where = f"{device} at {baud} baud: {err}; check that this is the port of the device"
        _refuse(f"conformance: {where if device is not None else err}")
    except KeyboardInterrupt:
        _refuse("conformance: interrupted; a stop was sent to the device", 130)
    broken = suite.json_of(host.facts, results)
    typer.echo(msgspec.json.encode(broken).decode() if json else suite.sum_of(results))
    raise typer.Exit(1 if broken["broken"] else 0)


def _line_and_rules(
    device: str | None, image: Path | None, baud: int, stack: ExitStack
) -> tuple[Line, Sequence[Rule]]:
    """Return the line to a device and the rules to test over it; `stack` closes the line."""
    from armrig_daemon.conformance.line import VirtualLine
    from armrig_daemon.conformance.serial_line import SerialLine
    from armrig_daemon.conformance.suite import RULES, pin_rules
    from armrig_daemon.emulator.settings import in_dead_band

    if device is not None:
        return stack.enter_context(closing(SerialLine(device, baud))), RULES
    uno = stack.enter_context(closing(_firmware(image)(in_dead_band(baud), 0)))
    return VirtualLine(uno), (*RULES, *pin_rules(uno.violations))


def _confirm_that_the_motor_is_unplugged(is_confirmed: bool) -> None:
    """Ask for a confirmation, because the rules drive the pin up to 5 V."""
    if is_confirmed:
        return
    typer.echo("The test drives the motor's pin up to 5 V: the motor must be unplugged.", err=True)
    if not sys.stdin.isatty():
        _refuse("conformance: no terminal for the question; confirm with --motor-unplugged")
    if not typer.confirm("Is the motor unplugged?", err=True):
        _refuse("conformance: unplug the motor first; nothing was sent")


def _interrupt(number: int, _: object) -> NoReturn:
    raise KeyboardInterrupt


@app.command()
@with_options
def virtual(
    directory: Annotated[Path, option("--directory", "Folder for the recordings.")],
    config: _ConfigFile = None,
    seed: int = preset(
        1, "Seed of the noise, and of the names and times of the runs.", min=0, max=2**63 - 1
    ),
    rig_file: _RigFile = None,
    firmware: _Firmware = False,
    image: _Hex = None,
) -> None:
    """Play runs on an emulated rig in virtual time, and record them.

    Each line of the standard input is a run, as JSON: {"u": [1.5, 1.5, …], "experiment": "step"}.
    The input u is in V, with one value for each sample. Each line of the standard output is the
    path of a recording.

    The same seed, runs and configuration result in the same bytes.
    """
    from armrig_daemon.config import description_of
    from armrig_daemon.emulator.device import Device
    from armrig_daemon.service.virtual_service import VirtualService, requests_of

    try:
        read = _configuration(
            config, None, None, _EMULATION_DEFAULTS, system=False, rig_file=rig_file
        )
        loaded = read()
        described = description_of(loaded)
        device = _firmware(image) if firmware or image else Device
        switch_on = partial(device, description=described)
        service = VirtualService(
            loaded, directory.absolute(), seed=seed, switch_on=switch_on, description=described
        )
        for request in requests_of(sys.stdin.buffer.read()):
            typer.echo(service.record(request))
    except (ValueError, OperationError, OSError) as err:
        _refuse(str(err))


def _firmware(image: Path | None) -> Callable[..., Uno]:
    """Return a function that creates a simulated Uno with its firmware."""
    from armrig_daemon.emulator.layout import layout_of
    from armrig_daemon.emulator.settings import firmware_image, harness_program
    from armrig_daemon.emulator.uno import Uno

    program, image_path = harness_program(os.environ), firmware_image(image)
    return partial(Uno, program, image_path, layout=layout_of(image_path))


def _announcement(port: Path, baud: int) -> str:
    """Return the sentence that announces an emulated rig."""
    speed = "" if baud == DeviceSettings().baud else f"ARMRIG_DEVICE_BAUD={baud} "
    return (
        f"armrigd: an emulated rig is at {port}, {baud} baud, 0 to {U_MAX_V:g} V; "
        f"drive it with `{speed}armrigd run --port {port}`, end it with Ctrl-C"
    )


def _say_stall(lines: LineWriter, ns: int) -> None:
    """Print how long the emulator was held up."""
    lines.put(f"armrigd: {stall_sentence(ns)}")


def _write_stall(fd: int, ns: int) -> None:
    """Report a stall to the daemon without waiting, because the daemon may also be stalled."""
    with suppress(OSError):
        os.write(fd, b"%d\n" % ns)


def _socket_directory() -> Path:
    """Return the directory of the sockets; create it for this user only."""
    path = Path(socket_directory(os.environ, uid=os.getuid(), temporary=tempfile.gettempdir()))
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        path_stat = path.lstat()
    except OSError as err:
        _refuse(f"{path}: {err.strerror}; set XDG_RUNTIME_DIR to your own directory", EX_CONFIG)
    try:
        # In a temporary directory, another user could have created this directory and would own the
        # socket.
        require_trusted(path_stat, owners={os.getuid()})
    except InputError as err:
        _refuse(f"{path}: {err}; set XDG_RUNTIME_DIR to your own directory", EX_CONFIG)
    return path


def _check_no_file(path: Path) -> None:
    """Refuse to start if another file has the socket's name; zenoh would delete this file."""
    if os.path.lexists(path) and not path.is_socket():
        _refuse(f"{path}: another file has the name of the socket; move it away", EX_CONFIG)


def _refuse(message: str, code: int = 1) -> NoReturn:
    from armrig_core.process.journal import log_prefix

    text = f"{log_prefix('error') or 'armrigd: '}{message}"
    typer.echo(printable(brief(text), keep="\n"), err=True)
    raise typer.Exit(code)
