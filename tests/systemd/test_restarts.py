"""The service is restarted and killed during runs of five clients; each client is notified.

`ARMRIG_RESTARTS=20 pytest -s tests/systemd/test_restarts.py` repeats each and prints the counts.
"""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.systemd.machine import Machine, wait_for
from tests.systemd.served_rig import Rig

pytestmark = pytest.mark.machine
RESTARTS = int(os.environ.get("ARMRIG_RESTARTS", "1"))
CLIENTS = ("run", "subscriber", "status", "page", "recorder")
FOLDER = Path("/run/clients")
STOPPED = (
    "the service of rig 1 has stopped; `systemctl status armrigd@1`; what was recorded is in "
    "`armrig ls`"
)
TOLD_S, CONNECTED_S = 20.0, 60.0


class Client:
    """One of `connected_client.py`, a unit of the machine."""

    def __init__(self, machine: Machine, name: str) -> None:
        self._machine = machine
        self.name = name
        files = [
            f"Standard{stream}=file:{FOLDER}/{name}.{stream}" for stream in ("Output", "Error")
        ]
        given = [f"--property={one}" for one in (*files, f"WorkingDirectory={FOLDER}")]
        program = "/opt/checkout/tests/systemd/connected_client.py"
        command = ["/opt/armrig/bin/python", program, name]
        machine.run(
            "systemd-run", "--quiet", "--collect", f"--unit=client-{name}", *given, *command
        )

    def written(self, stream: str) -> str:
        """Return its output so far."""
        path = self._machine.path(FOLDER / f"{self.name}.{stream}")
        return path.read_text() if path.exists() else ""

    def end(self) -> None:
        """End it."""
        self._machine.systemctl("kill", "--signal=KILL", f"client-{self.name}")


@pytest.fixture(scope="module")
def clients(first: Rig) -> Iterator[list[Client]]:
    """Give five clients of rig 1, which is otherwise idle."""
    first.machine.run("mkdir", "-p", str(FOLDER))
    first.start()
    clients = [Client(first.machine, name) for name in CLIENTS]
    wait_for(lambda: "recording rig 1" in clients[-1].written("Error"))
    yield clients
    for client in clients:
        client.end()
    first.machine.run("rm", "-r", str(FOLDER))


def _errors(machine: Machine) -> list[str]:
    """Return the journal's entries of the machine at the priority of an error, or above it."""
    machine.run("journalctl", "--sync")
    found = machine.run("journalctl", "--no-pager", "-p", "err", "-o", "json").stdout
    lines = [json.loads(line) for line in found.splitlines()]
    return [f"{line.get('_SYSTEMD_UNIT', '')}: {line['MESSAGE']}" for line in lines]


def _restart(rig: Rig) -> None:
    rig.machine.systemctl("restart", rig.unit)


def _kill(rig: Rig) -> None:
    rig.machine.run("kill", "-KILL", rig.main_pid())


@pytest.mark.parametrize("end", [_restart, _kill])
def test_five_clients_are_notified_that_the_service_has_stopped(
    rig: Rig, clients: list[Client], end: Callable[[Rig], None]
) -> None:
    told: Counter[str] = Counter()
    before = _errors(rig.machine)

    for _ in range(RESTARTS):
        _wait_until_connected(rig, clients)
        rig.machine.systemctl("reset-failed", rig.unit, check=False)  # five starts in a minute
        pid, heard = rig.main_pid(), {c.name: len(c.written("Error")) for c in clients}
        end(rig)
        wait_for(lambda p=pid: rig.is_active() and rig.main_pid() not in ("0", p))
        told.update(_told(clients, heard))

    errors = _errors(rig.machine)[len(before) :]
    print(f"{end.__name__}: {RESTARTS}; told: {dict(told)}; errors: {Counter(errors)}")
    assert told == dict.fromkeys(CLIENTS, RESTARTS)
    if end is _restart:
        assert errors == []


def _wait_until_connected(rig: Rig, clients: list[Client]) -> None:
    """Wait until the motor turns, and each client has heard of the present daemon."""
    heard = {c.name: len(c.written("Output")) for c in clients}
    wait_for(lambda: rig.phase() == "active" and rig.volts()[-1] > 0.0, CONNECTED_S)
    for client in clients:
        if client.name in ("subscriber", "status", "page"):
            wait_for(lambda c=client: len(c.written("Output")) > heard[c.name], CONNECTED_S)
        elif client.name == "recorder":  # zenoh tries again after 1, 2 and 4 s
            wait_for(lambda c=client: _records(c.written("Error")), CONNECTED_S)


def _records(said: str) -> bool:
    """Return whether the recorder has heard of the rig since it began to wait for it."""
    return said.rfind("waiting for it") <= said.rfind("restarted")


def _told(clients: list[Client], heard: dict[str, int]) -> list[str]:
    """Return the clients that were notified within `TOLD_S`."""
    until_s = time.monotonic() + TOLD_S
    while True:
        told = [c.name for c in clients if STOPPED in c.written("Error")[heard[c.name] :]]
        if len(told) == len(clients) or time.monotonic() > until_s:
            return told
        time.sleep(0.1)


@pytest.fixture
def rig(first: Rig) -> Rig:
    """Give rig 1."""
    return first
