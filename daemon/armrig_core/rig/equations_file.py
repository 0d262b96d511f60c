"""A Python file with own equations, `model = armrig.Ode(…)`, and the process that runs it.

The file is code, so it is executed only if a person names it on this machine, never from the
description that is attached to a recording. The daemon and the emulator do not execute it: a
process of its own integrates the equations and ends with its parent. Each request is a line of JSON
with inputs and the time for which each is held; the answer contains the outputs.
"""

from __future__ import annotations

import os
import runpy
import select
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from math import ceil
from pathlib import Path
from typing import Any
from weakref import finalize

import msgspec
import numpy as np
from numpy.typing import NDArray

from armrig_core.errors import InputError, OperationError
from armrig_core.process.printable import plural, printable
from armrig_core.process.realtime import end_with_parent, leave_fifo
from armrig_core.rig.equations import (
    Course,
    Ode,
    derivative_function,
    evaluate_outputs,
    integrate_ode,
)

# Largest times to answer, in the emulator and, with a limit of the processor time, in a rehearsal.
_START_S, _ANSWER_S, _GUEST_S = 3.0, 2.0, 60.0
_END_S = 1.0  # longest time from the end of the answers to that of the process
_TOLERANCE = 1e-6  # relative change of the states if the steps are doubled
_MAX_STEPS = 4096  # of one interval
_MAX_CHARACTERS = 1000  # of an error of the file
_MAX_ANSWER_BYTES = 1 << 26  # more than the outputs of the longest run
_announced: set[Path] = set()  # files that this program has already named


