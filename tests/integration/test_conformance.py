"""`armrig conformance` on a real pseudo-terminal, as on a board's port."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.processes import complete_lines
from tests.sampling import sampled

pytestmark = pytest.mark.real_time
PATIENCE_S = 120.0
_RIG = "import sys; from armrig_daemon.__main__ import main; sys.exit(main())"
_ASKS = "import sys; from armrig.cli import main; sys.exit(main())"


def started(program: str, *arguments: str) -> subprocess.Popen[str]:
    """Start a command with the paths of the tests."""
    paths = os.pathsep.join(p for p in sys.path if p)
    return subprocess.Popen(
        [sys.executable, "-c", program, *arguments],
        env={**os.environ, "PYTHONPATH": paths},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Path]:
    """Emulate a rig for one test; return its port."""
    port = tmp_path / "rig"
    process = started(_RIG, "emulate", "--port", str(port), "--trace", str(tmp_path / "trace"))
    end_s = time.monotonic() + PATIENCE_S
    while not port.is_symlink():
        assert process.poll() is None
        assert time.monotonic() < end_s
        time.sleep(0.02)
    yield port
    process.terminate()
    process.communicate(timeout=PATIENCE_S)


def trace(port: Path) -> list[str]:
    """Return the changes of the motor's voltage so far, a line each."""
    return complete_lines((port.parent / "trace").read_text())


def last_volts(port: Path) -> float:
    """Return the present voltage of the motor's pin."""
    return float(trace(port)[-1].split(",")[1])


@pytest.mark.exhaustive
def test_a_device_at_a_port_is_proved_though_the_host_stalls(rig: Path) -> None:
    """All rules in real time, with 300 ms of SIGSTOP now and then."""
    asks = started(_ASKS, "conformance", "--device", str(rig), "--motor-unplugged", "--json")
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
    assert last_volts(rig) == 0.0


@pytest.mark.exhaustive
@pytest.mark.parametrize("number", sampled([signal.SIGINT, signal.SIGTERM]))
def test_an_interruption_leaves_the_device_at_0_v(rig: Path, number: signal.Signals) -> None:
    """Exit code 130, and one line; not by the watchdog, but by STOP."""
    asks = started(_ASKS, "conformance", "--device", str(rig), "--motor-unplugged")
    assert asks.stdout is not None
    for line in asks.stdout:
        if "A k not newer" in line:  # the next rule drives the motor
            break
    asks.send_signal(number)

    _, complaint = asks.communicate(timeout=PATIENCE_S)

    assert asks.returncode == 130
    assert complaint == "armrigd: conformance: interrupted; a stop was sent to the device\n"
    assert last_volts(rig) == 0.0
    assert not trace(rig)[-1].endswith("WATCHDOG")
