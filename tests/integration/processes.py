"""Real processes: an emulated rig at a socket, and the daemon that drives it.

Tests of the serial edge itself have a pseudo-terminal instead of the socket.
"""

from __future__ import annotations

import faulthandler
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile

import armrig
from armrig.rig.client import Rig
from armrig_core.access.emulator_socket import socket_path

from tests.integration.fork_server import LAST_FRAME, SHOW_THREADS, Forked, ForkServer

WITHIN_S = 30.0
"""Time to wait for an event; a busy machine takes seconds to load a program."""
_COMMAND_S = 60.0
_LAST_LINES = 1000  # B
_MOST_SHOWN = 120  # characters of a command
BURNER = """
import os
parent = os.getppid()
while os.getppid() == parent:
    for _ in range(1_000_000):
        pass
"""


def wait_for(what: Callable[[], object], within_s: float = WITHIN_S) -> None:
    """Wait until `what` is true; an assertion fails after `within_s`."""
    until = time.monotonic() + within_s
    while not what():
        assert time.monotonic() < until, "it did not happen in time"
        threading.Event().wait(0.005)


def settled(rig: Rig) -> str:
    """Return the phase of a rig whose device answers: in a stall of this machine it is lost."""
    seen = []
    wait_for(lambda: seen.append(rig.status().phase) or seen[-1] != "init")
    return seen[-1]


def newest(path: Path, column: str) -> int:
    """Return the newest value of a column in a growing file; -1 if it has no sample yet."""
    try:
        values = armrig.load(path).samples[column]
    except (FileNotFoundError, armrig.FileError):  # Its recorder has not yet written the header.
        return -1
    return int(values[-1]) if values.size else -1


def freeze(pid: int) -> None:
    """Stop a process (SIGSTOP), and return once it is stopped."""
    os.kill(pid, signal.SIGSTOP)
    wait_for(lambda: state_of(pid) in "Tt")


