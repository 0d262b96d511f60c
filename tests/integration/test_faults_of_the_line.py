"""Faults of the line between daemon and device, during a run.

The witness at the motor's terminals is the emulator's.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from armrig.rig.replies import RefusedError

from tests.integration.driving import (
    STOPPED_S,
    check_every_k,
    check_volts,
    driven,
    outcome,
    recorded,
    samples,
)
from tests.integration.fork_server import ForkServer
from tests.integration.processes import Bench, settled, wait_for
from tests.integration.relay import Relay
from tests.sampling import sampled


@pytest.fixture(scope="module")
def _connected(
    tmp_path_factory: pytest.TempPathFactory, forks: ForkServer
) -> Iterator[tuple[Bench, Relay]]:
    bench = Bench(tmp_path_factory.mktemp("line"), forks, terminal=True)
    bench.emulate()
    relay = Relay(bench.port, bench.folder / "line")
    bench.port = bench.folder / "line"
    bench.configure()
    bench.serve()
    yield bench, relay
    relay.end()
    bench.end()


@pytest.fixture
def bench(_connected: tuple[Bench, Relay]) -> Bench:
    """Give the rig and the daemon that all tests here share: at 0 V, without a holder."""
    bench, relay = _connected
    relay.do("ends")
    with bench.rig() as rig:
        wait_for(lambda: rig.status().device and rig.status().phase in ("safe", "fault"))
        rig.reset()
        wait_for(lambda: rig.status().phase == "safe")
    return bench


@pytest.fixture
def line(_connected: tuple[Bench, Relay]) -> Relay:
    """Give the line between the daemon and its device."""
    return _connected[1]


def _stays_at_0_v_but_samples_again(bench: Bench) -> None:
    """T1 and S6: by itself, disarmed; only a reset, then arm, leads out."""
    with bench.rig() as rig:
        wait_for(lambda: bool(rig.status().device))
        k = next(samples(rig)).k
        assert next(samples(rig)).k > k
        assert settled(rig) == "fault"
        with pytest.raises(RefusedError, match="in fault"):
            rig.arm("a test")
        assert bench.volts() == 0.0
        rig.reset()
        assert settled(rig) == "safe"


@pytest.mark.parametrize("pacing", ["scheduled", "exchange"])
def test_a_pulled_cable_stops_the_run_at_0_v(bench: Bench, line: Relay, pacing: str) -> None:
    """The master of the pty is closed."""
    with driven(bench, pacing=pacing):
        pulled_ns = line.do("unplug")

        assert bench.went_to_0_v_after(pulled_ns) < STOPPED_S
        assert "is gone" in outcome(recorded(bench))
        line.do("plug")
        _stays_at_0_v_but_samples_again(bench)
    check_volts(bench)


@pytest.mark.parametrize("fault", ["stop_reading", "stop_answering"])
def test_a_failure_of_one_direction_stops_the_run(bench: Bench, line: Relay, fault: str) -> None:
    """S4: no answer is no fresh round trip."""
    with driven(bench, pacing="exchange"):
        failed_ns = line.do(fault)

        assert bench.went_to_0_v_after(failed_ns) < STOPPED_S
        recording = recorded(bench)
        time.sleep(1.0)  # the host goes on asking who is there: more waits in the line
        line.do("ends")
        _stays_at_0_v_but_samples_again(bench)
    assert "no answer from the device" in outcome(recording)
    check_every_k(recording)
    check_volts(bench)


@pytest.mark.parametrize("noise", sampled(["flip", "garbage", "cut"]))
def test_noise_on_the_line_does_not_drive_the_motor(bench: Bench, line: Relay, noise: str) -> None:
    """Either way, one piece of twenty is spoilt."""
    with driven(bench), bench.rig() as rig:
        line.do(noise)
        time.sleep(2.0)
        line.do("ends")
        rig.stop()

        recording = recorded(bench)
    check_volts(bench)
    check_every_k(recording)
    # A frame of ours that is cut spoils the next one, too: the third in a row trips.
    assert recording.missing > 0 or "no answer from the device" in outcome(recording)
    applied = recording.samples["u_applied_v"]
    assert np.abs(applied[:, None] - [0.0, 1.0, 4.0]).min(axis=1).max() <= 5 / 1024


def test_a_reset_of_the_device_stops_the_run(bench: Bench, line: Relay) -> None:
    with driven(bench):
        reset_ns = line.do("reset")

        assert bench.went_to_0_v_after(reset_ns) < STOPPED_S
        recording = recorded(bench)
        _stays_at_0_v_but_samples_again(bench)
    assert "the device was reset" in outcome(recording)
    check_every_k(recording)
    check_volts(bench)
