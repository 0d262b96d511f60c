"""Commands that cannot be those of the holder are refused here, before anybody reads them.

Cheap, on zenoh's thread: a stranger must not keep the service from those who hold the rig. What
is let in is judged anew, by the service and by the core; the core alone decides.
"""

from __future__ import annotations

from armrig_core.access_control import MOST_BYTES, MOST_OF_CALIBRATION
from armrig_core.codes import RefusalCode
from armrig_core.commands import REQUESTS, Calibrate, Leased, Refused, Run, refused

from armrig_daemon.decisions.orders import NOT_HELD

LEASED = frozenset(name for name, kind in REQUESTS.items() if issubclass(kind, Leased))
"""Names of the commands that carry a lease."""


def refusal(name: str, payload: bytes, lease: bytes) -> Refused | None:
    """Return why a command is turned away, or None.

    Parameters
    ----------
    name : str
        Of the command; one that there is not is let in, and told so inside.
    payload : bytes
        As it came. A lease is of hexadecimal digits: what does not hold it as it is granted cannot
        be of its holder.
    lease : bytes
        The one in force, as far as the service knows; empty where there is none.
    """
    if name in LEASED and not (lease and lease in payload):
        return refused(RefusalCode.NOT_HELD, NOT_HELD)
    most = MOST_OF_CALIBRATION if name == Calibrate.name else MOST_BYTES
    if name != Run.name and len(payload) > most:
        text = f"{name}: {len(payload)} B, at most {most} B are allowed"
        return refused(RefusalCode.TOO_LONG, text, bytes=len(payload), most_bytes=most)
    return None
