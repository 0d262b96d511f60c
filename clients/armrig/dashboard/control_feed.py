"""Run in control for the page: the plot of r, the limits of the law, and shares of decisions."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from itertools import islice
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from armrig_core.commands.commands import StatusReport
from armrig_core.control.control_law import ControlLaw
from armrig_core.errors import ArmrigError
from armrig_core.process.printable import with_degrees
from armrig_core.recording_file.manifest import RUN, Manifest
from armrig_core.rig.description import Description
from armrig_core.rig.volts import U_MAX_V

from armrig.dashboard.bins import TURN, WIDTH_S, Rows, Signal, coarser
from armrig.recordings.decisions import DecisionCounts
from armrig.recordings.files.control_run import law_of
from armrig.recordings.files.loading import beginning

_LOOK_S = 0.25  # between two looks for the law of a run
_MOST_LOOKS = 12  # the file of a new run may not be on the disk yet
_TEXT_S = 0.5  # numbers that change more often cannot be read
_R = (Signal(key="r", label="r", unit="", kind="value"),)


class Panel(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Plot in which the page draws r, and the limits of the law."""

    law: str = ""
    """Hash of the law; "" if the dashboard does not know it, or the client sets each voltage."""
    key: str = ""
    """Key of the signal in whose plot r is; "" if r has a plot of its own."""
    below: str = ""
    """Key of the signal below which the own plot is; "" for the last one."""
    name: str = "r"
    unit: str = ""
    span: float = 1.0
    """Width of the range of r, in its unit."""
    scale: float = 1.0
    """Factor from the unit of the law to the unit of the plot."""
    is_turning: bool = False
    """True if the plot shows one turn, 0 to 360 °."""
    limits: tuple[float, float] = (-inf, inf)
    """Lowest and highest voltage of the law, in V; JSON has null for an end of the input."""


def panel_of(law: ControlLaw, described: Description, drawn: Sequence[Signal]) -> Panel:
    """Return the plot of the output that follows r, or of its rate; otherwise a plot for r."""
    r, plot = law.reference, {signal.key: signal for signal in drawn}
    limits = law.lo or -inf, law.hi if law.hi < U_MAX_V else inf
    span = r.high - r.low or 1.0
    common: dict[str, Any] = {"law": law.sha256, "name": r.name, "limits": limits}
    for channel in described.channels:
        value, names = plot[channel.name], (channel.rate, f"{channel.name}_rate")
        followed = next((plot[name] for name in names if name in plot), None)
        if (r.name, r.unit) == (channel.name, channel.unit):
            followed = value
        elif r.name not in names or r.unit != f"{channel.unit}/s":
            continue
        if followed is None:
            return Panel(below=channel.name, unit=with_degrees(r.unit), span=span, **common)
        turns = followed.kind == "turning"
        key, scale = followed.key, value.scale
        return Panel(key=key, unit=followed.unit, scale=scale, is_turning=turns, **common)
    return Panel(below=law.outputs[0].name, unit=with_degrees(r.unit), span=span, **common)


class RunLaw(NamedTuple):
    """Law of a run in control."""

    law: ControlLaw | None
    """The law; None if it is not known, or the client sets each voltage."""
    is_own: bool
    """True if the client sets each voltage."""


