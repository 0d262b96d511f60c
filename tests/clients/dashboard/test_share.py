"""The certificate for visitors: what it is valid for, and how long its files exist."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

import pytest
from armrig.dashboard.share import certificate, qr_code


@pytest.mark.parametrize("address", ["192.0.2.7", "2001:db8::7"])
def test_a_temporary_certificate_is_for_its_address_and_two_days(
    address: str,
) -> None:
    x509 = pytest.importorskip("cryptography.x509", reason="no cryptography")
    hashes = pytest.importorskip("cryptography.hazmat.primitives.hashes", reason="no cryptography")
    with certificate(address) as made:
        found = x509.load_pem_x509_certificate(made.certificate.read_bytes())
        folder = made.key.parent
        assert made.key.read_bytes().startswith(b"-----BEGIN PRIVATE KEY")
        assert folder.stat().st_mode & 0o777 == 0o700

    now = datetime.now(UTC)
    assert now - found.not_valid_before_utc == pytest.approx(
        timedelta(hours=1), abs=timedelta(minutes=5)
    )
    assert found.not_valid_after_utc - now == pytest.approx(
        timedelta(days=2), abs=timedelta(minutes=5)
    )
    names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert list(names.get_values_for_type(x509.IPAddress)) == [ip_address(address)]
    assert not found.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    assert made.fingerprint == ":".join(f"{b:02X}" for b in found.fingerprint(hashes.SHA256()))
    assert not Path(folder).exists()


def test_a_longer_address_gives_a_larger_qr_code() -> None:
    pytest.importorskip("segno", reason="no segno")

    assert len(qr_code("https://192.0.2.7:8808/#token=" + 40 * "x")) > len(qr_code("x")) > 100
