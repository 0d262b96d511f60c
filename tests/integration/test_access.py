"""A client on a network can do what their name permits, and is recorded by that name."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import socket
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import armrig
import pytest
import zenoh
from armrig.dashboard.foxglove import foxglove
from armrig.dashboard.serving import DashboardSettings, dashboard
from armrig.lab import pki
from armrig.rig.client import Rig
from armrig.rig.replies import RefusedError, RunEndedError
from armrig.rig.session import NoReplyError, RigError
from armrig_core.access.credential import Credential, read_credential
from armrig_core.process.open_files import MAX_IDLE_FILES, MOST_FILES, SHUT_S
from armrig_core.rig.description import builtin
from armrig_daemon.config import EX_CONFIG

from tests.integration.driving import bring_to_rest, samples
from tests.integration.fork_server import ForkServer
from tests.integration.laboratory import (
    Laboratory,
    by_certificate,
    certificates,
    free_port,
)
from tests.integration.processes import WITHIN_S, Bench, settled, wait_for
from tests.integration.sockets import sockets


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory, forks: ForkServer) -> Iterator[Laboratory]:
    """Give a laboratory that a module's tests share."""
    bench = Bench(tmp_path_factory.mktemp("lab"), forks)
    laboratory = Laboratory(bench)
    try:
        bench.emulate()
        bench.serve()
        yield laboratory
    finally:
        bench.end()


@pytest.fixture
def lab(shared: Laboratory) -> Laboratory:
    """Give the laboratory, with its rig at 0 V and without a holder."""
    bring_to_rest(shared.bench)
    return shared


def test_an_operator_s_run_is_recorded_under_their_name(lab: Laboratory) -> None:
    with lab.rig("alice") as rig:
        rig.arm("a test", Ts=0.01)
        recording = armrig.load(rig.run([1.0, 4.0] * 25))

    assert recording.manifest.owner == "a test (certificate alice)"
    assert recording.manifest.owner_checked == "certificate alice"
    said = lab.bench.processes[-1].said
    assert "info: arm: by a test (certificate alice)" in said
    assert "info: run: by a test (certificate alice)" in said


def test_a_stop_is_recorded_under_the_name_of_its_sender(lab: Laboratory) -> None:
    with lab.rig("alice") as rig, lab.rig("carol") as other:
        rig.arm("a test", Ts=0.01)
        with pytest.raises(RunEndedError, match=r"stopped by the next \(certificate carol\)"):
            rig.run([1.0] * 1000, progress=lambda done, _: done > 20 and other.stop("the next"))


def test_a_local_user_stops_the_rig_without_any_certificate(lab: Laboratory) -> None:
    with lab.rig("alice") as rig, lab.bench.rig() as here:
        rig.arm("a test")
        assert here.status().owner == "a test (certificate alice)"
        assert here.status().owner_checked == "certificate alice"
        here.stop()
        wait_for(lambda: here.status().phase in ("safe", "fault"))
        assert here.status().phase == "safe"
        with pytest.raises(RefusedError, match="not the lease in force"):
            rig.set(1.0)


def test_an_observer_can_watch_and_cannot_command(lab: Laboratory) -> None:
    with lab.rig("bob") as rig:
        assert next(samples(rig)).u_applied_v == 0.0
        assert settled(rig) == "safe"
        for command in (rig.stop, rig.reset, lambda: rig.arm("a test")):
            with pytest.raises(NoReplyError, match="look for bob in the access list"):
                command()


@pytest.mark.parametrize("who", ["eve", "wrong"])
def test_a_client_on_no_access_list_gets_no_answer(lab: Laboratory, who: str) -> None:
    with lab.rig(who) as rig:
        with pytest.raises(NoReplyError, match="not permitted"):
            rig.status()
        with pytest.raises(NoReplyError):
            next(rig.stream())


def test_a_run_too_long_for_the_network_is_refused_by_the_client(lab: Laboratory) -> None:
    """The daemon would drop it, because it keeps no message of that size."""
    with lab.rig("alice") as rig:
        rig.arm("a test")
        with pytest.raises(
            RigError, match="at most 8323072 B are allowed: play the input in parts"
        ):
            rig.run([1.0 + 1e-15] * 500_000)


def test_a_daemon_that_cannot_listen_does_not_start(bench: Bench) -> None:
    """Exit code 78, one line, and the motor's loop never starts."""
    made = certificates(bench.folder)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        by_certificate(bench, made, f"tls/127.0.0.1:{taken.getsockname()[1]}")
        bench.emulate()
        daemon = bench.start("armrig_daemon", "run", "--config", str(bench.config))
        assert daemon.popen.wait(WITHIN_S) == EX_CONFIG

    assert "another program listens there; use another port" in daemon.said
    assert "Traceback" not in daemon.said
    assert bench.volts() == 0.0


@pytest.mark.parametrize("level", ["socket", "certificate"])
def test_a_daemon_listens_only_at_configured_endpoints(bench: Bench, level: str) -> None:
    """A1: nothing, or one port of TCP; no multicast, no gossip, no second port."""
    made = certificates(bench.folder)
    port = free_port()
    if level == "certificate":
        by_certificate(bench, made, f"tls/127.0.0.1:{port}")
    bench.emulate()
    daemon = bench.serve()

    expected = {} if level == "socket" else {"tcp": [f"0100007F:{port:04X}"]}
    assert sockets(daemon.popen.pid) == expected
    assert sockets(bench.loop_pid(daemon)) == {}


