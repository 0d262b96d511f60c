"""Who does the work: processes here, or a Dask cluster; both are executors of the same kind."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

from armrig_core.errors import OperationError

from armrig.recordings.export import imported

_CONNECT_S = 10.0


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Give an executor of so many processes on this machine, each with one thread for matrices.

    Where its user ends early, by Ctrl-C or a full disk, they are killed: nobody takes what they
    are at.
    """
    # Not forked: whatever threads and locks this process has, the others begin clean.
    context = multiprocessing.get_context("spawn")
    before = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(count, mp_context=context, initializer=_begin)
    try:
        yield executor
    except BaseException:
        # A shutdown waits for them; a second Ctrl-C in that wait left pool and workers waiting for
        # each other for ever.
        for process in set(multiprocessing.active_children()) - before:
            process.kill()
        raise
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """Give an executor that is a Dask cluster; its workers need armrig, and the same folders.

    Raises
    ------
    ImportError
        dask.distributed is not installed.
    OperationError
        No scheduler answers.
    """
    distributed = imported("distributed", "dask")
    # It logs each lost connection with its traceback; what a person must know is raised.
    logging.disable(logging.CRITICAL)
    try:
        with _connected(distributed, address) as client:
            yield client.get_executor(pure=False)
    finally:
        logging.disable(logging.NOTSET)


def _connected(distributed: Any, address: str) -> Any:
    try:
        return distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as err:
        msg = f"--scheduler {address}: no Dask scheduler answers; `dask scheduler` starts one and "
        raise OperationError(f"{msg}says its address, such as tcp://127.0.0.1:8786") from err


def _begin() -> None:
    """Make a worker process: Ctrl-C is its parent's, whose death is its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