def load_equations(path: Path) -> Ode:
    """Execute a model file, and return its `model`; raise InputError with the line of an error."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: no regular file")
        model = runpy.run_path(str(path)).get("model")
    except InputError:
        raise
    except BaseException as err:  # a file may also raise SystemExit
        frames = traceback.extract_tb(err.__traceback__)[::-1]
        line = next((f.lineno for f in frames if f.filename == str(path)), None)
        if line is None and isinstance(err, OSError):
            raise InputError(f"{path}: {err.strerror}") from err
        where = f", line {line}" if line else ""
        raise InputError(f"{path}{where}: {type(err).__name__}: {err}") from err
    if not isinstance(model, Ode):
        raise InputError(f"{path} defines no `model`; write model = armrig.Ode(f=…, …)")
    return model


class EquationsProcess:
    """The process of a model file; the states are 0 at first."""

    def __init__(
        self, path: Path, outputs: Sequence[str], cpu_s: int = 0, rest_v: float = 0.0
    ) -> None:
        """Start the process at the input `rest_v`; raise InputError if the model has other outputs.

        After its start it may have `cpu_s` seconds of processor time. With 0, the processor time is
        not limited, and each answer takes at most 2 s.
        """
        self._path, self._t, self._cpu_s = path, 0.0, cpu_s
        self._until_s = time.monotonic() + _GUEST_S
        program = [sys.executable, "-m", __name__, str(path), str(os.getpid()), str(cpu_s)]
        program.append(repr(rest_v))
        if path not in _announced:
            _announced.add(path)
            print(f"executing {path}", file=sys.stderr, flush=True)
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(program, stdin=pipe, stdout=pipe, start_new_session=True)
        self.close = finalize(self, _end, self._process)
        """End the process."""
        *self.matrices, self.rest, self.delay_s = self._answer(_START_S)
        """A, B and C of small motions about the states 0 and the rest; the outputs there, and the
        dead time of the input, in s."""
        if len(self.rest) != len(outputs):
            self.close()
            raise InputError(
                f"{path}: output returns {plural(len(self.rest), 'value')}; the rig has "
                f"{plural(len(outputs), 'output')}, {', '.join(outputs)}"
            )

    def run(self, u: Sequence[float], dt: float) -> NDArray[np.float64]:
        """Hold each input for dt seconds; return the outputs (N, ny) after each, without rest."""
        if self._process.stdin is not None:
            with suppress(BrokenPipeError):  # the process has ended, as its answer says
                self._process.stdin.write(msgspec.json.encode((u, dt)) + b"\n")
                self._process.stdin.flush()
        y = np.array(self._answer(_ANSWER_S))
        if y.shape != (len(u), len(self.rest)):
            self.close()
            raise InputError(f"{self._path}: the number of outputs changes after t = {self._t:g} s")
        self._t += len(u) * dt
        return np.asarray(y - self.rest)

    def _answer(self, limit_s: float) -> list[Any]:
        line, out = bytearray(), self._process.stdout
        until = self._until_s if self._cpu_s else time.monotonic() + limit_s
        while out is not None and not line.endswith(b"\n"):
            if not select.select([out], [], [], max(0.0, until - time.monotonic()))[0]:
                raise self._too_long(f"{_GUEST_S if self._cpu_s else limit_s:g} s")
            part = os.read(out.fileno(), 1 << 16)
            line += part
            if not part and self._has_used_its_time():
                raise self._too_long(f"{self._cpu_s} s of processor time")
            if not part or len(line) > _MAX_ANSWER_BYTES:
                reason = "wrote too much" if part else "ended"
                line[:] = msgspec.json.encode(f"the process {reason} after t = {self._t:g} s")
                break
        try:
            answer = msgspec.json.decode(line, type=str | list[Any])
        except msgspec.DecodeError:  # the file wrote to a descriptor that it did not open
            answer = f"the process gave no answer after t = {self._t:g} s"
        if isinstance(answer, str):
            self.close()
            raise InputError(f"{self._path}: {answer}")
        return list(answer)

    def _has_used_its_time(self) -> bool:
        with suppress(subprocess.TimeoutExpired):  # a file may close its descriptors, and go on
            return self._process.wait(_END_S) == -signal.SIGXCPU
        return False

    def _too_long(self, limit: str) -> OperationError:
        self.close()
        at = f"{self._path}: from t = {self._t:g} s on"
        way_out = "play fewer samples, or make the file faster"
        return OperationError(f"{at} the file took more than {limit}: {way_out}")


def _end(process: subprocess.Popen[bytes]) -> None:
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)  # also processes that the file has started
    process.wait()
    for stream in (process.stdin, process.stdout):
        with suppress(BrokenPipeError):
            if stream is not None:
                stream.close()


class _Motion:
    """Motion of the states from 0."""

    def __init__(self, ode: Ode, rest_v: float) -> None:
        self.rest_v = rest_v
        self.ode, self.x, self.t, self.step_s = ode, np.zeros((len(ode.states), 1, 1)), 0.0, np.inf

    def linear(self) -> list[Any]:
        """Return A, B, C of small motions about states 0 and rest, outputs, and dead time."""
        n, ode, h = len(self.ode.states), self.ode, 1e-6
        derivative, p = derivative_function(ode, (1, 1)), ode.point(**ode.values)

        def at(z: NDArray[np.float64]) -> NDArray[np.float64]:
            t, x = np.zeros((1, 1)), z[:n, None, None].copy()
            u = self.rest_v + z[n:, None, None]
            y = evaluate_outputs(ode, t, x, u, p, (1, 1))
            return np.concatenate([derivative(t, x, u, p), y])[:, 0, 0]

        with np.errstate(all="ignore"):
            slopes = [(at(step) - at(-step)) / (2 * h) for step in h * np.eye(n + 1)]
            M, rest_y = np.nan_to_num(slopes).T, at(np.zeros(n + 1))[n:]
        _check_finite(rest_y)
        matrices = [M[:n, :n].tolist(), M[:n, n:].tolist(), M[n:, :n].tolist()]
        return [*matrices, rest_y.tolist(), ode.delay]

    def held(self, u: float, dt: float) -> list[float]:
        """Hold an input for a time; return the outputs at its end."""
        t = self.t + np.array([[0.0], [dt]])
        held = np.full((2, 1, 1), u)
        course = Course(u=held, before=held, t=t, Ts=dt, linear=(False,))
        steps = max(1, int(np.ceil(dt / self.step_s)))
        try:
            with np.errstate(all="ignore"):
                fine = integrate_ode(self.ode, course, self.x, self.ode.values, steps)
                while steps <= _MAX_STEPS:
                    coarse = fine
                    fine = integrate_ode(self.ode, course, self.x, self.ode.values, 2 * steps)
                    size = np.abs(fine.end) + np.abs(self.x) + _TOLERANCE
                    if np.all(np.abs(fine.end - coarse.end) <= _TOLERANCE * size):
                        y = fine.y[1, :, 0, 0]
                        _check_finite(y)
                        self.x, self.t = fine.end, self.t + dt
                        # Longer at first in the next interval; a short one says nothing.
                        self.step_s = 2 * dt / steps if steps > 1 else max(self.step_s, dt)
                        return [float(value) for value in y]
                    steps *= 2
            raise InputError(f"{_MAX_STEPS} steps in {dt:.2g} s do not follow the equations")
        except ValueError as err:  # also numpy's, if the number of outputs changes
            state = ", ".join(f"{x:.4g}" for x in self.x.ravel())
            raise InputError(f"at t = {self.t:.4g} s, x = [{state}], u = {u:.3g} V: {err}") from err


def _check_finite(y: NDArray[np.float64]) -> None:
    if not np.all(np.isfinite(y)):
        raise InputError("output returns a value that is not finite")


def _serve(path: Path, parent: int, cpu_s: int, rest_v: float) -> None:
    """Answer the requests on standard input until it ends; see `EquationsProcess`."""
    leave_fifo()  # the emulator may be at SCHED_FIFO
    end_with_parent(parent, signal.SIGKILL)  # the file may ignore SIGTERM
    answers, requests = os.fdopen(os.dup(1), "wb"), os.fdopen(os.dup(0), "rb")
    os.dup2(2, 1)  # the file may print
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)  # and read

    def answer(value: object) -> None:
        answers.write(msgspec.json.encode(value) + b"\n")
        answers.flush()

    if cpu_s:
        import resource  # Windows, which also loads equations, has none

        most = ceil(time.process_time()) + cpu_s
        resource.setrlimit(resource.RLIMIT_CPU, (most, most + 1))
    try:
        motion = _Motion(load_equations(path), rest_v)
        answer(motion.linear())
        for line in requests:
            u, dt = msgspec.json.decode(line)
            answer([motion.held(volts, dt) for volts in u])
    except ValueError as err:
        answer(printable(str(err).removeprefix(f"{path}: ")[:_MAX_CHARACTERS]))


if __name__ == "__main__":
    _serve(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]))
