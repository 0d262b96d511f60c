"""The service's own wake-ups."""

from __future__ import annotations

import select
from collections.abc import Iterator
from pathlib import Path

import pytest
from armrig_daemon.config import Config
from armrig_daemon.service.service import Service


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    """Return a service that has started nothing."""
    service = Service(Config(), "unixsock-stream/nowhere", tmp_path)
    yield service
    service._signals.close()


def test_a_client_that_comes_while_the_service_looks_does_not_silence_a_later_one(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader, wake = service._signals._reader, service._signals.wake

    class Interrupted:
        def recv(self, n: int) -> bytes:
            wake()
            return reader.recv(n)

    wake()
    with monkeypatch.context() as patch:
        patch.setattr(service._signals, "_reader", Interrupted())
        service._woken()
    wake()

    assert select.select([service._signals.fd], [], [], 0)[0]
