"""A file of users and passwords, as people write it."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig_core.access.credential import read_passwords, read_users
from armrig_core.errors import FileError


def _written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    path.chmod(0o600)
    return path


def test_each_line_is_a_user_and_all_after_the_first_colon_is_the_password(tmp_path: Path) -> None:
    """Twelve characters are enough; a Windows editor has written the file."""
    text = "\ufeff\r\n ada : 12345678901ä \r\nbob-2:a:b c:d e:f g\r\n\r\n"
    path = _written(tmp_path / "passwords", text.encode())

    assert read_users(path) == {"ada": "12345678901ä", "bob-2": "a:b c:d e:f g"}
    assert read_passwords(path) == {"ada", "bob-2"}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"ada:12345678901", "line 1: the password of 'ada' has 11 characters: at least 12"),
        (b"\n\nada 123456789012", "line 3: name 'ada 123456789012': .* after the name come : and"),
        (b"ada:123456789012\nada:123456789012", "line 2: 'ada' is listed twice"),
        (b"ada:123456789012\n\xff", "line 2 is not UTF-8"),
        (b"", "no users; the file needs a line user:password for each user"),
        (b"a" * 65_537, "more than the 65536 B allowed; the file needs a line user:password"),
    ],
)
def test_a_wrong_password_file_is_refused_with_the_line(
    tmp_path: Path, text: bytes, says: str
) -> None:
    path = _written(tmp_path / "passwords", text)

    with pytest.raises(FileError, match=rf"^{path}: {says}"):
        read_users(path)
