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
    read, wake = os.read, service._signals.wake

    def interrupted(fd: int, n: int) -> bytes:
        wake()
        return read(fd, n)

    wake()
    with monkeypatch.context() as patch:
        patch.setattr("armrig_core.signal_pipe.os.read", interrupted)
        service._woken()
    wake()

    assert select.select([service._signals.fd], [], [], 0)[0]
