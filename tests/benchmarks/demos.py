"""Outcomes of `armrig demo` on a busy machine, one after another, each in a fresh folder.

`python -m tests.benchmarks.demos [--n 12] [--busy 2] [--seconds 30]`; `--ordinary` takes real-time
rights away, and `--stop` stops the emulator (SIGSTOP) for 20 to 500 ms at random moments. The exit
code is 1 if one failed.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from random import Random
from typing import NamedTuple

from tests.integration.processes import burning

LONGEST_S = 900.0
AGAIN = " again: "
VIRTUAL = "the demonstration goes on in virtual time"
BETWEEN_S = (0.2, 2.0)
STOPPED_S = (0.02, 0.5)


class Ended(NamedTuple):
    """Outcome of a demonstration."""

    code: int
    took_s: float
    again: list[str]
    """Steps that were repeated, with the reasons."""
    why_virtual: str
    """Reason for virtual time; empty in real time."""
    stops: int
    """Number of stops of its emulator."""
    last: str
    """Last line of its output."""


class Stopper(threading.Thread):
    """Stops the emulator of a demonstration again and again, until its end."""

    def __init__(self, demo: int, rng: Random) -> None:
        super().__init__(daemon=True)
        self._demo, self._rng = demo, rng
        self._over = threading.Event()
        self.stops = 0

    def run(self) -> None:
        """Stop it at random moments, for random times."""
        while not self._over.wait(self._rng.uniform(*BETWEEN_S)):
            for pid in _emulators(self._demo):
                try:
                    os.kill(pid, signal.SIGSTOP)
                    self._over.wait(self._rng.uniform(*STOPPED_S))
                    os.kill(pid, signal.SIGCONT)
                except ProcessLookupError:
                    continue
                self.stops += 1

    def end(self) -> int:
        """Stop no more; return how often it was done."""
        self._over.set()
        self.join()
        return self.stops


def _emulators(pid: int) -> list[int]:
    """Return the emulators among the descendants of a process."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        found = [pid] if b"emulate" in _words(pid) else []
    except OSError:  # it has just ended
        return []
    return found + [e for child in children for e in _emulators(int(child))]


def _words(pid: int) -> list[bytes]:
    return Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")


def once(folder: Path, seconds: float, *, ordinary: bool, rng: Random | None) -> Ended:
    """Run one demonstration with a socket of its own."""
    arguments = ["--directory", str(folder / "demo"), "--seconds", str(seconds)]
    program = [sys.executable, "-m", "armrig", "demo", *arguments]
    began_s = time.monotonic()
    demo = subprocess.Popen(
        [*(_WITHOUT_RIGHTS if ordinary else []), *program],
        env={**os.environ, "XDG_RUNTIME_DIR": str(folder), "COLUMNS": "160"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    stopper = Stopper(demo.pid, rng) if rng else None
    if stopper:
        stopper.start()
    try:
        text, _ = demo.communicate(timeout=LONGEST_S)
    finally:
        demo.kill()
        stops = stopper.end() if stopper else 0
    said = [line.strip() for line in text.splitlines() if line.strip()]
    at = said.index(VIRTUAL) if VIRTUAL in said else 0
    return Ended(
        demo.returncode,
        time.monotonic() - began_s,
        [line.partition(AGAIN)[2] for line in said if AGAIN in line],
        said[at - 1] if at else "",
        stops,
        said[-1] if said else "",
    )


# The bounding set, too: root's programs would have the right back at once.
_WITHOUT_RIGHTS = ["setpriv", "--bounding-set", "-sys_nice", "--inh-caps", "-sys_nice", "--"]


def main() -> int:
    """Run 12 demonstrations next to 2 busy programs, with telegraphs of 30 s, by default."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=12)
    parser.add_argument("--busy", type=int, default=2, help="programs in an endless loop")
    parser.add_argument("--seconds", type=float, default=30.0, help="of each telegraph")
    parser.add_argument("--ordinary", action="store_true", help="without real-time rights")
    parser.add_argument("--stop", action="store_true", help="stop the emulator now and then")
    parser.add_argument("--seed", type=int, default=1, help="of these moments")
    asked = parser.parse_args()
    if asked.ordinary and not shutil.which(_WITHOUT_RIGHTS[0]):
        parser.error(f"--ordinary needs {_WITHOUT_RIGHTS[0]} (util-linux)")
    results = []
    with burning(asked.busy, apart=True):
        for i in range(asked.n):
            rng = Random(asked.seed + i) if asked.stop else None
            with tempfile.TemporaryDirectory(prefix="armrig-demo-") as folder:
                ended = once(Path(folder), asked.seconds, ordinary=asked.ordinary, rng=rng)
            results.append(ended)
            _print(i + 1, ended)
    good = sum(ended.code == 0 for ended in results)
    took = sorted(ended.took_s for ended in results)
    print(
        f"{good} of {asked.n} good beside {asked.busy} busy programs, {took[0]:.0f} to "
        f"{took[-1]:.0f} s, once more {sum(len(e.again) for e in results)} times in all, "
        f"{sum(bool(e.why_virtual) for e in results)} ended in virtual time"
    )
    return 0 if good == asked.n else 1


def _print(i: int, ended: Ended) -> None:
    load = ", ".join(f"{mean:.1f}" for mean in os.getloadavg())
    how = "good" if ended.code == 0 else f"exit {ended.code}: {ended.last}"
    stopped = f", stopped {ended.stops} times" if ended.stops else ""
    times = f"{ended.took_s:.0f} s, once more {len(ended.again)}{stopped}"
    print(f"{i:3d}  {times}, load {load}: {how}", flush=True)
    for why in ended.again:
        print(f"       {why}", flush=True)
    if ended.why_virtual:
        print(f"       in virtual time: {ended.why_virtual}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
