"""Small certificate authority: keys and certificates for rigs and their users.

The keys use the elliptic curve P-256, and the signatures are ECDSA with SHA-256. All TLS 1.3
implementations support both. A certificate contains its purpose. A client therefore refuses a
server that presents an operator's certificate. An issued certificate cannot sign other
certificates. With its certificate, a rig may connect to a router, but it may neither send commands
nor read streams.
"""

from __future__ import annotations

import ipaddress
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal, NamedTuple

from armrig_core.access.access_list import AccessList, read_access_list
from armrig_core.access.credential import RIG_PREFIX, ROUTER, check_name, rig_name
from armrig_core.errors import InputError
from armrig_core.telemetry.topics import check_rig_id

try:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
except ModuleNotFoundError as err:
    raise InputError(
        "certificates need the package cryptography: pip install 'armrig[pki]'"
    ) from err

Role = Literal["operators", "observers"]
RIG_DAYS = 365
AUTHORITY_DAYS = 3650
_CLOCK_TOLERANCE = timedelta(hours=1)  # for machines whose clock is slow
_KEY, _CERTIFICATE, ACCESS_LIST = "authority.key", "authority.pem", "access.toml"
_HOST = re.compile(r"(?!-)[A-Za-z0-9-]{1,63}(?<!-)(\.(?!-)[A-Za-z0-9-]{1,63}(?<!-))*")


class Issued(NamedTuple):
    """Certificate that the authority has signed."""

    name: str
    role: str
    """`rig`, `router`, or the role in the access list."""
    expires: datetime
    path: Path


def make_authority(directory: Path, *, days: int = AUTHORITY_DAYS, force: bool = False) -> Path:
    """Create an authority in `directory` with an empty access list; return its certificate's path.

    Raises InputError if an authority exists already; a new authority would invalidate the existing
    certificates.
    """
    if not force and (directory / _KEY).exists():
        raise InputError(
            f"{directory / _KEY}: there is an authority already; --force makes another, and all "
            "certificates of the first become invalid"
        )
    key = ec.generate_private_key(ec.SECP256R1())
    name = subject_name("armrig authority")
    certificate = (
        builder(name, name, key.public_key(), days)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_key_usage(signs_certificates=True), critical=True)
        .sign(key, hashes.SHA256())
    )
    directory.mkdir(mode=0o755, parents=True, exist_ok=True)
    _write(directory / _KEY, pem_of_key(key), 0o600)
    _write(directory / _CERTIFICATE, pem_of(certificate), 0o644)
    if not (directory / ACCESS_LIST).exists():
        _write(directory / ACCESS_LIST, AccessList().toml().encode(), 0o644)
    return directory / _CERTIFICATE


def issue_to_rig(
    directory: Path, rig: str, hosts: Sequence[str], *, days: int = RIG_DAYS, force: bool = False
) -> Issued:
    """Create the credential of a rig's daemon, and put the rig on the access list.

    `hosts` are the names by which clients connect to the rig. Without hosts, the credential is
    valid only for a connection to a router.

    Raises InputError if there is no authority, the rig was revoked or has a credential already, or
    a host is neither a name nor an address.
    """
    name = check_name(rig_name(check_rig_id(rig)))
    _refuse_revoked(directory, name)
    issued = _issue(directory, name, "rig", [_host(host) for host in hosts], days, force=force)
    _put_on_list(directory, name, "rigs")
    return issued


def issue_to_router(
    directory: Path, hosts: Sequence[str], *, days: int = RIG_DAYS, force: bool = False
) -> Issued:
    """Create a router's credential; rigs and people connect to the router by the names in `hosts`.

    Raises InputError if there is no authority, a credential exists already, or a host is not a name
    or address.
    """
    if not hosts:
        raise InputError("name the hosts of the router for its clients, such as --host lab.local")
    return _issue(directory, ROUTER, ROUTER, [_host(host) for host in hosts], days, force=force)


def issue_to_person(
    directory: Path, name: str, role: Role, *, days: int = RIG_DAYS, force: bool = False
) -> Issued:
    """Create the credential of an operator or observer, and put the name on the access list.

    Raises InputError if there is no authority, or the name is not allowed, was revoked, or has a
    credential already.
    """
    _refuse_revoked(directory, name)
    if name.startswith(RIG_PREFIX) or name in ("authority", ROUTER):
        raise InputError(f"{name!r} is a name of rigs or routers: use another name")
    issued = _issue(directory, name, role, [], days, force=force)
    _put_on_list(directory, name, role)
    return issued


def renew(directory: Path, name: str, *, days: int = RIG_DAYS) -> Issued:
    """Create a new key and certificate for a name; the hosts and the role of the name stay.

    Raises InputError if the name has no credential, or was revoked.
    """
    path = directory / f"{check_name(name)}.pem"
    if not path.exists():
        raise InputError(
            f"{path}: there is nothing to renew; `armrig pki list` shows the credentials"
        )
    role = read_access_list(directory / ACCESS_LIST).role(name)
    if role in ("operators", "observers"):
        return issue_to_person(directory, name, role, days=days, force=True)  # type: ignore[arg-type]
    if role == "revoked" or not (name.startswith(RIG_PREFIX) or name == ROUTER):
        raise InputError(f"{name!r} was revoked, or is not on the access list: nothing is renewed")
    hosts: list[x509.GeneralName] = []
    with suppress(x509.ExtensionNotFound):
        old = _read_certificates(path)[0].extensions
        hosts = list(old.get_extension_for_class(x509.SubjectAlternativeName).value)
    issued = _issue(directory, name, ROUTER if name == ROUTER else "rig", hosts, days, force=True)
    if name != ROUTER:
        _put_on_list(directory, name, "rigs")
    return issued


