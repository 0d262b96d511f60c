"""Texts of functions about uneven data and refused calls, word for word, in two stored files.

A new case is a line `>>> …` in one of them. `make stored` writes the files again; a person reads
their difference.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.clients.said import assert_said


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(
    "name",
    [
        "said_of_data.txt",
        "said_of_refusals.txt",
        pytest.param("said_of_hints.txt", marks=pytest.mark.exhaustive),
    ],
)
def test_a_function_prints_the_stored_output(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/0")

    assert_said(Path(__file__).with_name(name), tmp_path)
