"""Each command that waits for Ctrl-C ends in order, whenever that or SIGTERM comes.

`python -m tests.benchmarks.signals [--signals 10000] [--starts 200]`
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Timer

from tests.integration.fleet_lab import FleetLab
from tests.integration.laboratory import free_port

_WITHIN_S = 60.0
_IN_WAIT_S = 0.5
_WAIT = """
import sys
from armrig_core.signal_pipe import until_signal
for _ in range(int(sys.argv[1])):
    with until_signal() as ended:
        print("waits", flush=True)
        while not ended.wait(eval(sys.argv[2])):
            pass
"""
_WAITS_S = ("0", "1e-4", "None")


@dataclass(frozen=True)
class Command:
    """A command, its line when it waits, and the exit codes in order."""

    name: str
    arguments: list[str]
    waits: str
    codes: dict[signal.Signals, set[int]]


# A process that loads ends by the default of SIGTERM.
_CLIENT = {
    signal.SIGINT: {0, 130},
    signal.SIGTERM: {128 + signal.SIGTERM, -signal.SIGTERM},
}
_DAEMON = {signal.SIGINT: {0, 130}, signal.SIGTERM: {0, -signal.SIGTERM}}


@dataclass(frozen=True)
class Moment:
    """Time at which a signal is sent."""

    waits: bool
    """The signal comes when the command waits; otherwise while it starts."""
    after_s: float
    number: signal.Signals


@dataclass
class Row:
    """Outcomes of the starts of a command."""

    starts: int = 0
    waiting: int = 0
    codes: Counter[str] = field(default_factory=Counter)
    late_s: float = 0.0
    own_start: int = 0
    faults: list[str] = field(default_factory=list)


def main() -> int:
    """Print a table; the exit code is 1 if anything did not end in order."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--signals", type=int, default=10_000)
    parser.add_argument("--starts", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="Commands at a time.")
    parser.add_argument("--only", default="", help="A command, such as `record --all`.")
    asked = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # also where we run in the background
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    failed = 0
    for wait_s in () if asked.only else _WAITS_S:
        ended = _signalled(asked.signals, wait_s, random.Random(asked.seed))
        failed += ended != asked.signals
        print(f"wait({wait_s}): {ended} of {asked.signals} signals ended it", flush=True)
    print(f"{'command':14} {'starts':>6} {'waited':>6} {'slowest':>8}  exit codes", flush=True)
    with tempfile.TemporaryDirectory(prefix="armrig-signals-") as name, _daemon(Path(name)):
        for command in _commands(Path(name)):
            if asked.only in ("", command.name):
                row = _row(command, Path(name), asked)
                failed += len(row.faults)
                _print(command, row)
    return 1 if failed else 0


