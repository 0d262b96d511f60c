"""The stream of events that each page gets, and the clock that fills it: 20 messages a second."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from math import degrees, isfinite
from typing import Any

import msgspec
from armrig_core.commands import StatusReport
from armrig_core.telemetry import Sample

from armrig.dashboard.bins import as_lists
from armrig.dashboard.driver import Driver
from armrig.dashboard.experiments import run_facts
from armrig.dashboard.feed import LATE_US, Feed
from armrig.dashboard.viewers import Viewer, Viewers
from armrig.rig.status_rows import status_rows

PERIOD_S = 0.05
_TIMING_S = 1.0
_STALE_S = 0.5
"""And two sampling times: without a sample for so long the data are stale."""
_PIECE = 500  # rows of history in a message


def event(name: str, value: Any) -> bytes:
    """Return a server-sent event; JSON has no line breaks in it."""
    return b"event: %s\ndata: %s\n\n" % (name.encode(), msgspec.json.encode(value))


class Stream:
    """Tells all viewers what the feed and the driver know."""

    def __init__(self, feed: Feed, driver: Driver) -> None:
        """Begin with no viewer."""
        self._feed, self._driver = feed, driver
        self.viewers = Viewers()
        self._told: dict[str, bytes] = {}

    async def fill(self) -> None:
        """Send what is new, 20 times a second, until it is cancelled; a late turn skips."""
        due = timing_due = time.monotonic()
        while True:
            due = max(due + PERIOD_S, time.monotonic())
            await asyncio.sleep(due - time.monotonic())
            self.viewers.send(event("live", self._live()))
            self._send_changed("status", _status(self._feed))
            self._send_changed("run", self._driver.run)
            if due >= timing_due:
                self.viewers.send(self._timing())
                timing_due = due + _TIMING_S

    async def messages(self, viewer: Viewer, *, may_command: bool) -> AsyncIterator[bytes]:
        """Give what one viewer is sent: first the past, then what comes.

        Raises
        ------
        TooManyViewersError
            There are as many viewers as are allowed.
        """
        self.viewers.add(viewer)
        try:
            # What comes from here on waits for him; the page passes over a row that it has.
            past = self._feed.history()
            first = [
                event("hello", {"may_command": may_command, "late_us": LATE_US}),
                event("status", _status(self._feed)),
                event("run", self._driver.run),
                self._timing(),
            ]
            for message in first:
                yield message
            for i in range(0, past.shape[0], _PIECE):
                yield event("past", as_lists(past[i : i + _PIECE]))
                await asyncio.sleep(0)  # others are served, and we hear that he has gone
            yield event("whole", {})
            async for message in viewer.messages():
                yield message
        finally:
            self.viewers.remove(viewer)

    def _live(self) -> dict[str, Any]:
        news, status = self._feed.news(), self._feed.status
        limit_s = _STALE_S + 2 * (status.Ts if status else 0.0)
        return {
            "age_s": round(news.age_s, 3) if isfinite(news.age_s) else None,
            "is_stale": not news.age_s <= limit_s,
            "rows": as_lists(news.rows) if news.rows.size else [],
            "newest": _newest(news.newest),
        }

    def _timing(self) -> bytes:
        timing = self._feed.timing()
        facts = {
            "late": timing.late,
            "missing": timing.missing,
            "unheard": timing.unheard,
            "last_gap": timing.last_gap,
            "report": timing.report,
            "viewers": len(self.viewers),
            "model": self._feed.model_lines(),
        }
        return event("timing", facts)

    def _send_changed(self, name: str, value: Any) -> None:
        message = event(name, value)
        if self._told.get(name) != message:
            self._told[name] = message
            self.viewers.send(message)


def _newest(sample: Sample | None) -> dict[str, float | None] | None:
    if sample is None:
        return None
    theta_1, alpha = sample.theta_1_rad, sample.alpha_rad
    return {
        "u": sample.u_applied_v,
        "theta_1": round(degrees(theta_1), 2) if isfinite(theta_1) else None,
        "alpha": round(degrees(alpha), 2) if isfinite(alpha) else None,
    }


def _status(feed: Feed) -> dict[str, Any]:
    status: StatusReport | None = feed.status
    if status is None:
        return {"trouble": feed.trouble, "rows": []}
    return {
        "trouble": feed.trouble,
        "rows": status_rows(status),
        "rig": status.rig,
        "phase": status.phase,
        "fault": status.fault,
        "reason": status.reason,
        "remedy": status.remedy,
        "line": status.line,
        "owner": status.owner,
        "Ts": status.Ts,
        "u_min": status.u_min,
        "u_max": status.u_max,
        "arm_removed": status.arm_removed,
        "last_run": run_facts(status.last_run),
    }
