"""What a reader must know of the calibration that a recording was read with."""

from __future__ import annotations

from datetime import datetime, timedelta

from armrig_core.calibration import Calibration
from armrig_core.manifest import Manifest

STALE_DAYS = 30
"""A calibration that is older than this when a recording is made is stale."""


def remarks(calibration: Calibration | None, manifest: Manifest) -> list[str]:
    """Return what speaks against a recording's calibration, one sentence each; none is best.

    A calibration that was made after the recording is as good as one from before.

    Parameters
    ----------
    calibration : Calibration or None
        What the recording is read with.
    manifest : Manifest
        Of the recording.
    """
    if calibration is None:
        return ["The recording has no calibration: its angles are those that the daemon made."]
    made = calibration.made
    if made is None:
        return [
            "The rig was not calibrated: its angles rest on configured values that were "
            "never measured (see `armrig calibrate`)."
        ]
    found = []
    uid = str(manifest.device.get("uid", ""))
    if uid != made.device_uid:
        found.append(
            f"The calibration is of another device: it was made on {made.device_uid or 'none'}, "
            f"the recording on {uid or 'one that does not say'}."
        )
    elif manifest.rig != made.rig:
        found.append(f"The calibration is of rig {made.rig}, the recording of rig {manifest.rig}.")
    age = _age(made.date, manifest.started)
    if age is None:
        found.append("The age of the calibration is not known.")
    elif age > timedelta(days=STALE_DAYS):
        found.append(
            f"The calibration was {age.days} days old, and {STALE_DAYS} are allowed: calibrate "
            "the rig again."
        )
    return found


def calibrated(calibration: Calibration | None) -> str:
    """Return when a calibration was made, or that it was not."""
    made = calibration.made if calibration else None
    return "no" if made is None else made.date[:16].replace("T", " ")


def _age(made: str, started: str) -> timedelta | None:
    try:
        return datetime.fromisoformat(started) - datetime.fromisoformat(made)
    except (ValueError, TypeError):  # no date, or one without an offset against one with
        return None
