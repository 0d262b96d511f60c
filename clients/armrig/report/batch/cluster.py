"""Workers of a Dask scheduler as the executor of a batch."""

import asyncio
import logging
import re
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from armrig_core.errors import InputError, OperationError
from armrig_core.process.imports import load_extra

from armrig.report.batch.batch import difference, environment

_PRIVATE = re.compile(r"tls://.+:\d+|(tcp://)?(localhost|127(\.\d+){3}|\[::1\]):\d+")
_TIMEOUT_S = 10.0  # longest wait for the scheduler, and for its first worker


def cluster(address: str, folder: Path) -> Callable[[], AbstractContextManager[Executor]]:
    """Return the function with which `batch` opens an executor of a Dask cluster.

    It raises OperationError if no scheduler answers, or if a process of the cluster has a `fault`.
    An address at which anybody in the network could send code raises InputError at once.
    """
    if not _PRIVATE.fullmatch(address):
        raise InputError(
            f"--scheduler {address}: anybody in the network can send code to such an address; give "
            "tcp://127.0.0.1:PORT of this machine, or tls://HOST:PORT with certificates"
        )
    return partial(_executor, address, folder)


@contextmanager
def _executor(address: str, folder: Path) -> Iterator[Executor]:
    distributed = load_extra("distributed", "dask")
    logging.disable(logging.CRITICAL)  # distributed logs a traceback for each lost connection
    try:
        with warnings.catch_warnings(action="ignore"):
            asyncio.run(_ask(distributed, address))
            with distributed.Client(address, timeout=_TIMEOUT_S, set_as_default=False) as client:
                if problem := _problem(client, str(folder)):
                    raise OperationError(f"--scheduler {address}: {problem}")
                yield client.get_executor(pure=False)
    finally:
        logging.disable(logging.NOTSET)


async def _ask(distributed: Any, address: str) -> None:
    """Raise OperationError if no scheduler answers: a Client would wait for a silent one."""
    try:
        security = distributed.Security().get_connection_args("client")
        async with distributed.rpc(address, timeout=_TIMEOUT_S, connection_args=security) as server:
            await asyncio.wait_for(server.versions(), _TIMEOUT_S)
    except (OSError, TypeError, ValueError) as err:  # a TypeError if Dask has no certificates
        why = "Dask's configuration lacks certificates" if isinstance(err, TypeError) else str(err)
        text = f"--scheduler {address}: no Dask scheduler answers ({why or 'it is silent'})"
        raise OperationError(f"{text}; `dask scheduler --host 127.0.0.1` starts one") from err


def _problem(client: Any, folder: str) -> str:
    """Return why the cluster is unsuitable, or ""."""
    arguments = (fault, environment(), folder)
    try:
        faults = {"scheduler": client.run_on_scheduler(*arguments)}
        faults |= {f"worker {at}": text for at, text in client.run(*arguments).items()}
    except Exception as err:
        return f"the scheduler or a worker lacks this version of armrig ({err}); install it there"
    if len(faults) == 1:
        return "it has no worker; `dask worker ADDRESS --nthreads 1` starts one"
    return next((f"the {name} {text}" for name, text in faults.items() if text), "")


def fault(expected: dict[str, str], folder: str, dask_worker: Any) -> str:
    """Return why the process of a cluster in which this runs is unsuitable for a batch, or ""."""
    if other := difference(expected):
        return other
    for listener in dask_worker.listeners:
        if not _PRIVATE.fullmatch(at := listener.listen_address):
            return f"listens at {at}, open to the network; start it with --host 127.0.0.1"
    state = getattr(dask_worker, "state", None)  # Dask also passes the scheduler, which has none
    if state and state.nthreads > 1:
        return "has several threads, which share numpy's settings; start it with --nthreads 1"
    sees = state is None or Path(folder).is_dir()
    return "" if sees else f"does not see the folder {folder}; mount it there under this path"
