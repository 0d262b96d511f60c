"""The table of docs/benchmarks.md agrees with the pages and the scripts that it names."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "benchmarks.md"
ROWS = [
    [cell.strip() for cell in line.split(" | ")]
    for line in PAGE.read_text(encoding="utf-8").splitlines()
    if "](benchmarks/" in line
]
_NUMBER = re.compile(r"\d+(?: \d{3})*(?:\.\d+)?")


def _linked(row: list[str]) -> Path:
    (name,) = re.findall(r"\]\((.*?)\)", row[2])
    return PAGE.parent / name


def test_each_page_of_the_folder_has_a_result() -> None:
    assert {_linked(row) for row in ROWS} == set((ROOT / "docs" / "benchmarks").glob("*.md"))


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0].lstrip("| "))
def test_the_numbers_of_a_result_occur_on_its_page(row: list[str]) -> None:
    numbers = set(_NUMBER.findall(row[1]))

    assert numbers
    assert numbers - set(_NUMBER.findall(_linked(row).read_text(encoding="utf-8"))) == set()


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0].lstrip("| "))
def test_the_way_to_a_result_is_a_script_or_a_target(row: list[str]) -> None:
    commands = re.findall(r"`([^`\s]+)[^`]*`", row[3])

    assert commands
    for command in commands:
        assert command == "make" or (ROOT / "tests" / "benchmarks" / command).is_file()
