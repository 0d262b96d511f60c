"""Losses by `kill -9` of a process that records at 1 kHz, at n random moments.

`python -m tests.benchmarks.kills [--n 1000] [--seed 1]`
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.daemon import killed_writer

_ONE_GO = 100  # processes whose files are kept at a time


def main() -> int:
    """Kill, recover, count; exit code 1 where anything is lost that must not be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    began, found = time.monotonic(), []
    for first in range(0, asked.n, _ONE_GO):
        with tempfile.TemporaryDirectory(prefix="armrig-kills-", dir=Path.cwd()) as name:
            n = min(_ONE_GO, asked.n - first)
            program = [
                sys.executable,
                killed_writer.__file__,
                name,
                str(n),
                f"{asked.seed + first}",
            ]
            subprocess.run(program, check=True)
            found += killed_writer.judged(Path(name))
    faults = [(i, fault) for i, one in enumerate(found) for fault in one.faults]
    samples = sum(one.ledger.handed for one in found)
    lost_s = np.array([one.ledger.handed - one.found for one in found]) * killed_writer.TS_NS / 1e9
    behind_s = np.array([one.ledger.handed - one.ledger.acknowledged for one in found])
    behind_s = behind_s * killed_writer.TS_NS / 1e9
    acknowledged = sum(one.ledger.acknowledged for one in found)
    print(f"{asked.n} kills, {asked.n - len(found)} before the file had begun; ", end="")
    print(f"{samples} samples handed over, {acknowledged} acknowledged")
    for name, values in (("lost, not acknowledged", lost_s), ("not acknowledged yet", behind_s)):
        p50, p99, most = np.percentile(values, [50, 99, 100])
        print(f"{name}: p50 {p50:.3f}, p99 {p99:.3f}, max {most:.3f} s")
    print(f"{sum(lost_s > 0.2)} lost more than 0.2 s; {len(faults)} faults; ", end="")
    print(f"{time.monotonic() - began:.0f} s")
    for i, fault in faults:
        print(f"  {i}: {fault}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
