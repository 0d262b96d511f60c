"""The scripts in tests/benchmarks can be started."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("*.py")))
def test_the_imports_of_a_benchmark_exist(name: str) -> None:
    importlib.import_module(f"tests.benchmarks.{name}")
