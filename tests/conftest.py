"""Settings of all tests."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Generator
from typing import Any

import pytest
from armrig_core.signal_pipe import ENDING

from tests.progress import Progress

pytest_plugins = ("tests.stalls.repeats", "tests.order", "tests.examples")

# Before numpy is loaded: its threads only wait for each other on matrices as small as ours.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# A shell's background job ignores them and its children with it, which some tests send them to.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
# Rare garbage collections: with Python's thresholds they took 3 % of the processor time.
gc.set_threshold(100_000, 50, 50)


@pytest.hookimpl(trylast=True)
def pytest_configure(config: pytest.Config) -> None:
    """Show progress by room where a person or CI reads; the workers of xdist show nothing."""
    # pytest has read these options. They are not for a pytest that a test starts.
    os.environ.pop("PYTEST_ADDOPTS", None)
    terminal = config.pluginmanager.get_plugin("terminalreporter")
    if terminal is not None and not config.option.verbose:
        config.pluginmanager.register(Progress(terminal))


def pytest_itemcollected(item: pytest.Item) -> None:
    """Refuse a timed test that `make test` would not find, which looks for it in one folder."""
    if item.get_closest_marker("timed") and "integration" not in item.path.parts:
        raise pytest.UsageError(
            f"{item.nodeid}: is marked as timed and does not stand in tests/integration"
        )


def pytest_collection_finish() -> None:
    """Exempt the collected tests from garbage collection: a full collection takes 0.3 s."""
    gc.freeze()


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
    """Make a skip a failure if ARMRIG_REQUIRE_ALL=1 requires all tests."""
    report = yield
    if report.skipped and os.environ.get("ARMRIG_REQUIRE_ALL") == "1":
        report.outcome = "failed"
        report.longrepr = f"skipped, where ARMRIG_REQUIRE_ALL=1: {report.longrepr}"
    return report
