"""The access over a network is judged before the motor's loop starts: nothing is half-open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from armrig.lab import pki
from armrig_core.access.access_control import remote, size_limits
from armrig_core.access.access_list import AccessList
from armrig_core.access.credential import read_credential
from armrig_core.commands.commands import MOST_REMOTE_BYTES
from armrig_core.errors import InputError
from armrig_daemon.config import Access, Config, load
from armrig_daemon.service.access import network_of, router_of

TLS = "tls/0.0.0.0:7447"


@pytest.fixture
def files(tmp_path: Path) -> dict[str, str]:
    """Give all files that [access] can name."""
    pki.make_authority(tmp_path)
    pki.issue_to_rig(tmp_path, "1", ["localhost"])
    pki.issue_to_person(tmp_path, "alice", "operators")
    pki.issue_to_person(tmp_path, "bob", "observers")
    return {
        "certificate": str(tmp_path / "rig-1.pem"),
        "names": str(tmp_path / "access.toml"),
    }


def _network(**access: str) -> Any:
    return network_of(Config(access=Access(**access)))


def _chosen(files: dict[str, str], *keys: str) -> dict[str, str]:
    return {key: files[key] for key in keys}


def test_without_an_endpoint_there_is_no_network() -> None:
    assert network_of(Config()) is None


def test_a_client_on_the_list_is_admitted(files: dict[str, str]) -> None:
    tls = _network(listen=TLS, **_chosen(files, "certificate", "names"))

    assert (tls.operators, tls.observers) == (1, 1)
    assert tls.expires == read_credential(Path(files["certificate"]), "rig").expires
    subjects = [subject["id"] for subject in tls.access_control["subjects"]]
    assert subjects == ["alice", "bob"]


@pytest.mark.parametrize(
    ("listen", "keys", "says"),
    [
        (TLS, [], r"needs certificate, too; `armrig pki rig` makes one"),
        (TLS, ["names"], r"needs certificate, too"),
        (TLS, ["certificate"], r"needs names, too; `armrig pki ca` makes one"),
        ("", ["certificate"], r"certificate is given, but listen is not"),
        ("", ["names"], r"names is given, but listen is not"),
    ],
)
def test_a_missing_access_key_is_reported(
    files: dict[str, str], listen: str, keys: list[str], says: str
) -> None:
    with pytest.raises(InputError, match=rf"^\[access\] .*{says}"):
        _network(listen=listen, **_chosen(files, *keys))


@pytest.mark.parametrize(
    ("listen", "says"),
    [
        ("tcp/192.0.2.7:7447", r"must be tls/HOST:PORT"),
        ("tcp/127.0.0.1:7447", r"must be tls/HOST:PORT"),
        ("udp/127.0.0.1:7447", r"must be tls/HOST:PORT"),
        ("tls/0.0.0.0", r"must be tls/HOST:PORT"),
        ("tls/0.0.0.0:0", r"must be tls/HOST:PORT"),
        ("tls/0.0.0.0:70000", r"must be tls/HOST:PORT"),
        ("tls/0.0.0.0:7447#enable_mtls=false", r"must be tls/HOST:PORT"),
        ("tls/0.0.0.0:7447?prio=1", r"must be tls/HOST:PORT"),
        ("7447", r"must be tls/HOST:PORT"),
    ],
)
def test_an_endpoint_without_encryption_is_refused(listen: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        load([], {"ARMRIG_ACCESS_LISTEN": listen}, {})


@pytest.mark.parametrize("listen", ["tls/127.0.0.1:7447", "tls/[::]:7447"])
def test_encrypted_endpoints_are_accepted(listen: str) -> None:
    assert load([], {"ARMRIG_ACCESS_LISTEN": listen}, {}).access.listen == listen


def test_credential_paths_are_relative_to_the_folder_of_the_configuration(
    files: dict[str, str], tmp_path: Path
) -> None:
    path = tmp_path / "armrig.toml"
    path.write_text(f'[access]\nlisten = "{TLS}"\ncertificate = "rig-1.pem"\nnames = "access.toml"')

    assert load([path], {}, {}).access.certificate == files["certificate"]
    assert network_of(load([path], {}, {})) is not None


@pytest.mark.parametrize("key", ["certificate", "names"])
def test_a_file_that_cannot_be_used_is_refused(
    files: dict[str, str], tmp_path: Path, key: str
) -> None:
    files[key] = str(tmp_path / "nothing")

    with pytest.raises(InputError, match=rf"^\[access\] {tmp_path}/nothing: "):
        _network(listen=TLS, **_chosen(files, "certificate", "names"))


def test_a_client_certificate_is_refused_for_the_daemon(
    files: dict[str, str], tmp_path: Path
) -> None:
    files["certificate"] = str(tmp_path / "alice.pem")

    with pytest.raises(InputError, match="has another purpose; `armrig pki rig` makes"):
        _network(listen=TLS, **_chosen(files, "certificate", "names"))


def test_the_access_list_denies_every_request_that_it_does_not_allow() -> None:
    people = AccessList(operators=("alice",), observers=("bob",), revoked=("eve",))

    control = remote("1", people)

    assert (control["enabled"], control["default_permission"]) == (True, "deny")
    assert {rule["permission"] for rule in control["rules"]} == {"allow"}
    asked = {
        rule["id"]: rule["key_exprs"]
        for rule in control["rules"]
        if rule["flows"] == ["ingress"] and "query" in rule["messages"]
    }
    assert asked == {
        "ask for schema and history": ["rig/1/schema/**", "rig/1/history"],
        "alice asks": ["rig/1/cmd/*/alice"],
        "bob asks": ["rig/1/cmd/status/bob"],
    }
    assert "'eve'" not in str(control)
    shared = [rule["id"] for rule in control["rules"] if not rule["id"].startswith(("a", "b"))]
    shared += [rule["id"] for rule in control["rules"] if rule["id"].startswith("ask for")]
    for name, subject, policy in zip(
        ("alice", "bob"), control["subjects"], control["policies"], strict=True
    ):
        assert subject == {"id": name, "cert_common_names": [name]}
        assert policy["subjects"] == [name]
        assert set(policy["rules"]) == {*shared, f"{name} asks", f"{name} is answered"}


def test_a_router_needs_the_certificate_of_this_rig(files: dict[str, str], tmp_path: Path) -> None:
    other = str(pki.issue_to_rig(tmp_path, "2", []).path)
    router = "tls/lab.local:7447"

    found = router_of(Config(access=Access(router=router, certificate=files["certificate"])))

    assert found is not None
    assert (found.endpoint, found.is_router) == (router, True)
    assert found.expires == read_credential(Path(files["certificate"]), "rig").expires
    assert found.low_pass_filter == size_limits("1")
    assert "connect_certificate_base64" in found.tls
    assert _network(router=router, certificate=files["certificate"]) is None
    assert _network(router=router, listen=TLS, **_chosen(files, "certificate", "names")) is not None
    for certificate, says in (
        ("", "needs certificate, too; `armrig pki rig` makes one"),
        (other, "of rig-2; the router admits this rig only with a certificate of rig-1"),
        (str(tmp_path / "router.pem"), "there is no such file; `armrig pki rig` writes one"),
    ):
        with pytest.raises(InputError, match=says):
            router_of(Config(access=Access(router=router, certificate=certificate)))
    with pytest.raises(InputError, match="names is given, but listen is not"):
        _network(router=router, **_chosen(files, "certificate", "names"))


@pytest.mark.parametrize("router", ["tcp/127.0.0.1:7447", "tls/lab.local", "lab.local:7447"])
def test_a_router_endpoint_without_tls_is_refused(router: str) -> None:
    with pytest.raises(InputError, match="must be tls/HOST:PORT"):
        load([], {"ARMRIG_ACCESS_ROUTER": router}, {})


@pytest.mark.parametrize("name", ["run", "control"])
def test_a_run_over_a_network_may_have_eight_mebibytes(name: str) -> None:
    (limit,) = (rule["size_limit"] for rule in size_limits("1") if rule["id"] == f"size of {name}")

    assert limit == MOST_REMOTE_BYTES
