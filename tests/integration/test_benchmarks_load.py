"""The scripts in tests/benchmarks: whoever wants a figure again can start each."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.exhaustive
def test_each_benchmark_finds_what_it_imports() -> None:
    """With the folders on the path that their first lines name."""
    names = sorted(path.stem for path in FOLDER.glob("*.py"))
    command = "import importlib, sys\nfor name in sys.argv[1:]: importlib.import_module(name)"
    rooms = (".", "benchmarks", "integration", "daemon")
    path = os.pathsep.join(str(FOLDER.parent / room) for room in rooms)

    done = subprocess.run(
        [sys.executable, "-c", command, *names],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )

    assert len(names) > 20
    assert done.returncode == 0, done.stderr[-1000:]
