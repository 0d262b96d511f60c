"""Texts of functions about uneven data, word for word; they are in said_of_data.txt.

A new case is a line `>>> …` in it. `make stored` writes the file again; a person reads its
difference.
"""

from __future__ import annotations

import os
from difflib import unified_diff
from pathlib import Path

import pytest

from tests.clients.said import said_again

FILE = Path(__file__).with_name("said_of_data.txt")


@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_function_says_what_it_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/0")
    stored = FILE.read_text(encoding="utf-8")

    found = said_again(stored, tmp_path)

    if os.environ.get("WRITE_STORED"):
        FILE.write_text(found, encoding="utf-8")
        return
    differs = list(unified_diff(stored.splitlines(), found.splitlines(), "stored", "now", n=2))
    assert not differs, "\n".join([*differs, "", "If this is what is to be said: make stored"])
