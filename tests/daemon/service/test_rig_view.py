"""What the service knows of its rig: nothing is told to it but by what the loop says."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig_daemon.config import Config
from armrig_daemon.pipe import Host, State
from armrig_daemon.service.rig_view import RigView

HELD = State(t_host_ns=5, phase="armed", reason="", owner="a test", ts_us=20_000, device={"x": 1})


@pytest.fixture
def rig(tmp_path: Path) -> RigView:
    """Return the view of a rig of which nothing has been told."""
    return RigView(Config(), "unixsock-stream/s", tmp_path)


def test_before_the_loop_has_spoken_nothing_is_known(rig: RigView) -> None:
    """It is asked for its status all the same."""
    status = rig.status(None)

    assert not rig.is_known
    assert (status.phase, status.owner, status.host, status.Ts) == ("init", "", {}, 0.01)


def test_a_status_is_of_the_newest_that_the_loop_told(rig: RigView) -> None:
    """The state, and what this host gave the loop."""
    rig.note_state(State(t_host_ns=1, phase="safe", reason="", owner="", ts_us=0, device={}))
    rig.note_host(Host(granted={"fifo": 80}))
    rig.note_state(HELD)
    status = rig.status(None)

    assert rig.is_known
    assert (rig.state, rig.host) == (HELD, {"fifo": 80})
    assert (status.phase, status.owner, status.device) == ("armed", "a test", {"x": 1})
    assert (status.host, status.Ts) == ({"fifo": 80}, 0.02)
