"""Process that plans the runs of a service, so that no stop waits for a long input or a model.

A request and its answer are frames on the process's standard input and output: the length as u64,
then as many bytes. The process is started with the service, ends with it, and is replaced if it was
killed.
"""

from __future__ import annotations

import os
import pickle
import queue
import resource
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from importlib import import_module
from io import BufferedReader
from typing import IO, NamedTuple

from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import Refused, RunOptions, build_refusal
from armrig_core.process import realtime
from armrig_core.rig.description import Description

from armrig_daemon.config import Config
from armrig_daemon.service.plan import RunPlan, plan_of

CPU_S = 60
"""Longest processor time of a plan, in s."""
WALL_S = 60.0
"""Longest time of a plan, in s, for equations that only wait."""
_START, _END = -1, -2  # in the place of a job's number: start the process, end the thread
_END_S = 1.0  # time for the process to end its own processes
_LENGTH = struct.Struct("<Q")
_READ = 1 << 20


class Job(NamedTuple):
    """Request for a plan; `number` names it."""

    number: int
    payload: bytes
    """Command as JSON."""
    Ts: float
    """Sampling time of the lease, in s."""
    config: Config
    start_rad: float | None
    """Angle of the turning shaft, in rad; None if it is not known."""
    command: str = RunOptions.name
    """Name of the command, `run` or `control`."""


Result = RunOptions | RunPlan | Refused
"""Options of a run, which are known first, its plan, or the reason why there is none."""


class Planner:
    """Thread that has runs planned by a process, one after the other."""

    def __init__(self, description: Description, changed: Callable[[], None], stderr: int) -> None:
        """Start the thread, which calls `changed` after each plan, but no process yet.

        `stderr` is the standard error of the process, and is closed at the end of the planner.
        """
        self._description, self._changed, self._stderr = description, changed, stderr
        self._numbers: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._results: queue.SimpleQueue[tuple[int, Result]] = queue.SimpleQueue()
        self._lock = threading.Lock()  # of the next four; never held while a call may wait
        self._job: Job | None = None
        self._wanted = 0  # number of the job whose plan is wanted; 0 without one
        self._process: subprocess.Popen[bytes] | None = None
        self._doomed: list[tuple[float, subprocess.Popen[bytes]]] = []
        self._thread = threading.Thread(target=self._serve, name="planner", daemon=True)
        self._thread.start()

    def start(self) -> None:
        """Start the process, so that the first run does not wait for its imports."""
        self._numbers.put(_START)

    def plan(self, job: Job) -> None:
        """Have a run planned; its plan follows from `result`."""
        with self._lock:
            self._job, self._wanted = job, job.number
        self._numbers.put(job.number)

    def result(self, number: int) -> Result | None:
        """Return the options, then the plan with this number, or its refusal; None: not yet."""
        while not self._results.empty():
            answer_number, plan = self._results.get()
            if answer_number == number:
                return plan
        return None

    def cancel(self) -> None:
        """Drop the plan that is being made, and end its process."""
        with self._lock:
            is_planning, self._wanted, self._job = bool(self._wanted), 0, None
        if is_planning:
            self._doom()
        self.result(0)

    def look(self) -> None:
        """Kill processes that do not end or plan for too long; call it each second."""
        now_s = time.monotonic()
        with self._lock:
            self._doomed = [doomed for doomed in self._doomed if doomed[1].poll() is None]
            late = [process for since_s, process in self._doomed if now_s > since_s + _END_S]
        for process in late:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)

    def close(self) -> None:
        """End thread and process."""
        self.cancel()
        self._numbers.put(_END)

    def _serve(self) -> None:
        while (number := self._numbers.get()) != _END:
            try:
                self._handle(number)
            except Exception as err:  # such as too little memory for another process
                _reap(self._doom())
                reason = f"the run could not be planned: {err!r}"
                self._hand_back(number, build_refusal(RefusalCode.INTERNAL, reason))
        _reap(self._doom())
        os.close(self._stderr)

    def _handle(self, number: int) -> None:
        process = self._started()
        with self._lock:
            if self._job is None or self._job.number != number:
                return  # it was cancelled
            job, self._job = self._job, None
        self._hand_back(number, self._answer(process, job))

    def _hand_back(self, number: int, result: Result) -> None:
        with self._lock:
            is_wanted = number == self._wanted
            if is_wanted and not isinstance(result, RunOptions):
                self._wanted = 0
        if is_wanted:
            self._results.put((number, result))
            self._changed()

    def _started(self) -> subprocess.Popen[bytes]:
        """Return the process; start it first if it has ended or must end."""
        with self._lock:
            process = self._process
        if process is None or process.poll() is not None:
            pipe = subprocess.PIPE
            process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(os.getpid())],
                stdin=pipe,
                stdout=pipe,
                stderr=self._stderr,
                start_new_session=True,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # a thread has 30 MiB
            )
            with self._lock:
                self._process = process
        return process

    def _doom(self) -> subprocess.Popen[bytes] | None:
        """Ask the process to end; no other plan uses it, and `look` kills it if it stays."""
        with self._lock:
            process, self._process = self._process, None
            if process is not None:
                self._doomed.append((time.monotonic(), process))
        if process is not None:
            process.terminate()
        return process

    def _answer(self, process: subprocess.Popen[bytes], job: Job) -> RunPlan | Refused:
        assert process.stdin is not None and process.stdout is not None  # noqa: S101, PT018 - pipes
        until_s = time.monotonic() + WALL_S
        late = threading.Timer(WALL_S, self._doom)  # also if the process does not read
        late.start()
        try:
            with suppress(BrokenPipeError):  # the process has ended, as its answer says
                settings = job.Ts, job.config, job.start_rad, self._description, job.command
                for part in (pickle.dumps((job.number, *settings)), job.payload):
                    _write(process.stdin, part)
            return self._read_plan(process.stdout.fileno(), job.number)
        except EOFError:
            self._doom()
            code = _reap(process)
        finally:
            late.cancel()
        if time.monotonic() >= until_s:
            return _too_long(f"{WALL_S:g} s")
        if code == -signal.SIGXCPU:
            return _too_long(f"{CPU_S} s of processor time")
        text = f"the planning process ended with code {code}: send the run again"
        return build_refusal(RefusalCode.INTERNAL, text)

    def _read_plan(self, fd: int, number: int) -> RunPlan | Refused:
        """Read the answer; raise EOFError if the process has ended."""
        while True:
            answer_number, result = pickle.loads(_read(fd))
            if answer_number != number:
                raise ValueError(f"the plan {answer_number} came instead of {number}")
            if not isinstance(result, RunOptions):
                break
            self._hand_back(number, result)
        source, text = _read(fd), _read(fd)
        return result._replace(source=source, text=text) if isinstance(result, RunPlan) else result