def state_of(pid: int) -> str:
    """Return the state letter of a process (proc_pid_stat(5)): T stopped, Z ended."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


def children(pid: int) -> list[int]:
    """Return the processes that any thread of a process has started."""
    found: list[int] = []
    for thread in Path(f"/proc/{pid}/task").iterdir():
        with suppress(OSError):  # it has just ended
            found += map(int, (thread / "children").read_text().split())
    return found


def programs(pid: int) -> Iterator[str]:
    """Give a line for each process below a process; the times are those of its main thread."""
    for child in children(pid):
        with suppress(OSError):  # it has just ended
            folder = Path(f"/proc/{child}")
            ran_ns, waited_ns, _ = map(int, (folder / "schedstat").read_text().split())
            command = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()[:_MOST_SHOWN]
            times = f"ran {ran_ns / 1e9:.1f} s, waited {waited_ns / 1e9:.1f} s for a processor"
            yield f"{child} {state_of(child)} {times}: {command}"
            yield from programs(child)


def threads() -> str:
    """Return what each thread of this process does."""
    with TemporaryFile("w+") as file:
        faulthandler.dump_traceback(file, all_threads=True)
        file.seek(0)
        return file.read()


class Burners:
    """Programs that keep processors busy at ordinary priority, in a `with` block, however often.

    They are stopped outside of it, and do not outlive us. `apart` gives a session to each: then the
    kernel gives each as large a share of the processors as all of our programs have together.
    """

    def __init__(self, n: int, *, apart: bool = False) -> None:
        command = [sys.executable, "-c", BURNER]
        self._programs = [subprocess.Popen(command, start_new_session=apart) for _ in range(n)]
        self._signal(signal.SIGSTOP)

    def __enter__(self) -> None:
        self._signal(signal.SIGCONT)

    def __exit__(self, *_: object) -> None:
        self._signal(signal.SIGSTOP)

    def end(self) -> None:
        """End them."""
        for program in self._programs:
            program.kill()
            program.wait()

    def _signal(self, number: signal.Signals) -> None:
        for program in self._programs:
            program.send_signal(number)


class Process:
    """A program with its standard error kept."""

    def __init__(
        self,
        log: Path,
        *arguments: str,
        env: dict[str, str] | None = None,
        forks: ForkServer | None = None,
    ) -> None:
        self.log = log
        self.popen: subprocess.Popen[bytes] | Forked
        environ = {**os.environ, **(env or {})}
        with log.open("wb") as stderr:
            if forks is not None:
                with Path(os.devnull).open("wb") as nothing:
                    self.popen = forks.start(["-m", *arguments], environ, nothing, stderr)
                return
            self.popen = subprocess.Popen(
                [sys.executable, "-m", *arguments],
                stderr=stderr,
                stdin=subprocess.DEVNULL,
                env=environ,
            )

    @property
    def said(self) -> str:
        """Return its output so far."""
        return self.log.read_text()

    def show_threads(self) -> None:
        """Have a running copy of the fork server print what its threads do, unless it is frozen."""
        if not isinstance(self.popen, Forked) or self.popen.poll() is not None:
            return
        if state_of(self.popen.pid) in "Tt":
            return
        before = len(self.said)
        self.kill(SHOW_THREADS)
        with suppress(AssertionError):  # a report is no test
            wait_for(lambda: LAST_FRAME in self.said[before:] or self.popen.poll() is not None)

    def kill(self, number: int = signal.SIGKILL) -> int:
        """Send a signal; return the time of it."""
        self.popen.send_signal(number)
        return time.monotonic_ns()

    def end(self) -> int:
        """End it and return its exit code."""
        if self.popen.poll() is None:
            self.popen.terminate()
        return self.popen.wait(WITHIN_S)


class Bench:
    """One rig in a folder of its own."""

    def __init__(
        self, folder: Path, forks: ForkServer | None = None, *, terminal: bool = False
    ) -> None:
        self.folder = folder
        self.forks = forks
        self.port = folder / "tty" if terminal else Path(f"unix:{folder}/line.sock")
        self.trace = folder / "trace.csv"
        self.recordings = folder / "recordings"
        self.config = folder / "armrig.toml"
        self.processes: list[Process] = []
        self.emulator: Process
        self.daemon: Process
        self.configure()

    def use_terminal(self) -> None:
        """Have a pseudo-terminal from now on."""
        self.port = self.folder / "tty"
        self.configure()

    def configure(self, baud: int = 1_000_000, more: str = "", watchdog_ms: int = 250) -> None:
        """Write the configuration of both programs; the longest watchdog outlasts most stalls."""
        self.config.write_text(
            f'[device]\nport = "{self.port}"\nbaud = {baud}\nwatchdog_ms = {watchdog_ms}\n'
            f'[recording]\ndirectory = "{self.recordings}"\n'
            f"[emulator]\nbaud = {baud}\n{more}\n"
        )

    def start(self, *arguments: str, env: dict[str, str] | None = None) -> Process:
        """Start a program, with additions to its environment."""
        log = self.folder / f"log{len(self.processes)}"
        env = {"XDG_RUNTIME_DIR": str(self.folder), **(env or {})}
        process = Process(log, *arguments, env=env, forks=self.forks)
        self.processes.append(process)
        return process

    def client(self, program: str, *arguments: str) -> subprocess.Popen[bytes] | Forked:
        """Start a client's program without its output."""
        command = ["-c", program, *arguments]
        if self.forks is None:
            nothing = subprocess.DEVNULL
            return subprocess.Popen([sys.executable, *command], stdout=nothing, stderr=nothing)
        with Path(os.devnull).open("wb") as nowhere:
            return self.forks.start(command, os.environ, nowhere, nowhere)

    def armrig(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run a command of `armrig` on this rig."""
        assert self.forks is not None
        env = {**os.environ, "XDG_RUNTIME_DIR": str(self.folder)}
        with TemporaryFile() as stdout, TemporaryFile() as stderr:
            program = self.forks.start(["-m", "armrig", *arguments], env, stdout, stderr)
            code = program.wait(_COMMAND_S)
            stdout.seek(0)
            stderr.seek(0)
            said = stdout.read().decode(), stderr.read().decode()
        return subprocess.CompletedProcess(arguments, code, *said)

    def emulate(self) -> Process:
        """Start the emulated rig with its witness."""
        self.emulator = self.start(
            *("armrig_daemon", "emulate", "--port", str(self.port)),
            *("--config", str(self.config), "--trace", str(self.trace)),
        )
        wait_for(self.port_is_there)
        return self.emulator

    def port_is_there(self) -> bool:
        """Return whether an emulator has made the port."""
        return (socket_path(str(self.port)) or self.port).exists()

    def serve(self, env: dict[str, str] | None = None) -> Process:
        """Start the daemon and wait until it samples."""
        self.daemon = self.start("armrig_daemon", "run", "--config", str(self.config), env=env)
        self.is_served_by(self.daemon)
        return self.daemon

    def is_served_by(self, daemon: Process) -> None:
        """Wait until the daemon samples; an assertion fails if it has ended."""
        socket = self.folder / "armrig" / "1.sock"
        # Two waits: to load takes a program most of one where this machine is busy.
        wait_for(lambda: socket.exists() or daemon.popen.poll() is not None)
        wait_for(lambda: self.phase() == "safe" or daemon.popen.poll() is not None)
        assert daemon.popen.poll() is None, daemon.said

    @property
    def endpoint(self) -> str:
        """Return where the daemon listens."""
        return f"unixsock-stream/{self.folder}/armrig/1.sock"

    def rig(self) -> Rig:
        """Return a client."""
        return Rig("1", connect=self.endpoint)

    def recording(self) -> Path:
        """Return the last finished recording; where a stall has ended a run there is one before."""
        return max(self.recordings.glob("*.mcap"), key=lambda path: path.stat().st_mtime_ns)

    def phase(self) -> str:
        """Return the daemon's phase, or nothing without a daemon."""
        if not (self.folder / "armrig" / "1.sock").exists():
            return ""
        try:
            with self.rig() as rig:
                return rig.status().phase
        except RuntimeError:
            return ""

    def settled(self) -> str:
        """Return the daemon's phase, once its device answers."""
        with self.rig() as rig:
            return settled(rig)

    def loop_pid(self, daemon: Process) -> int:
        """Return the process of the loop."""
        (pid,) = (
            child
            for child in children(daemon.popen.pid)
            if b"armrig_daemon.loop.process" in Path(f"/proc/{child}/cmdline").read_bytes()
        )
        return pid

    def report(self) -> dict[str, str]:
        """Return what shows why a test failed: threads, processes, phase, outputs."""
        here = {"Threads of the tests": threads(), "Processes": "\n".join(programs(os.getpid()))}
        phase = self.phase()
        for process in self.processes:
            process.show_threads()
        said = {f"Printed by {process.log.name}": process.said for process in self.processes}
        return {**here, "Phase of the daemon": phase, **said}

    def end(self) -> None:
        """End all processes, the last first."""
        for process in reversed(self.processes):
            process.end()

    def voltage_changes(self) -> list[tuple[int, float]]:
        """Return the witness's voltages at the motor's terminals: monotonic ns, V."""
        return _changes(complete_lines(self.trace.read_text()))

    def volts(self) -> float:
        """Return the voltage at the motor's terminals, read from the end: it is asked often."""
        with self.trace.open("rb") as trace:
            skipped = trace.seek(max(trace.seek(0, os.SEEK_END) - _LAST_LINES, 0))
            text = trace.read().decode()
        lines = complete_lines(text)
        return _changes(lines[1:] if skipped else lines)[-1][1]

    def went_to_0_v_after(self, t_ns: int) -> float:
        """Return the time from `t_ns` until the motor stayed at 0 V, in s."""
        wait_for(lambda: self.volts() == 0.0)
        changes = self.voltage_changes()
        return max(0, changes[-1][0] - t_ns) / 1e9


def complete_lines(text: str) -> list[str]:
    """Return the lines of a file without the last line that a process is still writing."""
    return text[: text.rfind("\n") + 1].splitlines()


def _changes(lines: list[str]) -> list[tuple[int, float]]:
    fields = [line.split(",") for line in lines]
    return [(int(t), float(volts)) for t, volts, *_ in fields if t.isdigit()]
