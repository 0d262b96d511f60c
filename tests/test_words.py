"""The linter sees the banned words, and leaves out what is no prose."""

from __future__ import annotations

import pytest

from tests.words import (
    module_findings,
    page_findings,
    script_findings,
)

LONG = "The " + "very " * 29 + "end."
"""A sentence of 31 words."""


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("The gap is told by the loop.\n", "phrase"),
        ("- A point.\n- The reader sees it\n  once\n  more.\n", "phrase"),
        (f"A short one. {LONG}\n", "long"),
    ],
)
def test_a_page_has_no_banned_phrase_and_no_long_sentence(text: str, kind: str) -> None:
    """In a paragraph as in a list, over the end of a line, too."""
    assert [finding.kind for finding in page_findings(text)] == [kind]


@pytest.mark.parametrize(
    ("source", "kind"),
    [
        ('"""Where the rig is."""', "first"),
        ('class A:\n    x: int\n    """Whether it runs."""', "first"),
        ('def f():\n    """Return the time.\n\n    It is told.\n    """', "phrase"),
        (f'"""{LONG}"""', "long"),
        ('Option("--rig", help="The rig that is told to stop.")', "phrase"),
        ('raise Error(f"{n} samples " f"are told by {name}")', "phrase"),
        (f'print("{LONG}")', "long"),
    ],
)
def test_a_module_is_read_in_docstrings_help_and_messages(source: str, kind: str) -> None:
    """A text is found once, a formatted one as a whole."""
    assert [finding.kind for finding in module_findings(source)] == [kind]


@pytest.mark.parametrize(
    "source", ['say("The gap was told.")', "say(`The ${n} gaps were told.`)", "<b>It was told.</b>"]
)
def test_the_page_in_the_browser_is_read(source: str) -> None:
    """Its scripts and its HTML."""
    assert [finding.kind for finding in script_findings(source)] == ["phrase"]


@pytest.mark.parametrize(
    "text",
    [
        "```\nHe told\n```\n",
        "| told | behind |\n",
        "> He told it.\n",
        "The key `told once more` is a number.\n",
        'The log says "he told it anew".\n',
        "[the page](told-anew.md)\n",
    ],
)
def test_code_tables_and_quotations_are_left_out(text: str) -> None:
    """They are others' words, or names."""
    assert not list(page_findings(text))


def test_a_literal_block_of_a_docstring_is_left_out() -> None:
    block = f"    Run ::\n\n        {LONG}\n\n        {LONG}\n\n"
    source = f'def f():\n    """Run it.\n\n{block}    It is told.\n    """'
    assert [finding.kind for finding in module_findings(source)] == ["phrase"]


def test_messages_that_a_test_quotes_and_names_are_left_out() -> None:
    """A key of one word is no message."""
    assert not list(module_findings('assert said == "It was told."', quotes=True))
    assert not list(module_findings('row["told"]'))


def test_a_sentence_ends_at_its_period() -> None:
    """Also before a name in small letters, and not after e.g. and the like."""
    half = "word " * 20

    assert not list(page_findings(f"{half} end. zenoh {half} end.\n"))
    assert len(list(page_findings(f"{half} (e.g. one) {half} end.\n"))) == 1


def test_a_finding_names_its_line() -> None:
    """The line of the sentence in the file."""
    text = "# Title\n\nA sentence. Another\none.\n\n```\ncode\n```\n\nIt was told.\n"

    assert [finding.line for finding in page_findings(text)] == [10]
