"""Remarks on the calibration of a recording: age, device and rig."""

from __future__ import annotations

from datetime import datetime, timedelta

from armrig_core.calibration import Calibration
from armrig_core.manifest import Manifest

STALE_DAYS = 30
"""Largest age of a calibration at the time of a recording, in days, before it counts as stale."""


def remarks(calibration: Calibration | None, manifest: Manifest) -> list[str]:
    """Return a list with a sentence for each doubt about a recording's calibration.

    A calibration that was made after the recording is never stale.

    Parameters
    ----------
    calibration : Calibration or None
        Calibration with which the recording is read.
    manifest : Manifest
        Manifest of the recording.
    """
    if calibration is None:
        return ["The recording has no calibration: the daemon computed its angles."]
    made = calibration.made
    if made is None:
        return [
            "The rig was not calibrated: its angles use configured values that were never measured "
            "(see `armrig calibrate`)."
        ]
    found = []
    uid = str(manifest.device.get("uid", ""))
    if uid != made.device_uid:
        found.append(
            f"The calibration is of another device: it was made on {made.device_uid or 'none'}, "
            f"the recording was made on {uid or 'a device without an id'}."
        )
    elif manifest.rig != made.rig:
        of = f"The calibration is of rig {made.rig}"
        found.append(f"{of}, and the recording is of rig {manifest.rig}.")
    age = _age(made.date, manifest.started)
    if age is None:
        found.append("The age of the calibration is not known.")
    elif age > timedelta(days=STALE_DAYS):
        found.append(
            f"The calibration was {age.days} days old, more than {STALE_DAYS} days: calibrate "
            "the rig again."
        )
    return found


def calibrated(calibration: Calibration | None) -> str:
    """Return the date and time of a calibration; "no" if nothing was measured."""
    made = calibration.made if calibration else None
    return "no" if made is None else made.date[:16].replace("T", " ")


def _age(made: str, started: str) -> timedelta | None:
    try:
        return datetime.fromisoformat(started) - datetime.fromisoformat(made)
    except (ValueError, TypeError):  # not a date, or only one of the two has an offset
        return None
