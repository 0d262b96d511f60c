"""Floods from strangers: the holder is served, and the run ends with its holder."""

from __future__ import annotations

import json
import signal
import time

import pytest
from armrig_core.commands import commands

from tests.integration.driving import begin, last_run, stranger
from tests.integration.processes import Bench, wait_for
from tests.integration.test_dead_man import DEAD_MAN_S, LATE_S, RUNNER

pytestmark = pytest.mark.timed
FLOOD = """
name, payload = sys.argv[2:]
back, sent = [0], 0
def answered(reply):
    back[0] += 1
print("there", flush=True)
while True:
    while sent - back[0] < 30:
        session.get("rig/1/cmd/" + name, answered, payload=payload, timeout=5)
        sent += 1
    time.sleep(0.03)
"""
"""Sends a request a thousand times a second, or as often as it is answered."""


def test_run_requests_of_other_clients_do_not_prevent_the_run_of_the_holder(served: Bench) -> None:
    request = {"lease": "0" * 32, "n": 1, "u": [1.0, 2.0] * 10_000}
    with stranger(served, FLOOD, "run", json.dumps(request)), served.rig() as rig:
        rig.arm("a test", Ts=0.01)
        rig._ask(commands.RunRequest(**rig._stamp(), u=[1.0] * 500), commands.RunAccepted)
        wait_for(lambda: served.volts() > 0)
        rig.stop()
        wait_for(lambda: served.volts() == 0)


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("status", {}),
        ("renew", {"lease": "0" * 32, "n": 1}),
    ],
)
def test_a_flood_hides_neither_the_signs_nor_the_end_of_a_client(
    served: Bench, name: str, fields: dict[str, object]
) -> None:
    """There are three attempts.

    On a busy machine such a flood delays the emulator, and the device's watchdog ends the run
    before its client does.
    """
    for _ in range(3):
        took_s, last = _killed_in_a_flood(served, name, fields)
        if "stopped by itself: WATCHDOG" not in last.outcome:
            break
        with served.rig() as rig:
            rig.reset()

    assert last.outcome == "its client went away: no sign of it for 0.6 s"
    assert 0.2 < took_s < DEAD_MAN_S + LATE_S


def _killed_in_a_flood(
    bench: Bench, name: str, fields: dict[str, object]
) -> tuple[float, commands.LastRun]:
    """Return when a run whose client is killed came to 0 V, in s after that, and how it ended."""
    client = begin(bench, 50, RUNNER, "1000", "scheduled", str(DEAD_MAN_S))
    try:
        with stranger(bench, FLOOD, name, json.dumps(fields)):
            time.sleep(2 * DEAD_MAN_S)
            client.send_signal(signal.SIGKILL)
            took_s = bench.went_to_0_v_after(time.monotonic_ns())
    finally:
        client.kill()
        client.wait()
    return took_s, last_run(bench)
