"""Who somebody is on the network: a key, its certificate, and the authority that signed it.

One PEM file holds all three, in this order, as `armrig pki` writes it. It is judged before zenoh
sees it, which only says that it cannot connect.
"""

from __future__ import annotations

import base64
import os
import re
import ssl
import stat
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from shlex import quote
from typing import Any, Literal

from armrig_core.bounded import CONFIGURATION_LIMIT, read_bounded
from armrig_core.errors import FileError, InputError
from armrig_core.printable import printable

Purpose = Literal["rig", "client", "router", "rig at a router"]
"""What a certificate is for: a rig or a router is served with it, or somebody connects with it."""
ROUTER = "router"
"""Name in the certificate of a router."""
RIG_PREFIX = "rig-"
"""How the name in a rig's certificate begins."""

_MADE_BY = {
    "rig": "armrig pki rig",
    "client": "armrig pki operator",
    "router": "armrig pki router",
    "rig at a router": "armrig pki rig",
}
_SERVED = ("rig", "router")
_BLOCK = re.compile(rb"-----BEGIN ([A-Z0-9 ]+)-----.*?-----END \1-----\n?", re.DOTALL)
_NAME = re.compile(r"[a-z0-9-]{1,40}")
# X509_V_ERR_… of OpenSSL, x509_vfy.h
_NOT_YET, _EXPIRED, _PURPOSE = 9, 10, 26


@dataclass(frozen=True, slots=True, kw_only=True)
class Credential:
    """A key with its certificate, which an authority has signed."""

    name: str
    """Common name in the certificate."""
    expires: datetime
    """When the certificate, or its authority's, ends."""
    key: bytes
    """PEM, as are the others."""
    certificate: bytes
    authority: bytes

    def tls(self, side: Literal["listen", "connect"]) -> dict[str, Any]:
        """Return zenoh's `transport/link/tls`: both ends show a certificate, or there is no link.

        A link ends with the certificate of the other side, and not later.
        """
        return {
            "root_ca_certificate_base64": _base64(self.authority),
            f"{side}_private_key_base64": _base64(self.key),
            f"{side}_certificate_base64": _base64(self.certificate),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        }


def check_name(name: str) -> str:
    """Return the name of a person or a program, or raise ValueError where it can be part of no key.

    The daemon's access list names him so, and so do the keys of his commands.
    """
    if not _NAME.fullmatch(name):
        raise InputError(f"name '{printable(name)}': 1 to 40 of a-z, 0-9 and - are allowed")
    return name


def rig_name(rig: str) -> str:
    """Return the name in the certificate of a rig, such as rig-1."""
    return f"{RIG_PREFIX}{rig}"


def exposed(path: Path, found: os.stat_result, secret: str) -> str:
    """Return why others than its owner may know a secret in a file, and what to type; or nothing.

    The group of a service's files is that of the people who may operate its rig.
    """
    if os.name != "posix" or not found.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        return ""
    mend = f"chmod 400 {quote(str(path))}"
    if found.st_uid != os.geteuid():
        mend = f"chown {_this_user()} {quote(str(path))} && {mend}"
    return (
        f"{path}: mode {stat.S_IMODE(found.st_mode):04o} lets others than its owner read {secret} "
        f"or change it: allowed is 0400 or 0600: `{mend}`"
    )


def _this_user() -> str:
    from pwd import getpwuid  # Windows has none

    try:
        return getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


