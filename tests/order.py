"""A pytest plug-in for the order of the tests.

It draws an order, and shows what ran before a failure. Every second worker of xdist collects from
the end, so that two workers share the compilation of the modules of tests.
"""

from __future__ import annotations

import random
from collections.abc import Generator
from itertools import groupby
from typing import Any, Final

import pytest

SHOWN: Final = 10
"""Tests that a failure shows as run before it."""
DISTRIBUTIONS: Final = ("load", "loadscope", "worksteal")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option."""
    parser.addoption(
        "--order-seed",
        type=int,
        metavar="SEED",
        help="Draw the order of the modules, of the tests in each, and the workers' shares.",
    )


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """Draw how xdist distributes the tests to its workers, before xdist reads it."""
    seed = config.getoption("order_seed")
    if seed is not None and getattr(config.option, "numprocesses", None):
        config.option.dist = random.Random(seed).choice(DISTRIBUTIONS)


def from_the_end(config: pytest.Config) -> bool:
    """Return whether this process is a worker of xdist that collects the last folder first.

    It does so if it collects one folder. Several arguments keep their order.
    """
    worker = getattr(config, "workerinput", {}).get("workerid", "gw0")
    return worker[-1] in "13579" and len(config.args) == 1


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Reverse the content of a folder in every second worker."""
    report = yield
    if isinstance(collector, pytest.Directory) and from_the_end(collector.config):
        report.result.reverse()
    return report


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Order the modules as in the first worker; then draw the order, the same in all workers."""
    if from_the_end(config):
        modules = [list(tests) for _, tests in groupby(items, key=lambda item: item.path)]
        items[:] = [item for tests in reversed(modules) for item in tests]
    if (seed := config.getoption("order_seed")) is not None:
        items[:] = shuffled(items, random.Random(seed))


def shuffled(items: list[pytest.Item], generator: random.Random) -> list[pytest.Item]:
    """Return the tests in a drawn order; those of a module stay together and share its fixtures."""
    modules = [list(tests) for _, tests in groupby(items, key=lambda item: item.path)]
    generator.shuffle(modules)
    for tests in modules:
        generator.shuffle(tests)
    return [item for tests in modules for item in tests]


def pytest_configure(config: pytest.Config) -> None:
    """Keep what runs in this process."""
    config.pluginmanager.register(_Before(config))


class _Before:
    """The tests that ran in this process."""

    def __init__(self, config: pytest.Config) -> None:
        self._worker = getattr(config, "workerinput", {}).get("workerid", "the only process")
        self._seed = config.getoption("order_seed")
        self._ran: list[str] = []

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Generator[None, Any, Any]:
        """Show with a failure what ran before it."""
        report = yield
        if report.failed:
            order = "as collected" if self._seed is None else f"--order-seed {self._seed}"
            before = "".join(f"\n  {test}" for test in self._ran[-SHOWN:])
            text = (
                f"{self._worker}, order {order}, {len(self._ran)} tests before, the last:{before}"
            )
            report.sections.append(("Order", text))
        if report.when == "teardown":
            self._ran.append(item.nodeid)
        return report
