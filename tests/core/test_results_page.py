"""The commands of docs/benchmarks.md exist, and each subject of the page names a command."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.core.test_contributing import lacking

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
SUBJECTS = PAGE.split("\n## ")[2:]  # after the introduction and the machine
_SCRIPT = re.compile(r"`(\w+\.py)[^`]*`(†?)")
"""A script of tests/benchmarks, or with a dagger a script in the history."""


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda text: text.partition("\n")[0])
def test_each_subject_names_a_command(subject: str) -> None:
    assert _SCRIPT.search(subject) or "`make " in subject


def test_the_commands_of_the_page_exist() -> None:
    is_there = {(name, not dagger) for name, dagger in _SCRIPT.findall(PAGE)}

    assert {
        (name, here)
        for name, here in is_there
        if (ROOT / "tests" / "benchmarks" / name).is_file() != here
    } == set()
    assert lacking(PAGE) == set()
