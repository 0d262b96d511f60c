"""A loop at 50 Hz next to two busy programs: python-automationshield, and a law of armrig.

    python -m venv FOLDER
    FOLDER/bin/pip install python-automationshield  # its first import downloads arduino-cli
    python -m tests.benchmarks.shield_controller FOLDER/bin/python --seconds 60

Its board is a pseudo-terminal that speaks the protocol of its AeroShield; that of armrig is the
emulated rig, with its real-time priority and without. For each program the script prints

- the share of the inputs u[k] that were computed from y[k - 1] or a newer sample,
- the share of the intervals that differ by more than a tenth of Ts, and the longest interval,
- what the program records of an input at its limit,
- the time from `kill -9` of the controlling program to rest, several times.

The readings of the pseudo-terminal are the numbers of its samples, and the controller sends the
number that it read, so the board knows the age of each input.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import armrig
import numpy as np
from armrig.recordings.files.control_run import control_run
from armrig.rig.local_daemon import running
from armrig.rig.telemetry_stream import LiveGap
from armrig_daemon.config import TimingTable

Ts, WAIT_S, KILLS = 0.02, 10.0, 3
_RUN, _TEST = 1, 0
_CODES, _FIRST = 200, 20
"""Codes _FIRST to _FIRST + _CODES - 1 are numbers of samples; the code 255 is the limit."""
_SATURATED = 50

_THEIRS = f"""
import sys
from automationshield import AeroShield, ShieldController

class Echo(ShieldController):
    def variables(self):
        self.n = 0
    def controller(self, t, dt, ref, pot, sensor):
        self.n += 1
        number = round(sensor * 4096 / 360) % {_CODES}
        return (number + {_FIRST} + 0.5) * 100 / 255 if self.n > {_SATURATED} else 150.0

