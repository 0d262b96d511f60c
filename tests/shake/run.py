"""One run of a command under a condition."""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, NamedTuple

from tests.shake import suite
from tests.shake.conditions import Condition
from tests.shake.stopping import WALL, stopped
from tests.stalls.host import STOPS

PAUSE_S: Final = 2.0
"""Mean time from one stop to the next; drawn from an exponential distribution."""
SUMMARY_S: Final = 30.0
"""Time for pytest's summary after the limit, in s."""
TIMED_OUT: Final = 124
_BURNER: Final = "while True: pass"
_LOOK_S: Final = 0.1


class Result(NamedTuple):
    """Outcome of a run."""

    exit_code: int
    wall_s: float
    cpu_s: float
    """Processor time of the command and its children, user and system."""
    stops: int
    left_over: int
    """Processes that were still there after the command."""
    failed: list[str]
    repeated: list[str]


def run(
    command: list[str],
    condition: Condition,
    seed: int,
    *,
    folder: Path,
    log: Path,
    limit_s: float,
    environ: dict[str, str],
) -> Result:
    """Run a command in a folder, its output in a log; kill it after the limit."""
    generator = random.Random(seed)
    cores = sorted(os.sched_getaffinity(0))
    allowed = [generator.choice(cores)] if condition.one_core else cores
    mark = f"{os.getpid()}-{time.monotonic_ns()}"
    stops = log.with_suffix(".stops")
    stops.write_text("")
    options = f"--hypothesis-profile drawn --hypothesis-seed {seed}"
    options += f" --order-seed {seed}" if condition.shuffled else ""
    environ = {
        **environ,
        suite.MARK: mark,
        STOPS: str(stops),
        "PYTEST_ADDOPTS": f"{environ.get('PYTEST_ADDOPTS', '')} {options}".strip(),
    }
    with ExitStack() as stack:
        for _ in range(condition.burners):
            burner = subprocess.Popen([sys.executable, "-c", _BURNER], start_new_session=True)
            stack.callback(burner.wait)
            stack.callback(burner.kill)
        stack.callback(suite.kill, mark)
        began = time.monotonic()
        with log.open("wb") as output:
            program = subprocess.Popen(
                command,
                cwd=folder,
                env=environ,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                preexec_fn=lambda: os.sched_setaffinity(0, allowed),
                # As in a terminal of its own. If one session has programs pinned to two cores,
                # Linux 6.18 lets other programs on these cores wait for 40 s.
                start_new_session=True,
            )
        n = 0
        ended: tuple[int, Any] | None = None
        while ended is None and time.monotonic() - began < limit_s:
            pause_s = generator.expovariate(1 / PAUSE_S) if condition.stop_ms else _LOOK_S
            ended = _ended(program, min(pause_s, limit_s))
            if ended is None and condition.stop_ms:
                n += _stop_one(mark, generator, generator.randint(*condition.stop_ms), stops)
        if timed_out := ended is None:
            ended = interrupted(program)
        left_over = suite.kill(mark)
        ended = ended or _ended(program, None)
        assert ended is not None
        wall_s = time.monotonic() - began
    code, usage = ended
    code = TIMED_OUT if timed_out else code
    text = log.read_text(errors="replace")
    return Result(
        exit_code=code,
        wall_s=round(wall_s, 1),
        cpu_s=round(usage.ru_utime + usage.ru_stime, 2),
        stops=n,
        left_over=left_over,
        failed=named(text, "FAILED|ERROR"),
        repeated=named(text, "REPEATED"),
    )


def interrupted(program: subprocess.Popen[bytes]) -> tuple[int, Any] | None:
    """Interrupt a program and its group: pytest shows what failed up to here.

    Return its exit code and its resource usage; None if it still runs after `SUMMARY_S`.
    """
    os.killpg(program.pid, signal.SIGINT)
    return _ended(program, SUMMARY_S)


def named(text: str, how: str) -> list[str]:
    """Return the tests that the summary of pytest names."""
    return list(dict.fromkeys(re.findall(rf"^(?:{how}) (tests/.*?)(?: - |$)", text, re.M)))


def _ended(program: subprocess.Popen[bytes], within_s: float | None) -> tuple[int, Any] | None:
    """Return the exit code and the resource usage of a program; None if it still runs then."""
    until = time.monotonic() + (float("inf") if within_s is None else within_s)
    while True:
        # A thread that was killed while it was stopped is ours to wait for, too.
        try:
            pid, status, usage = os.wait4(-1, os.WNOHANG | WALL)
        except ChildProcessError:
            return None
        if pid == program.pid and not os.WIFSTOPPED(status):
            program.returncode = os.waitstatus_to_exitcode(status)
            return program.returncode, usage
        if pid == 0:
            if time.monotonic() > until:
                return None
            time.sleep(min(_LOOK_S, max(0.0, until - time.monotonic())))


def _stop_one(run: str, generator: random.Random, length_ms: int, stops: Path) -> bool:
    """Stop a process of a run; return whether that was possible."""
    candidates = suite.processes(run)
    if not candidates:
        return False
    pid = generator.choice(candidates)
    pids = " ".join(map(str, suite.ancestors(pid)))
    began_ns = time.monotonic_ns()
    with stops.open("a") as file:
        file.write(f"{began_ns} {began_ns + length_ms * 1_000_000} {pids}\n")
    with stopped(pid) as done:
        if done:
            time.sleep(length_ms / 1000)
    return done
