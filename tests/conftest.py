"""Settings of all tests."""

from __future__ import annotations

import os
from collections.abc import Generator
from typing import Any

import pytest

# Before numpy is loaded: its threads only wait for each other on matrices as small as ours.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, Any, Any]:
    """Make a skip a failure where ARMRIG_REQUIRE_ALL=1 says that all must run."""
    report = yield
    if report.skipped and os.environ.get("ARMRIG_REQUIRE_ALL") == "1":
        report.outcome = "failed"
        report.longrepr = f"skipped, where ARMRIG_REQUIRE_ALL=1: {report.longrepr}"
    return report
