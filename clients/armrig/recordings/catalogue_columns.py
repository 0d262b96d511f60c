"""The columns of a catalogue: what is said of each recording, for a program."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armrig.recordings.recording_summary import RecordingSummary, shown_path

COLUMNS: dict[str, Any] = {
    "recording": np.object_,
    "run_id": np.object_,
    "rig": np.object_,
    "started": "datetime64[ms]",
    "experiment": np.object_,
    "name": np.object_,
    "validation": np.bool_,
    "validation_of": np.object_,
    "seconds": np.float64,
    "Ts": np.float64,
    "samples": np.int64,
    "missing": np.int64,
    "outcome": np.object_,
    "outcome_code": np.object_,
    "part": np.int64,
    "pacing": np.object_,
    "device": np.object_,
    "calibration_sha256": np.object_,
    "armrig": np.object_,
    "bytes": np.int64,
}
"""Columns of the table and their types: what `facts_of` says of each recording."""


def columns(recordings: Sequence[RecordingSummary]) -> dict[str, NDArray[Any]]:
    """Return the table of these recordings by columns, each (N,)."""
    rows = [facts_of(summary) for summary in recordings]
    for row in rows:
        row["started"] = _utc(row["started"])
    return {name: np.array([r[name] for r in rows], kind) for name, kind in COLUMNS.items()}


def facts_of(summary: RecordingSummary) -> dict[str, Any]:
    """Return what is said of a recording, for a program."""
    return {
        "recording": shown_path(summary.path),
        "run_id": summary.run_id,
        "rig": summary.rig,
        "started": summary.started,
        "experiment": summary.kind,
        "name": summary.name,
        "validation": summary.is_validation,
        "validation_of": summary.validation_of or None,
        "seconds": summary.seconds,
        "Ts": summary.Ts,
        "samples": summary.samples,
        "missing": summary.missing,
        "outcome": summary.outcome,
        "outcome_code": summary.outcome_code,
        "part": summary.part,
        "pacing": summary.pacing,
        "device": summary.device,
        "calibration_sha256": summary.calibration_sha256,
        "armrig": summary.armrig,
        "bytes": summary.size,
    }


def _utc(text: str) -> datetime | None:
    """Return a time of day in UTC, without saying so; None where the text names none."""
    try:
        when = datetime.fromisoformat(text)
        return when.astimezone(UTC).replace(tzinfo=None) if when.tzinfo else None
    except (ValueError, OverflowError):
        return None
