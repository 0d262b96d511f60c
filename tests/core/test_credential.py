"""An unusable credential is refused in one line before any use."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from armrig.lab import pki
from armrig_core.access.credential import Purpose, read_credential
from armrig_core.errors import FileError
from cryptography import x509

DAY = timedelta(days=1)


@pytest.fixture
def authority(tmp_path: Path) -> Path:
    """Give the folder of an authority."""
    pki.make_authority(tmp_path / "pki")
    return tmp_path / "pki"


def _blocks(path: Path) -> list[str]:
    """Return key, certificate and authority."""
    text = path.read_text()
    return re.findall(r"-----BEGIN [^-]+-----.*?-----END [^-]+-----\n", text, re.DOTALL)


def _refused(path: Path, purpose: Purpose = "client") -> str:
    with pytest.raises(FileError) as caught:
        read_credential(path, purpose)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value).removeprefix(f"{path}: ")


def _written(path: Path, text: str) -> Path:
    path.write_text(text)
    path.chmod(0o600)
    return path


def test_the_intermediate_certificates_of_a_credential_are_sent(
    authority: Path, tmp_path: Path
) -> None:
    key, own, root = _blocks(pki.issue_to_person(authority, "alice", "operators").path)
    _, between, _ = _blocks(pki.issue_to_person(authority, "bob", "operators").path)

    found = read_credential(_written(tmp_path / "a.pem", key + own + between + root), "client")

    assert (found.name, found.key, found.authority) == ("alice", key.encode(), root.encode())
    assert found.certificate == (own + between).encode()


def test_a_certificate_expires_no_later_than_its_authority(tmp_path: Path) -> None:
    made = x509.load_pem_x509_certificate(pki.make_authority(tmp_path, days=5).read_bytes())
    issued = pki.issue_to_person(tmp_path, "alice", "operators", days=30)

    assert read_credential(issued.path, "client").expires == made.not_valid_after_utc


def test_a_certificate_is_valid_for_one_purpose(authority: Path) -> None:
    rig = pki.issue_to_rig(authority, "1", ["localhost"]).path
    alice = pki.issue_to_person(authority, "alice", "operators").path

    assert read_credential(rig, "rig").name == "rig-1"
    assert _refused(rig, "client").startswith("the certificate has another purpose")
    assert _refused(alice, "rig").startswith("the certificate has another purpose")


def test_a_certificate_is_valid_within_its_period(
    authority: Path, tolerate: Callable[[timedelta], None]
) -> None:
    tolerate(10 * DAY)
    old = pki.issue_to_person(authority, "alice", "operators", days=-1).path
    old_rig = pki.issue_to_rig(authority, "1", ["localhost"], days=-1).path
    tolerate(-DAY)
    new = pki.issue_to_person(authority, "bob", "operators").path

    assert "has expired: `armrig pki renew`" in _refused(old)
    assert "has expired: `armrig pki renew`" in _refused(old_rig, "rig")
    begins = f"{datetime.now(UTC) + DAY:%Y-%m-%d}"
    assert re.search(rf"is not valid before {begins} \d\d:\d\d UTC: check the clock", _refused(new))


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return key, certificate and authority of alice (kca) and bob (KCA), and spoilt ones."""
    folder = tmp_path_factory.mktemp("blocks")
    pki.make_authority(folder / "pki")
    pki.make_authority(folder / "forged")
    k, c, a = _blocks(pki.issue_to_person(folder / "pki", "alice", "operators").path)
    bob = _blocks(pki.issue_to_person(folder / "pki", "bob", "operators").path)
    named = {**dict(zip("KCA", bob, strict=True)), "k": k, "c": c, "a": a}
    spoilt = {
        f"{name}!": re.sub(r"\n[^-]{20}", "\nAAAAAAAAAAAAAAAAAAAA", named[name], count=1)
        for name in "kca"
    }
    forged = _blocks(folder / "forged" / "authority.pem")[0]
    locked = k.replace("PRIVATE KEY", "ENCRYPTED PRIVATE KEY")
    return {**named, **spoilt, "forged": forged, "locked": locked}


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("k c forged", "not signed by the authority in the file"),
        ("k C A", "the key does not belong to the certificate"),
        ("", "0 private keys and 0 certificates"),
        ("c a", "0 private keys and 2 certificates"),
        ("k c", "1 private keys and 1 certificates"),
        ("k k c a", "2 private keys and 2 certificates"),
        ("k! c a", "its key or a certificate is damaged"),
        ("k c! a", "its key or a certificate is damaged"),
        ("k c a!", "its key or a certificate is damaged"),
        ("locked c a", r".*without a passphrase"),
    ],
)
def test_a_credential_has_one_key_its_certificate_and_the_authority_of_both(
    blocks: dict[str, str], tmp_path: Path, content: str, says: str
) -> None:
    path = _written(tmp_path / "a.pem", "".join(blocks[name] for name in content.split()))

    assert re.match(says, _refused(path))


@pytest.mark.parametrize("mode", [0o440, 0o420, 0o404, 0o402])
def test_a_key_readable_by_other_users_is_refused(authority: Path, mode: int) -> None:
    """The group of a service's files is that of the students."""
    path = pki.issue_to_person(authority, "alice", "operators").path
    path.chmod(mode)

    assert _refused(path) == (
        f"with mode {mode:04o} other users can read or change the key; allowed is 0400 or "
        f"0600: `chmod 400 {path}`"
    )
    path.chmod(0o400)
    assert read_credential(path, "client").name == "alice"


def test_the_chmod_command_quotes_its_path(tmp_path: Path) -> None:
    path = tmp_path / "a key;.pem"
    path.touch(mode=0o644)

    assert _refused(path).endswith(f": `chmod 400 '{path}'`")


def test_the_mode_of_the_opened_credential_is_checked(
    authority: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mode, or the file itself, may change just before it is opened."""
    path = pki.issue_to_person(authority, "alice", "operators").path
    real = os.open

    def late(*arguments: object) -> int:
        path.chmod(0o644)
        return real(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "open", late)

    assert _refused(path).startswith("with mode 0644 other users can read or change the key")


@pytest.mark.root
@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives a file to another user")
def test_a_user_who_cannot_change_a_key_s_mode_gets_the_command_for_root(authority: Path) -> None:
    path = pki.issue_to_rig(authority, "1", []).path
    path = path.rename(path.with_name("a rig's.pem"))
    os.chown(path, 1, -1)
    path.chmod(0o640)

    name = shlex.quote(str(path))
    assert _refused(path, "rig").endswith(f": `chown root {name} && chmod 400 {name}`")


def test_a_missing_file_is_reported_with_the_command_that_creates_it(tmp_path: Path) -> None:
    assert (
        _refused(tmp_path / "a.pem", "rig") == "there is no such file; `armrig pki rig` writes one"
    )
    assert _refused(tmp_path).startswith("Is a directory")
