"""A file with the name of a recording may be anything, and lead anywhere."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.opening import regular_file

SOMEBODY = 12345


@pytest.fixture
def link(tmp_path: Path) -> Path:
    """Give a link to a file."""
    (tmp_path / "file").write_bytes(b"content")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    return tmp_path / "link"


def test_a_symbolic_link_of_the_user_is_followed(link: Path) -> None:
    with regular_file(link) as stream:
        assert stream.read() == b"content"


def test_a_symbolic_link_of_another_user_is_not_followed(
    link: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a folder that many may write to, the link could lead to a file of the reader."""
    if os.geteuid() == 0:
        os.lchown(link, SOMEBODY, SOMEBODY)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: SOMEBODY)

    with pytest.raises(DamageError, match="another user's link is not followed"):
        regular_file(link)


def test_a_symbolic_link_is_refused_if_links_are_not_allowed(link: Path) -> None:
    with pytest.raises(DamageError, match="a link is not followed"):
        regular_file(link, may_be_link=False)


@pytest.mark.parametrize("kind", ["pipe", "folder"])
def test_a_pipe_or_folder_is_refused_without_waiting(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "it"
    os.mkfifo(path) if kind == "pipe" else path.mkdir()

    with pytest.raises((DamageError, IsADirectoryError)):
        regular_file(path)


def test_a_dangling_symbolic_link_is_a_missing_file(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "gone")

    with pytest.raises(FileNotFoundError):
        regular_file(tmp_path / "link")
