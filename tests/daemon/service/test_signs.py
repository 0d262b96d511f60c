"""Signs of a run's client on their way through a real session: each is of when it came."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import msgspec
from armrig.rig.session import open_session
from armrig_core.commands import Renew, Run
from armrig_core.topics import command_key
from armrig_daemon.config import Config
from armrig_daemon.service.client_watchdog import begun
from armrig_daemon.service.commands import Commands
from armrig_daemon.service.publish import Session
from armrig_daemon.service.rig_view import RigView
from armrig_daemon.service.runs import Runs

from tests.daemon.loop_ends import LoopEnds

LEASE = "a" * 32
PERIOD_S = 2.0
RUN = Run(lease=LEASE, n=3, u=[1.0], dead_man=PERIOD_S)


def test_a_sign_that_waited_for_the_service_is_of_when_it_came(tmp_path: Path) -> None:
    """Otherwise a client that died while the service was busy would count as alive for longer."""
    endpoint = f"unixsock-stream/{tmp_path}/s"
    has_come = threading.Event()
    sign = msgspec.json.encode(Renew(lease=LEASE, n=4))
    config, loop = Config(), LoopEnds()
    rig = RigView(config, endpoint, tmp_path)
    runs = Runs(config, tmp_path, lambda: None)
    runs._presence = begun(RUN, 0.0)  # as good as gone
    with Session(endpoint, "1", has_come.set) as session:
        commands = Commands(
            config, rig, runs, session, loop.child, lambda *_: None, lambda *_: None
        )
        commands.note_lease(LEASE)
        with open_session(endpoint, rig="1") as client:
            sent_s = time.monotonic()
            replies = client.get(command_key("1", Renew.name), payload=sign)
            assert has_come.wait(30)
            come_s = time.monotonic()

            commands.serve_signs()

            assert next(iter(replies)).ok is not None
    loop.close()
    assert sent_s + PERIOD_S <= runs.client_gone_s <= come_s + PERIOD_S
