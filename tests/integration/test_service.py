"""The daemon as its users meet it: zenoh, recordings, errors for people."""

from __future__ import annotations

import json

import armrig
import numpy as np
import pytest
from armrig.rig.replies import RefusedError
from armrig_core.recording_file.manifest import CONFIG
from armrig_daemon.config import EX_CONFIG
from mcap.reader import make_reader

from tests.integration.driving import hold
from tests.integration.processes import WITHIN_S, Bench, wait_for


def test_the_client_receives_the_recording_of_its_run(served: Bench) -> None:
    u = armrig.telegraph(300, 0.1, low=0.0, high=5.0, seed=1)

    with served.rig() as rig:
        rig.arm("a test", Ts=0.005)
        path = rig.run(u, experiment="blackbox", details={"seed": 1})

    recording = armrig.load(path)
    at = recording.samples["k"].astype(int) - recording.manifest.k_first
    np.testing.assert_allclose(recording.samples["u_cmd_v"], u[at], atol=1e-4)
    assert at.size + recording.missing == u.size
    assert recording.manifest.details == {"seed": 1}
    assert recording.manifest.Ts == 0.005
    assert not recording.truncated


def test_an_invalid_voltage_of_an_unchecked_client_is_refused(served: Bench) -> None:
    """S1: the service checks by itself."""
    before = len(served.voltage_changes())
    with served.rig() as rig:
        lease = rig.arm("a test").lease
        for volts in ("6.0", "-1.0", "1e999", "NaN", "null", "true", '"3"'):
            payload = f'{{"lease": "{lease}", "n": 1, "u": {volts}}}'
            session = rig._require_session()
            (reply,) = session.get("rig/1/cmd/set", payload=payload, timeout=30)
            assert reply.err is not None, volts
            assert b"set: " in reply.err.payload.to_bytes()
    assert {volts for _, volts in served.voltage_changes()[before:]} <= {0.0}


def test_the_motor_voltage_follows_a_manual_voltage_and_a_stop(served: Bench) -> None:
    before = len(served.voltage_changes())
    with served.rig() as rig:
        hold(rig, served, 2.0)
        rig.stop()
        wait_for(lambda: served.volts() == 0.0)
    volts = [volts for _, volts in served.voltage_changes()[before:] if volts]
    assert volts == pytest.approx([2.0] * len(volts), abs=0.01)


def test_the_daemon_waits_for_a_missing_port(bench: Bench) -> None:
    daemon = bench.start("armrig_daemon", "run", "--config", str(bench.config))
    wait_for(lambda: bench.phase() == "init")
    with bench.rig() as rig:
        wait_for(lambda: rig.status().line)
        assert rig.status().line.startswith(
            f"{bench.port}: no rig is connected, and the daemon waits for one"
        )
        with pytest.raises(RefusedError, match="no rig is connected, and the daemon waits for one"):
            rig.arm("a test")

    bench.emulate()
    wait_for(lambda: bench.phase() == "safe")

    assert daemon.said.count(f"{bench.port} cannot be opened: it is not there") == 1
    assert "Traceback" not in daemon.said


def test_a_port_in_use_is_reported(served: Bench) -> None:
    second = served.start("armrig_daemon", "run", "--config", str(served.config), "--rig", "2")

    assert second.popen.wait(WITHIN_S) == EX_CONFIG
    assert "it is in use by another program" in second.said
    assert served.settled() == "safe"


def test_a_daemon_emulates_its_rig_with_the_longest_watchdog(bench: Bench) -> None:
    bench.config.write_text(f'[recording]\ndirectory = "{bench.recordings}"\n')

    daemon = bench.start("armrig_daemon", "run", "--config", str(bench.config), "--emulate")
    bench.is_served_by(daemon)
    with bench.rig() as rig:
        rig.arm("a test", Ts=0.01)
        path = rig.run([1.0] * 5)

    with path.open("rb") as file:
        attached = {found.name: found.data for found in make_reader(file).iter_attachments()}
    assert json.loads(attached[CONFIG])["device"]["watchdog_ms"] == 250
    # Its line is a socket, whose bytes wait for no worker of the kernel.
    assert f"port unix:{bench.folder}/armrig/1-{daemon.popen.pid}.line at" in daemon.said