def revoke(directory: Path, name: str) -> None:
    """Put a name on the list of revoked names; a revoked name has no rights.

    Raises InputError if the name is not on the access list.
    """
    people = read_access_list(directory / ACCESS_LIST)
    if people.role(check_name(name)) not in ("operators", "observers", "rigs"):
        raise InputError(
            f"{name!r} is neither an operator nor an observer nor a rig, such as rig-1; "
            "`armrig pki list` shows the names"
        )
    _put_on_list(directory, name, "revoked")


def list_certificates(directory: Path) -> list[Issued]:
    """Return the certificates in the authority's folder that the authority has issued."""
    people = read_access_list(directory / ACCESS_LIST)
    certificates = []
    for path in sorted(directory.glob("*.pem")):
        name = path.stem
        role = people.role(name)
        if role != "revoked" and name.startswith(RIG_PREFIX):
            role = "rig"
        elif name == ROUTER:
            role = ROUTER
        if name != Path(_CERTIFICATE).stem:
            expires = _read_certificates(path)[0].not_valid_after_utc
            certificates.append(Issued(name, role or "on no list", expires, path))
    return certificates


def _refuse_revoked(directory: Path, name: str) -> None:
    if read_access_list(directory / ACCESS_LIST).role(check_name(name)) == "revoked":
        raise InputError(
            f"{name!r} was revoked; with a new certificate for this name, the stolen certificate "
            f"would be valid again; use another name, such as {name[:38]}-2"
        )


def _put_on_list(directory: Path, name: str, role: str) -> None:
    people = read_access_list(directory / ACCESS_LIST)
    _write(directory / ACCESS_LIST, people.with_name(name, role).toml().encode(), 0o644)


def _issue(
    directory: Path, name: str, role: str, hosts: list[x509.GeneralName], days: int, *, force: bool
) -> Issued:
    path = directory / f"{name}.pem"
    if path.exists() and not force:
        raise InputError(
            f"{path}: exists already; `armrig pki renew {name}` or --force makes a new key"
        )
    try:
        signing: Any = serialization.load_pem_private_key((directory / _KEY).read_bytes(), None)
        authority = _read_certificates(directory / _CERTIFICATE)[0]
    except FileNotFoundError as err:
        raise InputError(
            f"{err.filename}: there is no authority here; `armrig pki ca` makes one"
        ) from err
    key = ec.generate_private_key(ec.SECP256R1())
    serves, connects = ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH
    purposes = ([serves] if hosts else []) + ([connects] if role != ROUTER else [])
    unsigned = (
        builder(subject_name(name), authority.subject, key.public_key(), days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(signing.public_key()), critical=False
        )
    )
    if hosts:
        unsigned = unsigned.add_extension(x509.SubjectAlternativeName(hosts), critical=False)
    certificate = unsigned.sign(signing, hashes.SHA256())
    text = pem_of_key(key) + pem_of(certificate) + pem_of(authority)
    _write(path, text, 0o600)
    return Issued(name, role, certificate.not_valid_after_utc, path)


def builder(
    subject: x509.Name, issuer: x509.Name, public_key: ec.EllipticCurvePublicKey, days: int
) -> x509.CertificateBuilder:
    """Return the builder of a certificate that is valid from now on for a number of days."""
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(public_key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCK_TOLERANCE)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public_key), critical=False)
    )


def subject_name(common_name: str) -> x509.Name:
    """Return the subject of a certificate."""
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=False,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _host(host: str) -> x509.GeneralName:
    with suppress(ValueError):
        return x509.IPAddress(ipaddress.ip_address(host))
    if len(host) > 253 or not _HOST.fullmatch(host):
        raise InputError(f"--host {host!r}: give a name such as lab-1.example.edu, or an address")
    return x509.DNSName(host)


def pem_of_key(key: ec.EllipticCurvePrivateKey) -> bytes:
    """Return a private key as text, without a password."""
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def pem_of(certificate: x509.Certificate) -> bytes:
    """Return a certificate as text."""
    return certificate.public_bytes(serialization.Encoding.PEM)


def _read_certificates(path: Path) -> list[x509.Certificate]:
    data = path.read_bytes()
    try:
        return x509.load_pem_x509_certificates(data)
    except ValueError as err:
        raise InputError(f"{path}: contains no certificate") from err


def _write(path: Path, data: bytes, mode: int) -> None:
    """Write a file atomically; the file has the mode `mode` as soon as it exists."""
    made = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with open(made, "xb", opener=lambda name, flags: os.open(name, flags, mode)) as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        made.replace(path)
    finally:
        made.unlink(missing_ok=True)
