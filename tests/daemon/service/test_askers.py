"""Nobody says of himself what only the daemon has checked."""

from __future__ import annotations

import pytest
from armrig_daemon.service.askers import signed


@pytest.mark.parametrize(
    ("said", "by", "told"),
    [
        ("anna", "", "anna"),
        ("anna", "user bob", "anna (user bob)"),
        ("", "certificate bob", "certificate bob"),
        ("", "", ""),
        (" anna\x1b[2J ", "", "anna\\x1b[2J"),
        ("anna (bench 2)", "", "anna (bench 2)"),
        ("a" * 81, "", "a" * 80),
    ],
)
def test_who_asks_is_told_with_what_was_checked(said: str, by: str, told: str) -> None:
    """What he says is bounded and prints; what was checked stands after it in brackets."""
    assert signed(said, by) == told


@pytest.mark.parametrize("kind", ["user", "certificate"])
@pytest.mark.parametrize("said", ["({0} bob)", "(({0} {0} bob)", "((({0} ({0} {0} {0} bob)"])
@pytest.mark.parametrize("other", ["", "(certificate ", "(user "])
def test_no_claim_is_left_and_none_is_made_of_another(kind: str, said: str, other: str) -> None:
    """Doubled and nested ones, too."""
    told = signed(other + said.format(kind), "")

    assert "(user " not in told
    assert "(certificate " not in told


def test_a_claim_that_others_would_end_is_none() -> None:
    """In "anna (user has the rig"."""
    assert signed("anna (user ", "") == "anna ("
    assert signed("anna (user's bench)", "") == "anna (user's bench)"
