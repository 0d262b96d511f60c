"""Data of the rig for the dashboard: samples of the last five minutes, status and timing."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice, pairwise
from operator import itemgetter
from typing import Any

import numpy as np
from armrig_core.commands.commands import StatusReport
from armrig_core.rig.description import Description, builtin
from armrig_core.telemetry.telemetry import Sample

from armrig.dashboard.bins import (
    ARM_SIGNALS,
    COLUMNS,
    Rows,
    RunRotation,
    Signal,
    binned,
    coarser,
    needed_before,
    signals,
    signals_of,
)
from armrig.dashboard.control_feed import ControlFeed, law_of_run
from armrig.recordings.daemon_reports import is_note
from armrig.rig.telemetry_stream import MOST_TOLD, gaps_between

HISTORY_S = 300.0
"""Length of the history that a new viewer receives, in s."""
FINE_S = 30.0
"""Length in s of the newest part of the history; older rows are sent in wider bins."""
COARSE_S = 0.05
_MOST_ROWS = 40_000  # five minutes of bins, and the additional rows at wraps
LATE_US = (50, 100, 200, 500, 1000, 2000, 5000, 10_000)
"""Upper edges of the histogram of lateness, in µs; a last bin contains all later samples."""
_MOST_STATES, _MOST_NOTES = 200, 100
_BACK_NS = 1_000_000_000
_LATE_S = 60  # length of the histogram, in s


@dataclass(frozen=True, slots=True, kw_only=True)
class News:
    """Changes since the last message to the viewers."""

    rows: Rows
    """New bins."""
    at_s: float
    """Time of the call of `Feed.news`, in s of the server's monotonic clock."""
    age_s: float
    """Age of the newest sample, in s; inf before the first sample."""
    newest: Sample | None
    """The newest sample."""
    signals: tuple[Signal, ...]
    """Signals of the rig, in the order of the values in a row."""
    reference: Rows
    """New rows of the reference of a run in control, in the unit of its law."""
    pieces: tuple[int, int] = (0, 0)
    """Number of pieces of rows and of the reference so far, for the next call of `Feed.news`."""


@dataclass(slots=True)
class FeedTiming:
    """Timing of the rig."""

    late: list[int] = field(default_factory=lambda: [0] * (len(LATE_US) + 1))
    """Number of samples in each bin of lateness (`LATE_US`) during the last minute."""
    missing: int = 0
    """Number of missing samples since the start of the dashboard."""
    unheard: int = 0
    """Number of published samples that did not reach the dashboard."""
    last_gap: str = ""
    """Reason for the last gap."""
    report: dict[str, float] = field(default_factory=dict)
    """Values from the daemon's newest timing report, by name, such as `wake_p99_us`."""


