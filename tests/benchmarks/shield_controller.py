"""A loop at 50 Hz next to two busy programs: python-automationshield, and a law of armrig.

    pip install python-automationshield --target FOLDER
    python -m tests.benchmarks.shield_controller FOLDER --seconds 30

Its board is a pseudo-terminal that speaks the protocol of its AeroShield; that of armrig is the
emulated rig. For each program the script prints

- the share of the samples whose input depends on the newest sample or the one before it,
- the share of the intervals that differ by more than a tenth of Ts, and the longest interval,
- the time from `kill -9` of the controlling program to rest.
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
from pathlib import Path

import armrig
import numpy as np
from armrig.recordings.files.control_run import control_run
from armrig.rig.local_daemon import running

Ts, WAIT_S = 0.02, 10.0
_RUN, _TEST = 1, 0

_THEIRS = """
import sys
from automationshield import AeroShield, ShieldController

class Proportional(ShieldController):
    def controller(self, t, dt, ref, pot, sensor):
        return 20 + 0.1 * (ref - sensor)

Proportional(AeroShield(sys.argv[1])).run(freq=50, cycles=int(sys.argv[2]), ref=45)
"""
_OURS = """
import sys, armrig
law = armrig.load_law(sys.argv[1])
with armrig.Rig("1") as rig:
    rig.arm("a benchmark", Ts=0.02)
    print(rig.control(law, [2.0] * int(sys.argv[2]), unmonitored=True), flush=True)
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
                    os.write(self._end, bytes([0x02, 0x00, 0x64]))


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


def measure_theirs(folder: str, seconds: float) -> None:
    """Print the figures of python-automationshield."""
    board, count = Board(), round(seconds / Ts)
    program = [sys.executable, "-c", _THEIRS, board.port]
    where = {**os.environ, "PYTHONPATH": folder}
    with two_busy_programs():
        subprocess.run([*program, str(count)], check=True, stdout=subprocess.DEVNULL, env=where)
        times = [t for t, code in board.inputs if code]
        print("automationshield: each input is that of the sample before it; " + intervals(times))
        running_one = subprocess.Popen(
            [*program, "100000"], stdout=subprocess.DEVNULL, start_new_session=True, env=where
        )
        time.sleep(8.0)
        os.killpg(running_one.pid, signal.SIGKILL)  # the controlling program is a child of it
        killed, n = time.perf_counter(), len(board.inputs)
        time.sleep(WAIT_S)
    rests = [t - killed for t, code in board.inputs[n:] if code == 0]
    print(
        f"automationshield: rest after {rests[0]:.2f} s"
        if rests
        else f"automationshield: not at rest {WAIT_S:g} s after kill -9, code {board.inputs[-1][1]}"
    )


def measure_ours(seconds: float) -> None:
    """Print the figures of a law of armrig."""
    arm = armrig.arm(armrig.ArmParameters())
    law = armrig.place(arm, [-8 + 8j, -8 - 8j, -20], rate=True, Ts=Ts)
    with tempfile.TemporaryDirectory() as folder, two_busy_programs():
        path = Path(folder) / "law.json"
        path.write_bytes(law.text)
        program = [sys.executable, "-c", _OURS, str(path)]
        with running(["--emulate"], rig="1", log=Path(folder) / "log"):
            count = round(seconds / Ts)
            done = subprocess.run([*program, str(count)], check=True, stdout=-1, text=True)
            recording = armrig.load(done.stdout.strip())
            run = control_run(recording)
            assert run is not None
            newest = 100 * np.mean(run.predicted == 0)
            times = (recording.samples["t_host_ns"] / 1e9).tolist()
            print(
                f"armrig: {newest:.1f} % of the inputs are those of the sample before; "
                + intervals(times)
            )
            held = subprocess.Popen([*program, "2000"], stdout=-1)
            with armrig.Rig("1") as rig:
                for sample in rig.stream():
                    if sample.u_applied_v > 0.5:
                        break
                held.kill()
                killed = time.perf_counter()
                for sample in rig.stream():
                    if sample.u_applied_v == 0:
                        break
            print(f"armrig: rest {time.perf_counter() - killed:.2f} s after kill -9 of the client")


def main() -> None:
    """Measure both programs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", help="folder with python-automationshield and its packages")
    parser.add_argument("--seconds", type=float, default=30.0)
    chosen = parser.parse_args()
    measure_theirs(chosen.folder, chosen.seconds)
    measure_ours(chosen.seconds)


if __name__ == "__main__":
    main()
