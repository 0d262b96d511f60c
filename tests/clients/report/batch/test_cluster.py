"""A batch on any executor, and on a Dask cluster: a scheduler and its workers as processes."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Executor, Future
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest
from armrig.cli import main
from armrig.report.batch import batch as batch_module
from armrig.report.batch.batch import environment, results
from armrig.report.batch.cluster import cluster, fault
from armrig.report.batch.tasks import Verify, items_in
from armrig_core.errors import InputError, OperationError

from tests.clients.batches import kept, started, wait_for_rows

pytest.importorskip("pyarrow.parquet")


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:8786", "localhost:1", "tcp://[::1]:9", "tls://lab-server:8786"]
)
def test_a_scheduler_behind_the_loopback_or_certificates_is_accepted(address: str) -> None:
    assert callable(cluster(address, Path()))


@pytest.mark.parametrize(
    "address",
    ["tcp://10.0.0.1:8786", "lab-server:8786", "tcp://127.0.0.1.example.org:1", "ws://127.0.0.1:1"],
)
def test_an_address_where_anybody_can_send_code_is_refused(
    address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match="anybody in the network can send code"):
        cluster(address, tmp_path)

    table = tmp_path / "t.parquet"
    assert main(["batch", "verify", ".", "-o", str(table), "--scheduler", address]) == 1
    assert "tls://HOST:PORT with certificates" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def process(*listens_at: str, nthreads: int | None = 1) -> Any:
    """Return what Dask passes: a worker, or without `nthreads` the scheduler."""
    server = SimpleNamespace(listeners=[SimpleNamespace(listen_address=at) for at in listens_at])
    if nthreads is not None:
        server.state = SimpleNamespace(nthreads=nthreads)
    return server


PRIVATE = process("tcp://127.0.0.1:1", "tls://0.0.0.0:2")


@pytest.mark.parametrize(
    ("server", "folder", "text"),
    [
        (PRIVATE, "here", ""),
        (process("tcp://127.0.0.1:1", nthreads=None), "nowhere", ""),
        (PRIVATE, "nowhere", "does not see the folder nowhere; mount it"),
        (
            process("tcp://127.0.0.1:1", "tcp://0.0.0.0:2"),
            "here",
            "listens at tcp://0.0.0.0:2, open",
        ),
        (process("tcp://127.0.0.1:1", nthreads=4), "here", "start it with --nthreads 1"),
    ],
)
def test_a_process_that_is_open_or_cannot_do_the_work_is_named(
    server: Any, folder: str, text: str
) -> None:
    Path("here").mkdir(exist_ok=True)
    found = fault(environment(), folder, server)
    assert text in found if text else found == ""


@pytest.mark.parametrize("name", ["armrig", "numpy", "OPENBLAS_CORETYPE"])
def test_another_version_or_kernel_is_named(name: str) -> None:
    text = f"has {name} {environment()[name]} instead of 0.1; give all machines the same"
    assert fault(environment() | {name: "0.1"}, ".", PRIVATE) == text


def test_a_worker_of_another_version_that_comes_later_computes_no_row(tmp_path: Path) -> None:
    """Its task refuses: the check at the start does not see this worker."""
    (tmp_path / "a.mcap").write_bytes(b"no recording")
    expected = environment() | {"scipy": "0.1"}
    with pytest.raises(OperationError, match=r"the worker on .* has scipy"):
        batch_module._row_in(Verify(), expected, items_in(tmp_path)[0])


class LostError(Exception):
    """An executor gave up an item, for which it had replaced several workers."""


class Replacing(Executor):
    """Works in its own thread and gives up "deadly"; "cut" cancels, as a lost scheduler does."""

    opened = 0

    def __init__(self) -> None:
        Replacing.opened += 1
        self.runs: list[str] = []

    def submit(self, function: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.runs.append(args[0])
        if args[0] == "cut":
            future.cancel()
            future.set_running_or_notify_cancel()
        elif args[0] == "deadly":
            future.set_exception(LostError("key-7f3a on tcp://127.0.0.1:40123"))
        elif args[0] == "old":
            future.set_exception(AttributeError("module has no attribute '_row_in'"))
        else:
            future.set_result(function(args[0]))
        return future


def test_an_item_that_the_executor_gives_up_is_repeated_alone_and_costs_nothing_else() -> None:
    """The row has the text that it has with a pool, without names of this run."""
    executor = Replacing()

    came = dict(results(str.upper, ["a", "deadly", "b", "c"], lambda: executor, at_once=3))

    assert executor.runs == ["a", "deadly", "b", "c", "deadly"]
    assert str(came.pop("deadly")) == "its process died 2 times: it was killed or ran out of memory"
    assert came == {"a": "A", "b": "B", "c": "C"}


@pytest.mark.parametrize(
    ("item", "text"), [("cut", "type the same command again"), ("old", "lacks this version of")]
)
def test_lost_work_and_an_old_worker_end_the_batch_with_one_sentence(item: str, text: str) -> None:
    came = results(str.upper, ["a", item, "b"], Replacing, at_once=1)
    assert next(came) == ("a", "A")
    with pytest.raises(OperationError, match=text):
        next(came)


class Cluster(NamedTuple):
    """A scheduler and its two workers, each a process."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@pytest.fixture
