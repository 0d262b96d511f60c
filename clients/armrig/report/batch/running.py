"""Many items through an executor, whose workers may die: each result once, as it comes."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Generator, Hashable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from contextlib import AbstractContextManager
from typing import TypeVar

from armrig_core.errors import OperationError

MOST_DEATHS = 2
"""So many workers may die of an item that runs alone; then it is given up."""

T = TypeVar("T", bound=Hashable)
R = TypeVar("R")
Open = Callable[[], AbstractContextManager[Executor]]


def results(
    function: Callable[[T], R], items: Sequence[T], open_executor: Open, *, at_once: int
) -> Iterator[tuple[T, R | Exception]]:
    """Give each item with its result, in the order in which they come.

    Where a worker dies its executor is opened anew. Of whose work it died cannot be told from
    outside, so what ran then runs again, one at a time.

    Parameters
    ----------
    function : callable
        Raises nothing itself; it is sent to the workers.
    items : sequence
        Each once.
    open_executor : callable
        Gives one that is open.
    at_once : int
        How many are handed over and not back yet.

    Yields
    ------
    item, result
        Or what the executor has raised in its place.

    Raises
    ------
    OperationError
        The executor has dropped its work.
    """
    waiting, alone = deque(items), deque[T]()
    deaths: Counter[T] = Counter()
    while waiting or alone:
        with open_executor() as workers:
            ran = yield from _until_a_death(workers, function, waiting, alone, at_once)
        if len(ran) == 1:
            deaths[ran[0]] += 1
            if deaths[ran[0]] >= MOST_DEATHS:
                text = f"the process that worked on it died, {MOST_DEATHS} times: it was killed, "
                yield ran.pop(), RuntimeError(f"{text}or ran out of memory")
        alone.extend(ran)


def _until_a_death(
    workers: Executor, function: Callable[[T], R], waiting: deque[T], alone: deque[T], at_once: int
) -> Generator[tuple[T, R | Exception], None, list[T]]:
    """Give results until all is done, or a worker dies; return what ran then."""
    running: dict[Future[R], T] = {}
    while waiting or alone or running:
        source, most = (alone, 1) if alone else (waiting, at_once)
        while source and len(running) < most:
            try:
                future = workers.submit(function, source[0])
            except BrokenExecutor:  # it died with nothing to do
                return [*running.values()]
            running[future] = source.popleft()
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in sorted(done, key=_is_broken):
            if _is_broken(future):
                return [*running.values()]
            item = running.pop(future)
            yield item, future.exception() or future.result()  # type: ignore[misc]
    return []


def _is_broken(future: Future[R]) -> bool:
    try:
        return isinstance(future.exception(), BrokenExecutor)
    except CancelledError as err:
        msg = "the cluster has dropped its work: its scheduler or all workers are gone; what is "
        raise OperationError(f"{msg}done is kept, and the same command goes on from there") from err
