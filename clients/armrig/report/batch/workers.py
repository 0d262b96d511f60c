"""Worker processes of a batch."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager


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


def begin_worker() -> None:
    """Prepare a worker process, which ignores Ctrl-C and ends when its parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
