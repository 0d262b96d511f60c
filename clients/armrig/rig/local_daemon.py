"""Start a daemon on this machine as a child process, and end it after a `with` block."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from armrig.rig.client import Rig
from armrig.rig.session import NoReplyError, RigError

_START_TIMEOUT_S = 60.0  # the daemon itself waits 30 s for the rig that it emulates
_STOP_TIMEOUT_S = 30.0  # on a busy host the loop alone takes seconds to load
_POLL_INTERVAL_S = 0.1


@contextmanager
def running(arguments: Sequence[str], *, rig: str, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run `armrigd run` until the block ends; the end of the block sets the motor to 0 V.

    If this process is killed or the calling thread ends, the kernel sends a signal to the daemon.
    After this signal the daemon also sets the motor to 0 V and ends. The block begins after the
    first answer of the rig with the id `rig`. The file `log` gets all output of the daemon.

    Raises RigError if another daemon answers for this rig, or the new daemon has ended or does not
    answer. The message contains the last line of the daemon's log.
    """
    if _answers(rig):  # clients cannot distinguish two daemons
        raise RigError(f"a daemon of rig {rig} already runs; end it, or choose another --rig")
    program = [sys.executable, "-m", "armrig_daemon", "run", "--parent", str(os.getpid())]
    log.unlink(missing_ok=True)  # not truncated: another daemon may still write to it
    with log.open("wb") as output:
        # A new session: Ctrl-C reaches this process only, which stops the daemon in order.
        daemon = subprocess.Popen(
            [*program, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            start_new_session=True,
        )
        try:
            _wait_until_it_answers(daemon, rig, log)
            yield daemon
        finally:
            stop(daemon)


def _answers(rig: str) -> bool:
    try:
        with Rig(rig) as opened:
            opened.status()
    except NoReplyError:
        return False
    return True


def stop(daemon: subprocess.Popen[bytes]) -> None:
    """Make the daemon set the motor to 0 V and end; kill the daemon if it does not end.

    Ctrl-C does not interrupt the wait for the daemon's end.
    """
    if daemon.poll() is not None:
        return
    daemon.send_signal(signal.SIGTERM)
    try:
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:  # this is not the main thread; signals interrupt only the main thread
        before = None
    try:
        daemon.wait(_STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        daemon.kill()
        daemon.wait()
    finally:
        if before is not None:
            signal.signal(signal.SIGINT, before)


def require_running(daemon: subprocess.Popen[bytes], log: Path) -> None:
    """Raise RigError if the daemon has ended, with the signal or the last line of the log."""
    if daemon.poll() is None:
        return
    if daemon.returncode < 0:
        raise RigError(f"the daemon was ended by {signal.Signals(-daemon.returncode).name} ({log})")
    raise RigError(f"the daemon ended with exit code {daemon.returncode}: {_last_line(log)}")


def _last_line(log: Path) -> str:
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return lines[-1].removeprefix("armrigd: ") if lines else f"it printed nothing in {log}"


def _wait_until_it_answers(daemon: subprocess.Popen[bytes], rig: str, log: Path) -> None:
    until = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < until:
        require_running(daemon, log)
        if _answers(rig):
            require_running(daemon, log)  # if another daemon has answered, the new daemon has ended
            return
        time.sleep(_POLL_INTERVAL_S)
    msg = f"the daemon did not answer within {_START_TIMEOUT_S:g} s; last line: {_last_line(log)}; "
    raise RigError(f"{msg}if this host is busy, close other programs and try again ({log})")
