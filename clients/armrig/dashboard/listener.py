"""The thread that listens to the rig, and finds a daemon that came back."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from armrig_core.commands import StatusReport

from armrig.dashboard.feed import Feed
from armrig.rig.client import Rig
from armrig.rig.remote_source import RemoteSource
from armrig.rig.session import RigError, open_session
from armrig.rig.telemetry_stream import decoded

_LOOK_S = 0.025
_STATUS_S = 0.5
_SILENT_S = 2.0  # and Ts: then the connection is made anew, whatever the daemon answers
_AGAIN_S = 0.3
_MOST_PIECES = 100


class Listener:
    """Fills a feed for as long as it runs, in a thread of its own."""

    def __init__(
        self, feed: Feed, *, rig: str, connect: str | None, found: Callable[[], None]
    ) -> None:
        """Prepare to listen to a rig, found as by `armrig.Rig`; `found` is called when it is."""
        self._found = found
        self._feed = feed
        self._rig = rig
        self._connect = connect
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name="listener", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def end(self) -> None:
        """End, and wait for it."""
        self._ends.set()
        self._thread.join(5.0)

    def _run(self) -> None:
        while not self._ends.is_set():
            try:
                with Rig(self._rig, connect=self._connect) as opened:
                    self._listen(opened)
            except (RigError, ValueError) as err:
                self._feed.trouble = str(err)
            self._ends.wait(_AGAIN_S)

    def _listen(self, rig: Rig) -> None:
        """Listen until the end, or until nothing comes any more."""
        feed = self._feed
        with (
            rig.arrivals("sample") as samples,
            rig.arrivals("gap") as gaps,
            rig.arrivals("timing") as reports,
            rig.arrivals("state") as states,
            rig.arrivals("event") as events,
        ):
            feed.status = status = rig.status()
            feed.trouble = ""
            self._found()
            self._take_past()
            asked_s = heard_s = time.monotonic()
            while not self._ends.wait(_LOOK_S):
                feed.add_gaps(gaps())
                if came := samples():
                    feed.add_samples(came)
                    heard_s = time.monotonic()
                for report in reports():
                    feed.add_report(report)
                feed.add_events(events())
                now = time.monotonic()
                feed.add_states(fresh := states())
                if _changed(fresh, status) or now - asked_s >= _STATUS_S:
                    feed.status = status = rig.status()
                    feed.trouble, asked_s = "", now
                if now - heard_s > _SILENT_S + 2 * status.Ts:
                    return  # a session may outlive the daemon that it led to

    def _take_past(self) -> None:
        """Take what the daemon still has of the last minutes."""
        with open_session(self._connect, rig=self._rig) as session:
            source = RemoteSource(session, self._rig)
            for _ in range(_MOST_PIECES):
                piece = source.next_piece()
                if piece is None or self._ends.is_set():
                    return
                for name, take in self._takers():
                    take(
                        [decoded(name, data) for kind, data in piece.past.messages if kind == name]
                    )
                if not piece.is_full:
                    return

    def _takers(self) -> tuple[tuple[str, Callable[[list[Any]], None]], ...]:
        return (
            ("gap", self._feed.add_gaps),
            ("state", self._feed.add_states),
            ("event", self._feed.add_events),
            ("sample", lambda samples: self._feed.add_samples(samples, live=False)),
        )


def _changed(states: list[Any], status: StatusReport) -> bool:
    """Tell whether the daemon has published another state than the status that we have."""
    return any(
        (s.phase, s.owner, s.reason) != (status.phase, status.owner, status.reason) for s in states
    )