history = Echo(AeroShield(sys.argv[1])).run(freq=50, cycles=int(sys.argv[2]))
print("recorded as", set(history[:{_SATURATED}, 4].tolist()), "of", history.shape[1], "columns")
"""
_OURS = """
import sys, armrig
law = armrig.control.load_law(sys.argv[1])
with armrig.Rig("1") as rig:
    rig.arm("a benchmark", Ts=0.02)
    reference = [(0.5, 9.3)[k // 100 % 2] for k in range(int(sys.argv[2]))]
    print(rig.control(law, reference), flush=True)
"""


class Board:
    """Pseudo-terminal that answers as the firmware of an AeroShield, and notes each input."""

    def __init__(self) -> None:
        """Open the terminal, and answer in a thread."""
        self._end, terminal = os.openpty()
        tty.setraw(terminal)
        self.port = os.ttyname(terminal)
        self.inputs: list[tuple[float, int]] = []
        threading.Thread(target=self._answer, daemon=True).start()

    def _answer(self) -> None:
        pending = b""
        while True:
            pending += os.read(self._end, 64)
            while len(pending) >= 2:
                (flag, code), pending = pending[:2], pending[2:]
                if flag == _TEST:
                    os.write(self._end, b"\x01AE")
                    continue
                self.inputs.append((time.perf_counter(), code if flag == _RUN else 0))
                if flag == _RUN:
                    number = (len(self.inputs) - 1) % _CODES
                    os.write(self._end, bytes([0x00, 0x00, number]))

    def share_of_previous(self) -> str:
        """Return the share of numbered inputs that are computed from the sample before them."""
        used = [(n, code) for n, (_, code) in enumerate(self.inputs) if code not in (0, 255)]
        newest = [(n - 1) % _CODES == code - _FIRST for n, code in used]
        return f"{100 * np.mean(newest):.1f} % of {len(newest)} inputs from y[k - 1]"


@contextmanager
def two_busy_programs() -> Iterator[None]:
    """Run two programs that compute without a pause."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        yield
    finally:
        for program in busy:
            program.kill()


def intervals(times: list[float]) -> str:
    """Return the share of intervals that are off by a tenth of Ts, and the longest, as text."""
    gaps = np.diff(times)
    off = 100 * np.mean(np.abs(gaps / Ts - 1) > 0.1)
    return f"{off:.1f} % of {gaps.size} intervals off by a tenth, longest {1e3 * gaps.max():.0f} ms"


def measure_theirs(python: str, seconds: float) -> None:
    """Print the figures of python-automationshield."""
    board, count = Board(), round(seconds / Ts)
    program = [python, "-c", _THEIRS, board.port]
    with two_busy_programs():
        done = subprocess.run([*program, str(count)], check=True, stdout=subprocess.PIPE, text=True)
        times = [t for t, code in board.inputs if code]
        print(f"automationshield: {board.share_of_previous()}; {intervals(times)}")
        recorded = done.stdout.strip().splitlines()[-1]
        print(f"automationshield: an input of 150 % in {_SATURATED} samples: {recorded}")
        for _ in range(KILLS):
            loop = subprocess.Popen(
                [*program, "100000"], stdout=subprocess.DEVNULL, start_new_session=True
            )
            time.sleep(8.0)
            os.killpg(loop.pid, signal.SIGKILL)  # the controlling program is a child of it
            killed, n = time.perf_counter(), len(board.inputs)
            loop.wait()
            time.sleep(WAIT_S)
            rests = [t - killed for t, code in board.inputs[n:] if code == 0]
            held = f"not at rest after {WAIT_S:g} s, code {board.inputs[-1][1]}"
            print("automationshield, kill -9:", f"rest after {rests[0]:.2f} s" if rests else held)


def measure_ours(priority: int, seconds: float) -> None:
    """Print the figures of a law of armrig; `priority` 0 is that of an ordinary program."""
    arm = armrig.physics.arm(armrig.physics.ArmParameters())
    law = armrig.control.place(arm, [-17 + 17j, -17 - 17j, -24.5], rate=True, Ts=Ts)
    name = f"armrig, priority {priority}"
    with tempfile.TemporaryDirectory() as folder, two_busy_programs():
        path, settings = Path(folder) / "law.json", Path(folder) / "rig.toml"
        path.write_bytes(law.text)
        settings.write_text(f"[timing]\npriority = {priority}\n")
        program = [sys.executable, "-c", _OURS, str(path)]
        options = ["--emulate", "--config", str(settings)]
        with running(options, rig="1", log=Path(folder) / "log"):
            count = round(seconds / Ts)
            done = subprocess.run(
                [*program, str(count)], check=False, capture_output=True, text=True
            )
            if done.returncode:
                print(f"{name}: {done.stderr.splitlines()[-1]}")
                return
            recording = armrig.load(done.stdout.strip())
            run = control_run(recording)
            assert run is not None
            newest = 100 * np.mean(run.predicted == 0)
            times = (recording.samples["t_host_ns"] / 1e9).tolist()
            print(
                f"{name}: {newest:.1f} % of {run.k.size} inputs from y[k - 1]; {intervals(times)}"
            )
            print(f"{name}: {run.summary}")
            for _ in range(KILLS if priority else 0):
                print(
                    f"{name}, kill -9 of the client: rest after {_rest_after_kill(program):.2f} s"
                )


def _rest_after_kill(program: list[str]) -> float:
    """Kill the client of a run, and return the time until the device reports 0 V, in s."""
    held = subprocess.Popen([*program, "2000"], stdout=subprocess.DEVNULL)
    with armrig.Rig("1") as rig:
        samples = (sample for sample in rig.stream() if not isinstance(sample, LiveGap))
        next(sample for sample in samples if sample.u_applied_v > 0.5 or held.poll() is not None)
        assert held.poll() is None, "the run was refused"
        held.kill()
        killed = time.monotonic_ns()
        held.wait()
        times = (s.t_host_ns - killed for s in samples if s.u_applied_v == 0)
        return next(t for t in times if t > 0) / 1e9


def main() -> None:
    """Measure both programs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("python", help="Python that has python-automationshield")
    parser.add_argument("--seconds", type=float, default=60.0)
    chosen = parser.parse_args()
    parts = [partial(measure_theirs, chosen.python)]
    parts += [partial(measure_ours, priority) for priority in (TimingTable().priority, 0)]
    for measure in parts:
        print(f"load before: {os.getloadavg()[0]:.1f}")
        measure(chosen.seconds)


if __name__ == "__main__":
    main()
