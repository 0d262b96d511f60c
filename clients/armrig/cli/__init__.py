"""The command `armrig`. Heavy modules are imported only by the commands that need them."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from importlib.metadata import version
from keyword import iskeyword
from pathlib import Path
from traceback import format_exception
from typing import Any

import typer
import typer.core
from armrig_core.errors import ArmrigError, OperationError, ParameterError
from armrig_core.process.loading import is_interrupt, use_one_thread
from armrig_core.process.options import HELP, preset, with_options

from armrig.cli.printing import tell_error

_HELP_INDENT = 6
"""Number of columns around the name of a command in the help."""

_HEADINGS = {
    "Rig": {"rig": "lab status watch stop reset note dashboard", "calibration": "calibrate"},
    "Runs": {"runs": "collect record play", "demo": "demo"},
    "Recordings": {
        "imports": "import",
        "recordings": "ls info plot verify export recover replay",
    },
    "Identify": {"identify": "sampling hints identify batch"},
    "Validate": {"validate": "validate compare check linearity report"},
    "Design": {"design": "design"},
    "Physics": {
        "physics": "model simulate",
        "grey_box": "greybox split",
        "integration": "integrate",
    },
    "Administration": {
        "administration": "rigs doctor flash conformance",
        "glossary": "glossary",
        "service": "service",
        "pki": "pki router",
    },
}
"""Commands under each heading of `armrig --help`, by module."""
_MODULES = {
    name: module
    for modules in _HEADINGS.values()
    for module, names in modules.items()
    for name in names.split()
}
_EXAMPLES = {
    "note": '"the arm was touched"',
    "dashboard": "--open",
    "record": "--from unixsock-stream//run/armrig/1.sock -o monday.mcap",
    "play": "@last --speed 10",
    "demo": "--directory demo",
    "import": "heater.csv --input power --signal temp --name heater",
    "info": "@last",
    "plot": "@last -o data.png",
    "verify": "@last",
    "export": "@last data.mat",
    "replay": "@last",
    "sampling": "@step",
    "hints": "@blackbox -o hints.png",
    "identify": "@blackbox --structure oe --integrator --validate @blackbox/validation",
    "validate": "@blackbox/validation --model model.json",
    "compare": "@blackbox @blackbox/validation",
    "check": "@blackbox",
    "linearity": "@blackbox",
    "report": "@blackbox @blackbox/validation -o report.pdf",
    "model": "--set J_2=0.005 -o step.png",
    "simulate": "@last --model model.json",
    "greybox": "@greybox",
    "split": "@greybox --parts 1,2,4",
    "integrate": "--method heun --h 0.01",
    "glossary": '"velocity fit"',
    "flash": "--port /dev/ttyACM0 --dry-run",
    "conformance": "--device /dev/ttyACM0",
    "router": "--certificate pki/router.pem --names pki/access.toml",
}
"""Arguments in the example at the end of a command's help."""


class _UnderHeadings(typer.core.TyperGroup):
    """Group that lists its commands and its groups of commands under headings."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the commands, in the order of the help."""
        return list(_MODULES)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands under their headings; all names have the same width."""
        width = max(map(len, self.commands))
        limit = formatter.width - width - _HELP_INDENT
        for heading, modules in _HEADINGS.items():
            names = " ".join(modules.values()).split()
            rows = [(x, self.commands[x].get_short_help_str(limit)) for x in names]
            with formatter.section(heading):
                formatter.write_dl([(f"{name:{width}}", text) for name, text in rows])


# Commands that connect to a rig, or measure the host of a rig; they do not exist on Windows.
_WITH_A_RIG = ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty", "zenoh")
_DEBUG = "--debug"
# Address space, in MiB, and open files of the commands that open a session: 0.7 to 0.9 GiB and
# 18 to 26 files were measured. With less, zenoh aborts or blocks. `lab` passes its limits to a
# daemon.
_OF_RIG = " ".join(_HEADINGS["Rig"].values()).split()
_NEEDS = dict.fromkeys([*_OF_RIG, "collect", "record", "router"], (1024, 32))
_NEEDS |= dict.fromkeys(["dashboard", "lab"], (2048, 64))
_SIGPIPE = 13  # the module `signal` of Windows does not define this name

# typer contains a copy of click, and does not export this class under another name.
_UsageError: Any = typer.BadParameter.__base__


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"armrig {version('armrig')}")
        raise typer.Exit


def _options(
    print_version: bool = preset(
        False,
        "Show the version and exit.",
        names="--version",
        is_eager=True,
        callback=_print_version,
    ),
    debug: bool = preset(False, "Print the traceback of an internal error.", names=_DEBUG),
) -> None:
    """Define the options that precede the command; `_internal` reads `debug` from the arguments."""


def app(*names: str) -> typer.Typer:
    """Return the command line with the named commands; without a name, with all commands.

    Only the modules of these commands are imported, so that a stop is sent without delay.
    """
    command_line = typer.Typer(
        cls=_UnderHeadings,
        context_settings=HELP | {"max_content_width": 100},
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
    )
    command_line.callback(
        help="Record, identify and validate models of a control laboratory's rig."
    )(with_options(_options))
    for name in names or _MODULES:
        module = import_module(f"armrig.cli.{_MODULES[name]}")
        command = getattr(module, f"{name}_" if iskeyword(name) else name)
        if isinstance(command, typer.Typer):
            command_line.add_typer(command, name=name, context_settings=HELP)
        else:
            line = f"Example: armrig {name} {_EXAMPLES.get(name, '')}".rstrip()
            command_line.command(name, epilog=line, context_settings=HELP)(with_options(command))
    return command_line


def load(arguments: Sequence[str]) -> Any:
    """Import the modules of the command in `arguments`, and return the command line."""
    return _command_line(*(name for name in arguments[:1] if name in _MODULES))


@cache
def _command_line(*names: str) -> Any:
    return typer.main.get_command(app(*names))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code; 0 is success.

    SIGTERM and SIGHUP (a closed terminal) end the command as Ctrl-C does. A run that the command
    began is stopped. The exit code is then 128 plus the number of the signal.
    """
    use_one_thread()
    with _signals() as received:
        code = _run(arguments)
    if received:
        return _report_error(f"ended by {received[0].name}", 128 + received[0])
    return code


