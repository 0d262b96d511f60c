"""The same data give the same model, however many threads the linear algebra runs in."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest
from armrig.data.argument import takes_data
from armrig.data.dataset import Dataset, Signals
from threadpoolctl import threadpool_info, threadpool_limits

_SCRIPT = """
import json
import numpy as np
from armrig import Dataset, armax, arx, telegraph
from armrig.numerics.polynomial import apply_filter

rng = np.random.default_rng(1)
u = telegraph(20_000, 0.3, 1.5, 3.5, seed=rng) - 2.5
noise = apply_filter([1.0, 0.5], [1.0, -0.7], 0.5 * rng.standard_normal(u.size))
data = Dataset(u=u, y=apply_filter([0.0, 1.0, 0.5], [1.0, -1.2, 0.6], u) + noise, Ts=1.0)
fits = [
    arx(data, na=8, nb=8),
    armax(data, na=3, nb=2, nc=2),  # too low a nb: Gauss-Newton's steps are slow there
]
print(json.dumps([[f.theta.tolist(), f.std.tolist()] for f in fits]))
"""


def _estimated(threads: str) -> Any:
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    environment = os.environ | dict.fromkeys(names, threads)
    paths = [path for path in sys.path if path]
    environment["PYTHONPATH"] = os.pathsep.join(paths)
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT], env=environment, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


def _threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info()}


@takes_data
def _threads_of_a_function(data: Dataset | Signals) -> set[int]:
    """Return the numbers of threads while a function of data runs."""
    return _threads()


def test_a_function_of_data_uses_one_thread_of_linear_algebra() -> None:
    """After its end, the caller's number of threads applies again."""
    data = Dataset(u=np.arange(3.0), y=np.arange(3.0), Ts=1.0)

    with threadpool_limits(2):
        assert _threads_of_a_function(data) == {1}
        assert _threads() == {2}


def _set_threads(number: int) -> None:
    """Set it in a thread that ends, because the limits of other threads then still apply."""
    setting = Thread(target=threadpool_limits, args=(number,))
    setting.start()
    setting.join()


def test_overlapping_calls_leave_the_number_of_threads_of_the_caller() -> None:
    """The first call to begin ends first."""
    data = Dataset(u=np.arange(3.0), y=np.arange(3.0), Ts=1.0)
    first_begins, second_begins, first_ended = Event(), Event(), Event()

    @takes_data
    def called(_: Dataset | Signals, *, begins: Event, until: Event) -> bool:
        begins.set()
        return until.wait(timeout=30)

    before = _threads()
    _set_threads(2)
    with ThreadPoolExecutor() as pool:
        first = pool.submit(called, data, begins=first_begins, until=second_begins)
        first_begins.wait(timeout=30)
        second = pool.submit(called, data, begins=second_begins, until=first_ended)
        assert first.result()
        first_ended.set()
        assert second.result()
    after = _threads()
    _set_threads(*before)
    assert after == {2}


@pytest.mark.exhaustive
def test_threads_change_no_estimate_by_a_millionth_of_its_deviation() -> None:
    """ARX and ARMAX, with one thread and with four, 20 000 samples."""
    pinned, free = _estimated("1"), _estimated("4")

    for (theta, std), (other, _) in zip(pinned, free, strict=True):
        np.testing.assert_allclose((np.array(theta) - other) / std, 0.0, atol=1e-6)
