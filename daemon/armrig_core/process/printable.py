"""Text from untrusted sources, made safe for a terminal or a log.

A control character moves the cursor, changes colours or titles, or hides the text before it. Marks
that change the direction of writing can hide text, too. All these characters are escaped.
"""

from __future__ import annotations

import re
from operator import index
from typing import Any, SupportsIndex

SPACES = "\u00a0\u202f\u2009"
"""Spaces that armrig writes between a number and its unit; they are harmless."""
_MAX_WORD, _KEPT_LENGTH = 400, 100  # characters; a path may have several hundred
_LONG_WORD = re.compile(rf"'[^']{{{_MAX_WORD},}}'|\"[^\"]{{{_MAX_WORD},}}\"|\S{{{_MAX_WORD},}}")


def printable(text: str, keep: str = "") -> str:
    r"""Return the text with unprintable characters escaped as in Python, such as \x1b.

    The characters in `keep`, such as a line break, are not escaped.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else _escape(c) for c in text)


def printable_texts(document: Any) -> Any:
    """Return lists and tables, as of JSON, with unprintable characters of their texts escaped.

    Line breaks, tabs and `SPACES` are kept.
    """
    if isinstance(document, str):
        return printable(document, keep="\n\t" + SPACES)
    if isinstance(document, list):
        return [printable_texts(value) for value in document]
    if isinstance(document, dict):
        return {printable_texts(key): printable_texts(value) for key, value in document.items()}
    return document


def json_printable(text: str) -> str:
    r"""Return an equivalent JSON text in which unprintable characters are escaped, such as \u001b.

    `text` is JSON without line breaks between its tokens.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else _json_escaped(c) for c in text)


def brief(message: str) -> str:
    """Return a message in which long words and long quotations are shortened.

    A message may quote a very long value of a user; the advice after the value must stay visible.
    """
    return _LONG_WORD.sub(_shorten, message)


def _shorten(match: re.Match[str]) -> str:
    text = match[0]
    return f"{text[:_KEPT_LENGTH]}… ({plural(len(text), 'character')}){text[-1]}"


def _escape(character: str) -> str:
    return character.encode("unicode_escape").decode()


def _json_escaped(character: str) -> str:
    units = character.encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{units[i : i + 2].hex()}" for i in range(0, len(units), 2))


def plural(n: SupportsIndex | float, singular: str, many: str = "") -> str:
    """Return a number with its noun: 1 sample, 2 samples, 0.5 days; `many` is by default with s."""
    number = f"{n:g}" if isinstance(n, float) else f"{index(n)}"
    return f"{number} {singular if number == '1' else many or f'{singular}s'}"


def with_degrees(text: str) -> str:
    """Return a text for people: degC and degF are °C and °F, but not in a name such as T1_degC.

    Examples
    --------
    >>> from armrig_core.process.printable import with_degrees
    >>> print(with_degrees("T1_degC in degC"))
    T1_degC in °C
    """
    return re.sub(r"(?<![\w\"'])deg(?=[CF](?![A-Za-z0-9_]))", "°", text)
