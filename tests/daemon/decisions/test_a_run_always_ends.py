"""A run ends, whatever ends it: its file is finished, and the next one is taken.

Also where nothing is left that could confirm the stop.
"""

from __future__ import annotations

import pytest
from armrig_daemon.decisions.state import LinkDown, LinkUp, Phase
from armrig_daemon.pipe import Reset, Run, RunEnded

from tests.daemon.virtual_bench import LEASE, Bench, codes


def _playing(*, scheduled: bool) -> Bench:
    bench = Bench()
    bench.arm()
    bench.ask(
        Run, lease=LEASE, n=1, run_id="r", codes=codes(*[1.0, 4.0] * 200), scheduled=scheduled
    )
    bench.run_for(1000)
    return bench


def _is_over(bench: Bench) -> None:
    assert [ended.run_id for ended in bench.of(RunEnded)] == ["r"]
    assert bench.ask(Reset).error == ""
    assert bench.arm().error == ""
    again = bench.ask(Run, lease=LEASE, n=1, run_id="s", codes=codes(1.0, 4.0), scheduled=False)
    assert again.error == ""


@pytest.mark.parametrize("scheduled", [False, True])
def test_a_run_whose_device_is_reset_ends(*, scheduled: bool) -> None:
    bench = _playing(scheduled=scheduled)

    bench.ports.device.reset(bench.ports.now)
    bench.run_for(3000)

    assert bench.phase is Phase.FAULT
    _is_over(bench)


@pytest.mark.parametrize("scheduled", [False, True])
def test_a_run_ends_if_the_link_goes_after_the_trip(*, scheduled: bool) -> None:
    bench = _playing(scheduled=scheduled)
    sound = bench.ports.from_device
    bench.ports.from_device = lambda data: b""
    while bench.phase is not Phase.FAULT:
        bench.run_for(1)

    bench.ports.send(bench.ports.now, LinkDown("gone"))
    bench.run_for(600)
    bench.ports.from_device = sound
    bench.ports.send(bench.ports.now, LinkUp())
    bench.run_for(3000)

    _is_over(bench)
