"""Executors for a batch: processes on this machine, or a Dask cluster."""

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
from armrig_core.process.imports import imported

_CONNECT_TIMEOUT_S = 10.0


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Yield an executor of `count` processes on this machine.

    If an exception ends the batch early, such as Ctrl-C or a full disk, the processes are killed.
    """
    # Do not fork: the copy would contain locks that threads of this process hold.
    context = multiprocessing.get_context("spawn")
    before = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(count, mp_context=context, initializer=begin_worker)
    try:
        yield executor
    except BaseException:
        # A shutdown waits for the processes; without the kill, a second Ctrl-C during the shutdown
        # left the pool and its workers in a deadlock.
        for process in set(multiprocessing.active_children()) - before:
            process.kill()
        raise
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """Yield an executor of a Dask cluster; its workers need armrig and access to the same folders.

    Raises
    ------
    ImportError
        dask.distributed is not installed.
    OperationError
        No scheduler answers.
    """
    distributed = imported("distributed", "dask")
    # distributed logs a traceback for each lost connection. It raises serious failures anyway.
    logging.disable(logging.CRITICAL)
    try:
        with _connected(distributed, address) as client:
            yield client.get_executor(pure=False)
    finally:
        logging.disable(logging.NOTSET)


def _connected(distributed: Any, address: str) -> Any:
    try:
        return distributed.Client(address, timeout=_CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as err:
        msg = f"--scheduler {address}: no Dask scheduler answers; `dask scheduler` starts one and "
        raise OperationError(f"{msg}prints its address, such as tcp://127.0.0.1:8786") from err


def begin_worker() -> None:
    """Prepare a worker process, which ignores Ctrl-C and ends when its parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
