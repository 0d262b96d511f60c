"""`armrig pki`: certificates that TLS takes for what they are for, and files that stay private."""

from __future__ import annotations

import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from armrig.cli import main
from armrig_core.access.access_list import read_access_list
from armrig_core.access.credential import read_credential
from armrig_core.errors import FileError
from cryptography import x509


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give a folder with an authority, with us in it."""
    monkeypatch.chdir(tmp_path)
    assert main(["pki", "ca"]) == 0
    return tmp_path / "pki"


def test_an_authority_without_a_certificate_is_reported(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "authority.pem").write_text("none")

    assert main(["pki", "operator", "alice"]) == 1

    assert "authority.pem: contains no certificate" in capsys.readouterr().err
    assert not (here / "alice.pem").exists()


def test_only_the_owner_can_read_a_key(here: Path) -> None:
    main(["pki", "operator", "alice"])

    modes = {path.name: path.stat().st_mode & 0o777 for path in here.iterdir()}
    assert modes == {
        "authority.key": 0o600,
        "authority.pem": 0o644,
        "access.toml": 0o644,
        "alice.pem": 0o600,
    }


def test_a_certificate_contains_its_purpose(here: Path) -> None:
    main(["pki", "rig", "1", "--host", "lab-1.example.edu", "--host", "2001:db8::7"])
    rig, authority = x509.load_pem_x509_certificates((here / "rig-1.pem").read_bytes())

    hosts = rig.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert hosts.get_values_for_type(x509.DNSName) == ["lab-1.example.edu"]
    assert [str(a) for a in hosts.get_values_for_type(x509.IPAddress)] == ["2001:db8::7"]
    assert [c.public_key().key_size for c in (rig, authority)] == [256, 256]
    signs = [
        (
            c.extensions.get_extension_for_class(x509.BasicConstraints).value.ca,
            c.extensions.get_extension_for_class(x509.KeyUsage).value.key_cert_sign,
        )
        for c in (rig, authority)
    ]
    assert signs == [(False, False), (True, True)]


@pytest.mark.parametrize(
    "command", [["ca"], ["rig", "1", "--host", "localhost"], ["operator", "alice"]]
)
def test_an_existing_file_is_overwritten_only_on_request(
    here: Path, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    if command != ["ca"]:
        assert main(["pki", *command]) == 0
    before = {path.name: path.read_bytes() for path in here.iterdir()}

    assert main(["pki", *command]) == 1
    assert "--force" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in here.iterdir()} == before
    assert main(["pki", *command, "--force"]) == 0
    assert {path.name: path.read_bytes() for path in here.iterdir()} != before


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("alice", ["operator", "alice"]),
        ("bob", ["observer", "bob"]),
        ("rig-1", ["rig", "1"]),
        ("router", ["router", "--host", "lab"]),
    ],
)
def test_a_renewed_certificate_is_valid_for_its_days(
    here: Path, name: str, command: list[str]
) -> None:
    def days() -> float:
        certificate = x509.load_pem_x509_certificates((here / f"{name}.pem").read_bytes())[0]
        return (certificate.not_valid_after_utc - datetime.now(UTC)) / timedelta(days=1)

    main(["pki", *command, "--days", "30"])
    assert 29.9 < days() <= 30

    assert main(["pki", "renew", name, "--days", "7"]) == 0

    assert 6.9 < days() <= 7


def test_renewal_keeps_the_name_the_hosts_and_the_role(here: Path) -> None:
    main(["pki", "rig", "1", "--host", "lab-1.example.edu", "--days", "5"])
    main(["pki", "observer", "bob", "--days", "5"])
    old = {name: (here / f"{name}.pem").read_bytes() for name in ("rig-1", "bob")}

    for name in old:
        assert main(["pki", "renew", name]) == 0

    for name, text in old.items():
        before, after = (
            x509.load_pem_x509_certificates(found)[0]
            for found in (text, (here / f"{name}.pem").read_bytes())
        )
        assert before.subject == after.subject
        assert before.public_key() != after.public_key()
        assert (after.not_valid_after_utc - before.not_valid_after_utc).days in (359, 360)
    hosts = after_hosts(here / "rig-1.pem")
    assert hosts == ["lab-1.example.edu"]
    assert read_access_list(here / "access.toml").observers == ("bob",)


def after_hosts(path: Path) -> list[str]:
    """Return the host names in a certificate."""
    certificate = x509.load_pem_x509_certificates(path.read_bytes())[0]
    found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return list(found.get_values_for_type(x509.DNSName))


def test_a_revoked_name_is_not_issued_again(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A stolen certificate of that name would be valid again."""
    main(["pki", "operator", "alice"])
    assert main(["pki", "revoke", "alice"]) == 0
    assert "when the daemons of the rigs have this file" in capsys.readouterr().out
    assert read_access_list(here / "access.toml").revoked == ("alice",)

    for command in (["operator", "alice", "--force"], ["observer", "alice"], ["renew", "alice"]):
        assert main(["pki", *command]) == 1
        assert "'alice' was revoked" in capsys.readouterr().err
    assert main(["pki", "operator", "alice-2"]) == 0


