"""If a test fails, the pins of its simulated Uno are kept as VCD."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.firmware import uno_host

_PINS = pytest.StashKey[list[Path]]()


@pytest.fixture(autouse=True)
def pins(request: pytest.FixtureRequest) -> Iterator[None]:
    """Trace the pins of each Uno that is switched on; a test that holds leaves no trace."""
    traced = uno_host.pins = request.node.stash[_PINS] = []
    yield
    uno_host.pins = None
    if _PINS in request.node.stash:
        for trace in traced:
            trace.unlink()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, Any, Any]:
    """Name the traces of a test that failed."""
    report = yield
    if report.failed and item.stash.get(_PINS, []):
        report.sections.append(("pins of the Uno", "\n".join(map(str, item.stash[_PINS]))))
        del item.stash[_PINS]  # they are kept
    return report
