"""The proof of a client's identity: which file it comes from, and why it cannot be used."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig.lab import pki
from armrig.rig.session import RigError, _way
from armrig_core.client_settings import ClientSettings

TCP = "tcp/lab:7447"


@pytest.fixture
def password(tmp_path: Path) -> Path:
    """Give a file with the password of one user."""
    path = tmp_path / "password"
    path.write_text("ada:a long enough password\n")
    path.chmod(0o600)
    return path


def test_a_password_is_sent_over_tcp_alone(password: Path) -> None:
    settings = ClientSettings(password=str(password))

    over_tcp, over_socket = (_way(where, None, settings) for where in (TCP, "unixsock-stream/x"))

    proof = {"user": "ada", "password": "a long enough password"}
    assert (over_tcp.name, dict(over_tcp.proof)) == ("ada", {"transport/auth/usrpwd": proof})
    assert (over_socket.name, over_socket.proof) == ("", ())
    assert (_way(TCP, None, ClientSettings()).name, over_tcp.endpoint) == ("", TCP)


@pytest.mark.parametrize("n", [2, 3])
def test_a_file_with_the_passwords_of_others_is_refused_with_their_number(
    password: Path, n: int
) -> None:
    password.write_text("".join(f"user-{k}:a long enough password\n" for k in range(n)))

    with pytest.raises(RigError) as refused:
        _way(TCP, None, ClientSettings(password=str(password)))

    assert str(refused.value) == f"{password} has {n} users: keep only your own line"


def test_a_credential_that_is_given_goes_before_the_configured_one(tmp_path: Path) -> None:
    folder = tmp_path / "pki"
    pki.make_authority(folder)
    given, configured = (
        str(pki.issue_to_person(folder, name, "operators").path) for name in ("ada", "bob")
    )
    settings, where = ClientSettings(certificate=configured), "tls/lab:7447"

    assert _way(where, given, settings).name == "ada"
    assert _way(where, None, settings).name == "bob"
    assert _way(where, given, ClientSettings()).name == "ada"
