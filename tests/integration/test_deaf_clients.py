"""Clients that never read, and connections that say nothing: no stop waits for them.

Without the daemon's and the router's settings, each deaf client holds a stop up by 1 to 5 s.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from armrig.rig.client import Rig

from tests.integration.fleet_lab import FleetLab
from tests.integration.laboratory import Laboratory
from tests.integration.processes import Bench

pytestmark = pytest.mark.timed
LATE_S = 1.0
"""Threshold between a stop and a late stop on a busy machine; measured: some milliseconds."""
ASKED = [("cmd/stop", 5000), ("cmd/status", 0), ("history", 0)]  # 5000 B: refused unparsed
_STOPS, _PAUSE_S = 8, 0.3  # a deaf client holds up the others only now and then


@contextmanager
def deaf(
    n: int, target: str, key: str, size: int = 0, credential: Path | str = ""
) -> Iterator[None]:
    """Have `n` clients query a key and read no answer."""
    command = [sys.executable, str(Path(__file__).with_name("deaf_client.py"))]
    arguments = [target, f"rig/1/{key}", str(size), str(credential)]
    clients = [
        subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, text=True)
        for _ in range(n)
    ]
    try:
        for client in clients:
            assert client.stdout is not None
            assert client.stdout.readline() == "there\n"
        yield
    finally:
        for client in clients:
            client.kill()
        for client in clients:
            client.communicate()


def slowest_stop_s(connected: Rig, other: Callable[[], Rig]) -> float:
    """Return the slowest stop of a connected client, and of clients that connect for the stop."""
    took: list[float] = []
    for _ in range(_STOPS):
        begun = time.monotonic()
        connected.stop()
        took.append(time.monotonic() - begun)
        begun = time.monotonic()
        with other() as rig:
            rig.stop()
        took.append(time.monotonic() - begun)
        time.sleep(_PAUSE_S)
    return max(took)


@pytest.mark.parametrize(("key", "size"), ASKED)
def test_clients_of_the_socket_that_never_read_delay_no_stop(
    served: Bench, key: str, size: int
) -> None:
    with served.rig() as rig, deaf(3, f"{served.folder}/armrig/1.sock", key, size):
        assert slowest_stop_s(rig, served.rig) < LATE_S


def test_observers_that_never_read_delay_no_stop(bench: Bench) -> None:
    lab = Laboratory(bench)
    bench.emulate()
    daemon = bench.serve()
    with lab.rig("alice") as alice, bench.rig() as local, ExitStack() as observers:
        for key in ("cmd/status/bob", "history", "cmd/stop/bob"):  # the last is forbidden
            where = lab.endpoint.removeprefix("tls/")
            observers.enter_context(deaf(2, where, key, credential=lab.made / "bob.pem"))

        assert slowest_stop_s(alice, lambda: lab.rig("alice")) < LATE_S
        assert slowest_stop_s(local, bench.rig) < LATE_S
    assert "frozen" not in daemon.said


def test_observers_at_a_router_that_never_read_delay_no_stop_and_cost_no_sample(
    bench: Bench,
) -> None:
    lab = FleetLab(bench.folder, rigs=("1",))
    router = lab.serve(bench)
    where = lab.endpoint.removeprefix("tls/")
    with (
        lab.alice() as rig,
        bench.rig() as local,
        deaf(8, where, "history", credential=lab.made / "bob.pem"),
        rig.arrivals("sample") as heard,
    ):
        assert slowest_stop_s(rig, lab.alice) < LATE_S
        assert slowest_stop_s(local, bench.rig) < LATE_S
        ks = [sample.k for sample in heard()]
    assert ks == list(range(ks[0], ks[-1] + 1))
    assert router.popen.poll() is None


def test_silent_connections_delay_no_stop(served: Bench) -> None:
    silent = [socket.socket(socket.AF_UNIX) for _ in range(300)]
    try:
        with served.rig() as rig:
            for connection in silent:
                connection.connect(f"{served.folder}/armrig/1.sock")
            assert slowest_stop_s(rig, served.rig) < LATE_S
    finally:
        for connection in silent:
            connection.close()
