"""Stream of server-sent events for the pages, with new data 30 times a second.

Each viewer has a bounded queue. A viewer that does not receive its messages is dropped.
"""

from __future__ import annotations

import asyncio
import hashlib
import time
from collections.abc import AsyncIterator, Callable, Mapping
from math import degrees, isfinite
from pathlib import PurePosixPath
from typing import Any

import msgspec
from armrig_core.commands.commands import LastRun, StatusReport
from armrig_core.errors import OperationError
from armrig_core.rig.arm import ArmParameters
from armrig_core.rig.volts import U_MAX_V
from armrig_core.telemetry.telemetry import Sample

from armrig.dashboard.bins import Rows, Signal, as_lists, columns_of, signals
from armrig.dashboard.driver import CommandSender
from armrig.dashboard.experiments import suggest_experiments
from armrig.dashboard.feed import LATE_US, Feed, News
from armrig.dashboard.page_json import page_json
from armrig.rig.status import status_rows

MOST_VIEWERS = 64
"""Largest number of viewers of one listening socket."""
_MAX_WAITING = 250  # messages: the history, and the new data of five seconds at 30 Hz
PERIOD_S = 1 / 30
_TIMING_S = 1.0
OPEN_S = 1 / 50
"""Shortest time in s between two new viewers. Viewers that connect again and again would otherwise
delay a stop, because a single thread serves all requests."""
PAUSE_S = 0.25
"""Shortest time in s between two encodings of the history, even if clients connect often."""
_PIECE = 500  # rows in a message
_STALE_S = 0.3
"""If no sample arrives for this time, in s, plus two sampling times, the data are stale."""
_RATE_PER_VOLT = degrees(ArmParameters().torque_per_volt / ArmParameters().damping)
"""Steady rate of the arm at 1 V with the handout's parameters, in °/s."""
_STATUS_FIELDS = (
    *("rig", "phase", "fault", "reason", "remedy", "line", "owner", "Ts", "u_min", "u_max"),
)
"""Fields of the daemon's status that the page receives as they are."""


class TooManyViewersError(OperationError):
    """The largest number of viewers is reached."""


class Viewer:
    """Queue of messages for one viewer."""

    def __init__(self, drop: Callable[[], None]) -> None:
        """Store the function `drop`, which closes the connection and discards queued data."""
        self._waiting: asyncio.Queue[bytes | None] = asyncio.Queue(_MAX_WAITING)
        self._drop = drop
        self.is_dropped = False
        """True if the viewer did not read its messages."""

    def offer(self, message: bytes) -> None:
        """Queue a message, or drop the viewer if the queue is full."""
        try:
            self._waiting.put_nowait(message)
        except asyncio.QueueFull:
            self.is_dropped = True
            self._drop()

    async def messages(self) -> AsyncIterator[bytes]:
        """Yield the messages until the viewer is dropped or the server ends."""
        while not self.is_dropped and (message := await self._waiting.get()) is not None:
            yield message

    def end(self) -> None:
        """End the stream after the queued messages."""
        self.is_dropped = self._waiting.full()
        if not self.is_dropped:
            self._waiting.put_nowait(None)


class Viewers:
    """All viewers of one listening socket."""

    def __init__(self) -> None:
        """Begin without viewers."""
        self._viewers: set[Viewer] = set()
        self.dropped = 0
        """Number of dropped viewers."""

    def __len__(self) -> int:
        """Return the number of viewers."""
        return len(self._viewers)

    def add(self, viewer: Viewer) -> None:
        """Add a viewer.

        Raises TooManyViewersError if the largest number of viewers is reached.
        """
        if len(self) >= MOST_VIEWERS:
            raise TooManyViewersError(f"{MOST_VIEWERS} pages are open already: close one")
        self._viewers.add(viewer)

    def remove(self, viewer: Viewer) -> None:
        """Remove a viewer."""
        self._viewers.discard(viewer)

    def send(self, message: bytes) -> None:
        """Send one message to all viewers."""
        for viewer in [*self._viewers]:
            viewer.offer(message)
            if viewer.is_dropped:
                self._viewers.discard(viewer)
                self.dropped += 1

    def end(self) -> None:
        """End the streams of all viewers."""
        for viewer in self._viewers:
            viewer.end()
        self._viewers.clear()