class ControlFeed:
    """Decisions of the runs in control; the lock of `Feed` protects it."""

    def __init__(self) -> None:
        """Begin without decisions."""
        self._rows: deque[Rows] = deque()  # t, r and r, in the unit of the law
        self._pieces = 0  # so far
        self._newest_ns = -1
        self._began_ns = -1  # start of the newest run
        self._counts = DecisionCounts()
        self._is_own = False
        self._panel: Panel | None = None
        self._is_known = False
        self._looks, self._looked_s = 0, -inf
        self._text, self._told_s = "", -inf

    def begin(self, t_ns: int) -> None:
        """Begin a run at `t_ns` on the clock of the samples."""
        self._began_ns, self._counts, self._is_own = t_ns, DecisionCounts(), False
        self._is_known, self._looks, self._text = False, 0, ""

    def forget(self) -> None:
        """Forget all decisions, because the clock or the rig is another one."""
        self._rows.clear()
        self._newest_ns, self._panel = -1, None
        self.begin(-1)

    def add(self, decisions: Sequence[Any], kept_s: float) -> None:
        """Add decisions in order, and forget those that are older than `kept_s` by more."""
        fresh = [d for d in decisions if d.t_host_ns > self._newest_ns]
        if not fresh:
            return
        self._newest_ns = fresh[-1].t_host_ns
        self._counts = self._counts.with_messages(d for d in fresh if d.t_host_ns >= self._began_ns)
        made = np.array([(d.t_host_ns / 1e9, d.r, d.r) for d in fresh], np.float64)
        self._add_rows(coarser(made, WIDTH_S, _R))
        while self._rows[0][-1, 0] < self._newest_ns / 1e9 - kept_s:
            self._rows.popleft()

    @property
    def wants_law(self) -> bool:
        """True if a run in control has begun, and it is time to look for its law."""
        is_due = time.monotonic() - self._looked_s >= _LOOK_S
        return bool(not self._is_known and self._counts.decisions and is_due)

    def take_law(
        self, found: RunLaw | None, described: Description, drawn: Sequence[Signal]
    ) -> None:
        """Take what is known about the law of the run; None if it is not known yet."""
        self._looked_s, self._looks = time.monotonic(), self._looks + 1
        if found is None and self._looks < _MOST_LOOKS:
            return
        law, self._is_own = found or RunLaw(None, is_own=False)
        before, self._is_known = self._panel, True
        self._panel = panel_of(law, described, drawn) if law else Panel()
        rows = np.concatenate(self._rows)
        if before and before.law != self._panel.law:
            rows = rows[rows[:, 0] >= self._began_ns / 1e9]
        # All rows are sent again, because the page discards the rows of another plot.
        self._rows.clear()
        self._add_rows(rows)

    @property
    def pieces(self) -> int:
        """Number of pieces of rows so far, to be passed to `rows`."""
        return self._pieces

    def rows(self, after: int = 0) -> Rows:
        """Return t and r in the unit of its plot, twice, since a number of pieces."""
        fresh = [*islice(reversed(self._rows), max(0, self._pieces - after))][::-1]
        if not fresh or self._panel is None:
            return np.zeros((0, 3))
        rows = np.concatenate(fresh) * (1.0, self._panel.scale, self._panel.scale)
        if self._panel.is_turning:
            rows[:, 1:] %= TURN
        return rows

    def facts(self, *, is_going: bool) -> dict[str, Any] | None:
        """Return plot, limits and shares for the page; None without a run in control.

        `is_going` is True while the input is driven.
        """
        if self._panel is None:
            return None
        now_s = time.monotonic()
        if self._counts.decisions and (not is_going or now_s - self._told_s > _TEXT_S):
            self._told_s = now_s
            self._text = self._counts.of_client if self._is_own else self._counts.of_law
        is_limited = is_going and self._counts.decisions
        panel = self._panel if is_limited else msgspec.structs.replace(self._panel, limits=_NONE)
        return {"panel": panel, "shares": self._text}

    def _add_rows(self, rows: Rows) -> None:
        self._rows.append(rows)
        self._pieces += 1


_NONE = -inf, inf


def law_of_run(status: StatusReport | None) -> RunLaw | None:
    """Return the law of the newest run from its recording; None if it cannot be read."""
    if status is None or status.last_run is None:
        return None
    try:
        _, content = beginning(Path(status.last_run.recording))
        is_own = Manifest.of(content.metadata[RUN]).controller_sha256 == ""
        law = law_of(content.attachments)
    except (ArmrigError, OSError):
        return None
    return RunLaw(law, is_own=is_own) if law or is_own else None
