"""The bench of the tests on real processes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from processes import Bench


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    """Give a bench, and end all that was started on it."""
    bench = Bench(tmp_path)
    yield bench
    for process in reversed(bench.processes):
        process.end()
