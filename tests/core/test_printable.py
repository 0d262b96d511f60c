"""Text of others does nothing to a terminal."""

from __future__ import annotations

import json

import pytest
from armrig_core.process.printable import brief, json_printable, printable
from hypothesis import given
from hypothesis import strategies as st

HOSTILE = "\x1b]0;title\x07\x1b[2J\r\x9b31m\u202eabc\u200b\x7f\x00\ud800"


def test_printable_text_is_unchanged() -> None:
    assert printable("Zoë Ångström, 陈 [red] α\\n") == "Zoë Ångström, 陈 [red] α\\n"
    assert printable("a\nb\r", keep="\n") == "a\nb\\r"


def test_unprintable_characters_are_escaped() -> None:
    assert printable(HOSTILE) == (r"\x1b]0;title\x07\x1b[2J\r\x9b31m\u202eabc\u200b\x7f\x00\ud800")


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_all_text_prints_once_it_is_escaped(text: str) -> None:
    assert printable(text).isprintable()
    assert printable(printable(text)) == printable(text)


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_json_keeps_its_value(text: str) -> None:
    shown = json_printable(json.dumps({"owner": text}, ensure_ascii=False))

    assert shown.isprintable()
    assert json.loads(shown) == {"owner": text}


LONG = 'rig.id = "' + "a b " * 1250 + '": 1 to 40 characters are allowed'
SHORT = 'rig.id = "' + "a b " * 24 + 'a b… (5002 characters)": 1 to 40 characters are allowed'


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (LONG, SHORT),
        (LONG.replace('"', "'"), SHORT.replace('"', "'")),
        (f"key {'x' * 4999}: no such key", f"key {'x' * 100}… (5000 characters): no such key"),
        (ordinary := f"{'/folder' * 50}: there is no such file; " + "many words " * 100, ordinary),
    ],
    ids=["quoted", "in single quotes", "word", "ordinary"],
)
def test_a_long_quotation_or_word_in_a_message_is_shortened(message: str, told: str) -> None:
    assert brief(message) == told
