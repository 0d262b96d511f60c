"""`armrigd estop` on a rig whose daemon is dead, and next to a live daemon."""

from __future__ import annotations

import os
import signal

from tests.integration.driving import driven
from tests.integration.processes import WITHIN_S, Bench, freeze, wait_for


def test_the_rig_of_a_dead_daemon_is_stopped(bench: Bench) -> None:
    bench.emulate()
    daemon = bench.serve()
    with driven(bench):
        loop = bench.loop_pid(daemon)
        freeze(daemon.popen.pid)  # or its end may end the loop in order
        os.kill(loop, signal.SIGKILL)
        daemon.kill()

        stop = bench.start("armrig_daemon", "estop", "--config", str(bench.config))

        assert stop.popen.wait(WITHIN_S) == 0, stop.said
    wait_for(lambda: bench.volts() == 0.0)
    bench.serve()
    assert bench.settled() == "safe"


def test_a_daemon_that_lives_is_not_disturbed(served: Bench) -> None:
    stop = served.start("armrig_daemon", "estop", "--config", str(served.config))

    assert stop.popen.wait(WITHIN_S) == 1
    assert stop.said == (
        f"armrigd: estop: nothing sent: {served.port} cannot be opened: it is in use by another "
        "program, maybe another rig's daemon; end that program, or give this rig a port of its "
        "own; `armrig stop` stops the motor of a running daemon\n"
    )
    assert served.settled() == "safe"
