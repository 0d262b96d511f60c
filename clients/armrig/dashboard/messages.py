"""What the page is told: each message as values for JSON."""

from __future__ import annotations

from math import degrees, isfinite
from pathlib import PurePosixPath
from typing import Any

import msgspec
from armrig_core.commands import LastRun, StatusReport
from armrig_core.telemetry import CHANNELS, Sample

from armrig.dashboard.bins import as_lists
from armrig.dashboard.feed import Feed, News, Timing
from armrig.rig.status_rows import status_rows

_STALE_S = 0.3
"""And two sampling times: without a sample for so long the data are stale."""


def event(name: str, value: Any) -> bytes:
    """Return a server-sent event; JSON has no line breaks in it."""
    return b"event: %s\ndata: %s\n\n" % (name.encode(), msgspec.json.encode(value))


def live_facts(news: News, status: StatusReport | None) -> dict[str, Any]:
    """Return what is new: rows, and the age of the newest sample."""
    limit_s = _STALE_S + 2 * (status.Ts if status else 0.0)
    return {
        "at_s": round(news.at_s, 3),
        "age_s": round(news.age_s, 3) if isfinite(news.age_s) else None,
        "is_stale": not news.age_s <= limit_s,
        "rows": as_lists(news.rows) if news.rows.size else [],
        "newest": _newest(news.newest),
    }


def timing_facts(timing: Timing) -> dict[str, Any]:
    """Return how well the rig is timed."""
    return {
        "late": timing.late,
        "missing": timing.missing,
        "unheard": timing.unheard,
        "last_gap": timing.last_gap,
        "report": timing.report,
    }


def status_facts(feed: Feed) -> dict[str, Any]:
    """Return how the rig is, in the words of `armrig status`."""
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
        "last_run": _run_facts(status.last_run),
    }


def _newest(sample: Sample | None) -> dict[str, float | None] | None:
    if sample is None:
        return None
    angles = {c.name: getattr(sample, c.value_field) for c in CHANNELS}
    return {
        "u": sample.u_applied_v,
        **{name: round(degrees(y), 2) if isfinite(y) else None for name, y in angles.items()},
    }


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
