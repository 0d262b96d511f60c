"""A daemon that a network reaches, and those who come: certificates of all kinds, and of none."""

from __future__ import annotations

import secrets
import socket
from contextlib import suppress
from datetime import timedelta
from pathlib import Path
from unittest.mock import patch

from armrig.lab import pki
from armrig.rig.client import Rig
from armrig_core.access.credential import read_credential
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key
from cryptography.x509.oid import NameOID

from tests.integration.processes import Bench

HOSTS = ["localhost", "127.0.0.1", "10.77.0.1"]
OPERATORS, OBSERVERS = ("alice", "carol"), ("bob",)


def free_port() -> int:
    """Return a free port of TCP, outside of those that the kernel gives (ip_local_port_range)."""
    while True:
        port = 20_000 + secrets.randbelow(12_000)
        with socket.socket() as found, suppress(OSError):
            found.bind(("127.0.0.1", port))
            return port


def certificates(folder: Path) -> Path:
    """Make an authority's folder with a certificate of each kind; return it.

    The certificates are those of operators, an observer, a revoked client (eve) and a client on no
    list (wrong). One has expired (expired), and one has an operator's name by another authority
    (forged).
    """
    made = folder / "pki"
    pki.make_authority(made)
    pki.issue_to_rig(made, "1", HOSTS)
    for name in OPERATORS:
        pki.issue_to_person(made, name, "operators")
    for name in OBSERVERS:
        pki.issue_to_person(made, name, "observers")
    pki.issue_to_person(made, "eve", "operators")
    pki.revoke(made, "eve")
    people = (made / pki.ACCESS_LIST).read_text()
    pki.issue_to_person(made, "wrong", "operators")
    (made / pki.ACCESS_LIST).write_text(people)
    with patch.object(pki, "_CLOCK_TOLERANCE", timedelta(days=10)):
        expired = pki._issue(made, "alice", "operators", [], -1, force=True).path
        expired.rename(made / "expired.pem")
    pki._issue(made, "alice", "operators", [], 365, force=True)
    _signed_by_bob(made)
    other = folder / "forged"
    pki.make_authority(other)
    pki.issue_to_person(other, "alice", "operators").path.rename(made / "forged.pem")
    return made


def _signed_by_bob(made: Path) -> None:
    """Make a certificate of alice that bob's certificate signs, as if bob were an authority.

    In addition make a chain of bob's certificate and alice's: a program that reads the last one
    takes bob for alice.
    """
    bob, alice = (read_credential(made / f"{name}.pem", "client") for name in ("bob", "alice"))
    issuer = x509.load_pem_x509_certificate(bob.certificate)
    signer = load_pem_private_key(bob.key, None)
    assert isinstance(signer, ec.EllipticCurvePrivateKey)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "alice")])
    forged = (
        x509.CertificateBuilder(issuer.subject, name, signer.public_key(), 1)
        .not_valid_before(issuer.not_valid_before_utc)
        .not_valid_after(issuer.not_valid_after_utc)
        .sign(signer, hashes.SHA256())
        .public_bytes(Encoding.PEM)
    )
    for path, chain in (
        ("signed-by-bob", (bob.key, forged, bob.certificate, bob.authority)),
        ("bob-before-alice", (bob.key, bob.certificate, alice.certificate, bob.authority)),
    ):
        written = made / f"{path}.pem"
        written.write_bytes(b"".join(chain))
        written.chmod(0o600)


def by_certificate(bench: Bench, made: Path, where: str) -> str:
    """Have a bench's daemon listen at `where`; return that."""
    bench.configure(
        watchdog_ms=250,
        more=f'[access]\nlisten = "{where}"\ncertificate = "{made}/rig-1.pem"\n'
        f'names = "{made}/access.toml"\n',
    )
    return where


class Laboratory:
    """A daemon at a port of this machine, for who has a certificate."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.made = certificates(bench.folder)
        self.endpoint = by_certificate(bench, self.made, f"tls/localhost:{free_port()}")

    def rig(self, who: str) -> Rig:
        """Return a client with this name."""
        return Rig("1", connect=self.endpoint, certificate=self.made / f"{who}.pem")
