"""Batches as processes of their own, which tests disturb."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from armrig.report.batch.batch import SUFFIX
from numpy.typing import NDArray

SHORT, LONG = 400, 5000
"""Samples; an OE model of the long ones takes a second or more."""


def telegraph(seed: int, N: int = SHORT) -> NDArray[np.float64]:
    """Return an input that excites."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.choice([1.0, 3.0], N // 5), 5)


@contextmanager
def started(folder: Path, table: Path, *more: str) -> Iterator[subprocess.Popen[bytes]]:
    """Give `armrig batch identify` of OE models as a process."""
    command = [sys.executable, "-m", "armrig", "batch", "identify", str(folder), "-o", str(table)]
    command += ["--structure", "oe", "--integrator", *more]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        try:
            yield process
        finally:
            process.kill()


def kept(table: Path) -> list[bytes]:
    """Return the rows that are kept so far."""
    with suppress(FileNotFoundError):
        return table.with_name(table.name + SUFFIX).read_bytes().split(b"\n")[1:-1]
    return []


def wait_for_rows(table: Path, count: int, process: subprocess.Popen[bytes]) -> None:
    """Return as soon as so many rows are kept."""
    until = time.monotonic() + 200
    while time.monotonic() < until:
        if len(kept(table)) >= count:
            return
        assert process.poll() is None, "it ended before it was disturbed"
        time.sleep(0.005)
    pytest.fail(f"not {count} rows in 200 s")
