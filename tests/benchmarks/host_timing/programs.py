"""Programs of the contestants: started for one turn, and always ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path, PurePosixPath

import numpy as np
from armrig.rig.client import Rig
from armrig.rig.session import NoReplyError, RigError
from armrig_core.endpoint import endpoint
from numpy.typing import NDArray

from tests.benchmarks.host_timing.kernel import PARENT

RIG = "bench"
BAUD = 1_000_000
SUBSCRIBERS = 4
OURS = {"PYTHONPATH": str(Path(__file__).parents[3])}
"""Environment in which the programs are found."""
_START_S, _STOP_S = 30.0, 5.0
_CONFIG = f"""\
# The benchmark's: an emulated rig at a pseudo-terminal, its wire modelled.
[rig]
id = "{RIG}"

[device]
baud = {BAUD}
watchdog_ms = 100

[recording]
directory = "{{directory}}"
"""


@contextmanager
def program(*arguments: str, module: bool = True) -> Iterator[subprocess.Popen[bytes]]:
    """Run one of our modules with pipes to and from it, and end it."""
    leash = [] if module else ["tests.benchmarks.host_timing.leashed"]
    command = [sys.executable, "-m", *leash, *arguments]
    with ExitStack() as stack:
        with _uninterrupted():
            # A session of its own: Ctrl-C is ours, and everything is ended in order.
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE if not module else None,
                env={**os.environ, **OURS, PARENT: str(os.getpid())},
                start_new_session=True,
            )
            stack.callback(_end, process)
        yield process


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Delay Ctrl-C to the end of the block, so that no running program remains."""
    received: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: received.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if received:
        signal.raise_signal(signal.SIGINT)


def output(process: subprocess.Popen[bytes], within_s: float) -> bytes:
    """Return what a program prints until it ends by itself.

    Raises
    ------
    RigError
        It fails or does not end in time.
    """
    name = _name(process)
    try:
        printed, errors = process.communicate(timeout=within_s)
    except subprocess.TimeoutExpired as err:
        raise RigError(
            f"{name} did not end within {within_s:.0f} s; is this machine very busy?"
        ) from err
    if process.returncode:
        why = (errors or b"").decode(errors="replace").strip().splitlines()[-1:]
        raise RigError(f"{name} ended with exit code {process.returncode} {' '.join(why)}".strip())
    return printed


def line(process: subprocess.Popen[bytes]) -> str:
    """Return the next line that a program prints."""
    printed = process.stdout.readline().decode().strip() if process.stdout else ""
    if not printed:
        raise RigError(f"{_name(process)} did not start; see what it says above")
    return printed


def tell(process: subprocess.Popen[bytes], text: str) -> None:
    """Write a line to a program."""
    if process.stdin is not None:
        process.stdin.write(f"{text}\n".encode())
        process.stdin.flush()


class Subscribers:
    """Processes that note when each sample is called back."""

    def __init__(self, processes: Sequence[subprocess.Popen[bytes]]) -> None:
        """Wait until all listen."""
        self._processes = processes
        for process in processes:
            line(process)

    def heard(self) -> list[NDArray[np.int64]]:
        """End them; return k, the sample's host time and the callback's, (n, 3) for each."""
        triples = [output(p, _STOP_S + _START_S) for p in self._processes]
        return [np.frombuffer(data, np.int64).reshape(-1, 3) for data in triples]


class Daemon:
    """The daemon on an emulated rig, in a directory of its own."""

    def __init__(self, directory: Path) -> None:
        self.endpoint = endpoint(RIG, PurePosixPath(directory) / "armrig")
        self.log = directory / "armrigd.log"
        self._directory = directory
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it and wait until it samples."""
        config = self._directory / "armrig.toml"
        config.write_text(_CONFIG.format(directory=self._directory), encoding="utf-8")
        leash = [sys.executable, "-m", "tests.benchmarks.host_timing.leashed"]
        command = [*leash, sys.executable, "-m", "armrig_daemon", "run", "--config", str(config)]
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(
                [*command, "--emulate"],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=_environment(self._directory),
                start_new_session=True,
            )
        until = time.monotonic() + _START_S
        while time.monotonic() < until:
            if self._process.poll() is not None:
                msg = f"the daemon ended with exit code {self._process.returncode}: "
                msg += self._last_line()
                raise RigError(msg)
            with suppress(NoReplyError), self.rig() as rig:
                if rig.status().phase == "safe":
                    return
            time.sleep(0.1)
        raise RigError(f"the daemon is not ready after {_START_S:g} s: {self._last_line()}")

    def rig(self) -> Rig:
        """Return a client of it."""
        return Rig(RIG, connect=self.endpoint)

    def loop_pid(self) -> int | None:
        """Return the process of the loop, or None if the kernel does not report it."""
        if self._process is None:
            return None
        for stat in Path("/proc").glob("[0-9]*/stat"):
            with suppress(OSError):
                parent = int(stat.read_text().rsplit(")", 1)[1].split()[1])
                named = b"armrig_daemon.loop.process" in (stat.parent / "cmdline").read_bytes()
                if parent == self._process.pid and named:
                    return int(stat.parent.name)
        return None

    def stop(self) -> None:
        """End it in order, which brings the motor to 0 V, or else by force."""
        if self._process is not None:
            _end(self._process)

    def _last_line(self) -> str:
        lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return lines[-1] if lines else "it said nothing"


@contextmanager
def daemon() -> Iterator[Daemon]:
    """Run the daemon; it and its directory are gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="armrig-bench-") as directory:
        running = Daemon(Path(directory))
        try:
            running.start()
            yield running
        finally:
            running.stop()


@contextmanager
def subscribers(where: str) -> Iterator[Subscribers]:
    """Run the subscribers of an endpoint."""
    with ExitStack() as stack:
        yield Subscribers(
            [
                stack.enter_context(program("tests.benchmarks.host_timing.subscriber", where, RIG))
                for _ in range(SUBSCRIBERS)
            ]
        )


def _environment(directory: Path) -> dict[str, str]:
    """Return ours, with sockets apart from a daemon's that the user may have, and no settings."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith("ARMRIG_")}
    kept.pop("RUNTIME_DIRECTORY", None)
    return kept | {**OURS, "XDG_RUNTIME_DIR": str(directory), PARENT: str(os.getpid())}


def _name(process: subprocess.Popen[bytes]) -> str:
    """Return a readable name of the program: the module's name, or that of another program."""
    arguments = process.args if isinstance(process.args, list) else [process.args]
    named = [
        str(a)
        for a in arguments
        if a not in (sys.executable, "-m", "tests.benchmarks.host_timing.leashed")
    ]
    return Path(named[0]).name


def _end(process: subprocess.Popen[bytes]) -> None:
    running = process.poll() is None
    if running:
        process.terminate()
    # Before the wait: cyclictest prints all that it has measured at its end, and nobody reads it.
    for pipe in (process.stdin, process.stdout, process.stderr):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()
    if running:
        try:
            process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
