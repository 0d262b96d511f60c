"""A client whose link to the rig is lost during a run, through a router that is killed."""

from __future__ import annotations

import time
from contextlib import nullcontext, suppress
from dataclasses import replace

import armrig
import pytest
from armrig.rig.client import Rig
from armrig.rig.collection import Shown, collect
from armrig.rig.session import LostLinkError, NoReplyError

from tests.clients.fake_daemon import step_plan
from tests.integration.driving import last_run
from tests.integration.fleet_lab import WITHIN_S, FleetLab
from tests.integration.processes import Bench, Process, wait_for

DEAD_MAN_S = 1.0
LATE_S = 0.5
"""Allowance for a busy machine, in s."""
KILLED_AT = 50


@pytest.fixture
def lab(bench: Bench) -> FleetLab:
    """Give a lab whose first rig is that of the bench."""
    lab = FleetLab(bench.folder, rigs=("1",))
    bench.configure(watchdog_ms=250, more=lab.access("1"))
    return lab


@pytest.fixture
def router(bench: Bench, lab: FleetLab) -> Process:
    """Give the lab's router."""
    return bench.start("armrig", *lab.router_command())


@pytest.fixture
def connect(bench: Bench, lab: FleetLab, router: Process, monkeypatch: pytest.MonkeyPatch) -> str:
    """Give the endpoint at which alice reaches the rig through the router."""
    monkeypatch.setenv("ARMRIG_CLIENT_CERTIFICATE", str(lab.made / "alice.pem"))
    bench.emulate()
    bench.serve()

    def answers() -> bool:
        with suppress(NoReplyError), Rig("1", connect=lab.endpoint) as rig:
            return bool(rig.status())
        return False  # the router or the daemon has not come yet

    wait_for(answers, WITHIN_S)
    return lab.endpoint


def _killing(router: Process) -> Shown:
    """Return a display of a run's progress that kills the router once."""
    killed: list[int] = []

    def progress(done: int, total: int) -> None:
        if done > KILLED_AT and not killed:
            killed.append(done)
            router.kill()
            router.popen.wait()

    return lambda *_: nullcontext(progress)


def test_a_run_is_complete_if_its_router_returns(
    connect: str, router: Process, bench: Bench, lab: FleetLab
) -> None:
    told: list[str] = []

    def tell(sentence: str) -> None:
        told.append(sentence)
        if "link lost" in sentence:
            bench.start("armrig", *lab.router_command())

    plan = replace(step_plan("a test", seconds=4), dead_man=60)
    done = collect(plan, rig="1", connect=connect, tell=tell, display=_killing(router))

    assert armrig.load(done.path).N == done.samples == 400
    assert (outcome := armrig.load(done.path).outcome) is not None
    assert outcome.outcome == "complete"
    _, lost, back = told  # after the rehearsal
    assert "link lost after " in lost
    assert "the motor may turn until " in lost
    assert back == "rig 1 answers again: waiting for the end of the run"


@pytest.mark.timed
def test_a_client_that_lost_its_link_ends_after_its_dead_man_time(
    connect: str, router: Process, bench: Bench
) -> None:
    lost_ns: list[int] = []

    def tell(sentence: str) -> None:
        if "link lost" in sentence:
            lost_ns.append(time.monotonic_ns())

    plan = replace(step_plan("a test", seconds=60), dead_man=DEAD_MAN_S)
    with pytest.raises(LostLinkError) as ended:
        collect(plan, rig="1", connect=connect, tell=tell, display=_killing(router))

    assert ", and did not return; by its dead-man the rig stopped the motor at " in str(ended.value)
    assert len(lost_ns) == 1
    assert bench.went_to_0_v_after(lost_ns[0]) < DEAD_MAN_S + LATE_S
    assert last_run(bench).outcome == "its client went away: no sign of it for 1 s"
