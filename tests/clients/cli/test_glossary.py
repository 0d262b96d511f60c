"""The command glossary and its page are one text."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from armrig.cli import main
from armrig.cli.glossary import _matching_term, read_terms
from armrig_core.errors import InputError

PAGE = (Path(__file__).parents[3] / "docs" / "glossary.md").read_text(encoding="utf-8")


def test_the_words_of_the_first_outputs_are_explained() -> None:
    words = {"ARX", "OE", "BJ", "MDL", "σ", "robust", "fault", "latched", "validation"}
    words |= {"daemon", "count", "lease", "lateness"}

    assert words <= read_terms(PAGE).keys()


def test_each_entry_of_the_page_is_a_term_of_one_sentence() -> None:
    terms = read_terms(PAGE)

    assert len(terms) == PAGE.count("\n- ") >= 40
    assert [name for name, text in terms.items() if not re.fullmatch(r".*[^.]\.", text)] == []
    assert len({name.casefold() for name in terms}) == len(terms)


@pytest.mark.parametrize(
    "typed", ["velocity fit", "Velocity-Fit", "velocity_fit", " VELOCITY  FIT"]
)
def test_a_term_is_found_in_any_case_and_hyphenation(
    typed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["glossary", typed]) == 0

    assert capsys.readouterr().out.startswith("velocity fit: The fit computed")


def test_terms_containing_the_word_are_offered_before_similar_terms() -> None:
    terms = dict.fromkeys(["grain", "Static gain", "train", "gain of the loop", "again"], "")

    with pytest.raises(InputError, match=r"nearest: Static gain, gain of the loop, again$"):
        _matching_term("gain", terms)
    with pytest.raises(InputError, match=r"nearest: train, grain$"):
        _matching_term("traim", terms)


@pytest.mark.parametrize(("typed", "term"), [("counts", "count"), ("Dead Bands", "dead band")])
def test_a_plural_means_its_term(typed: str, term: str) -> None:
    assert _matching_term(typed, read_terms(PAGE)) == term


def test_the_glossary_without_a_term_lists_all_terms(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["glossary"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert main(["glossary", "--json"]) == 0

    explained = json.loads(capsys.readouterr().out)
    assert listed == list(explained) == list(read_terms(PAGE))
