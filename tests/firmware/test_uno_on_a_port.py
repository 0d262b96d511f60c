"""`armrigd emulate --firmware`: the binary at a pseudo-terminal, in real time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from armrig_daemon.conformance.host import LineHost
from armrig_daemon.conformance.serial_line import SerialLine

from tests.firmware.uno_host import broken, harness
from tests.tools import needs

COMMAND = [sys.executable, "-m", "armrig_daemon"]
EMULATE = [*COMMAND, "emulate", "--firmware", "--port"]
needs_simavr = needs("cc", "make", "simavr")


@pytest.fixture
def port(tmp_path: Path) -> Iterator[Path]:
    """Emulate a rig with the firmware; give its port, and end it well."""
    port = tmp_path / "uno"
    environ = os.environ | {"ARMRIG_FIL": str(harness())}
    emulator = subprocess.Popen([*EMULATE, str(port)], env=environ, stderr=subprocess.PIPE)
    try:
        while not port.exists():
            assert emulator.poll() is None
            time.sleep(0.01)
        yield port
    finally:
        emulator.terminate()
        emulator.communicate()
    assert emulator.returncode == 0


@needs("cc", "make", "simavr", "avr-gcc")
def test_a_pin_that_is_high_at_reset_is_reported_in_a_line_and_the_exit_code(
    tmp_path: Path,
) -> None:
    low = "    PWM_PORT = 0;\n    PWM_DDR = PWM_PIN;\n"
    image = broken(tmp_path, "boards/uno/motor.c", low, low.replace("0", "PWM_PIN"))
    environ = os.environ | {"ARMRIG_FIL": str(harness())}
    command = [*COMMAND, "emulate", "--hex", str(image), "--port", str(tmp_path / "uno")]
    with subprocess.Popen(command, env=environ, stderr=subprocess.PIPE, text=True) as emulator:
        said = next(line for line in emulator.stderr if "enable line is low" in line)
        emulator.terminate()
        rest = emulator.stderr.read()

    assert said.startswith(f"{tmp_path / 'uno'}: the motor's pin is high while")
    assert said.endswith("ms after power-on\n")
    assert "Traceback" not in rest
    assert emulator.returncode == 1


@needs_simavr
def test_a_host_that_opens_the_port_receives_the_hello_of_the_firmware(port: Path) -> None:
    with closing(SerialLine(str(port), 500_000)) as line:
        reply = LineHost(line).hello(30_000)

    assert reply.firmware != 0
    assert (reply.queue, reply.pwm_bits) == (256, 10)
    assert reply.reset == 2  # by its pin, as the port was opened


@pytest.mark.exhaustive
@pytest.mark.real_time
@needs_simavr
def test_the_uno_passes_conformance_in_real_time(port: Path) -> None:
    arguments = ["conformance", "--device", str(port), "--motor-unplugged", "--json"]

    ended = subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, check=False)

    told = json.loads(ended.stdout)
    assert [r for r in told["rules"] if r["outcome"] == "FAIL"] == []
    assert (ended.returncode, told["broken"]) == (0, 0)
    assert len(told["rules"]) > 80
    assert told["device"]["firmware"] != "0"
