"""`armrig conformance` on a real pseudo-terminal, as on a board's port."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time

import pytest

from tests.integration.processes import Bench
from tests.sampling import sampled

PATIENCE_S = 120.0


def _started(bench: Bench, *more: str) -> subprocess.Popen[str]:
    """Test the emulated rig at a bench's terminal."""
    bench.use_terminal()
    bench.emulate()
    command = ["conformance", "--device", str(bench.port), "--motor-unplugged", *more]
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [sys.executable, "-m", "armrig", *command], stdout=pipe, stderr=pipe, text=True
    )


@pytest.mark.exhaustive
def test_a_device_at_a_port_passes_conformance_on_a_stalling_host(bench: Bench) -> None:
    """All rules in real time, with 300 ms of SIGSTOP now and then."""
    asks = _started(bench, "--json")
    for _ in range(4):
        time.sleep(2)
        asks.send_signal(signal.SIGSTOP)
        time.sleep(0.3)
        asks.send_signal(signal.SIGCONT)

    out, complaint = asks.communicate(timeout=PATIENCE_S)

    told = json.loads(out)
    assert [r for r in told["rules"] if r["outcome"] == "FAIL"] == []
    assert (asks.returncode, told["broken"], complaint) == (0, 0, "")
    assert len(told["rules"]) > 80
    assert told["device"]["queue"] == 512
    assert bench.volts() == 0.0


@pytest.mark.exhaustive
@pytest.mark.parametrize("number", sampled([signal.SIGINT, signal.SIGTERM]))
def test_an_interrupted_conformance_test_stops_the_device(
    bench: Bench, number: signal.Signals
) -> None:
    """Exit code 130, and one line; not by the watchdog, but by STOP."""
    asks = _started(bench)
    assert asks.stdout is not None
    for line in asks.stdout:
        if "A k not newer" in line:  # the next rule drives the motor
            break
    asks.send_signal(number)

    _, complaint = asks.communicate(timeout=PATIENCE_S)

    assert asks.returncode == 130
    assert complaint == "armrigd: conformance: interrupted; a stop was sent to the device\n"
    assert bench.volts() == 0.0
    assert "WATCHDOG" not in bench.trace.read_text().splitlines()[-1]