class Stream:
    """Stream of the feed's and the driver's state to all viewers of one listening socket."""

    def __init__(
        self,
        feed: Feed,
        driver: CommandSender,
        *,
        may_command: bool,
        command: str = "armrig dashboard",
    ) -> None:
        """Begin without viewers; `command` is the command that has started the server."""
        self._feed, self._driver, self._command = feed, driver, command
        self.may_command = may_command
        """True if the viewers of this socket may command."""
        past = {"past": feed.history, "past_reference": feed.reference}
        self._history = HistoryEncoder(lambda: {name: rows() for name, rows in past.items()})
        self.viewers = Viewers()
        self._told: dict[str, bytes] = {}
        self._turn = asyncio.Lock()
        self._queued = 0  # new viewers that wait for their turn

    async def fill(self) -> None:
        """Send new data 30 times a second until the task is cancelled; missed times are skipped."""
        due = timing_due = time.monotonic()
        seen = self._feed.news().pieces
        while True:
            due = max(due + PERIOD_S, time.monotonic())
            await asyncio.sleep(due - time.monotonic())
            news = self._feed.news(seen)
            seen = news.pieces
            # The state comes first: it tells in which plot the rows of the reference are.
            self._send_changed()
            self.viewers.send(event("live", live_facts(news, self._feed.status)))
            if due >= timing_due:
                self.viewers.send(event("timing", self._feed.timing()))
                timing_due = due + _TIMING_S

    async def messages(self, viewer: Viewer) -> AsyncIterator[bytes]:
        """Yield the messages for one viewer: the current state, the history, and new messages.

        Raises TooManyViewersError if the largest number of viewers is reached.
        """
        await self._wait_for_turn()
        # All viewers receive the newest state first, so that they all know the same state. A later
        # change of the state is then sent to all of them.
        self._send_changed()
        self.viewers.add(viewer)
        # From here on, new messages are queued for the viewer. The page ignores repeated rows.
        past = asyncio.create_task(self._offer_past(viewer))
        try:
            hello = {
                "may_command": self.may_command,
                "late_us": LATE_US,
                "command": self._command,
            }
            # The rig comes first: its signals are the columns of the rows.
            for message in (event("hello", hello), *self._told.values()):
                yield message
            yield event("timing", self._feed.timing())
            async for message in viewer.messages():
                yield message
                await asyncio.sleep(0)  # other viewers are served, and a lost viewer is noticed
        finally:
            past.cancel()
            self.viewers.remove(viewer)

    async def _wait_for_turn(self) -> None:
        if self._queued >= MOST_VIEWERS:
            raise TooManyViewersError("many pages connect at this moment: try again")
        self._queued += 1
        try:
            async with self._turn:
                await asyncio.sleep(OPEN_S)
        finally:
            self._queued -= 1

    async def _offer_past(self, viewer: Viewer) -> None:
        for message in await self._history.messages():
            viewer.offer(message)

    def _send_changed(self) -> None:
        for name, value in (
            ("rig", rig_facts(self._feed)),
            ("status", status_facts(self._feed)),
            ("run", self._driver.run),
            ("marks", self._feed.marks()),
            ("control", self._feed.control()),
        ):
            message = event(name, value)
            if self._told.get(name) != message:
                self._told[name] = message
                self.viewers.send(message)