@contextmanager
def _signals() -> Iterator[list[signal.Signals]]:
    """Raise KeyboardInterrupt at the first SIGTERM or SIGHUP; yield the received signals."""
    received: list[signal.Signals] = []

    def interrupt(number: int, _: object) -> None:
        received.append(signal.Signals(number))
        # Raise only once: a second signal (SIGTERM after SIGHUP) must not interrupt the stop.
        if len(received) == 1:
            raise KeyboardInterrupt

    ending = [signal.SIGTERM]
    if hasattr(signal, "SIGHUP"):  # not on Windows
        ending.append(signal.SIGHUP)
    # A signal that nohup ignores stays ignored.
    before = {
        number: handler
        for number in ending
        if (handler := signal.getsignal(number)) not in (None, signal.SIG_IGN)
    }
    for number in before:
        signal.signal(number, interrupt)
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _run(arguments: Sequence[str] | None) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        command = load(words)
        if "_ARMRIG_COMPLETE" in os.environ:  # the shell requests completions
            command.main([], prog_name="armrig")
        # Not command.main(), which has other exit codes for Ctrl-C and for a broken pipe.
        with command.make_context("armrig", [*words] or ["--help"]) as context:
            _require_limits(words)
            command.invoke(context)
    except typer.Exit as err:
        return int(err.exit_code) if words else 2  # without a command, help is printed
    except _UsageError as err:
        from armrig.cli.usage_errors import usage_error

        if type(err).__name__ == "NoArgsIsHelpError":  # its message is the help, in many lines
            typer.echo(err.format_message())
            return 2
        return _report_error(usage_error(err, words), 2)
    except (typer.Abort, KeyboardInterrupt) as err:
        return _report_error(str(err) or "interrupted", 130)
    except BrokenPipeError:  # `armrig info F | head`
        # Nobody reads the output: the buffer must not raise when the interpreter ends.
        with suppress(OSError, ValueError), Path(os.devnull).open("wb") as nothing:
            os.dup2(nothing.fileno(), sys.stdout.fileno())
        return 128 + _SIGPIPE
    except OSError as err:
        return _report_error(_of_file(err), 1)
    except ParameterError as err:
        return _report_error(err.named(f"--{err.parameter.replace('_', '-')}"), 1)
    except ArmrigError as err:
        return _report_error(str(err), 1)
    except Exception as err:
        if is_interrupt(err):
            return _report_error("interrupted", 130)
        if isinstance(err, ModuleNotFoundError) and err.name in _WITH_A_RIG:
            command_name = f"armrig {' '.join(words[:1])}"
            return _report_error(f"{command_name} needs Linux: this system has no {err.name}", 1)
        return _internal(err, words)
    return 0


def _require_limits(arguments: Sequence[str]) -> None:
    """Refuse a command for which the limits of this process are too low; `stop` is always tried."""
    name = next((word for word in arguments if not word.startswith("-")), "")
    if name in _NEEDS and sys.platform != "win32" and not {"-h", "--help"} & {*arguments}:
        from armrig_core.process.open_files import require

        try:
            require(f"armrig {name}", memory_mib=_NEEDS[name][0], files=_NEEDS[name][1])
        except OperationError as err:
            if name != "stop":
                raise
            way_out = "`kill` the daemon, or use the emergency switch"
            tell_error(f"{err}; the stop is tried; if the motor still turns, {way_out}")


def _internal(err: Exception, arguments: Sequence[str]) -> int:
    """Report an internal error, write its traceback to a temporary file, and return 1."""
    text = "".join(format_exception(err))
    if _DEBUG in arguments:
        typer.echo(text, err=True, nl=False)
    head = f"armrig {version('armrig')}, Python {sys.version}\n$ armrig {shlex.join(arguments)}\n"
    try:
        with tempfile.NamedTemporaryFile(
            "w",
            encoding="utf-8",
            errors="backslashreplace",
            prefix="armrig-error-",
            suffix=".txt",
            delete=False,
        ) as file:
            file.write(head + text)
        where = file.name
    except OSError:  # such as a full disk: the person can still print the traceback
        where = f"what `armrig {_DEBUG} …` prints"
    summary = " ".join(f"{type(err).__name__}: {err}".split())
    return _report_error(f"internal error, please report it with {where}: {summary}", 1)


def _report_error(message: str, code: int) -> int:
    tell_error(message)
    return code


def _of_file(err: OSError) -> str:
    """Return a message with the file, the system's error and the remedy."""
    if not (err.filename and err.strerror):
        return str(err)
    name = Path(os.fsdecode(err.filename))
    way_out = {
        IsADirectoryError: "give a file in the folder",
        PermissionError: "ask its owner, or use a folder of yours",
    }.get(type(err), "")
    if isinstance(err, FileNotFoundError):
        way_out = {
            ".mcap": "`armrig ls` lists the recordings, each with its @NAME",
            ".json": "`armrig identify F --structure oe --save MODEL.json` writes a model",
        }.get(name.suffix.lower(), "")
    return f"{name}: {err.strerror}" + (f"; {way_out}" if way_out else "")
