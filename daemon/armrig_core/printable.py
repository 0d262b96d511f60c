"""Text of others, as it may be shown on a terminal or in a log.

A control character moves the cursor, changes colours or titles, or hides what stands before it; so
do the marks that turn the direction of writing. None of them is shown as it is.
"""

from __future__ import annotations

import re

_LONGEST, _KEPT = 400, 100  # characters; a path may have some hundred
_LONG = re.compile(rf"'[^']{{{_LONGEST},}}'|\"[^\"]{{{_LONGEST},}}\"|\S{{{_LONGEST},}}")


def printable(text: str, keep: str = "") -> str:
    r"""Return the text with what does not print escaped as Python does, such as \x1b.

    Parameters
    ----------
    keep : str
        Characters that are left as they are, such as a line break.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else _escaped(c) for c in text)


def json_printable(text: str) -> str:
    r"""Return JSON with what does not print escaped as JSON does, such as \u001b: the same value.

    Parameters
    ----------
    text : str
        JSON without line breaks between its tokens.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else _json_escaped(c) for c in text)


def brief(message: str) -> str:
    """Return a message in which no word, and nothing in quotes, is longer than a person reads.

    A value that was given may have any length, and what is to be done stands behind it.
    """
    return _LONG.sub(_shortened, message)


def _shortened(found: re.Match[str]) -> str:
    text = found[0]
    return f"{text[:_KEPT]}… ({len(text)} characters){text[-1]}"


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode()


def _json_escaped(character: str) -> str:
    units = character.encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{units[i : i + 2].hex()}" for i in range(0, len(units), 2))
