"""No client can claim what only the daemon has checked."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from armrig_daemon.service.commands import display_name


@pytest.mark.parametrize(
    ("said", "by", "told"),
    [
        ("anna", "", "anna"),
        ("anna", "user bob", "anna (user bob)"),
        ("", "certificate bob", "certificate bob"),
        ("", "", ""),
        (" anna\x1b[2J ", "", "anna\\x1b[2J"),
        ("anna (bench 2)", "user bob", "anna [bench 2] (user bob)"),
        ("a" * 81, "", "a" * 80),
        (" " * 100 + "anna", "user bob", "anna (user bob)"),
        ("anna" + " " * 100, "", "anna"),
    ],
)
def test_the_name_of_a_client_includes_its_verified_identity(said: str, by: str, told: str) -> None:
    assert display_name(said, by) == told


class _Unread(str):
    """A name that must not be read letter by letter."""

    __slots__ = ()

    def __iter__(self) -> Iterator[str]:
        pytest.fail("all of the name is read")


def test_a_long_client_name_is_truncated() -> None:
    """8 MB of unprintable characters delayed the service, and a stop, for half a second."""
    assert display_name(_Unread(" " + "\x01" * 1000), "user bob") == "\\x01" * 20 + " (user bob)"


@pytest.mark.parametrize(
    "said",
    [
        "(certificate certificate alice)",
        "anna (certificate alice)",
        "\uff08certificate alice\uff09",  # of full width
        "\u207dcertificate alice\u207e",  # superscripts
        "\ufe59certificate alice\ufe5a",  # small
        "\u2768certificate alice\u2769",  # ornaments
        "\u2e28certificate alice\u2e29",  # doubled
        "\u2474 alice",  # a digit in brackets
    ],
)
def test_round_brackets_in_a_client_name_are_replaced(said: str) -> None:
    told = display_name(said, "")

    assert not set(told) & set(
        "()\uff08\uff09\u207d\u207e\ufe59\ufe5a\u2768\u2769\u2e28\u2e29\u2474"
    )
    assert "[" in told
    assert "alice" in told
