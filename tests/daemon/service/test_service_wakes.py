"""The service's own wake-ups."""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from armrig_daemon.config import Config
from armrig_daemon.service.service import Service

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    """Return a service that has started nothing."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield Service(Config(), "unixsock-stream/nowhere", tmp_path)
    signal.set_wakeup_fd(-1)
    for number, handler in before.items():
        signal.signal(number, handler)


def test_who_comes_while_the_service_looks_does_not_silence_who_comes_later(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its sign is read with those before it; the next one must be given all the same."""
    read = os.read

    def interrupted(fd: int, n: int) -> bytes:
        service._wake()
        return read(fd, n)

    service._wake()
    with monkeypatch.context() as patch:
        patch.setattr("armrig_daemon.service.service.os.read", interrupted)
        service._woken()
    service._wake()

    assert select.select([service._wake_fd], [], [], 0)[0]