@pytest.mark.parametrize("more", [(), ("visitors", "foxglove")], ids=str)
def test_a_dashboard_listens_only_on_the_ports_that_it_prints(
    lab: Laboratory, more: tuple[str, ...]
) -> None:
    """A4: the page on the loopback; further ports for visitors and Foxglove on request."""
    here = lab.bench.endpoint
    share = "127.0.0.2" if "visitors" in more else None  # an address of its own, as a network's
    before = sockets(os.getpid())
    with contextlib.ExitStack() as opened:
        served = opened.enter_context(dashboard(DashboardSettings(connect=here, share=share)))
        said = [_listening("127.0.0.1", served.url)]
        said += [_listening(share, served.shared_url)] if share else []
        if "foxglove" in more:
            pytest.importorskip("foxglove", reason="no foxglove-sdk")
            url = opened.enter_context(foxglove(builtin("arm"), rig="1", connect=here, port=0))
            said.append(_listening("127.0.0.1", url))
        heard = sockets(os.getpid())

    assert {table for table in heard if heard[table] != before.get(table, [])} == {"tcp"}
    assert sorted(set(heard["tcp"]) - set(before.get("tcp", []))) == sorted(said)
    # The SDK cancels the task that accepts connections, and its `stop` does not wait for the end of
    # this task (websocket/server.rs). The port closes with the task.
    wait_for(lambda: sockets(os.getpid()) == before)


def _listening(address: str, url: str) -> str:
    """Return an address, and a URL's port, as /proc/net/tcp writes them."""
    return f"{bytes(map(int, address.split('.')))[::-1].hex().upper()}:{urlsplit(url).port:04X}"


def _connected(lab: Laboratory, who: str, zid: str) -> zenoh.Session:
    """Return the session of a client with another client's id."""
    return _opened(lab, read_credential(lab.made / f"{who}.pem", "client").tls("connect"), zid)


def _opened(lab: Laboratory, tls: dict[str, Any], zid: str) -> zenoh.Session:
    config = {
        "mode": "client",
        "id": zid,
        "connect": {"endpoints": [lab.endpoint]},
        "transport": {"link": {"tls": tls}},
    }
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


def _is_answered(session: zenoh.Session, key: str) -> bool:
    return any(reply.ok is not None for reply in session.get(key, timeout=WITHIN_S))


def test_the_zenoh_id_of_another_client_gives_no_rights(lab: Laboratory) -> None:
    with _connected(lab, "alice", "a11ce") as alice:
        assert _is_answered(alice, "rig/1/cmd/status/alice")
        with pytest.raises(zenoh.ZError):
            _connected(lab, "bob", "a11ce")
        assert _is_answered(alice, "rig/1/cmd/status/alice")

    with _connected(lab, "bob", "a11ce") as bob:
        assert _is_answered(bob, "rig/1/cmd/status/bob")
        assert not _is_answered(bob, "rig/1/cmd/status/alice")
        assert not _is_answered(bob, "rig/1/cmd/stop/bob")


@pytest.mark.exhaustive
def test_a_link_ends_with_the_certificate_that_opened_it(lab: Laboratory, tmp_path: Path) -> None:
    made = Path(shutil.copytree(lab.made, tmp_path / "pki"))
    days = 4 / 86_400
    short = pki._issue(made, "carol", "operators", [], days, force=True).path

    with Rig("1", connect=lab.endpoint, certificate=short) as rig:
        assert settled(rig) == "safe"
        wait_for(lambda: not _is_answered(rig._require_session(), "rig/1/cmd/status/carol"))


def _chained(lab: Laboratory, name: str) -> dict[str, Any]:
    """Return zenoh's settings with an unchanged chain, which armrig's client would refuse."""
    key, *chain = re.findall(
        rb"-----BEGIN .*?-----END [A-Z ]+-----\n",
        (lab.made / f"{name}.pem").read_bytes(),
        re.DOTALL,
    )
    now = datetime.now(UTC)
    shown = b"".join(chain[:-1])
    return Credential(
        name=name, begins=now, expires=now, key=key, certificate=shown, authority=chain[-1]
    ).tls("connect")


def test_an_observer_cannot_become_an_operator(lab: Laboratory) -> None:
    with pytest.raises(zenoh.ZError):
        _opened(lab, _chained(lab, "signed-by-bob"), "b0b")

    with _opened(lab, _chained(lab, "bob-before-alice"), "b0b") as bob:
        assert _is_answered(bob, "rig/1/cmd/status/bob")
        assert not _is_answered(bob, "rig/1/cmd/stop/alice")


@pytest.mark.exhaustive
def test_a_client_with_unused_connections_is_cut_off(lab: Laboratory) -> None:
    daemon = lab.bench.processes[-1]
    limits = Path(f"/proc/{daemon.popen.pid}/limits").read_text()
    soft, hard = map(int, re.findall(r"Max open files +(\d+) +(\d+)", limits)[0])
    assert soft >= min(MOST_FILES, hard)
    address = "localhost", int(lab.endpoint.rsplit(":", 1)[1])

    with contextlib.ExitStack() as held, lab.bench.rig() as here:
        with contextlib.suppress(
            ConnectionError
        ):  # the daemon has other files, so it may come early
            for _ in range(MAX_IDLE_FILES):
                connection = held.enter_context(socket.create_connection(address, 5))
                connection.sendall(bytes.fromhex("1603010200010001fc0303"))  # begins to shake hands
        wait_for(lambda: "the network is shut" in daemon.said)
        here.stop()
        with lab.bench.rig() as another:
            assert settled(another) == "safe"

    wait_for(lambda: "the network is open again" in daemon.said, SHUT_S + WITHIN_S)
    with lab.rig("alice") as rig:
        assert settled(rig) == "safe"
