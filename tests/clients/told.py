"""Messages about a mistake."""

from __future__ import annotations

import pytest


def told(capsys: pytest.CaptureFixture[str]) -> str:
    """Return the text on standard error, which must be one or two lines and no traceback."""
    said = capsys.readouterr()
    assert said.out == ""
    assert 1 <= said.err.count("\n") <= 2
    assert "Traceback" not in said.err
    return said.err
