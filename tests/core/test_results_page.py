"""The commands of docs/benchmarks.md exist, and each subject of the page names a command."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.core.test_contributing import lacking

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
SUBJECTS = PAGE.split("\n## ")[2:]  # after the introduction and the machine
_SCRIPT = re.compile(r"`(\w+\.\w+)[^`]*`")


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda text: text.partition("\n")[0])
def test_each_subject_names_a_command(subject: str) -> None:
    assert _SCRIPT.search(subject) or "`make " in subject


def test_the_commands_of_the_page_exist() -> None:
    scripts = {name for name in _SCRIPT.findall(PAGE) if name.endswith((".py", ".c"))}

    assert {
        name for name in scripts if not (ROOT / "tests" / "benchmarks" / name).is_file()
    } == set()
    assert lacking(PAGE) == set()
