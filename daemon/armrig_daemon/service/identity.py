"""Who has asked: what he says of himself, and behind it what the daemon has checked."""

from __future__ import annotations

import unicodedata

from armrig_core.printable import printable

_LONGEST = 80
_SQUARE = str.maketrans("()", "[]")


def signed(said: str, by: str) -> str:
    """Return who asks, for others to read; what stands in round brackets, the daemon has checked.

    Programs read `owner_checked` in the status, the log and the manifest.

    Parameters
    ----------
    said : str
        What he says of himself; his own round brackets become square ones.
    by : str
        What was checked, such as `certificate alice`; "" on the Unix socket, where whoever may
        open it is trusted.
    """
    begin = said.strip()[:_LONGEST]  # of a name of any length: the rest would hold up a stop
    name = "".join(map(_square, printable(begin).strip()[:_LONGEST]))
    if not by:
        return name
    return f"{name} ({by})" if name else by


def _square(character: str) -> str:
    """Return a square bracket for a round one, and for whatever looks like one."""
    plain = unicodedata.normalize("NFKC", character)
    if "(" in plain or ")" in plain:
        return plain.translate(_SQUARE)
    if character in "[]{}":
        return character
    return {"Ps": "[", "Pe": "]"}.get(unicodedata.category(character), character)
