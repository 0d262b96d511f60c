"""Check of a calibration from a client against the rig."""

from __future__ import annotations

from typing import Any

from armrig_core.errors import InputError
from armrig_core.rig.calibration import CALIBRATED, Calibration
from armrig_core.rig.calibration_file import check_measured
from armrig_core.rig.description import Description
from msgspec.structs import replace

from armrig_daemon.config import Config

_MAX_CHARACTERS = 80  # of a name or a date


def check_calibration(
    calibration: Calibration,
    raw: bytes,
    config: Config,
    device: dict[str, Any],
    description: Description,
) -> Calibration:
    """Return the checked calibration for the recordings; refuse a calibration of another rig.

    The ranges of zeros, angles, gain and offset were checked when the request was decoded.

    `raw` contains the samples from which the calibration was estimated. `device` contains the
    properties that the device reported. `description` describes the rig.

    Raises ValueError if the calibration was not measured on this rig and device, or the samples do
    not belong to it. It also raises ValueError if `wraps` differs from the configuration.
    """
    if not description.is_calibrated:
        whose = " and ".join(CALIBRATED)
        raise InputError(
            f"the rig is '{description.rig.name}', and a calibration is of {whose}: give "
            "zero_counts and per_count in the rig's description"
        )
    made = check_measured(calibration, raw)
    uid = str(device.get("uid", made.device_uid))  # without a device, the core will refuse
    if (made.rig, made.device_uid) != (config.rig.id, uid):
        whose = f"rig {made.rig[:_MAX_CHARACTERS]}, device {made.device_uid[:_MAX_CHARACTERS]}"
        raise InputError(
            f"the calibration is of {whose}, and this is rig {config.rig.id}, device {uid}: "
            "calibrate this rig with `armrig calibrate`"
        )
    if len(made.date) > _MAX_CHARACTERS or not made.date.isprintable():
        raise InputError(f"made.date: at most {_MAX_CHARACTERS} printable characters are allowed")
    for name in CALIBRATED:
        now, wraps = getattr(config.calibration, name).wraps, getattr(calibration, name).wraps
        if wraps != now:
            # If a channel wraps, arming does not check whether it is at the end of its range.
            raise InputError(
                f"{name}.wraps = {str(wraps).lower()}: must be {str(now).lower()}, as the "
                "configuration of this rig says"
            )
    # The calibration came from a client: the daemon has read no file.
    return replace(calibration, made=replace(made, file=""))
