"""Why no connection to a rig over a network came about: zenoh only says that there is none."""

from __future__ import annotations

import socket
import ssl
from pathlib import Path

from armrig_core.credential import Credential

_LONGEST_S = 3.0
_WAIT_S = 1.0  # a certificate is refused after the handshake, in TLS 1.3
_OTHER_HOST = (62, 64)  # X509_V_ERR_HOSTNAME_MISMATCH, X509_V_ERR_IP_ADDRESS_MISMATCH
_EXPIRED = 10


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
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.load_verify_locations(cadata=credential.authority.decode("ascii"))
    context.load_cert_chain(path)
    try:
        with (
            socket.create_connection((host, port), timeout=_LONGEST_S) as line,
            context.wrap_socket(line, server_hostname=host) as connected,
        ):
            connected.settimeout(_WAIT_S)
            connected.recv(1)
    except ssl.SSLCertVerificationError as err:
        return _of_its_certificate(err, host)
    except TimeoutError as err:
        return "" if "handshake" not in str(err) and "read" in str(err) else _SILENT
    except ssl.SSLError as err:
        if "ALERT" in (err.reason or ""):
            return (
                f"it refuses the certificate of {credential.name} ({_alert(err)}); see whether "
                "both are of the same authority, and whether its clock is set"
            )
        return "what listens there does not speak TLS 1.3: see that its [access] listen is tls/"
    except socket.gaierror:
        return f"there is no host {host}: see how it is spelt"
    except ConnectionRefusedError:
        return f"nobody listens at port {port} of {host}: see that armrigd runs, with [access]"
    except OSError as err:
        return f"{err.strerror or err}: see that {host} can be reached from here"
    return ""


_SILENT = "nothing answers: see that the host is on, and that no firewall stands between"


def _of_its_certificate(err: ssl.SSLCertVerificationError, host: str) -> str:
    if err.verify_code in _OTHER_HOST:
        return (
            f"its certificate is not for {host}: take a name that is in it, or make another by "
            f"`armrig pki rig ID --host {host}`"
        )
    if err.verify_code == _EXPIRED:
        return "its certificate has expired: `armrig pki renew` on its side makes a new one"
    return (
        f"its certificate is not of the authority that signed yours ({err.verify_message}): it "
        "is another laboratory's, or a stranger's"
    )


def _alert(err: ssl.SSLError) -> str:
    return (err.reason or "").rpartition("ALERT_")[2].replace("_", " ").lower()
