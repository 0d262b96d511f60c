"""Connections over a network: the proof of identity, and the reason of each failure."""

from __future__ import annotations

import json
import re
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
import zenoh
from armrig.lab import pki
from armrig.rig import session
from armrig.rig.client import Rig
from armrig.rig.session import NoReplyError, RigError, _way, why_not_connected
from armrig_core.access.client_settings import ClientSettings
from armrig_core.access.credential import read_credential, utc

from tests.integration.laboratory import free_port


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """Give an authority's folder, with a rig at localhost and an operator."""
    folder = tmp_path / "pki"
    pki.make_authority(folder)
    pki.issue_to_rig(folder, "1", ["localhost"])
    pki.issue_to_person(folder, "alice", "operators")
    return folder


@contextmanager
def _listening(rig: Path, protocol: str = "tls", **tls: Any) -> Iterator[int]:
    """Have zenoh listen with a rig's credential; give the port."""
    port = free_port()
    config = {
        "mode": "peer",
        "listen": {"endpoints": [f"{protocol}/127.0.0.1:{port}"]},
        "scouting": {"multicast": {"enabled": False}},
        "transport": {"link": {"tls": {**read_credential(rig, "rig").tls("listen"), **tls}}},
    }
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))):
        yield port


def _told(made: Path, port: int, host: str = "localhost") -> str:
    """Return the message to an operator whom the daemon refuses."""
    return _told_over(f"tls/{host}:{port}", certificate=made / "alice.pem")


def _told_over(where: str, **how: Any) -> str:
    with pytest.raises(NoReplyError, match=f"^no reply from rig 1 at {where}: ") as refused:
        Rig("1", connect=where, **how).__enter__()
    return str(refused.value).removeprefix(f"no reply from rig 1 at {where}: ")


def test_a_connection_refusal_suggests_to_start_the_daemon(made: Path) -> None:
    with socket.socket() as bound:  # and it does not listen
        bound.bind(("127.0.0.1", 0))
        port = bound.getsockname()[1]
        told = _told(made, port)

    assert told == (
        f"nobody listens at port {port} of localhost: check that armrigd runs, with [access], "
        "or `armrig router`"
    )


def test_an_error_names_an_unknown_host(made: Path) -> None:
    assert _told(made, 7447, "lab.invalid") == "there is no host lab.invalid: check its spelling"


def test_a_name_that_is_not_in_the_certificate_is_reported(made: Path) -> None:
    with _listening(made / "rig-1.pem") as port:
        assert _told(made, port, "127.0.0.1").endswith("`armrig pki rig ID --host 127.0.0.1`")


def test_a_rig_of_another_authority_is_refused(made: Path, tmp_path: Path) -> None:
    pki.make_authority(tmp_path / "other")
    rig = pki.issue_to_rig(tmp_path / "other", "1", ["localhost"]).path
    with _listening(rig) as port:
        assert "your certificate did not sign the listener's certificate" in _told(made, port)


@pytest.mark.parametrize(
    ("tolerance", "days", "wrong"),
    [
        (10, -1, "the listener's certificate has expired: "),
        (-10, 20, "the listener's certificate is not valid yet: "),
    ],
)
def test_a_rig_s_certificate_outside_its_time_is_reported(
    tolerance: int, days: int, wrong: str, made: Path, tolerate: Callable[[timedelta], None]
) -> None:
    good = (made / "rig-1.pem").read_bytes()
    tolerate(timedelta(days=tolerance))
    other = pki.issue_to_rig(made, "1", ["localhost"], days=days, force=True).path.read_bytes()
    (made / "rig-1.pem").write_bytes(good)
    key, certificate, _ = re.findall(rb"-----BEGIN.*?-----END [^-]+-----\n", other, re.DOTALL)
    parts = {"listen_private_key": key, "listen_certificate": certificate}
    files = {name: made / name for name in parts}
    for name, path in files.items():
        path.write_bytes(parts[name])
    none = {f"{name}_base64": None for name in parts}
    with _listening(made / "rig-1.pem", **none, **{n: str(p) for n, p in files.items()}) as port:
        assert _told(made, port).startswith(wrong)


def test_a_certificate_not_yet_valid_by_the_listener_s_clock_is_reported(
    made: Path, tolerate: Callable[[timedelta], None]
) -> None:
    alice = read_credential(made / "alice.pem", "client")
    tolerate(timedelta(days=-1))
    early = pki.issue_to_person(made, "bob", "operators").path
    with _listening(made / "rig-1.pem") as port:
        told = why_not_connected("localhost", port, alice, early)

    assert told == (
        "by its clock, the listener refuses the certificate of alice, which is not valid before "
        f"{utc(alice.begins)} and after {utc(alice.expires)}: check the listener's clock"
    )


def test_a_rig_that_refuses_our_certificate_is_reported(made: Path, tmp_path: Path) -> None:
    pki.make_authority(tmp_path / "other")
    other = str(tmp_path / "other" / "authority.pem")
    trusts = {"root_ca_certificate_base64": None, "root_ca_certificate": other}
    with _listening(made / "rig-1.pem", **trusts) as port:
        assert _told(made, port).startswith("the listener refuses the certificate of alice (")


def test_a_server_that_never_answers_is_reported(
    made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "LONGEST_S", 0.3)
    alice = made / "alice.pem"
    with socket.create_server(("127.0.0.1", 0)) as hanging:
        port = hanging.getsockname()[1]
        told = why_not_connected("127.0.0.1", port, read_credential(alice, "client"), alice)

    assert "does not speak TLS 1.3" in told


def test_a_working_connection_has_no_fault(made: Path) -> None:
    alice = made / "alice.pem"
    with _listening(made / "rig-1.pem") as port:
        told = why_not_connected("localhost", port, read_credential(alice, "client"), alice)

    assert told == ""


@pytest.mark.parametrize(
    "where", ["tls/localhost", "tls/localhost:7447#verify_name_on_connect=false"]
)
def test_an_invalid_endpoint_is_refused(made: Path, where: str) -> None:
    with pytest.raises(RigError, match="must be tls/HOST:PORT"):
        Rig("1", connect=where, certificate=made / "alice.pem").__enter__()


def test_a_missing_certificate_is_reported_with_where_to_configure_it(made: Path) -> None:
    with pytest.raises(RigError, match=r"needs your certificate: .* ARMRIG_CLIENT_CERTIFICATE"):
        Rig("1", connect="tls/localhost:7447").__enter__()


def test_an_explicit_credential_has_precedence_over_the_configured_one(made: Path) -> None:
    given, configured = (
        str(pki.issue_to_person(made, name, "operators").path) for name in ("ada", "bob")
    )
    settings, where = ClientSettings(certificate=configured), "tls/lab:7447"

    assert _way(where, given, settings).name == "ada"
    assert _way(where, None, settings).name == "bob"
    assert _way(where, given, ClientSettings()).name == "ada"
