"""Identity on the network: a key, its certificate, and the authority that signed it.

One PEM file contains all three, in this order; `armrig pki` writes such files. The file is checked
before zenoh uses it, because zenoh reports any defect only as a failed connection.
"""

from __future__ import annotations

import base64
import os
import re
import ssl
import stat
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from shlex import quote
from typing import Any, Literal

from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import CONFIGURATION_LIMIT, read_bounded
from armrig_core.process.printable import printable

Purpose = Literal["rig", "client", "router", "rig at a router"]
"""Purpose of a certificate: to listen as a rig or router, or to connect as a client or rig."""
ROUTER = "router"
"""Common name in a router's certificate."""
RIG_PREFIX = "rig-"
"""First characters of the common name in a rig's certificate."""

_MADE_BY = {
    "rig": "armrig pki rig",
    "client": "armrig pki operator",
    "router": "armrig pki router",
    "rig at a router": "armrig pki rig",
}
_SERVER_PURPOSES = ("rig", "router")
_BLOCK = re.compile(rb"-----BEGIN ([A-Z0-9 ]+)-----.*?-----END \1-----\n?", re.DOTALL)
_NAME = re.compile(r"[a-z0-9-]{1,40}")
# X509_V_ERR_… of OpenSSL, x509_vfy.h
_NOT_YET, _EXPIRED, _PURPOSE = 9, 10, 26
_NO_CHECK_TIME = 0x200000  # X509_V_FLAG_NO_CHECK_TIME


@dataclass(frozen=True, slots=True, kw_only=True)
class Credential:
    """A key, its certificate, and the certificate of the authority that signed it."""

    name: str
    """Common name of the certificate."""
    begins: datetime
    """Time from which the certificate is valid."""
    expires: datetime
    """Time at which the certificate or its authority's certificate expires, whichever is first."""
    key: bytes
    """Private key, as PEM; the certificates are also PEM."""
    certificate: bytes
    authority: bytes

    def tls(self, side: Literal["listen", "connect"]) -> dict[str, Any]:
        """Return zenoh's `transport/link/tls`, which requires a certificate at both ends of a link.

        zenoh ends a link when the certificate of the other side expires. A client that connects
        again in the last second of its certificate can keep this link.
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
    """Return `name`; raise ValueError if the name cannot be part of a zenoh key.

    The name identifies a person or a program in the daemon's access list, and in the zenoh keys of
    this client's commands.
    """
    if not _NAME.fullmatch(name):
        raise InputError(f"name '{printable(name)}': use 1 to 40 characters, each a-z, 0-9 or -")
    return name


def rig_name(rig: str) -> str:
    """Return the common name in a rig's certificate, such as rig-1."""
    return f"{RIG_PREFIX}{rig}"


def require_private(path: Path, inode: os.stat_result) -> None:
    """Refuse a key's file that users other than its owner may read or change.

    The file's group may not read the file either: for a service, this group contains all people who
    may operate the service.
    """
    if os.name != "posix" or not inode.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        return
    remedy = f"chmod 400 {quote(str(path))}"
    if inode.st_uid != os.geteuid():
        remedy = f"chown {_this_user()} {quote(str(path))} && {remedy}"
    raise FileError(
        f"{path}: with mode {stat.S_IMODE(inode.st_mode):04o} other users can read or change the "
        f"key; allowed is 0400 or 0600: `{remedy}`"
    )


def _this_user() -> str:
    from pwd import getpwuid  # Windows has none

    try:
        return getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


