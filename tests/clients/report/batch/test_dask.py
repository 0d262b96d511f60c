"""The same batch by a Dask cluster: a real scheduler and two workers, processes of their own."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import pytest
from armrig.cli import main

from tests.clients.batches import kept, started, wait_for_rows

pytest.importorskip("distributed")
pytest.importorskip("pyarrow")


class Cluster(NamedTuple):
    """A scheduler and its workers."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """Give a scheduler and two workers on this machine."""
    about = tmp_path / "scheduler.json"

    def dask(*given: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", *given, "--scheduler-file", str(about)]
        return stack.enter_context(
            subprocess.Popen(
                command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
        )

    with ExitStack() as stack:
        scheduler = dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        stack.callback(scheduler.kill)
        until = time.monotonic() + 60
        while not (about.exists() and about.read_text().rstrip().endswith("}")):
            assert time.monotonic() < until, "no scheduler in 60 s"
            time.sleep(0.05)
        workers = []
        for _ in range(2):
            workers.append(dask("worker", "--nthreads", "1", "--no-nanny", "--no-dashboard"))
            stack.callback(workers[-1].kill)
        yield Cluster(json.loads(about.read_text())["address"], scheduler, workers)


@pytest.mark.exhaustive
def test_a_cluster_with_a_killed_worker_computes_the_same_table(
    cluster: Cluster, lab: tuple[Path, bytes], tmp_path: Path
) -> None:
    folder, whole = lab
    table = tmp_path / "models.parquet"
    with started(folder, table, "--scheduler", cluster.address) as process:
        wait_for_rows(table, 2, process)
        cluster.workers[0].kill()
        said = process.communicate(timeout=300)[1]
    assert process.returncode == 0, said
    assert table.read_bytes() == whole


@pytest.mark.exhaustive
def test_a_lost_cluster_is_reported_and_the_batch_can_be_continued(
    cluster: Cluster, lab: tuple[Path, bytes], tmp_path: Path
) -> None:
    folder, whole = lab
    table = tmp_path / "models.parquet"
    with started(folder, table, "--scheduler", cluster.address) as process:
        wait_for_rows(table, 2, process)
        for one in (cluster.scheduler, *cluster.workers):
            one.kill()
        said = process.communicate(timeout=300)[1].decode()
    assert process.returncode == 1
    assert "the same command continues" in said
    assert "Traceback" not in said
    assert len(kept(table)) >= 2
    with started(folder, table, "--workers", "2") as process:
        said = process.communicate(timeout=300)[1].decode()
    assert process.returncode == 0, said
    assert table.read_bytes() == whole


@pytest.mark.exhaustive
def test_a_missing_scheduler_is_reported(
    lab: tuple[Path, bytes], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    given = ["batch", "verify", str(lab[0]), "-o", str(tmp_path / "x.parquet")]
    assert main([*given, "--scheduler", "tcp://127.0.0.1:9"]) == 1
    err = capfd.readouterr().err
    assert "no Dask scheduler answers" in err
    assert "Traceback" not in err
