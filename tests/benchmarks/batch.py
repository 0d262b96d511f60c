"""`armrig batch` with one process and with two, in turn, and after `kill -9` in the middle.

`python -m tests.benchmarks.batch [--files 1000] [--seconds 30] [--pairs 3]`. The recordings are of
the arm, at Ts 10 ms, with a hundred inputs in turn; the task is `identify --integrator`, an OE
model of four poles. Wall times are those of whole processes. The capacity of the machine for two
processes is measured, too: two batches of one process, half of the recordings each.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import numpy as np

from tests.clients.made_recordings import TS, of_the_arm

_INPUTS = 100
_LEAST = 5  # rows that are there before something is killed


def make(folder: Path, files: int, seconds: float) -> None:
    """Write the recordings, half of them into each of two folders, too."""
    halves = [folder.with_name(f"{folder.name}-{half}") for half in "ab"]
    for one in (folder, *halves):
        one.mkdir()
    made = []
    for seed in range(min(files, _INPUTS)):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.choice([1.0, 3.0], round(seconds / TS) // 5), 5)
        made.append(of_the_arm(u, seed=seed))
    for number in range(files):
        path = folder / f"run-{number:05}.mcap"
        path.write_bytes(made[number % len(made)])
        os.link(path, halves[number % 2] / path.name)


def started(folder: Path, table: Path, workers: int) -> subprocess.Popen[bytes]:
    """Start a batch."""
    command = [sys.executable, "-m", "armrig", "batch", "identify", str(folder), "--integrator"]
    command += ["-o", str(table), "--workers", str(workers)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL)


def timed(*batches: tuple[Path, Path, int]) -> float:
    """Return the wall time of batches that run at the same time, in s; their tables are removed."""
    for _, table, _ in batches:
        table.unlink(missing_ok=True)
    begin = time.perf_counter()
    for process in [started(*batch) for batch in batches]:
        if process.wait():
            sys.exit("a batch failed")
    return time.perf_counter() - begin


def kill_and_go_on(folder: Path, table: Path, files: int, *, whole: bool) -> int:
    """Kill a worker, or the batch, when half is done; return how many rows are there in the end."""
    table.unlink(missing_ok=True)
    progress = table.with_name(f"{table.name}.progress")
    process = started(folder, table, 2)
    while not progress.exists() or progress.read_bytes().count(b"\n") < max(files // 2, _LEAST):
        time.sleep(0.01)
    if whole:
        process.kill()
        process.wait()
        left = progress.read_bytes().count(b"\n") - 1
        print(f"  killed with {left} rows kept")
        process = started(folder, table, 2)
    else:
        text = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text()
        workers = [
            int(pid)
            for pid in text.split()
            if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()
        ]
        os.kill(workers[0], signal.SIGKILL)
    if process.wait():
        sys.exit("the batch failed")
    import pyarrow.parquet

    names = pyarrow.parquet.read_table(str(table))["recording"].to_pylist()
    return len(set(names)) if len(set(names)) == len(names) else -1


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--pairs", type=int, default=3)
    given = parser.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    directory = Path(tempfile.mkdtemp(prefix="armrig-batch-"))
    try:
        folder, table = directory / "runs", directory / "models.parquet"
        make(folder, given.files, given.seconds)
        print(
            f"{given.files} recordings of {given.seconds:g} s, {round(given.seconds / TS)} samples"
        )
        ratios, hashes = [], set()
        for _ in range(given.pairs):
            one = timed((folder, table, 1))
            hashes.add(hashlib.sha256(table.read_bytes()).hexdigest())
            two = timed((folder, table, 2))
            hashes.add(hashlib.sha256(table.read_bytes()).hexdigest())
            ratios.append(two / (one / 2))
            print(
                f"  one process {one:.1f} s, two {two:.1f} s: {ratios[-1]:.2f} x the half",
                flush=True,
            )
        halves = [(directory / f"runs-{h}", directory / f"{h}.parquet", 1) for h in "ab"]
        apart = timed(*halves)
        print(f"median {median(ratios):.2f} x the half; two batches apart {apart:.1f} s")
        for whole in (False, True):
            rows = kill_and_go_on(folder, table, given.files, whole=whole)
            hashes.add(hashlib.sha256(table.read_bytes()).hexdigest())
            print(f"{'the whole' if whole else 'a worker'} killed: {rows} rows, no file twice")
        print(f"{len(hashes)} different table{'s' * (len(hashes) != 1)} of {2 * given.pairs + 2}")
    finally:
        shutil.rmtree(directory)


if __name__ == "__main__":
    main()
