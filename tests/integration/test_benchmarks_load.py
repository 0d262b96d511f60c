"""The scripts in tests/benchmarks can be started."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.exhaustive
def test_each_benchmark_finds_what_it_imports() -> None:
    names = sorted(f"tests.benchmarks.{path.stem}" for path in FOLDER.glob("*.py"))
    command = "import importlib, sys\nfor name in sys.argv[1:]: importlib.import_module(name)"

    done = subprocess.run(
        [sys.executable, "-c", command, *names],
        cwd=FOLDER.parents[1],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )

    assert len(names) > 20
    assert done.returncode == 0, done.stderr[-1000:]
