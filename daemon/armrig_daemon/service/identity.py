"""Text that identifies a client: the name that the client gives, then the checked identity."""

from __future__ import annotations

import unicodedata

from armrig_core.process.printable import printable

_MAX_CHARACTERS = 80
_SQUARE = str.maketrans("()", "[]")


def signed(said: str, by: str) -> str:
    """Return a client's name for people; the daemon has checked the part in round brackets.

    Programs read the checked identity from `owner_checked` in the status, the log and the manifest.

    Parameters
    ----------
    said : str
        Name that the client gives; round brackets in it become square brackets.
    by : str
        Checked identity, such as `certificate alice`; "" on the Unix socket, where the daemon
        trusts every client that may open the socket.
    """
    begin = said.strip()[:_MAX_CHARACTERS]  # the rest of a very long name would delay a stop
    name = "".join(map(_square, printable(begin).strip()[:_MAX_CHARACTERS]))
    if not by:
        return name
    return f"{name} ({by})" if name else by


def _square(character: str) -> str:
    """Return a square bracket for a round bracket and for characters that look like a bracket."""
    plain = unicodedata.normalize("NFKC", character)
    if "(" in plain or ")" in plain:
        return plain.translate(_SQUARE)
    if character in "[]{}":
        return character
    return {"Ps": "[", "Pe": "]"}.get(unicodedata.category(character), character)
