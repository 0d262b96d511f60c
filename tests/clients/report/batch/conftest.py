"""Recordings of a small lab, and batches as processes, which the tests of a batch share."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
from armrig.report.batch import workers
from armrig.report.batch.batch import batch
from armrig.report.batch.tasks import Identify

from tests.clients import batches, made_recordings


@pytest.fixture(scope="session")
def lab(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes]:
    """Return twelve recordings, the last two long, and their table of a batch left alone."""
    made = tmp_path_factory.mktemp("lab")
    for n in range(10):
        data = made_recordings.of_the_arm(batches.telegraph(n), seed=n)
        (made / f"a-{n:02}.mcap").write_bytes(data)
    for n in range(2):
        data = made_recordings.of_the_arm(batches.telegraph(n, batches.LONG), seed=n)
        (made / f"z-long-{n}.mcap").write_bytes(data)
    table = tmp_path_factory.mktemp("whole") / "models.parquet"
    task = Identify(structure="oe", orders={"nb": 4, "nf": 4}, integrator=True)
    batch(made, task, table, open_executor=partial(workers.processes, 2), at_once=4)
    return made, table.read_bytes()
