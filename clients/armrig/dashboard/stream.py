"""The stream of events that each page gets, and the clock that fills it: 30 messages a second."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator

from armrig.dashboard.driver import Driver
from armrig.dashboard.feed import LATE_US, Feed
from armrig.dashboard.history import History
from armrig.dashboard.messages import event, live_facts, status_facts, timing_facts
from armrig.dashboard.viewers import Viewer, Viewers

PERIOD_S = 1 / 30
_TIMING_S = 1.0


class Stream:
    """Tells all viewers of one door what the feed and the driver know."""

    def __init__(
        self, feed: Feed, driver: Driver, audience: list[Viewers], *, may_command: bool
    ) -> None:
        """Begin with no viewer, and join the audience: the viewers of all doors."""
        self._feed, self._driver, self._audience = feed, driver, audience
        self.may_command = may_command
        """Whether the viewers of this door may."""
        self._history = History(feed.history)
        self.viewers = Viewers()
        audience.append(self.viewers)
        self._told: dict[str, bytes] = {}

    async def fill(self) -> None:
        """Send what is new, 30 times a second, until it is cancelled; a late turn skips."""
        due = timing_due = time.monotonic()
        seen = self._feed.news().pieces
        while True:
            due = max(due + PERIOD_S, time.monotonic())
            await asyncio.sleep(due - time.monotonic())
            news = self._feed.news(seen)
            seen = news.pieces
            self.viewers.send(event("live", live_facts(news, self._feed.status)))
            self._send_changed()
            if due >= timing_due:
                self.viewers.send(self._timing())
                timing_due = due + _TIMING_S

    async def messages(self, viewer: Viewer) -> AsyncIterator[bytes]:
        """Give what one viewer is sent: how all is now, what comes, and the past once it is made.

        Raises
        ------
        TooManyViewersError
            There are as many viewers as are allowed.
        """
        # What he is told first the others have heard, too: else a change back would be none.
        self._send_changed()
        self.viewers.add(viewer)
        # What comes from here on waits for him; the page passes over a row that it has.
        past = asyncio.create_task(self._offer_past(viewer))
        try:
            hello = {"may_command": self.may_command, "late_us": LATE_US}
            for message in (event("hello", hello), *self._told.values(), self._timing()):
                yield message
            async for message in viewer.messages():
                yield message
                await asyncio.sleep(0)  # others are served, and we hear that he has gone
        finally:
            past.cancel()
            self.viewers.remove(viewer)

    async def _offer_past(self, viewer: Viewer) -> None:
        for message in await self._history.messages():
            viewer.offer(message)

    def _timing(self) -> bytes:
        facts = timing_facts(self._feed.timing())
        facts |= {"viewers": sum(map(len, self._audience)), "model": self._feed.model_lines()}
        return event("timing", facts)

    def _send_changed(self) -> None:
        for name, value in (
            ("status", status_facts(self._feed)),
            ("run", self._driver.run),
            ("marks", self._feed.marks()),
        ):
            message = event(name, value)
            if self._told.get(name) != message:
                self._told[name] = message
                self.viewers.send(message)
