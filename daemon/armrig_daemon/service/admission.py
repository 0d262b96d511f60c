"""Admission of commands: an owner's command without the valid lease is refused without parsing.

The check is cheap and runs in zenoh's thread, so that a stranger cannot delay the holder's
commands. The service and the core check admitted commands again; the core alone decides.
"""

from __future__ import annotations

from armrig_core.access.access_control import MOST_BYTES, MOST_CALIBRATION_BYTES
from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import REQUESTS, Calibrate, Leased, Refused, Run, refused

from armrig_daemon.decisions.orders import NOT_HELD

LEASED = frozenset(name for name, kind in REQUESTS.items() if issubclass(kind, Leased))
"""Names of the commands that contain a lease."""


def refusal(name: str, payload: bytes, lease: bytes) -> Refused | None:
    """Return the refusal of a command, or None if it is admitted.

    Parameters
    ----------
    name : str
        Name of the command; an unknown name is admitted here, and refused by the service.
    payload : bytes
        Bytes of the command. A lease consists of hexadecimal digits, which JSON encoders do not
        escape. A payload without the lease in force is therefore not from the holder.
    lease : bytes
        Lease in force, as far as the service knows; empty if no lease is in force.
    """
    if name in LEASED and not (lease and lease in payload):
        return refused(RefusalCode.NOT_HELD, NOT_HELD)
    most = MOST_CALIBRATION_BYTES if name == Calibrate.name else MOST_BYTES
    if name != Run.name and len(payload) > most:
        text = f"{name}: {len(payload)} B, at most {most} B are allowed"
        return refused(RefusalCode.TOO_LONG, text, bytes=len(payload), most_bytes=most)
    return None
