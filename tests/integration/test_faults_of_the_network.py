"""Clients against a daemon that drives a motor: they do not read, or flood it."""

from __future__ import annotations

import pytest
from armrig_core.access.access_control import MOST_LOCAL_BYTES
from armrig_core.commands.codes import GapCode

from tests.integration.driving import (
    check_every_k,
    check_volts,
    driven,
    outcome,
    recorded,
    resident_mib,
    stranger,
)
from tests.integration.processes import Bench, freeze

pytestmark = pytest.mark.timed
MORE_MIB = 64.0
"""Memory that a client may cost the service, in MiB (R1)."""
SLOW = """
slow = session.declare_subscriber("rig/1/**", lambda sample: time.sleep(0.2))
print("there", flush=True)
time.sleep(60)
"""
HUGE = """
print("there", flush=True)
try:
    replies = list(session.get("rig/1/cmd/run", payload=bytes(int(sys.argv[2])), timeout=3))
except zenoh.ZError:
    replies = []
print(any(reply.ok for reply in replies), flush=True)
"""


def test_subscribers_that_do_not_read_cost_no_sample_of_the_run(bench: Bench) -> None:
    bench.emulate()
    daemon = bench.serve()
    with stranger(bench, SLOW), stranger(bench, SLOW) as stopped:
        freeze(stopped.pid)
        before = resident_mib(daemon.popen.pid)
        with driven(bench, samples=4000, Ts=0.001):
            recording = recorded(bench)
        grown = resident_mib(daemon.popen.pid) - before
    assert outcome(recording) == "complete"
    assert not any(gap.code == GapCode.SERVICE_LATE for gap in recording.gaps)
    check_every_k(recording)
    assert grown < MORE_MIB


@pytest.mark.parametrize("size", [MOST_LOCAL_BYTES - (1 << 20), MOST_LOCAL_BYTES + (8 << 20)])
def test_an_oversized_payload_disturbs_no_client(bench: Bench, size: int) -> None:
    bench.emulate()
    daemon = bench.serve()
    with driven(bench, samples=300), stranger(bench, HUGE, size) as client:
        assert client.stdout is not None
        assert client.stdout.readline() == "False\n"
        recording = recorded(bench)
    assert outcome(recording) == "complete"
    assert daemon.popen.poll() is None
    assert "Traceback" not in daemon.said
    check_volts(bench)
