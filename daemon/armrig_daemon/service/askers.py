"""Who has asked: what he says of himself, and behind it what the daemon has checked."""

from __future__ import annotations

from armrig_core.printable import printable

_LONGEST = 80
_CHECKED = ("(certificate ", "(user ")


def signed(said: str, by: str) -> str:
    """Return who asks, for others to read.

    Parameters
    ----------
    said : str
        What he says of himself; that he was checked, nobody can say so.
    by : str
        What was checked, such as `certificate alice`; "" on the Unix socket, where whoever may
        open it is trusted.
    """
    name = printable(said).strip()[:_LONGEST]
    for claim in _CHECKED:
        name = name.replace(claim, "(")
    if not by:
        return name
    return f"{name} ({by})" if name else by
