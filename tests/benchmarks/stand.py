"""A rig on real processes for repeated events; a broken process is replaced.

Daemon and emulator are started once, and again only if an event ended them. Clients are forked from
a process that has imported its modules; that does not change their behaviour.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import resource
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from armrig.rig.client import Rig
from armrig.rig.session import RigError

from tests.integration.processes import WITHIN_S, Bench, Process, state_of, wait_for
from tests.integration.relay import Relay

DEAD_MAN_S = 1.0
_TS = 0.005
_CLIENTS = multiprocessing.get_context("forkserver")
# Without the preload each client would import the benchmark again.
_CLIENTS.set_forkserver_preload(["__main__", "tests.benchmarks.stand"])


def drive(endpoint: str, mode: str) -> None:
    """Play a run, or drive by hand, as a client of its own process."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # that its run ends early is what we are here for
    with Rig(connect=endpoint) as rig:
        rig.arm("benchmark", Ts=_TS)
        if mode == "hand":
            while True:
                for volts in (1.0, 4.0):
                    rig.set(volts)
                    time.sleep(0.02)
        dead_man = DEAD_MAN_S if mode == "dead-man" else None
        pacing: Any = "exchange" if mode == "exchange" else "scheduled"
        rig.run([1.0, 4.0] * 2000, pacing=pacing, dead_man=dead_man)


class Witness:
    """Voltages at the motor's terminals, read as they are written."""

    def __init__(self, trace: Path) -> None:
        self._file = trace.open("rb")
        self._rest = b""
        self.changes: list[tuple[int, float]] = []
        """Monotonic ns, V."""

    def look(self) -> list[tuple[int, float]]:
        """Return all changes so far."""
        *lines, self._rest = (self._rest + self._file.read()).split(b"\n")
        for line in lines:
            t, volts, *_ = line.split(b",")
            if t.isdigit():
                self.changes.append((int(t), float(volts)))
        return self.changes

    def volts_at(self, t_ns: int) -> float:
        """Return the voltage at a time."""
        return next((volts for t, volts in reversed(self.changes) if t <= t_ns), 0.0)

    def stopped_ms_after(self, t_ns: int) -> float:
        """Return the time from `t_ns` until the motor stayed at 0 V, in ms."""
        wait_for(lambda: self.look()[-1][1] == 0.0)
        return max(0, self.changes[-1][0] - t_ns) / 1e6


