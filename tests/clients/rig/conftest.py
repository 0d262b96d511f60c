"""The folder of the services' sockets, on a machine of a test."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import pytest
from armrig.rig import session
from armrig_core.access import daemon_lock

SERVICE_UID = 4711


@pytest.fixture
def services(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Give the folder of the services, whose user is SERVICE_UID or the caller."""
    with (
        tempfile.TemporaryDirectory(prefix="armrig-") as temporary,
        tempfile.TemporaryDirectory(prefix="armrig-") as login,
    ):
        monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
        monkeypatch.setenv("XDG_RUNTIME_DIR", login)
        services = Path(temporary) / "armrig"
        monkeypatch.setattr(session, "SERVICES", PurePosixPath(services))
        monkeypatch.setattr(daemon_lock, "service_owners", lambda: {0, SERVICE_UID, os.getuid()})
        services.mkdir()
        services.chmod(0o755)
        (services / "1").mkdir()
        (services / "1").chmod(0o750)
        yield services
