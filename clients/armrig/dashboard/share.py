"""Access for phones and visitors: a TLS port whose token permits only watching and stopping."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from armrig_core.process.imports import load_extra

from armrig.rig.session import RigError

PORT = 8808
_DAYS = 2
_NOBODY = ("192.0.2.1", 9)  # an address reserved for documentation; nothing is sent to it


class Certificate(NamedTuple):
    """Self-signed certificate and its key, in files that `certificate` deletes after its block."""

    certificate: Path
    key: Path
    fingerprint: str
    """SHA-256 of the certificate, for comparison with the value that a visitor's browser shows."""


def own_address() -> str:
    """Return the address of this machine on its network.

    Raises RigError if the machine is not connected to a network.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(_NOBODY)
        except OSError as err:
            raise RigError(
                f"--share: this machine is on no network ({err.strerror}); join one first"
            ) from err
        return str(probe.getsockname()[0])


@contextmanager
def certificate(address: str) -> Iterator[Certificate]:
    """Yield a self-signed certificate for an address; its files exist until the block ends.

    Raises MissingPackageError if the package that makes certificates is not installed.
    """
    load_extra("cryptography", "share")
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec

    from armrig.lab.pki import builder, pem_of, pem_of_key, subject_name

    key = ec.generate_private_key(ec.SECP256R1())
    name, host = subject_name("armrig dashboard"), x509.IPAddress(ipaddress.ip_address(address))
    made = (
        builder(name, name, key.public_key(), _DAYS)
        .add_extension(x509.SubjectAlternativeName([host]), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    with TemporaryDirectory(prefix="armrig-share-") as folder:  # other users cannot read it
        files = Path(folder) / "certificate.pem", Path(folder) / "key.pem"
        files[0].write_bytes(pem_of(made))
        files[1].write_bytes(pem_of_key(key))
        yield Certificate(*files, made.fingerprint(hashes.SHA256()).hex(":").upper())


def qr_code(text: str) -> str:
    """Return a text as a QR code for terminals with a dark or a light background.

    Raises MissingPackageError if the package that draws QR codes is not installed.
    """
    drawn = StringIO()
    load_extra("segno", "share").make(text, error="l").terminal(out=drawn, compact=True)
    return drawn.getvalue()