class Stand:
    """An emulated rig, with or without a line that can fail, and what drives it."""

    def __init__(
        self, folder: Path, *, has_line: bool, terminal: bool = True, as_run_emulate: bool = False
    ) -> None:
        self.bench = Bench(folder, terminal=terminal)
        if as_run_emulate:
            self.bench.configure(watchdog_ms=250, more="tolerates_stalls = true")
        self.bench.emulate()
        self.witness = Witness(self.bench.trace)
        self.relay: Relay | None = None
        if has_line:
            self.relay = Relay(self.bench.port, folder / "line")
            self.bench.port = folder / "line"
            self.bench.configure()
        self.endpoint = f"unixsock-stream/{folder}/armrig/1.sock"
        self._daemon: Process | None = None
        self._loop_pid = 0
        self._rig: Rig | None = None
        self.client: Any = None

    @property
    def daemon(self) -> Process:
        """The service."""
        assert self._daemon is not None
        return self._daemon

    @property
    def loop_pid(self) -> int:
        """The process of the loop."""
        return self._loop_pid

    @property
    def rig(self) -> Rig:
        """A client that only looks, and stops."""
        assert self._rig is not None
        return self._rig

    def line(self, what: str) -> None:
        """Let something happen to the line."""
        assert self.relay is not None
        self.relay.do(what)

    def kill_loop(self) -> None:
        """Kill it."""
        os.kill(self._loop_pid, signal.SIGKILL)

    def kill_both(self) -> None:
        """Kill loop and service."""
        self.kill_loop()
        self.daemon.kill()

    def freeze_loop(self) -> None:
        """Freeze it."""
        os.kill(self._loop_pid, signal.SIGSTOP)

    def freeze_client(self) -> None:
        """Freeze who drives."""
        os.kill(self.client.pid, signal.SIGSTOP)

    def fill_disk(self) -> None:
        """Leave the service no room in its recording."""
        (active,) = self.bench.recordings.glob("*.active")
        self._limit_files(active.stat().st_size)

    def move_recordings(self) -> None:
        """Give the directory of the recordings another name."""
        self.bench.recordings.rename(self.bench.folder / "elsewhere")

    def remove_recordings(self) -> None:
        """Remove the directory of the recordings with its files."""
        shutil.rmtree(self.bench.recordings)

    def make_ready(self) -> None:
        """Bring everything back to rest."""
        self.let_go()
        self._thaw()
        try:
            if self._daemon is None or not self._is_at_rest():
                self._restart()
        except (RigError, AssertionError):
            self._restart()
        shutil.rmtree(self.bench.folder / "elsewhere", ignore_errors=True)
        self.bench.recordings.mkdir(exist_ok=True)
        for path in self.bench.recordings.glob("*"):
            path.unlink()

    def begin(self, mode: str) -> bool:
        """Have a client drive; return whether it does."""
        before = len(self.witness.look())
        self.client = _CLIENTS.Process(target=drive, args=(self.endpoint, mode), daemon=True)
        self.client.start()
        with contextlib.suppress(AssertionError):
            wait_for(lambda: len(self.witness.look()) > before)
            return True
        return False

    def outcome(self) -> str:
        """Return how the last run ended, once its recording is finished."""
        wait_for(lambda: (last := self.rig.status().last_run) is not None and last.finished)
        last = self.rig.status().last_run
        assert last is not None
        return last.outcome

    def let_go(self) -> None:
        """End the client."""
        if self.client is not None:
            self.client.kill()
            self.client.join()
            self.client = None

    def end(self) -> None:
        """End all."""
        self.let_go()
        self._thaw()
        self._disconnect()
        if self.relay is not None:
            self.relay.end()
        for process in reversed(self.bench.processes):
            process.end()

    def _thaw(self) -> None:
        for pid in (self._loop_pid, self._daemon.popen.pid if self._daemon else 0):
            if pid:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)
        if self._daemon is not None and self._daemon.popen.poll() is None:
            self._limit_files(resource.RLIM_INFINITY)
        if self.relay is not None:
            self.relay.do("ends")
            if not (self.bench.folder / "line").exists():
                self.relay.do("plug")

    def _limit_files(self, size: int) -> None:
        limits = (size, resource.RLIM_INFINITY)
        resource.prlimit(self.daemon.popen.pid, resource.RLIMIT_FSIZE, limits)

    def _is_at_rest(self) -> bool:
        if self.daemon.popen.poll() is not None:
            return False
        self.rig.stop()
        self._settle(lambda: self.rig.status().phase in ("safe", "fault"))
        if self.rig.status().phase == "fault":
            self._settle(self._is_reset)
        self._settle(lambda: (last := self.rig.status().last_run) is None or last.finished)
        return True

    def _is_reset(self) -> bool:
        """Reset, as often as it takes: a device that was unplugged has to be met again."""
        with contextlib.suppress(RigError):
            self.rig.reset()
        return self.rig.status().phase == "safe"

    def _settle(self, what: Callable[[], object]) -> None:
        wait_for(what, WITHIN_S / 2)

    def _restart(self) -> None:
        self._disconnect()
        if self._daemon is not None:
            self._daemon.popen.kill()
            self._daemon.popen.wait()
            if self._loop_pid:
                wait_for(lambda: _is_gone(self._loop_pid))
        self._daemon = self.bench.start("armrig_daemon", "run", "--config", str(self.bench.config))
        wait_for(lambda: self._connects() or self.daemon.popen.poll() is not None)
        assert self.daemon.popen.poll() is None, self.daemon.said
        self._loop_pid = self.bench.loop_pid(self.daemon)
        wait_for(lambda: self.rig.status().phase == "safe" or self._is_reset())

    def _connects(self) -> bool:
        if not (self.bench.folder / "armrig" / "1.sock").exists():
            return False
        try:
            self._rig = Rig(connect=self.endpoint).__enter__()
            self._rig.status()
        except RigError:
            self._disconnect()
            return False
        return True

    def _disconnect(self) -> None:
        rig, self._rig = self._rig, None
        if rig is not None:
            with contextlib.suppress(RigError):
                rig.__exit__()


def _is_gone(pid: int) -> bool:
    """Return whether a process has ended, also before its exit code was read."""
    with contextlib.suppress(OSError):
        return state_of(pid) == "Z"
    return True