def local(tmp_path: Path) -> Iterator[Cluster]:
    """Give a scheduler and two workers on this machine."""
    pytest.importorskip("distributed", reason="no distributed")
    about = tmp_path / "scheduler.json"

    def dask(*given: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", *given, "--scheduler-file", str(about)]
        command += ["--host", "127.0.0.1", "--no-dashboard"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        return stack.enter_context(subprocess.Popen(command, cwd=tmp_path, **quiet))

    with ExitStack() as stack:
        scheduler = dask("scheduler", "--port", "0")
        stack.callback(scheduler.kill)
        until = time.monotonic() + 60
        while not (about.exists() and about.read_text().rstrip().endswith("}")):
            assert time.monotonic() < until, "no scheduler in 60 s"
            time.sleep(0.05)
        workers = []
        for _ in range(2):
            workers.append(dask("worker", "--nthreads", "1", "--no-nanny"))
            stack.callback(workers[-1].kill)
        yield Cluster(json.loads(about.read_text())["address"], scheduler, workers)


@pytest.mark.exhaustive
def test_a_cluster_computes_the_table_of_a_pool_and_is_replaced_by_it(
    local: Cluster, lab: tuple[Path, bytes], tmp_path: Path
) -> None:
    """First a worker dies, which costs no row; then the scheduler, and the pool continues."""
    folder, whole = lab
    table, second = tmp_path / "models.parquet", tmp_path / "second.parquet"
    with started(folder, table, "--scheduler", local.address) as command:
        wait_for_rows(table, 2, command)
        local.workers[0].kill()
        said = command.communicate(timeout=300)[1]
    assert command.returncode == 0, said
    assert table.read_bytes() == whole

    with started(folder, second, "--scheduler", local.address) as command:
        wait_for_rows(second, 2, command)
        local.scheduler.kill()
        said = command.communicate(timeout=300)[1].decode()
    assert command.returncode == 1
    assert said.splitlines()[-1] == (
        "armrig: the scheduler is gone; results so far are kept: type the same command again to "
        "continue"
    )
    assert "Traceback" not in said
    assert len(kept(second)) >= 2
    with started(folder, second, "--workers", "2") as command:
        said = command.communicate(timeout=300)[1].decode()
    assert command.returncode == 0, said
    assert second.read_bytes() == whole


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("scheme", "text"), [("tcp", "it is silent"), ("tls", "configuration lacks certificates")]
)
def test_a_scheduler_that_does_not_answer_is_reported(
    scheme: str, text: str, lab: tuple[Path, bytes], tmp_path: Path
) -> None:
    """A process that accepts connections and says nothing would keep Dask's client forever."""
    pytest.importorskip("distributed", reason="no distributed")
    script = f"""if True:
        import socket, sys
        from armrig.cli import main
        from armrig.report.batch import cluster
        cluster._TIMEOUT_S = 0.5
        with socket.create_server(("127.0.0.1", 0)) as silent:
            address = f"{scheme}://127.0.0.1:{{silent.getsockname()[1]}}"
            sys.exit(main(["batch", "verify", *sys.argv[1:], "--scheduler", address]))
    """
    command = [sys.executable, "-c", script, str(lab[0]), "-o", str(tmp_path / "x.parquet")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 1
    assert text in done.stderr
    assert len(done.stderr.splitlines()) == 1
