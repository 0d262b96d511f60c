"""The bench of the tests on real processes."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration.browsing import CHROMIUM
from tests.integration.driving import bring_to_rest
from tests.integration.fork_server import ForkServer
from tests.integration.processes import Bench
from tests.integration.watching import Client, watched

_BENCH = pytest.StashKey[Bench]()


def pytest_itemcollected(item: pytest.Item) -> None:
    """Mark the tests with a bench: its rig is a process that a stall of the host stops."""
    if {"bench", "_serving", "shared"} & set(getattr(item, "fixturenames", ())):
        item.add_marker(pytest.mark.real_time)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Show with a failure what the bench reports, also if a fixture failed."""
    report = yield
    benches = [node.stash[_BENCH] for node in item.listchain() if _BENCH in node.stash]
    if report.failed:
        for bench in benches:
            try:
                report.sections += bench.report().items()
            except (OSError, RuntimeError) as err:
                report.sections.append(("Bench", repr(err)))
    return report


@pytest.fixture(scope="session")
def forks() -> Iterator[ForkServer]:
    """Give an interpreter to be copied."""
    forks = ForkServer()
    yield forks
    forks.end()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Give Debian's chromium."""
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright")
    with playwright.sync_playwright() as started:
        yield (made := started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"]))
        made.close()


@pytest.fixture
def bench(request: pytest.FixtureRequest, tmp_path: Path, forks: ForkServer) -> Iterator[Bench]:
    """Give a bench, and end all its processes."""
    bench = request.node.stash[_BENCH] = Bench(tmp_path, forks)
    yield bench
    bench.end()


@pytest.fixture(scope="module")
def _serving(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, forks: ForkServer
) -> Iterator[Bench]:
    bench = request.node.stash[_BENCH] = Bench(tmp_path_factory.mktemp("served"), forks)
    try:
        # The longest watchdog: a flood may hold the emulator up for long.
        bench.configure(watchdog_ms=250)
        bench.emulate()
        bench.serve()
        yield bench
    finally:
        bench.end()


@pytest.fixture
def served(_serving: Bench) -> Bench:
    """Give a rig and a daemon that a module's tests share: at 0 V, without a holder."""
    bring_to_rest(_serving)
    return _serving


@pytest.fixture(scope="module")
def _client(_serving: Bench) -> Iterator[Client]:
    with watched(_serving) as found:
        yield found


@pytest.fixture
def client(served: Bench, _client: Client) -> Client:
    """Give a client of a dashboard over a rig at rest, which does nothing and is not stale."""
    _client.wait("run", lambda seen: not seen["is_going"])
    _client.wait("live", lambda seen: not seen["is_stale"])
    return _client
