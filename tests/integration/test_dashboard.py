"""The dashboard's server over HTTP, with a real daemon and its emulated rig."""

from __future__ import annotations

import itertools
import socket
from contextlib import ExitStack, suppress
from math import isclose

import pytest
from armrig.dashboard.guard import MOST_CONNECTIONS

from tests.integration.driving import hold
from tests.integration.processes import WITHIN_S, Bench, wait_for
from tests.integration.watching import STEP, Client, begin, recorded, watched


def test_the_stream_has_each_sample_once_in_order(client: Client) -> None:
    """Each row is later than the row before.

    The first live rows may repeat the last of the past; the page discards them.
    """
    past: list[list[float]] = []
    live: list[list[float]] = []
    for name, value in client.events():
        past += value if name == "past" else []
        live += value["rows"] if name == "live" else []
        if len(live) > 100:
            break

    assert all(a[0] < b[0] for rows in (past, live) for a, b in itertools.pairwise(rows))
    assert past
    again = [row for row in live if row[0] <= past[-1][0]]
    assert again == past[len(past) - len(again) :]
    assert all(len(row) == 9 for row in past + live)
    assert {row[1] for row in live[-50:]} == {0.0}


def test_an_experiment_of_the_page_is_recorded(client: Client, served: Bench) -> None:
    before = len(served.voltage_changes())
    short = STEP | {"seconds": 1.0, "name": "page"}
    begin(client, served, short)
    client.wait("run", lambda seen: not seen["is_going"])
    run = client.first("run")

    assert run["error"] == ""
    assert run["told"].startswith("rehearsed on the model")
    assert (run["done"], run["total"]) == (100, 100)
    assert (served.recordings / run["recording"]).exists()
    assert "-step-page-" in run["recording"]
    levels = {0.0, STEP["low"], STEP["high"]}
    volts = [volts for _, volts in served.voltage_changes()[before:]]
    assert [min(abs(v - level) for level in levels) for v in volts] == pytest.approx(
        [0.0] * len(volts), abs=0.005
    )


def test_the_stop_button_ends_the_run_of_another_client(client: Client, served: Bench) -> None:
    with served.rig() as other:
        hold(other, served, 1.0, "somebody else")
        assert client.ask("/api/stop", {})[0] == 200
        wait_for(lambda: served.volts() == 0.0)


def test_two_runs_at_once_are_refused(client: Client, served: Bench) -> None:
    begin(client, served)

    status, told = client.ask("/api/run", {"owner": "me", "experiment": STEP})
    client.ask("/api/stop", {"owner": "somebody"})

    assert status == 409
    assert "is in progress" in told["error"]
    client.wait("run", lambda seen: not seen["is_going"])
    assert "stopped by somebody" in client.first("run")["error"]


COMMANDS = ("arm", "release", "reset", "preview", "run", "stop", "recordings", "mcap", "report")


@pytest.mark.parametrize(
    "headers",
    [{"Host": "evil.example:8807"}, {"Origin": "https://evil.example"}, {"Authorization": None}],
    ids=str,
)
def test_an_unauthorised_request_is_refused(
    client: Client, served: Bench, headers: dict[str, str | None]
) -> None:
    refused = [client.ask(f"/api/{name}", {"owner": "evil"}, **headers) for name in COMMANDS]
    refused.append(client.ask("/api/stream", **headers))

    assert {status for status, _ in refused} == {403}
    assert served.settled() == "safe"


def test_a_thousand_connections_prevent_no_stop(client: Client, served: Bench) -> None:
    begin(client, served)
    with ExitStack() as links:
        opened = [
            links.enter_context(socket.create_connection((client.host, client.port), 10.0))
            for _ in range(1000)
        ]
        assert client.ask("/api/stop", {}) == (200, {"stopped": True})
        wait_for(lambda: served.volts() == 0.0)
        assert sum(map(_is_open, opened)) <= MOST_CONNECTIONS


@pytest.mark.parametrize(
    "asked",
    [
        "POST / HTTP/1.1\r\nHost: {0}\r\nContent-Length: 9\r\nExpect: 100-continue\r\n\r\n",
        "GET /vendor/uPlot.iife.min.js HTTP/1.1\r\nHost: {0}\r\n\r\n" * 8,
        "POST /api/stop HTTP/1.1\r\nHost: {0}\r\nAuthorization: Bearer {1}\r\n"
        "Content-Length: 9\r\nExpect: 100-continue\r\n\r\n",
    ],
    ids=["a body that does not come", "answers that are not read", "a body, with the token"],
)
def test_unfinished_requests_prevent_no_stop(client: Client, served: Bench, asked: str) -> None:
    begin(client, served)
    with ExitStack() as links:
        for _ in range(MOST_CONNECTIONS + 10):
            link = links.enter_context(socket.socket())
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            link.connect((client.host, client.port))
            link.sendall(asked.format(f"{client.host}:{client.port}", client.token).encode())
            with suppress(ConnectionError):
                link.recv(1)  # the first answer, or that a body is waited for
        for _ in range(3):
            assert client.ask("/api/stop", {}) == (200, {"stopped": True})
        wait_for(lambda: served.volts() == 0.0)


def _is_open(link: socket.socket) -> bool:
    """Return whether the server has left an idle connection open."""
    link.setblocking(False)
    try:
        return link.recv(1) != b""
    except BlockingIOError:
        return True
    except ConnectionError:
        return False


def test_a_dashboard_ends_without_waiting_for_its_viewers(served: Bench) -> None:
    with socket.socket() as link:
        with watched(served) as client:
            begin(client, served)
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            link.connect((client.host, client.port))
            head = f"GET /api/stream HTTP/1.1\r\nHost: {client.host}:{client.port}\r\n"
            link.sendall(f"{head}Authorization: Bearer {client.token}\r\n\r\n".encode())
            assert link.recv(100)
        wait_for(lambda: served.volts() == 0.0)
        link.settimeout(WITHIN_S)
        with suppress(ConnectionError):
            while link.recv(65_536):  # an end comes, or time runs out
                pass


def test_the_page_shows_and_sends_a_recording_unchanged(client: Client, served: Bench) -> None:
    file = recorded(client, STEP | {"seconds": 2.0})

    _, listed = client.ask("/api/recordings", {})
    status, facts = client.ask("/api/recording", {"file": file})
    _, text = client.ask("/api/csv", {"file": file, "start": 0.5, "stop": 1.0})
    _, whole = client.ask("/api/mcap", {"file": file})

    assert listed["recordings"][0]["file"] == file
    assert status == 200
    assert facts["summary"].startswith("the data")
    assert [len(x) for x in facts["curves"]["u"]] == [200, 200, 200]
    header, *rows = text.decode().splitlines()
    assert header == "t [s],u [V],theta_1 counted [deg],alpha [deg]"
    assert isclose(float(rows[0].split(",")[0]), 0.5, abs_tol=0.01)
    assert len(rows) in (50, 51)
    assert whole == (served.recordings / file).read_bytes()