class Feed:
    """Data that the listener's thread writes and the server's thread reads, protected by a lock."""

    def __init__(self, local: Description | None = None) -> None:
        """Begin without data; a `local` description may have a model in a file."""
        self._local = local
        self._lock = threading.Lock()
        self._rows: deque[Rows] = deque()  # in pieces, as they came
        self._kept = 0
        self._pieces = 0  # so far
        self._tail = np.zeros((0, COLUMNS))
        self._rotation = RunRotation()
        self._control = ControlFeed()
        self._newest: Sample | None = None
        self._came_s = -np.inf
        self._late: deque[tuple[int, list[int]]] = deque(maxlen=_LATE_S)
        self._told: deque[Any] = deque(maxlen=MOST_TOLD)
        self._timing = FeedTiming()
        self._phase = ""  # of the newest state heard
        self._states: deque[tuple[int, str]] = deque(maxlen=_MOST_STATES)  # time in ns, phase
        self._notes: deque[tuple[int, str]] = deque(maxlen=_MOST_NOTES)  # time in ns, text
        self.status: StatusReport | None = None
        """Newest status of the daemon."""
        self.description = builtin("arm")
        """Description of the rig; until a daemon reports it, that of the arm."""
        self.signals: tuple[Signal, ...] = ARM_SIGNALS
        """Signals of the rig, in the order of the values in a row."""
        self.trouble = "looking for the rig's daemon"
        """Reason why no daemon is connected; "" if a daemon is connected."""

    def take_status(self, status: StatusReport) -> None:
        """Take the status of a daemon that answers; discard the rows of another rig."""
        self.status, self.trouble = status, ""
        local = self._local
        is_local = local is not None and local.text == status.described.text
        described = local if local is not None and is_local else status.described
        drawn = signals_of(described, status.limits, (status.u_min, status.u_max))
        if described.text != self.description.text or drawn != self.signals:
            with self._lock:
                self.description, self.signals = described, drawn
                self._forget_rows()

    def add_samples(self, samples: Sequence[Sample], *, live: bool = True) -> None:
        """Add samples in order; `live` is False for earlier samples, which the daemon has kept."""
        with self._lock:
            newest = self._newest if live and samples else None
            # The rig's machine, and therefore its monotonic clock, may have been restarted.
            if newest is not None and self._is_of_another_clock(samples[0], newest):
                self._forget_rows()
                self._forget_marks_after(samples[0].t_host_ns)
            newest_ns = self._newest.t_host_ns if self._newest else -1
            samples = [s for s in samples if s.t_host_ns > newest_ns]
            if not samples:
                return
            self._note_gaps(samples)
            found = signals(samples, self.signals, self._rotation.add(samples))
            made = binned(self._tail, found, self.signals)
            self._tail = needed_before(np.concatenate([self._tail, found]))
            self._newest = samples[-1]
            if live:
                self._came_s = time.monotonic()
                self._note_lateness(samples)
            self._rows.append(made)
            self._pieces += 1
            self._kept += made.shape[0]
            while self._rows and (
                self._kept > _MOST_ROWS or self._rows[0][-1, 0] < found[-1, 1] - HISTORY_S
            ):
                self._kept -= self._rows.popleft().shape[0]

    def add_gaps(self, gaps: Sequence[Any]) -> None:
        """Add gap records of the daemon."""
        self._told.extend(gaps)

    def add_states(self, states: Sequence[Any]) -> None:
        """Add states of the rig; a state may arrive twice, live and among the kept messages."""
        with self._lock:
            for state in states:
                found = state.t_host_ns, state.phase
                if state.phase != self._phase and found not in self._states:
                    self._states.append(found)
                    if state.phase == "active":
                        self._control.begin(state.t_host_ns)
                self._phase = state.phase

    def add_decisions(self, decisions: Sequence[Any]) -> None:
        """Add decisions of a run in control; a decision may arrive twice, as a state."""
        with self._lock:
            self._control.add(decisions, HISTORY_S)

    def look_for_law(self) -> None:
        """Look for the law of a run in control in its recording."""
        if self._control.wants_law:
            law = law_of_run(self.status)
            with self._lock:
                self._control.take_law(law)

    def control(self) -> dict[str, Any] | None:
        """Return the law of the last run in control, and its shares; None without such a run."""
        is_going = self.status is not None and self.status.phase == "active"
        with self._lock:
            return self._control.facts(is_going=is_going)

    def add_events(self, events: Sequence[Any]) -> None:
        """Add events of the daemon's log; each note is marked once."""
        with self._lock:
            for note in ((e.t_host_ns, e.message) for e in events if is_note(e)):
                if note not in self._notes:
                    self._notes.append(note)

    def marks(self) -> list[tuple[float, str, str]]:
        """Return time in s, kind (start, end, trip or note) and text of each recent mark.

        Only a note has a text.
        """
        with self._lock:
            oldest_s = self._newest.t_host_ns / 1e9 - HISTORY_S if self._newest else -np.inf
            states = sorted(self._states, key=itemgetter(0))
            marks = [(t_ns / 1e9, "note", text) for t_ns, text in self._notes]
        for (_, before), (t_ns, phase) in pairwise(states):
            if kind := _mark(before, phase):
                marks.append((t_ns / 1e9, kind, ""))
        return sorted(mark for mark in marks if mark[0] >= oldest_s)

    def add_report(self, report: Any) -> None:
        """Add the daemon's timing report of one second."""
        wake = report.wake_lateness_us
        self._timing.report = {
            "wake_p50_us": wake.p50,
            "wake_p99_us": wake.p99,
            "wake_max_us": wake.max,
            "jitter_p99_us": report.device_tick_error_us.p99,
            "link_p99_us": report.link_round_trip_us.p99,
            "cpu_pressure_percent": report.cpu_pressure_percent,
        }

    def history(self) -> Rows:
        """Return the rows of the last five minutes; rows older than `FINE_S` are in wider bins."""
        with self._lock:
            pieces, drawn = [*self._rows], self.signals
        if not pieces:
            return np.zeros((0, 1 + 2 * len(drawn)))
        rows = np.concatenate(pieces)
        newest = rows[-1, 0]
        rows = rows[rows[:, 0] >= newest - HISTORY_S]
        fine = int(np.searchsorted(rows[:, 0], newest - FINE_S))
        return np.concatenate([coarser(rows[:fine], COARSE_S, drawn), rows[fine:]])

    def reference(self) -> Rows:
        """Return the rows of the reference of the last five minutes, in the unit of its law."""
        with self._lock:
            return self._control.rows()

    def news(self, after: tuple[int, int] = (0, 0)) -> News:
        """Return the changes since a previous call; `after` is `News.pieces` of that call."""
        with self._lock:
            fresh = [*islice(reversed(self._rows), self._pieces - after[0])][::-1]
            rows = np.concatenate(fresh) if fresh else np.zeros((0, 1 + 2 * len(self.signals)))
            now_s = time.monotonic()
            return News(
                rows=rows,
                at_s=now_s,
                age_s=now_s - self._came_s,
                newest=self._newest,
                signals=self.signals,
                reference=self._control.rows(after[1]),
                pieces=(self._pieces, self._control.pieces),
            )

    def timing(self) -> FeedTiming:
        """Return the timing of the rig."""
        with self._lock:
            if self._late:
                counts = (counts for _, counts in self._late)
                self._timing.late = [sum(column) for column in zip(*counts, strict=True)]
            return self._timing

    def _is_of_another_clock(self, sample: Sample, newest: Sample) -> bool:
        """Return True if a sample is too old, and its number does not fit its time.

        A daemon that was frozen sends samples that the dashboard has read among the kept ones.
        """
        Ts = self.status.Ts if self.status else 0.0
        elapsed_s = (newest.t_sched_ns - sample.t_sched_ns) / 1e9
        fits = newest.k > sample.k and abs(elapsed_s - (newest.k - sample.k) * Ts) < Ts
        return sample.t_host_ns < newest.t_host_ns - _BACK_NS and not fits

    def _forget_rows(self) -> None:
        self._rows.clear()
        self._kept, self._newest, self._tail = 0, None, self._tail[:0]
        self._control = ControlFeed()

    def _forget_marks_after(self, t_ns: int) -> None:
        states = [found for found in self._states if found[0] <= t_ns]
        self._states, self._phase = deque(states, maxlen=_MOST_STATES), ""
        notes = (note for note in self._notes if note[0] <= t_ns)
        self._notes = deque(notes, maxlen=_MOST_NOTES)

    def _note_gaps(self, samples: Sequence[Sample]) -> None:
        before = self._newest
        for sample in samples:
            if before is not None and sample.k > before.k + 1:
                for gap in gaps_between(before, sample, self._told):
                    if gap.published:
                        self._timing.unheard += gap.count
                    else:
                        self._timing.missing += gap.count
                        self._timing.last_gap = gap.reason
            before = sample
        while self._told and self._told[0].k_first <= samples[-1].k:
            self._told.popleft()

    def _note_lateness(self, samples: Sequence[Sample]) -> None:
        second = int(self._came_s)
        if not self._late or self._late[-1][0] != second:
            self._late.append((second, [0] * (len(LATE_US) + 1)))
        late_us = [(s.t_host_ns - s.t_sched_ns) / 1e3 for s in samples]
        counts = self._late[-1][1]
        for place in np.searchsorted(LATE_US, late_us).tolist():
            counts[place] += 1


def _mark(before: str, phase: str) -> str:
    """Return the mark for a change of phase: start, trip or end; "" for no mark."""
    if phase == before:
        return ""
    return {"active": "start", "fault": "trip"}.get(phase, "end" if before == "active" else "")
