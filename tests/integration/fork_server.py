"""Programs that begin as copies of an interpreter that has loaded what they need.

Each is a process of its own that acts and ends as `python -m` or `python -c` does. Loading modules
takes most of a short program's time, and is done here once.
"""

from __future__ import annotations

import faulthandler
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import IO, Any

LOADED = (
    "armrig_daemon.service.service",
    "armrig_daemon.service.host.emulated_rig",
    "armrig_daemon.emulator.real_time",
    "armrig.rig.client",
)
SHOW_THREADS = signal.SIGUSR2
"""Signal at which a started program prints what each of its threads does."""
LAST_FRAME = " in <module>\n"
"""End of the outermost frame of the main thread, which is printed last."""
_MOST_BYTES = 1 << 20


class Forked:
    """A running program; has what `subprocess.Popen` has, as far as tests use it."""

    def __init__(self, pid: int, ended_fd: int) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self._ended_fd = ended_fd

    def poll(self) -> int | None:
        """Return the exit code; None while it runs."""
        return self._ended(0.0)

    def wait(self, timeout: float | None = None) -> int:
        """Return the exit code as soon as it has ended."""
        code = self._ended(timeout)
        if code is None:
            raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            with suppress(ProcessLookupError):  # its exit code is not here yet
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def _ended(self, within_s: float | None) -> int | None:
        if self.returncode is None and select.select([self._ended_fd], [], [], within_s)[0]:
            self.returncode = int(os.read(self._ended_fd, 100))
            os.close(self._ended_fd)
        return self.returncode


class ForkServer:
    """The interpreter that is copied; it ends with the process that started it."""

    def __init__(self) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            program = [sys.executable, __file__, str(theirs.fileno())]
            self._process = subprocess.Popen(program, pass_fds=(theirs.fileno(),))

    def start(
        self, arguments: list[str], env: Mapping[str, str], stdout: IO[bytes], stderr: IO[bytes]
    ) -> Forked:
        """Start `python` with arguments that begin with -m or -c; it has no standard input."""
        ended_out, ended_in = os.pipe()
        asked = json.dumps({"arguments": arguments, "env": dict(env), "folder": str(Path.cwd())})
        fds = [ended_in, stdout.fileno(), stderr.fileno()]
        socket.send_fds(self._socket, [asked.encode()], fds)
        os.close(ended_in)
        return Forked(int(self._socket.recv(100)), ended_out)

    def end(self) -> None:
        """End it; the started programs go on."""
        self._socket.close()
        self._process.wait()


def _copy(asked: socket.socket) -> dict[str, Any]:
    """Return, in a new process for each, the requested program."""
    while True:
        data, fds, _, _ = socket.recv_fds(asked, _MOST_BYTES, 3)
        if not data:
            sys.exit()
        if os.fork() == 0:
            break
        for fd in fds:
            os.close(fd)
        with suppress(ChildProcessError):  # what it took counts as ours: `time make test`
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
    # A parent for one program, because only a parent receives the exit code.
    ended_fd, stdout, stderr = fds
    pid = os.fork()
    if pid:
        asked.send(b"%d" % pid)
        asked.close()
        _, status = os.waitpid(pid, 0)
        os.write(ended_fd, b"%d" % os.waitstatus_to_exitcode(status))
        os._exit(0)
    asked.close()
    os.close(ended_fd)
    for of_program, fd in enumerate((os.open(os.devnull, os.O_RDONLY), stdout, stderr)):
        os.dup2(fd, of_program)
        os.close(fd)
    return dict(json.loads(data))


def _become(arguments: list[str], env: dict[str, str], folder: str) -> None:
    """Do what `python` does with these arguments; who returns from here ends as it does."""
    os.environ.clear()
    os.environ.update(env)
    os.chdir(folder)
    faulthandler.register(SHOW_THREADS)
    how, what, *given = arguments
    sys.argv = [how, *given]
    if (what, *given[:1]) == ("armrig_daemon", "run"):
        main_thread().guard()
    if how == "-m":
        runpy.run_module(what, run_name="__main__", alter_sys=True)
    else:
        exec(compile(what, "<string>", "exec"), {"__name__": "__main__"})


def main_thread() -> Any:
    """Return the module that watches the main thread of a daemon."""
    sys.path.insert(0, str(Path(__file__).parent))
    try:
        return import_module("main_thread")
    finally:
        del sys.path[0]


def _load() -> None:
    """Load the modules, and those that typer needs to read a command line."""
    for module in LOADED:
        import_module(module)
    from armrig_daemon.command_line import app
    from typer.main import get_command

    get_command(app).make_context("armrigd", ["emulate"]).close()


if __name__ == "__main__":
    _load()
    _become(**_copy(socket.socket(fileno=int(sys.argv[1]))))