def _signalled(n: int, wait_s: str, draw: random.Random) -> int:
    """Return how many of `n` signals, at random moments of a wait, ended it."""
    program = [sys.executable, "-c", _WAIT, str(n), wait_s]
    ended = -1
    with subprocess.Popen(program, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        while True:
            late = Timer(_WITHIN_S, process.kill)
            late.start()
            said = process.stdout.readline()
            late.cancel()
            ended += 1
            if not said:
                return ended if process.wait() else n
            until_s = time.perf_counter() + draw.uniform(0.0, 2e-4)
            while time.perf_counter() < until_s:
                pass
            process.send_signal(signal.SIGINT)


@contextmanager
def _daemon(folder: Path) -> Iterator[None]:
    """Run an emulated rig with its daemon, which is recorded and shown."""
    log = folder / "daemon"
    with log.open("wb") as said:
        program = [sys.executable, "-m", "armrig_daemon", "run", "--emulate"]
        daemon = subprocess.Popen(program, env=_environment(folder), stdout=said, stderr=said)
    try:
        _wait_until_said(log, "end it with Ctrl-C", daemon)
        yield
    finally:
        daemon.terminate()
        daemon.wait()


def _commands(folder: Path) -> Iterator[Command]:
    (folder / "lab").mkdir()
    lab = FleetLab(folder / "lab")
    where = f"unixsock-stream/{folder}/armrig/1.sock"
    router = lab.router_command()
    router[router.index("--listen") + 1] = "tls/localhost:{port}"
    for arguments, waits in (
        (router, "Ctrl-C ends it"),
        (["record", "--from", where, "-o", "{own}/a.mcap"], "Ctrl-C ends it"),
        (["record", "--all", "--from", where, "-o", "{own}"], "Ctrl-C ends it"),
        (["dashboard", "--connect", where, "--port", "{port}"], "Ctrl-C ends it"),
        (["lab"], "rig ready"),
    ):
        name = " ".join(arguments[: 1 + ("--all" in arguments)])
        yield Command(name, ["armrig", *arguments], waits, _CLIENT)
    yield Command(
        "armrigd run", ["armrig_daemon", "run", "--emulate"], "end it with Ctrl-C", _DAEMON
    )
    emulate = ["armrig_daemon", "emulate", "--port", "{own}/tty"]
    yield Command("armrigd emulate", emulate, "end it with Ctrl-C", _DAEMON)


def _row(command: Command, folder: Path, asked: argparse.Namespace) -> Row:
    """Start a command again and again, and end each at a random moment."""
    draw, row = random.Random(f"{asked.seed} {command.name}"), Row()
    for _ in range(2):  # the first reads from the disk
        begun_s = time.monotonic()
        _once(command, folder, Row(), Moment(True, 0.0, signal.SIGINT))
        loads_s = time.monotonic() - begun_s
    numbers = (signal.SIGINT, signal.SIGTERM)
    moments = [
        Moment(waits, draw.random() * (_IN_WAIT_S if waits else loads_s), draw.choice(numbers))
        for waits in (True, False)
        for _ in range(asked.starts // 2)
    ]
    with ThreadPoolExecutor(asked.jobs) as pool:
        list(pool.map(lambda moment: _once(command, folder, row, moment), moments))
    return row


def _once(command: Command, folder: Path, row: Row, moment: Moment) -> None:
    """Start a command, signal it at a moment, and judge its end."""
    number = moment.number
    with tempfile.TemporaryDirectory(prefix="s", dir=folder) as name:
        own, log = Path(name), Path(name) / "said"
        given = [
            a.replace("{own}", name).replace("{port}", f"{free_port()}") if "{" in a else a
            for a in command.arguments
        ]
        with log.open("wb") as said:
            process = subprocess.Popen(
                [sys.executable, "-m", *given],
                env=_environment(own),
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=said,
                start_new_session=True,
            )
        if moment.waits:
            try:
                _wait_until_said(log, command.waits, process)
            except RuntimeError as err:
                row.faults.append(f"{moment}: {err}")
                process.terminate()
                process.wait()
                return
        time.sleep(moment.after_s)
        row.waiting += command.waits in log.read_text()
        if number == signal.SIGINT:  # a terminal sends it to all
            os.killpg(process.pid, number)
        else:
            process.send_signal(number)
        sent_s = time.monotonic()
        try:
            code = process.wait(_WITHIN_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            code = process.wait()
        row.starts += 1
        row.codes[f"{code}"] += 1
        row.late_s = max(row.late_s, time.monotonic() - sent_s)
        text = log.read_text()
        # Before our first line: by the default of SIGINT, or by a traceback without a line of ours.
        in_start = "Traceback" in text and "__main__.py" not in text and "ignored" not in text
        if code != -signal.SIGKILL and (in_start or (code == -signal.SIGINT and not text)):
            row.own_start += 1
        elif code not in command.codes[number] or "Traceback" in text:
            row.faults.append(f"{moment}: {code}: {text}")
        elif left := _left(own):
            row.faults.append(f"{moment}: left {left}")


def _left(own: Path) -> list[str]:
    """Return the programs that are still there after a while, by their environment."""
    mark, found = f"XDG_RUNTIME_DIR={own}\0".encode(), [""]
    until_s = time.monotonic() + _WITHIN_S
    while found and time.monotonic() < until_s:
        found = []
        for process in Path("/proc").glob("[0-9]*"):
            try:
                if mark in (process / "environ").read_bytes():
                    found.append((process / "cmdline").read_text().replace("\0", " "))
            except OSError:
                continue
    return found


def _environment(own: Path) -> dict[str, str]:
    names = ("XDG_RUNTIME_DIR", "XDG_STATE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME")
    return {**os.environ, **dict.fromkeys(names, str(own))}


def _wait_until_said(log: Path, text: str, process: subprocess.Popen[bytes]) -> None:
    until_s = time.monotonic() + _WITHIN_S
    while text not in log.read_text():
        if process.poll() is not None or time.monotonic() > until_s:
            raise RuntimeError(log.read_text())
        time.sleep(0.01)


def _print(command: Command, row: Row) -> None:
    codes = ", ".join(f"{n} x {code}" for code, n in sorted(row.codes.items()))
    print(f"{command.name:14} {row.starts:6} {row.waiting:6} {row.late_s:6.2f} s  {codes}", end="")
    print(f"; {row.own_start} in the interpreter's start" if row.own_start else "", flush=True)
    for fault in row.faults:
        print(f"  {fault}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
