"""The stream of events that each page gets, and the clock that fills it: 20 messages a second."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator

from armrig.dashboard.bins import as_lists
from armrig.dashboard.driver import Driver
from armrig.dashboard.feed import LATE_US, Feed
from armrig.dashboard.messages import event, live_facts, status_facts, timing_facts
from armrig.dashboard.viewers import Viewer, Viewers

PERIOD_S = 0.05
_TIMING_S = 1.0
_PIECE = 500  # rows of history in a message


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
            self.viewers.send(event("live", live_facts(self._feed.news(), self._feed.status)))
            self._send_changed()
            if due >= timing_due:
                self.viewers.send(self._timing())
                timing_due = due + _TIMING_S

    async def messages(self, viewer: Viewer) -> AsyncIterator[bytes]:
        """Give what one viewer is sent: first the past, then what comes.

        Raises
        ------
        TooManyViewersError
            There are as many viewers as are allowed.
        """
        # What he is told first the others have heard, too: else a change back would be none.
        self._send_changed()
        self.viewers.add(viewer)
        try:
            # What comes from here on waits for him; the page passes over a row that it has.
            past = self._feed.history()
            first = [
                event("hello", {"may_command": viewer.may_command, "late_us": LATE_US}),
                *self._told.values(),
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

    def _timing(self) -> bytes:
        facts = timing_facts(self._feed.timing())
        facts |= {"viewers": len(self.viewers), "model": self._feed.model_lines()}
        return event("timing", facts)

    def _send_changed(self) -> None:
        for name, value in (("status", status_facts(self._feed)), ("run", self._driver.run)):
            message = event(name, value)
            if self._told.get(name) != message:
                self._told[name] = message
                self.viewers.send(message)
