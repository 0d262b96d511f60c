"""JSON for the page, whose texts contain no control characters."""

from __future__ import annotations

from typing import Any

import msgspec
from armrig_core.process.printable import SPACES, printable_texts

_SPACES = str.maketrans(dict.fromkeys(SPACES))


def page_json(found: Any) -> bytes:
    r"""Return a value as JSON in which control characters of texts are escaped, such as \\x1b.

    Names and texts of a recording may contain characters that hide or reverse the text after them.
    """
    encoded = msgspec.json.encode(found)
    # Most messages are rows of numbers, 30 times a second: only few are decoded again.
    if b"\\u00" not in encoded and encoded.decode().translate(_SPACES).isprintable():
        return encoded
    return msgspec.json.encode(printable_texts(msgspec.json.decode(encoded)))
