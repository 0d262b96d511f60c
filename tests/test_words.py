"""The linter sees the banned words, and leaves out what is no prose."""

from __future__ import annotations

import pytest

from tests.words import module_findings, page_findings, script_findings

LONG = "The " + "very " * 29 + "end."
"""A sentence of 31 words."""
HALF = "word " * 20
BLOCK = f"    Run ::\n\n        {LONG}\n\n        {LONG}\n\n"


@pytest.mark.parametrize(
    ("text", "kinds"),
    [
        ("The gap is told by the loop.\n", ["phrase"]),
        ("- A point.\n- The reader sees it\n  once\n  more.\n", ["phrase"]),
        (f"A short one. {LONG}\n", ["long"]),
        (f"{HALF} (e.g. one) {HALF} end.\n", ["long"]),
        (f"{HALF} end. zenoh {HALF} end.\n", []),
        ("```\nHe told\n```\n", []),
        ("| told | behind |\n", []),
        ("> He told it.\n", []),
        ("The key `told once more` is a number.\n", []),
        ('The log says "he told it anew".\n', []),
        ("[the page](told-anew.md)\n", []),
    ],
)
def test_a_page_is_read_without_its_code_tables_and_quotations(text: str, kinds: list[str]) -> None:
    """A sentence goes over the end of a line, and ends before a name in small letters."""
    assert [finding.kind for finding in page_findings(text)] == kinds


@pytest.mark.parametrize(
    ("source", "kinds"),
    [
        ('"""Where the rig is."""', ["first"]),
        ('class A:\n    x: int\n    """Whether it runs."""', ["first"]),
        ('def f():\n    """Return the time.\n\n    It is told.\n    """', ["phrase"]),
        (f'def f():\n    """Run it.\n\n{BLOCK}    It is told.\n    """', ["phrase"]),
        (f'"""{LONG}"""', ["long"]),
        ('Option("--rig", help="The rig that is told to stop.")', ["phrase"]),
        ('raise Error(f"{n} samples " f"are told by {name}")', ["phrase"]),
        (f'print("{LONG}")', ["long"]),
        ('row["told"]', []),
    ],
)
def test_a_module_is_read_in_docstrings_help_and_messages(source: str, kinds: list[str]) -> None:
    """A text is found once, a formatted one as a whole; a key of one word is no message."""
    assert [finding.kind for finding in module_findings(source)] == kinds


def test_messages_that_a_test_quotes_are_left_out() -> None:
    assert not list(module_findings('assert said == "It was told."', quotes=True))


@pytest.mark.parametrize(
    "source", ['say("The gap was told.")', "say(`The ${n} gaps were told.`)", "<b>It was told.</b>"]
)
def test_scripts_and_html_of_the_browser_page_are_read(source: str) -> None:
    assert [finding.kind for finding in script_findings(source)] == ["phrase"]


def test_a_finding_names_its_line() -> None:
    text = "# Title\n\nA sentence. Another\none.\n\n```\ncode\n```\n\nIt was told.\n"

    assert [finding.line for finding in page_findings(text)] == [10]
