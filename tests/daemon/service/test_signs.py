"""Signs of a run's client on their way through a real session: each is of when it came."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from armrig.rig.session import open_session
from armrig_core.commands import Renew, Run
from armrig_core.topics import command_key
from armrig_daemon.config import Config
from armrig_daemon.service.presence import begun
from armrig_daemon.service.publish import Session
from armrig_daemon.service.service import Service

LEASE = "a" * 32
PERIOD_S = 2.0
RUN = Run(lease=LEASE, n=3, u=[1.0], dead_man=PERIOD_S)
SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    """Return a service that has started nothing; its client is as good as gone."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    service = Service(Config(), "unixsock-stream/nowhere", tmp_path)
    service._runs._presence = begun(RUN, 0.0)
    yield service
    signal.set_wakeup_fd(-1)
    for number, handler in before.items():
        signal.signal(number, handler)


def test_a_sign_that_waited_for_the_service_is_of_when_it_came(
    service: Service, tmp_path: Path
) -> None:
    """Else a client that died while the service was busy would count as alive for longer."""
    endpoint = f"unixsock-stream/{tmp_path}/s"
    has_come = threading.Event()
    sign = msgspec.json.encode(Renew(lease=LEASE, n=4))
    with Session(endpoint, "1", has_come.set) as session:
        session.lease = LEASE.encode()
        service._session = session
        with open_session(endpoint, rig="1") as client:
            sent_s = time.monotonic()
            replies = client.get(command_key("1", Renew.name), payload=sign)
            assert has_come.wait(5)
            come_s = time.monotonic()

            service._take_signs()

            assert next(iter(replies)).ok is not None
    assert sent_s + PERIOD_S <= service._runs.client_gone_s <= come_s + PERIOD_S
