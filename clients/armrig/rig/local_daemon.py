"""A daemon of this machine as a child: started, waited for, and ended whatever happens."""

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

_START_S = 60.0  # the daemon itself waits 30 s for the rig that it emulates
_STOP_S = 5.0
_POLL_S = 0.1


@contextmanager
def running(arguments: Sequence[str], *, rig: str, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run `armrigd run` with these arguments until the block ends; the motor is then at 0 V.

    The daemon ends in the same good order where this process is killed, or the thread that called
    ends: the kernel tells it.

    Parameters
    ----------
    rig : str
        Its id, by which it is waited for until it answers.
    log : Path
        Where all that it says goes.

    Yields
    ------
    Popen
        The daemon, which answers.

    Raises
    ------
    RigError
        Another daemon answers for this rig; or ours ended, or does not answer: quotes its last
        line.
    """
    _require_none(rig)
    program = [sys.executable, "-m", "armrig_daemon", "run", "--parent", str(os.getpid())]
    log.unlink(missing_ok=True)  # and not emptied: another daemon may still write to it
    with log.open("wb") as output:
        # A session of its own: Ctrl-C is ours, and we stop it in order.
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


def _require_none(rig: str) -> None:
    """Refuse where another daemon answers: what is shown as ours would be its."""
    try:
        with Rig(rig) as opened:
            opened.status()
    except NoReplyError:
        return
    raise RigError(f"a daemon of rig {rig} already runs; end it, or choose another --rig")


def stop(daemon: subprocess.Popen[bytes]) -> None:
    """Ask the daemon to end, which brings the motor to 0 V; kill it where it does not.

    A second Ctrl-C does not keep it from that.
    """
    if daemon.poll() is not None:
        return
    daemon.send_signal(signal.SIGTERM)
    try:
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:  # not the main thread, which no signal interrupts
        before = None
    try:
        daemon.wait(_STOP_S)
    except subprocess.TimeoutExpired:
        daemon.kill()
        daemon.wait()
    finally:
        if before is not None:
            signal.signal(signal.SIGINT, before)


def require_running(daemon: subprocess.Popen[bytes], log: Path) -> None:
    """Raise RigError with the daemon's last line where it has ended."""
    if daemon.poll() is None:
        return
    raise RigError(f"the daemon ended with exit code {daemon.returncode}: {_last_line(log)}")


def _last_line(log: Path) -> str:
    """Return the last line of a log."""
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return lines[-1].removeprefix("armrigd: ") if lines else f"it said nothing in {log}"


def _wait_until_it_answers(daemon: subprocess.Popen[bytes], rig: str, log: Path) -> None:
    until = time.monotonic() + _START_S
    while time.monotonic() < until:
        require_running(daemon, log)
        try:
            with Rig(rig) as opened:
                opened.status()
        except NoReplyError:
            time.sleep(_POLL_S)  # not yet
        else:
            require_running(daemon, log)  # who answered may be another one, which ours gave way to
            return
    msg = f"the daemon did not answer within {_START_S:g} s; its last line: {_last_line(log)}; if "
    raise RigError(f"{msg}this host is busy, close other programs and try again ({log})")
