"""Why no connection to a rig over a network came about: zenoh only says that there is none."""

from __future__ import annotations

import socket
import ssl
from pathlib import Path

from armrig_core.credential import Credential

LONGEST_S = 3.0
"""How long each step may take."""
_LISTENS_S = 1.0  # a certificate is refused after the handshake, in TLS 1.3
# X509_V_ERR_… of OpenSSL, x509_vfy.h
_EXPIRED, _OTHER_HOST = 10, (62, 64)
_SILENT = "nothing answers: see that the host is on, and that no firewall stands between"


def why_not_connected(host: str, port: int, credential: Credential, path: Path) -> str:
    """Return what is wrong and what to do, found by a handshake of our own; "" where it goes well.

    Parameters
    ----------
    host, port
        Of the rig's daemon.
    credential : Credential
        What is shown to it.
    path : Path
        Its file.
    """
    try:
        line = socket.create_connection((host, port), timeout=LONGEST_S)
    except socket.gaierror:
        return f"there is no host {host}: see how it is spelt"
    except ConnectionRefusedError:
        listener = "armrigd runs, with [access], or `armrig router`"
        return f"nobody listens at port {port} of {host}: see that {listener}"
    except TimeoutError:
        return _SILENT
    except OSError as err:
        return f"{err.strerror or err}: see that {host} can be reached from here"
    with line:
        try:
            connected = _context(credential, path).wrap_socket(line, server_hostname=host)
        except ssl.SSLCertVerificationError as err:
            return _of_its_certificate(err, host)
        except OSError:  # ssl.SSLError and TimeoutError are of them
            return "what listens there does not speak TLS 1.3: see that its [access] listen is tls/"
        with connected:
            return _answer_to_ours(connected, credential)


def _context(credential: Credential, path: Path) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.load_verify_locations(cadata=credential.authority.decode("ascii"))
    context.load_cert_chain(path)
    return context


def _answer_to_ours(connected: ssl.SSLSocket, credential: Credential) -> str:
    """Return why it refuses our certificate; "" where it waits for what we have to say."""
    connected.settimeout(_LISTENS_S)
    try:
        connected.recv(1)
    except TimeoutError:
        return ""
    except ssl.SSLError as err:
        alert = (err.reason or "").rpartition("ALERT_")[2].replace("_", " ").lower()
        return (
            f"it refuses the certificate of {credential.name} ({alert}): see whether both are of "
            "the same authority, and whether its clock is set"
        )
    except OSError:
        return ""
    return ""


def _of_its_certificate(err: ssl.SSLCertVerificationError, host: str) -> str:
    if err.verify_code in _OTHER_HOST:
        return (
            f"its certificate is not for {host}: take a name that is in it, or have another made "
            f"by `armrig pki rig ID --host {host}`"
        )
    if err.verify_code == _EXPIRED:
        return "its certificate has expired: `armrig pki renew` makes a new one"
    return (
        f"its certificate is not of the authority that signed yours ({err.verify_message}): it is "
        "another laboratory's, or a stranger's"
    )
