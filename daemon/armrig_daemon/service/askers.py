"""Who has asked: what he says of himself, and behind it what the daemon has checked."""

from __future__ import annotations

import re

from armrig_core.printable import printable

_LONGEST = 80
# Whole, so that no rest of it is a claim again: as of "((user user ", or at the end, of "(user".
_CLAIM = re.compile(r"\(+((certificate|user)( |$))+")


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
    name = _CLAIM.sub("(", printable(said).strip()[:_LONGEST])
    if not by:
        return name
    return f"{name} ({by})" if name else by
