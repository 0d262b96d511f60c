"""Text of others does nothing to a terminal."""

from __future__ import annotations

import json

import pytest
from armrig_core.printable import brief, json_printable, printable
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


@pytest.mark.parametrize("quote", ["'", '"'])
def test_a_long_quotation_in_a_message_is_shortened(quote: str) -> None:
    told = brief(f"rig.id = {quote}{'a b ' * 1250}{quote}: 1 to 40 characters are allowed")

    begin = f"rig.id = {quote}{'a b ' * 24}a b"
    assert told == f"{begin}… (5002 characters){quote}: 1 to 40 characters are allowed"


def test_a_long_word_in_a_message_is_shortened() -> None:
    assert (
        brief(f"key {'x' * 4999}: no such key")
        == f"key {'x' * 100}… (5000 characters): no such key"
    )


def test_an_ordinary_message_is_left_as_it_is() -> None:
    message = f"{'/folder' * 50}: there is no such file; " + "many words " * 100

    assert brief(message) == message