def read_credential(path: Path, purpose: Purpose) -> Credential:
    """Return the credential in a file, which must be good for `purpose`, and now.

    Raises
    ------
    FileError
        The file cannot be read, or not by its owner alone; something is missing in it; the key is
        not that of the certificate; the certificate is not signed by the authority in the file,
        not of this time, or for another purpose.
    """
    data = _read(path, purpose)
    blocks = [(match[1], match[0]) for match in _BLOCK.finditer(data)]
    keys = [text for label, text in blocks if label.endswith(b"PRIVATE KEY")]
    certificates = [text for label, text in blocks if label == b"CERTIFICATE"]
    if len(keys) != 1 or len(certificates) < 2:
        raise FileError(
            f"{path}: {len(keys)} private keys and {len(certificates)} certificates: one key, its "
            f"certificate and that of its authority are needed, as `{_MADE_BY[purpose]}` writes it"
        )
    if b"ENCRYPTED" in keys[0]:
        raise FileError(f"{path}: the key is encrypted: a key without a passphrase is needed")
    authority = certificates[-1]
    try:
        shown = _shown(path, authority, purpose)
        authorities = _contents(authority)
    except (ssl.SSLError, ValueError) as err:
        raise FileError(f"{path}: {_what_is_wrong(err, purpose)}") from err
    ends = (_end(certificate) for certificate in (shown, *authorities))
    name = _common_name(path, shown)
    if purpose == "client" and name.startswith(RIG_PREFIX):  # it connects to a router
        raise FileError(f"{path}: {_other_purpose(purpose)}")
    return Credential(
        name=name,
        expires=min(ends),
        key=keys[0],
        certificate=b"".join(certificates[:-1]),
        authority=authority,
    )


def _read(path: Path, purpose: Purpose) -> bytes:
    def check(found: os.stat_result) -> None:
        if error := exposed(path, found, "the key"):
            raise FileError(error)

    try:
        return read_bounded(path, CONFIGURATION_LIMIT, check)
    except FileNotFoundError as err:
        raise FileError(f"{path}: there is no such file; `{_MADE_BY[purpose]}` writes one") from err
    except OSError as err:
        raise FileError(
            f"{path}: {err.strerror}; it must be a file that this user may read"
        ) from err


def _shown(path: Path, authority: bytes, purpose: Purpose) -> dict[str, Any]:
    """Return what the certificate says, after a handshake in memory in which it was shown.

    The standard library judges a certificate in a handshake only.
    """
    server, client = (
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER),
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT),
    )
    client.check_hostname, client.verify_mode = False, ssl.CERT_NONE
    for context in (server, client):
        context.load_cert_chain(path, password=lambda: "")  # it must never ask a terminal
    judge = client if purpose in _SERVED else server
    judge.load_verify_locations(cadata=authority.decode("ascii"))
    judge.verify_mode = ssl.CERT_REQUIRED
    there, back = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = {
        server: server.wrap_bio(there, back, server_side=True),
        client: client.wrap_bio(back, there),
    }
    for end in (client, server) * 3:  # three flights of TLS 1.3, and one more each
        try:
            ends[end].do_handshake()
        except ssl.SSLWantReadError:
            continue
    return dict(ends[judge].getpeercert() or {})


def _contents(authority: bytes) -> list[dict[str, Any]]:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(cadata=authority.decode("ascii"))
    return list(context.get_ca_certs())


def _end(certificate: dict[str, Any]) -> datetime:
    return datetime.fromtimestamp(ssl.cert_time_to_seconds(certificate["notAfter"]), UTC)


def _common_name(path: Path, certificate: dict[str, Any]) -> str:
    names = [v for part in certificate.get("subject", ()) for k, v in part if k == "commonName"]
    try:
        return check_name(names[0] if names else "")
    except ValueError as err:
        raise FileError(f"{path}: common name in the certificate: {err}") from err


def _what_is_wrong(err: ssl.SSLError | ValueError, purpose: Purpose) -> str:
    if isinstance(err, ssl.SSLCertVerificationError):
        return {
            _EXPIRED: "the certificate has expired: `armrig pki renew` makes a new one",
            _NOT_YET: "the certificate is not valid yet: see that the clock of this machine is set",
            _PURPOSE: _other_purpose(purpose),
        }.get(err.verify_code, f"not signed by the authority in the file ({err.verify_message})")
    if isinstance(err, ssl.SSLError) and err.reason == "KEY_VALUES_MISMATCH":
        return "the key is not that of the certificate"
    return "damaged: its key or a certificate cannot be read"


def _other_purpose(purpose: Purpose) -> str:
    made_by = _MADE_BY[purpose]
    return f"the certificate is for another purpose: `{made_by}` makes the one that is needed"


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