def _reap(process: subprocess.Popen[bytes] | None) -> int:
    """Wait for the end of a process, kill it if it stays, and return its exit code."""
    if process is None:
        return 0
    try:
        code = process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        code = process.wait()
    for stream in (process.stdin, process.stdout):
        with suppress(BrokenPipeError):
            if stream is not None:
                stream.close()
    return code


def _too_long(limit: str) -> Refused:
    return build_refusal(
        RefusalCode.NOT_ALLOWED,
        f"the rehearsal took more than {limit}: play fewer samples, or make the model faster",
    )


def _write(stream: IO[bytes], data: bytes) -> None:
    stream.write(_LENGTH.pack(len(data)))
    stream.write(data)
    stream.flush()


def _read(fd: int) -> bytes:
    """Read a frame; raise EOFError if the process has ended."""

    def exactly(count: int) -> bytes:
        parts = []
        while count:
            part = os.read(fd, min(count, _READ))
            if not part:
                raise EOFError
            parts.append(part)
            count -= len(part)
        return b"".join(parts)

    return exactly(*_LENGTH.unpack(exactly(_LENGTH.size)))


def _frame(stream: BufferedReader) -> bytearray:
    """Return a frame; it is empty at the end."""
    length = stream.read(_LENGTH.size)
    frame = bytearray(*_LENGTH.unpack(length)) if length else bytearray()
    stream.readinto(frame)
    return frame


def _limit_processor_time() -> None:
    used = resource.getrusage(resource.RUSAGE_SELF)
    most = int(used.ru_utime + used.ru_stime) + 1 + CPU_S
    resource.setrlimit(resource.RLIMIT_CPU, (most, resource.getrlimit(resource.RLIMIT_CPU)[1]))


def _main(parent: int) -> None:
    """Answer the requests on standard input until it ends."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # ends the process of own equations
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    realtime.end_with_parent(parent)
    for name in ("armrig_core.commands.rehearsal", "armrig_core.rig.arm"):
        import_module(name)  # now, so that the first run does not wait for it
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a library may print
    while request := _frame(requests):
        number, Ts, config, start_rad, description, command = pickle.loads(request)
        _limit_processor_time()
        source = text = b""

        def tell(value: object, number: int = number) -> None:
            _write(answers, pickle.dumps((number, value)))

        payload = partial(_frame, requests)
        result = plan_of(payload, Ts, config, description, start_rad, tell, command)
        if isinstance(result, RunPlan):
            source, text, result = result.source, result.text, result._replace(source=b"", text=b"")
        tell(result)
        for part in (source, text):
            _write(answers, part)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)


if __name__ == "__main__":
    _main(int(sys.argv[1]))
