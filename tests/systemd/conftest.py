"""The machine of these tests, and a rig in it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.systemd.machine import Machine, missing, wait_for
from tests.systemd.served_rig import Rig

_RIG = """[Unit]
Description=An emulated rig, in place of a board

[Service]
User=armrig
RuntimeDirectory=rig%i
CPUSchedulingPolicy=fifo
CPUSchedulingPriority=2
ExecStart=/opt/armrig/bin/armrigd emulate --config /etc/armrig/%i.toml --port /run/rig%i/tty \\
  --trace /run/rig%i/trace.csv
"""
_CONFIGURATION = """[device]
port = "/run/rig{rig}/tty"
watchdog_ms = 250

[emulator]
tolerates_stalls = true
"""


@pytest.fixture(scope="session")
def machine() -> Iterator[Machine]:
    """Give a machine on which the service is installed, and nothing started."""
    if why := missing():
        pytest.skip(why)
    machine = Machine()
    try:
        machine.run("armrig", "service", "install", "--yes")
        if not machine.may_raise_limits:  # then LimitRTPRIO= is none, and a loop cannot rise
            drop_in = Path("/etc/systemd/system/armrigd@.service.d/from-above.conf")
            machine.write(drop_in, "[Service]\nCPUSchedulingPriority=90\n")
        machine.write(Path("/etc/systemd/system/rig@.service"), _RIG)
        machine.systemctl("daemon-reload")
        yield machine
    finally:
        machine.end()


def _made(machine: Machine, rig: str) -> Rig:
    machine.write(Path(f"/etc/armrig/{rig}.toml"), _CONFIGURATION.format(rig=rig))
    machine.systemctl("start", f"rig@{rig}")
    wait_for(machine.path(f"/run/rig{rig}/tty").is_symlink)
    return Rig(machine=machine, id=rig)


@pytest.fixture(scope="session")
def first(machine: Machine) -> Rig:
    """Give rig 1."""
    return _made(machine, "1")


@pytest.fixture(scope="session")
def second(machine: Machine) -> Rig:
    """Give rig 2."""
    return _made(machine, "2")