class HistoryEncoder:
    """Encoder of the history; viewers that connect before an encoding begins share the result."""

    def __init__(self, rows: Callable[[], Mapping[str, Rows]]) -> None:
        """Store the function that returns the rows of the history by the name of their message."""
        self._rows = rows
        self._next: asyncio.Task[list[bytes]] | None = None
        self._began_s = -PAUSE_S

    async def messages(self) -> list[bytes]:
        """Return the history_messages history; its rows are read after this call."""
        if self._next is None:
            self._next = asyncio.create_task(self._encoded())
        # A viewer that leaves does not cancel the task for the other viewers.
        return await asyncio.shield(self._next)

    async def _encoded(self) -> list[bytes]:
        await asyncio.sleep(self._began_s + PAUSE_S - time.monotonic())
        # Later viewers get the next encoding, because this encoding may lack the newest rows.
        self._began_s, self._next = time.monotonic(), None
        return await asyncio.to_thread(lambda: history_messages(self._rows()))


def history_messages(past: Mapping[str, Rows]) -> list[bytes]:
    """Return rows as messages of their names, followed by a message that marks their end."""
    pieces = (
        event(name, as_lists(rows[i : i + _PIECE]))
        for name, rows in past.items()
        for i in range(0, rows.shape[0], _PIECE)
    )
    return [*pieces, event("whole", {})]


def event(name: str, value: Any) -> bytes:
    """Return a server-sent event with a value as JSON, which contains no line breaks."""
    return b"event: %s\ndata: %s\n\n" % (name.encode(), page_json(value))


def live_facts(news: News, status: StatusReport | None) -> dict[str, Any]:
    """Return new rows, the newest sample and its age, for the page."""
    limit_s = _STALE_S + 2 * (status.Ts if status else 0.0)
    reference = {"reference": as_lists(news.reference)} if news.reference.size else {}
    return reference | {
        "at_s": round(news.at_s, 3),
        "age_s": round(news.age_s, 3) if isfinite(news.age_s) else None,
        "is_stale": not news.age_s <= limit_s,
        "rows": as_lists(news.rows) if news.rows.size else [],
        "newest": _newest(news.newest, news.signals),
    }


def rig_facts(feed: Feed) -> dict[str, Any]:
    """Return the signals of the rig for the page, and what only the arm has.

    The hash is that of the signals and the description, or "" until a daemon has reported them.
    """
    described = feed.description
    body = described.channels[0].body if described.arm else ""
    text = described.text + msgspec.json.encode(feed.signals)
    known = hashlib.sha256(text).hexdigest() if feed.status else ""
    facts = {"hash": known, "signals": feed.signals, "arm": described.arm, "body": body}
    u_max = feed.status.u_max if feed.status else U_MAX_V
    return facts | {"suggested": suggest_experiments(described, u_max)}


def status_facts(feed: Feed) -> dict[str, Any]:
    """Return the status of the rig for the page, with the rows of `armrig status`."""
    status: StatusReport | None = feed.status
    if status is None:
        return {"trouble": feed.trouble, "rows": []}
    return {
        "trouble": feed.trouble,
        "rows": status_rows(status),
        **{name: getattr(status, name) for name in _STATUS_FIELDS},
        "rate_max": round(status.u_max * _RATE_PER_VOLT, 1) if feed.description.arm else 0.0,
        "arm_removed": status.arm_removed,
        "last_run": _run_facts(status.last_run),
    }


def _newest(sample: Sample | None, drawn: tuple[Signal, ...]) -> dict[str, float | None] | None:
    if sample is None:
        return None
    drawn = tuple(s for s in drawn if s.kind not in ("rate", "turned"))
    columns = columns_of(signals([]), signals([sample], drawn), drawn)
    values = zip(drawn, columns[0].tolist(), strict=True)
    return {s.key: round(y, 3) if isfinite(y) else None for s, y in values}


def _run_facts(last: LastRun | None) -> dict[str, Any] | None:
    if last is None:
        return None
    return {
        "run_id": last.run_id,
        "file": PurePosixPath(last.recording).name.removesuffix(".active"),
        "finished": last.finished,
        "samples": last.samples,
        "synced": last.synced,
        "outcome": last.outcome,
    }