def test_certificates_of_a_router_and_its_rigs_are_issued_and_revoked(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["pki", "router", "--host", "localhost"]) == 0
    assert main(["pki", "rig", "7"]) == 0
    assert main(["pki", "renew", "rig-7"]) == 0
    assert main(["pki", "renew", "router"]) == 0

    assert read_credential(here / "router.pem", "router").name == "router"
    assert read_credential(here / "rig-7.pem", "rig at a router").name == "rig-7"
    assert read_access_list(here / "access.toml").rigs[-1] == "rig-7"
    for path, purpose in (("router.pem", "rig at a router"), ("rig-7.pem", "rig")):
        with pytest.raises(FileError, match="has another purpose"):
            read_credential(here / path, purpose)  # type: ignore[arg-type]
    assert main(["pki", "revoke", "rig-7"]) == 0
    assert main(["pki", "rig", "7", "--force"]) == 1
    assert main(["pki", "rig", "8"]) == 0
    assert read_access_list(here / "access.toml").revoked == ("rig-7",)
    capsys.readouterr()
    assert main(["pki", "list"]) == 0
    listed = [line.split()[:2] for line in capsys.readouterr().out.splitlines()[-3:]]
    assert listed == [["rig-7", "revoked"], ["rig-8", "rig"], ["router", "router"]]


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (["operator", "Alice"], "name 'Alice': use 1 to 40 characters, each a-z, 0-9 or -"),
        (["operator", "../alice"], "name '../alice': use 1 to 40 characters, each a-z"),
        (["operator", "rig-1"], "'rig-1' is a name of rigs"),
        (["observer", "router"], "'router' is a name of rigs or routers"),
        (
            ["rig", "1", "--host", "*.example.edu"],
            "a name such as lab-1.example.edu, or an address",
        ),
        (["rig", "1", "--host", "lab-1/24"], "a name such as lab-1.example.edu, or an address"),
        (["rig", "A/B", "--host", "localhost"], "rig id 'A/B': use 1 to 40 characters, each a-z"),
        (["renew", "alice"], "there is nothing to renew"),
        (["revoke", "alice"], "'alice' is neither an operator nor an observer"),
    ],
)
def test_a_forbidden_name_or_value_is_refused(
    here: Path, command: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(here.iterdir())

    assert main(["pki", *command]) == 1
    assert says in capsys.readouterr().err
    assert sorted(here.iterdir()) == before


def test_a_missing_library_is_reported_with_its_installation(tmp_path: Path) -> None:
    """The package cryptography is an extra: only `armrig pki` needs it."""
    program = (
        "import sys; sys.modules['cryptography'] = None\n"
        "from armrig.cli import main\n"
        f"sys.exit(main(['pki', 'ca', '--directory', {str(tmp_path / 'pki')!r}]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )

    assert done.returncode == 1
    assert "pip install 'armrig[pki]'" in done.stderr
    assert not (tmp_path / "pki").exists()


def test_a_router_refuses_a_key_that_its_group_may_read(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["pki", "router", "--host", "localhost"]) == 0
    (here / "router.pem").chmod(0o640)
    files = ("--certificate", str(here / "router.pem"), "--names", str(here / "access.toml"))

    assert main(["router", "--listen", "tls/127.0.0.1:1", *files]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert said.endswith(f"allowed is 0400 or 0600: `chmod 400 {here}/router.pem`")
