"""Permissions by name."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig_core.access.access_list import AccessList, read_access_list
from armrig_core.errors import FileError


def test_an_access_list_is_read_as_it_was_written(tmp_path: Path) -> None:
    made = AccessList(operators=("alice", "bob"), observers=("carol",), revoked=("eve",))
    path = tmp_path / "access.toml"
    path.write_text(made.toml())

    assert read_access_list(path) == made


def test_a_name_moves_from_one_role_to_another() -> None:
    people = AccessList(operators=("alice",), observers=("bob",)).with_name("alice", "revoked")

    assert people == AccessList(observers=("bob",), revoked=("alice",))
    assert [people.role(name) for name in ("alice", "bob", "carol")] == ["revoked", "observers", ""]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('operators = ["alice"]\nobservers = ["alice"]', "'alice' is listed twice"),
        ('operators = ["alice"]\nrevoked = ["alice"]', "'alice' is listed twice"),
        ('operators = ["Alice"]', "name 'Alice': use 1 to 40 characters, each a-z"),
        ('operators = ["*"]', r"name '\*': use 1 to 40 characters, each a-z"),
        ('operators = ["a/b"]', "name 'a/b': use 1 to 40 characters, each a-z"),
        ('rigs = ["1"]', "allowed are names of rigs' certificates, such as rig-1"),
        ('operators = ["rig-1"]\nrigs = ["rig-1"]', "'rig-1' is listed twice"),
        ('operators = "alice"', "Expected `array`"),
        ('operator = ["alice"]', "unknown field `operator`"),
        ("operators = [", "Invalid value"),
    ],
)
def test_a_forbidden_entry_is_refused(tmp_path: Path, text: str, says: str) -> None:
    """A name is part of a key, in which * and / would match other names."""
    path = tmp_path / "access.toml"
    path.write_text(text)

    with pytest.raises(FileError, match=rf"access.toml: .*{says}"):
        read_access_list(path)


def test_a_missing_access_list_is_reported(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="there is no such file; `armrig pki ca` writes one"):
        read_access_list(tmp_path / "access.toml")