def read_credential(path: Path, purpose: Purpose) -> Credential:
    """Return the credential in a file; it must be valid now and for `purpose`.

    Raises FileError if the file cannot be read, other users can read it, or a part of it is
    missing. It also raises FileError if the key does not belong to the certificate. The authority
    in the file must have signed the certificate, which must be valid now and have this purpose.
    """
    data = _read(path, purpose)
    blocks = [(match[1], match[0]) for match in _BLOCK.finditer(data)]
    keys = [text for label, text in blocks if label.endswith(b"PRIVATE KEY")]
    certificates = [text for label, text in blocks if label == b"CERTIFICATE"]
    if len(keys) != 1 or len(certificates) < 2:
        raise FileError(
            f"{path}: {len(keys)} private keys and {len(certificates)} certificates; needed are a "
            "key, its certificate and the authority's certificate: "
            f"`{_MADE_BY[purpose]}` writes them"
        )
    if b"ENCRYPTED" in keys[0]:
        raise FileError(f"{path}: the key is encrypted; a key without a passphrase is needed")
    authority = certificates[-1]
    try:
        contents = _certificate(path, authority, purpose)
        authorities = _contents(authority)
    except (ssl.SSLError, ValueError) as err:
        wrong = _what_is_wrong(err, purpose)
        if getattr(err, "verify_code", 0) == _NOT_YET:
            with suppress(ssl.SSLError):  # another part of the certificate is wrong, too
                begins = _time(_certificate(path, authority, purpose, _NO_CHECK_TIME), "notBefore")
                wrong = f"the certificate is not valid before {utc(begins)}: check the clock"
        raise FileError(f"{path}: {wrong}") from err
    ends = (_time(certificate, "notAfter") for certificate in (contents, *authorities))
    name = _common_name(path, contents)
    if purpose == "client" and name.startswith(RIG_PREFIX):  # a rig's certificate, for a router
        raise FileError(f"{path}: {_other_purpose(purpose)}")
    return Credential(
        name=name,
        begins=_time(contents, "notBefore"),
        expires=min(ends),
        key=keys[0],
        certificate=b"".join(certificates[:-1]),
        authority=authority,
    )


def _read(path: Path, purpose: Purpose) -> bytes:
    try:
        return read_bounded(path, CONFIGURATION_LIMIT, partial(require_private, path))
    except FileNotFoundError as err:
        raise FileError(f"{path}: there is no such file; `{_MADE_BY[purpose]}` writes one") from err
    except OSError as err:
        raise FileError(f"{path}: {err.strerror}; choose a file that this user may read") from err


def _certificate(path: Path, authority: bytes, purpose: Purpose, flags: int = 0) -> dict[str, Any]:
    """Return the contents of the certificate; only a handshake, here in memory, verifies it."""
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    client = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    client.check_hostname, client.verify_mode = False, ssl.CERT_NONE
    for context in (server, client):
        context.load_cert_chain(path, password=lambda: "")  # never ask for one at a terminal
    judge = client if purpose in _SERVER_PURPOSES else server
    judge.load_verify_locations(cadata=authority.decode("ascii"))
    judge.verify_mode = ssl.CERT_REQUIRED
    judge.verify_flags |= flags
    there, back = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = {
        server: server.wrap_bio(there, back, server_side=True),
        client: client.wrap_bio(back, there),
    }
    for end in (client, server) * 3:  # TLS 1.3 has three flights; one more for each end
        try:
            ends[end].do_handshake()
        except ssl.SSLWantReadError:
            continue
    return dict(ends[judge].getpeercert() or {})


def _contents(authority: bytes) -> list[dict[str, Any]]:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(cadata=authority.decode("ascii"))
    return list(context.get_ca_certs())


def _time(certificate: dict[str, Any], field: str) -> datetime:
    return datetime.fromtimestamp(ssl.cert_time_to_seconds(certificate[field]), UTC)


def utc(time: datetime) -> str:
    """Return a time in UTC, as text for a person."""
    return f"{time:%Y-%m-%d %H:%M} UTC"


def _common_name(path: Path, certificate: dict[str, Any]) -> str:
    names = [v for part in certificate.get("subject", ()) for k, v in part if k == "commonName"]
    try:
        return check_name(names[0] if names else "")
    except ValueError as err:
        raise FileError(f"{path}: common name in the certificate: {err}") from err


def _what_is_wrong(err: ssl.SSLError | ValueError, purpose: Purpose) -> str:
    if isinstance(err, ssl.SSLCertVerificationError):
        return {
            _NOT_YET: "the certificate is not valid yet: check the clock of this machine",
            _EXPIRED: "the certificate has expired: `armrig pki renew` makes a new one",
            _PURPOSE: _other_purpose(purpose),
        }.get(err.verify_code, f"not signed by the authority in the file ({err.verify_message})")
    if isinstance(err, ssl.SSLError) and err.reason == "KEY_VALUES_MISMATCH":
        return "the key does not belong to the certificate"
    return "its key or a certificate is damaged"


def _other_purpose(purpose: Purpose) -> str:
    made_by = _MADE_BY[purpose]
    return f"the certificate has another purpose; `{made_by}` makes the needed certificate"


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
