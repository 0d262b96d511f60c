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

    pid = served.processes[1].popen.pid
    assert stop.popen.wait(WITHIN_S) == 1
    assert stop.said == (
        f"armrigd: estop: nothing sent: the daemon of rig 1 (process {pid}) has opened "
        f"{served.port}: `armrig stop` or `kill {pid}` stops the motor\n"
    )
    assert served.settled() == "safe"


def test_a_stop_reaches_the_device_of_a_dead_daemon(bench: Bench) -> None:
    bench.emulate()
    daemon = bench.serve()
    with driven(bench):
        loop = bench.loop_pid(daemon)
        freeze(daemon.popen.pid)  # or its end may end the loop in order
        os.kill(loop, signal.SIGKILL)
        daemon.kill()
        daemon.popen.wait(WITHIN_S)

        stop = bench.armrig("stop")

    dead = f"its daemon (process {daemon.popen.pid}) is dead"
    assert (stop.returncode, stop.stdout) == (
        0,
        f"rig 1, motor: at 0 V by `armrigd estop`; {dead}; start it again, then `armrig reset`\n",
    )
    wait_for(lambda: bench.volts() == 0.0)


def test_a_stop_reaches_a_daemon_whose_socket_was_deleted_in_a_run(bench: Bench) -> None:
    bench.emulate()
    daemon = bench.serve()
    with driven(bench):
        (bench.folder / "armrig" / "1.sock").unlink()

        stop = bench.armrig("stop")

        assert stop.stdout == "rig 1, motor: at 0 V, as the device reports\n", stop.stderr
        assert bench.volts() == 0.0
    assert "1.sock: another program deleted this socket; it is open again" in daemon.said
