"""Stops of a rig whose daemon is dead, whose daemon lives, and whose daemon's socket is gone."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

from tests.integration.driving import driven
from tests.integration.processes import WITHIN_S, Bench, freeze, wait_for


@contextmanager
def _dead(bench: Bench) -> Iterator[int]:
    """Give the process id of a daemon that was killed during a run."""
    bench.emulate()
    daemon = bench.serve()
    with driven(bench):
        loop = bench.loop_pid(daemon)
        freeze(daemon.popen.pid)  # or its end may end the loop in order
        os.kill(loop, signal.SIGKILL)
        daemon.kill()
        daemon.popen.wait(WITHIN_S)
        yield daemon.popen.pid
    wait_for(lambda: bench.volts() == 0.0)


def test_an_estop_stops_the_rig_of_a_dead_daemon(bench: Bench) -> None:
    with _dead(bench):
        stop = bench.start("armrig_daemon", "estop", "--config", str(bench.config))

        assert stop.popen.wait(WITHIN_S) == 0, stop.said
    bench.serve()
    assert bench.settled() == "safe"


def test_a_stop_reaches_the_device_of_a_dead_daemon(bench: Bench) -> None:
    with _dead(bench) as pid:
        stop = bench.armrig("stop")

    dead = f"its daemon (process {pid}) is dead"
    assert (stop.returncode, stop.stdout) == (
        0,
        f"rig 1, motor: at 0 V by `armrigd estop`; {dead}; start it again, then `armrig reset`\n",
    )


def test_an_estop_does_not_disturb_a_living_daemon(served: Bench) -> None:
    stop = served.start("armrig_daemon", "estop", "--config", str(served.config))

    pid = served.daemon.popen.pid
    assert stop.popen.wait(WITHIN_S) == 1
    assert stop.said == (
        f"armrigd: estop: nothing sent: the daemon of rig 1 (process {pid}) has opened "
        f"{served.port}: `armrig stop` or `kill {pid}` stops the motor\n"
    )
    assert served.settled() == "safe"


def test_a_stop_reaches_a_daemon_whose_socket_was_deleted_in_a_run(bench: Bench) -> None:
    bench.emulate()
    daemon = bench.serve()
    with driven(bench):
        (bench.folder / "armrig" / "1.sock").unlink()

        stop = bench.armrig("stop")

        assert stop.stdout == "rig 1, motor: at 0 V, as the device reports\n", stop.stderr
        assert bench.volts() == 0.0
    assert "1.sock: another program deleted this socket; it is open again" in daemon.said
