"""A run that its client no longer waits for does not begin: not after a router, a disk, a model."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from contextlib import closing

import numpy as np
import pytest
from armrig.rig.client import Rig, RigError
from armrig.rig.replies import RefusedError
from armrig_core.commands.commands import RunAccepted, RunRequest
from armrig_core.process.standstill import boot_ns

from tests.integration.fleet_lab import FleetLab
from tests.integration.processes import Bench, freeze, wait_for
from tests.integration.test_slow_calls import SlowCalls

pytestmark = [pytest.mark.timed, pytest.mark.exhaustive]
ORDERS = 10
_VALID_NS = 500_000_000
SLOW_MODEL = """
import time
import armrig
def f(t, x, u, p):
    time.sleep(0.01)
    return [u[0] - x[0]]
model = armrig.Ode(f, output=lambda t, x, u, p: x[0], states=["level"], parameters={})
"""
DESCRIPTION = """
[rig]
name = "slow"
[outputs.level]
unit = "V"
zero_counts = 6000.0
per_count = 7.6e-5
[model]
file = "slow.py"
"""


def _order(
    rig: Rig, before: Callable[[], None] = lambda: None
) -> tuple[threading.Thread, list[str]]:
    """Arm, then send a run whose client waits half a second; return its sender, and its refusal.

    `before` is called between the two.
    """
    rig.arm("a test", Ts=0.01)
    before()
    stamp = rig._stamp() | {"valid_until_ns": boot_ns() + (rig._ahead_ns or 0) + _VALID_NS}
    run, told = RunRequest(**stamp, u=[2.0] * 200), list[str]()

    def ask() -> None:
        try:
            rig._ask(run, RunAccepted)
            told.append("accepted")
        except RefusedError as err:
            told.append(err.code)
        except RigError:
            told.append("no reply")

    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    return thread, told


def _never_begins(bench: Bench, changes: int) -> None:
    time.sleep(0.3)  # a run would begin at once
    assert len(bench.voltage_changes()) == changes
    with bench.rig() as rig:
        assert rig.status().last_run is None
        rig.stop()
        wait_for(lambda: rig.status().phase == "safe")
    assert [*bench.recordings.glob("*")] == []


def test_no_run_begins_after_a_slow_disk(bench: Bench) -> None:
    with closing(SlowCalls(bench)) as slow:
        changes = len(bench.voltage_changes())
        for _ in range(ORDERS):
            with bench.rig() as rig:
                slow.choose("mkdir", 2)  # the first is of `arm`
                thread, told = _order(rig)
                wait_for(lambda: slow.shared.waits)
                time.sleep(0.8)
                slow.shared.number = 0
                thread.join()
                assert told == ["expired"]
                rig._lease = ""
            _never_begins(bench, changes)


def test_no_run_begins_after_a_slow_rehearsal(bench: Bench) -> None:
    _described(bench)
    changes = len(bench.voltage_changes())
    for _ in range(ORDERS):
        with bench.rig() as rig:
            thread, told = _order(rig)
            thread.join()
            assert told == ["expired"]
            rig._lease = ""
        _never_begins(bench, changes)


def test_a_client_that_waits_keeps_the_rig_armed_and_a_stop_ends_its_rehearsal(
    bench: Bench,
) -> None:
    _described(bench)
    ended: list[str] = []

    def run() -> None:
        with bench.rig() as rig:
            rig.arm("a test", Ts=0.01)
            try:
                rig.run(np.full(2000, 1.0))
            except RigError as err:
                ended.append(str(err))

    thread = threading.Thread(target=run, daemon=True)
    with bench.rig() as other:
        thread.start()
        wait_for(lambda: other.status().phase == "armed")
        time.sleep(11)  # without a sign of its client the rig is disarmed after 10 s
        assert other.status().phase == "armed"
        begun_s = time.monotonic()
        other.stop("anna")
        thread.join()
        assert time.monotonic() - begun_s < 5
        assert ended == ["the run did not begin: stopped by anna"]
        assert other.status().last_run is None
    assert [*bench.recordings.glob("*")] == []
    assert bench.volts() == 0


def _described(bench: Bench) -> None:
    (bench.folder / "slow.py").write_text(SLOW_MODEL)
    (bench.folder / "slow.toml").write_text(DESCRIPTION)
    bench.emulate()
    bench.configure(more=f'[rig]\nfile = "{bench.folder}/slow.toml"')
    bench.forks = None
    bench.serve()


def test_no_run_begins_after_a_router_that_stood_still(bench: Bench) -> None:
    lab = FleetLab(bench.folder, rigs=("1",))
    router = lab.serve(bench)
    changes = len(bench.voltage_changes())
    for _ in range(ORDERS):
        with lab.alice() as rig:
            thread, told = _order(rig, before=lambda: freeze(router.popen.pid))
            time.sleep(0.8)
            router.kill(signal.SIGCONT)
            thread.join()
            assert told == ["expired"]
            rig._lease = ""
        _never_begins(bench, changes)
