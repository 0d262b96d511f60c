"""How `armrig demo` ends beside busy programs: so many, one after another, each in a fresh folder.

`PYTHONPATH=tests/integration python tests/benchmarks/demos.py [n [busy programs [seconds]]]`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from processes import burning

LONGEST_S = 900.0
AGAIN = "; once more"
DEFAULTS = (12, 2, 30)


class Ended(NamedTuple):
    """How a demonstration ended."""

    code: int
    took_s: float
    again: list[str]
    """What was done once more, and why."""
    last: str
    """The last thing that it said."""


def once(folder: Path, seconds: int) -> Ended:
    """Run one, with a socket of its own."""
    arguments = ["--directory", str(folder / "demo"), "--seconds", str(seconds)]
    began_s = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "armrig", "demo", *arguments],
        env={**os.environ, "XDG_RUNTIME_DIR": str(folder), "COLUMNS": "160"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=LONGEST_S,
        text=True,
        check=False,
    )
    said = [line.strip() for line in done.stdout.splitlines() if line.strip()]
    again = [line.removesuffix(AGAIN) for line in said if line.endswith(AGAIN)]
    return Ended(done.returncode, time.monotonic() - began_s, again, said[-1] if said else "")


def main() -> None:
    """Run 12 beside 2, with telegraphs of 30 s, by default."""
    given = [int(argument) for argument in sys.argv[1:]]
    n, busy, seconds = (*given, *DEFAULTS[len(given) :])
    results = []
    with burning(busy):
        for i in range(n):
            with tempfile.TemporaryDirectory(prefix="armrig-demo-") as folder:
                ended = once(Path(folder), seconds)
            results.append(ended)
            load = ", ".join(f"{mean:.1f}" for mean in os.getloadavg())
            how = "good" if ended.code == 0 else f"exit {ended.code}: {ended.last}"
            times = f"{ended.took_s:.0f} s, once more {len(ended.again)}"
            print(f"{i + 1:3d}  {times}, load {load}: {how}", flush=True)
            for why in ended.again:
                print(f"       {why}", flush=True)
    good = sum(ended.code == 0 for ended in results)
    took = sorted(ended.took_s for ended in results)
    print(
        f"{good} of {n} good beside {busy} busy programs, {took[0]:.0f} to "
        f"{took[-1]:.0f} s, once more {sum(len(e.again) for e in results)} times in all"
    )


if __name__ == "__main__":
    main()
