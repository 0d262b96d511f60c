"""A calibration that a client sends, held against the rig that it is to be for."""

from __future__ import annotations

from typing import Any

from armrig_core.calibration import Calibration
from armrig_core.calibration_file import check_measured
from armrig_core.errors import InputError
from armrig_core.telemetry import ALPHA, THETA_1
from msgspec.structs import replace

from armrig_daemon.config import Config

_LONGEST = 80  # of a name or a date, in characters


def checked_calibration(
    calibration: Calibration, raw: bytes, config: Config, device: dict[str, Any]
) -> Calibration:
    """Return the calibration as it is recorded, or refuse it.

    Its zeros, angles, gain and offset are within their bounds already: those of a file's.

    Parameters
    ----------
    raw : bytes
        The samples that it was estimated from.
    device : dict
        What the device says of itself.

    Raises
    ------
    ValueError
        It was not measured, or on another rig or device; its samples are not its own; or it says
        that another potentiometer wraps, which is the configuration's to say.
    """
    made = check_measured(calibration, raw)
    uid = str(device.get("uid", made.device_uid))  # without a device the core refuses
    if (made.rig, made.device_uid) != (config.rig.id, uid):
        whose = f"rig {made.rig[:_LONGEST]}, device {made.device_uid[:_LONGEST]}"
        raise InputError(
            f"the calibration is of {whose}, and this is rig {config.rig.id}, device {uid}: "
            "calibrate this one with `armrig calibrate`"
        )
    if len(made.date) > _LONGEST or not made.date.isprintable():
        raise InputError(f"made.date: at most {_LONGEST} characters that print are allowed")
    for name in (THETA_1, ALPHA):
        now, wraps = getattr(config.calibration, name).wraps, getattr(calibration, name).wraps
        if wraps != now:
            # Where alpha wraps, arming does not look for it at the end of its range.
            raise InputError(
                f"{name}.wraps = {str(wraps).lower()}: must be {str(now).lower()}, as the "
                "configuration of this rig says"
            )
    # The daemon has read no file.
    return replace(calibration, made=replace(made, file=""))


def taken(calibration: Calibration) -> str:
    """Return what the status says of a calibration that was sent."""
    date = calibration.made.date if calibration.made else ""
    return f"sent by `armrig calibrate`, made {date}; in force until armrigd ends"
