"""Settings of all tests."""

from __future__ import annotations

import gc
import os
import re
import signal
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager
from datetime import timedelta
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import pytest
from armrig_core.process.signal_pipe import ENDING
from hypothesis import HealthCheck, settings

pytest_plugins = ("tests.stalls.repeats",)

# Before numpy is loaded: its threads only wait for each other on matrices as small as ours.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# A home of their own must not cost the tests a list of the fonts each.
os.environ.setdefault("MPLCONFIGDIR", str(Path(__file__).parents[1] / ".pytest_cache/matplotlib"))
# A shell's background job ignores them and its children with it, which some tests send them to.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
# No result depends on the speed of the machine or on an earlier run: each run tries the same
# examples. `--hypothesis-profile drawn --hypothesis-seed SEED` tries others.
settings.register_profile(
    "drawn",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    database=None,
    print_blob=True,
)
settings.register_profile("repeatable", settings.get_profile("drawn"), derandomize=True)
settings.load_profile("repeatable")
# Rare garbage collections: with Python's thresholds they took 3 % of the processor time.
gc.set_threshold(100_000, 50, 50)


def pytest_configure() -> None:
    """Forget the options of the environment: they are not for a pytest that a test starts."""
    os.environ.pop("PYTEST_ADDOPTS", None)


def pytest_itemcollected(item: pytest.Item) -> None:
    """Refuse a timed test that `make test` would not find, which looks for it in one folder."""
    if item.get_closest_marker("timed") and "integration" not in item.path.parts:
        raise pytest.UsageError(
            f"{item.nodeid}: is marked as timed and does not stand in tests/integration"
        )


def pytest_collection_finish() -> None:
    """Exempt the collected tests from garbage collection: a full collection takes 0.3 s."""
    gc.freeze()


FOLDERS: Final = {
    "HOME": "home",
    "XDG_CACHE_HOME": "home/.cache",
    "XDG_CONFIG_HOME": "home/.config",
    "XDG_DATA_HOME": "home/.local/share",
    "XDG_STATE_HOME": "home/.local/state",
    "XDG_RUNTIME_DIR": "run",
}
"""Folders of a user, below a test's folder, by environment variable."""
_N_FOLDERS: Final = 9
"""Folders below a test's folder: these, `work`, and the folders that contain them."""
_OF_THE_TESTS: Final = re.compile(
    "ARMRIG_(REQUIRE_ALL|REFERENCE_DATA|FIL|FIRMWARE_EXAMPLES|SIMULATE_SEEDS|RESTARTS|RUN)"
)


@pytest.fixture(scope="session", autouse=True)
def _clean_homes() -> Iterator[Callable[[], str]]:
    """Give the way to a folder with a home and XDG folders without a file.

    A folder in which a test left nothing is given again, because a new one costs 2 ms. The folders
    are not those of pytest, whose paths may be too long for a socket.
    """
    with _new_home() as home, pytest.MonkeyPatch.context() as patch:
        _enter(patch, home)  # also fixtures of modules must not see the tester's files
        with ExitStack() as stack:
            home = stack.enter_context(_new_home())

            def clean_home() -> str:
                nonlocal home
                if sum(len(names) + len(files) for _, names, files in os.walk(home)) != _N_FOLDERS:
                    stack.close()
                    home = stack.enter_context(_new_home())
                return home

            yield clean_home


@contextmanager
def _new_home() -> Iterator[str]:
    with TemporaryDirectory(prefix="armrig-", ignore_cleanup_errors=True) as folder:
        for path in (*FOLDERS.values(), "work"):
            Path(folder, path).mkdir(mode=0o700, parents=True, exist_ok=True)
        yield folder


def _enter(patch: pytest.MonkeyPatch, folder: str) -> None:
    for name, path in FOLDERS.items():
        patch.setenv(name, f"{folder}/{path}")
    for name in os.environ:
        if name.startswith("ARMRIG_") and not _OF_THE_TESTS.fullmatch(name):
            patch.delenv(name)
    patch.chdir(f"{folder}/work")


@pytest.fixture(autouse=True)
def _user_of_the_test(_clean_homes: Callable[[], str]) -> Iterator[None]:
    """Keep a test away from the files of the person who tests, and of all other tests."""
    with pytest.MonkeyPatch.context() as patch:
        _enter(patch, _clean_homes())
        yield


@pytest.fixture(autouse=True)
def _handlers_are_restored() -> Generator[None]:
    """Refuse a test that leaves a signal handler: a pool forked later would not end at SIGTERM."""
    handlers = {number: signal.getsignal(number) for number in ENDING}
    yield
    assert {number: signal.getsignal(number) for number in ENDING} == handlers


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, Any, Any]:
    """Make a skip a failure if ARMRIG_REQUIRE_ALL=1 requires all tests that this user can run."""
    report = yield
    is_allowed = os.geteuid() != 0 and item.get_closest_marker("root")
    if report.skipped and os.environ.get("ARMRIG_REQUIRE_ALL") == "1" and not is_allowed:
        report.outcome = "failed"
        report.longrepr = f"skipped, where ARMRIG_REQUIRE_ALL=1: {report.longrepr}"
    return report


@pytest.fixture
def tolerate(monkeypatch: pytest.MonkeyPatch) -> Callable[[timedelta], None]:
    """Give a function that sets how long before its issue a certificate becomes valid."""
    from armrig.lab import pki

    return partial(monkeypatch.setattr, pki, "_CLOCK_TOLERANCE")
