"""The dashboard's server over HTTP, with a real daemon and its emulated rig."""

from __future__ import annotations

import itertools
import json
import socket
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from math import isclose
from typing import Any

import pytest
from armrig.dashboard.connections import MOST
from armrig.rig.status_rows import status_rows

from tests.integration.driving import hold
from tests.integration.processes import WITHIN_S, Bench, wait_for
from tests.integration.watching import STEP, Client, begin, watched


@pytest.fixture(scope="module")
def _page(_serving: Bench) -> Iterator[Client]:
    with watched(_serving) as client:
        yield client


@pytest.fixture
def page(served: Bench, _page: Client) -> Client:
    """Give a client of a dashboard over a rig at rest, which does nothing and is not stale."""
    _page.wait("run", lambda seen: not seen["is_going"])
    _page.wait("live", lambda seen: not seen["is_stale"])
    return _page


def test_samples_come_in_the_stream(page: Client) -> None:
    """Each row is later than the row before.

    The first live rows may repeat the last of the past; the page discards them.
    """
    past: list[list[float]] = []
    live: list[list[float]] = []
    for name, value in page.events():
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


def test_the_past_comes_first(page: Client, served: Bench) -> None:
    began = page.wait("live", lambda seen: seen["rows"])["rows"][-1][0]
    with watched(served) as anew:
        anew.wait("live", lambda seen: not seen["is_stale"])
        seen = []
        for name, value in anew.events():
            if name == "whole":
                break
            seen += value if name == "past" else []

    # The daemon is older than this dashboard, which was not there to hear it.
    assert seen[0][0] < began < seen[-1][0]


def test_the_words_are_those_of_the_status(page: Client, served: Bench) -> None:
    with served.rig() as rig:
        rows = page.wait("status", lambda s: dict(s["rows"]) == dict(status_rows(rig.status())))
    rows = dict(rows["rows"])
    assert rows["phase"] == "safe"
    assert rows["owner"] == "nobody"
    assert rows["motor"] == "at 0 V, as the device reports"


def test_a_preview_moves_nothing(page: Client, served: Bench) -> None:
    before = served.voltage_changes()
    page.ask("/api/preview", STEP)

    assert served.settled() == "safe"
    assert served.voltage_changes() == before


def test_an_experiment_runs_and_is_recorded(page: Client, served: Bench) -> None:
    before = len(served.voltage_changes())
    short = STEP | {"seconds": 1.0, "name": "page"}
    begin(page, served, short)
    page.wait("run", lambda seen: not seen["is_going"])
    run = page.first("run")

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


def test_stop_ends_a_run_of_the_page(page: Client, served: Bench) -> None:
    begin(page, served)
    assert page.ask("/api/stop", {"owner": "somebody"}) == (200, {"stopped": True})

    wait_for(lambda: served.volts() == 0.0)
    page.wait("run", lambda seen: not seen["is_going"])
    assert "stopped by somebody" in page.first("run")["error"]


def test_a_note_is_marked_and_is_in_the_recording(page: Client, served: Bench) -> None:
    begin(page, served)
    assert page.ask("/api/note", {"owner": "Ada", "text": "<b>touched"}) == (
        200,
        {"recorded": True},
    )
    page.wait("marks", lambda seen: [kind for _, kind in seen][-2:] == ["start", "note"])
    status, told = page.ask("/api/note", {"owner": "Ada", "text": "x" * 501})
    assert (status, told["error"][-21:]) == (400, "line, not only blanks")
    page.ask("/api/stop", {})
    last = page.wait("status", lambda seen: seen["last_run"]["finished"])["last_run"]

    status, found = page.ask("/api/recording", {"file": last["file"]})

    assert status == 200
    assert [(owner, text) for _, owner, text in found["notes"]] == [("Ada", "<b>touched")]


def test_a_stop_right_after_a_run_holds(page: Client, served: Bench) -> None:
    for _ in range(5):
        assert page.ask("/api/run", {"owner": "me", "experiment": STEP})[0] == 200
        assert page.ask("/api/stop", {"owner": "somebody"})[0] == 200
        page.wait("run", lambda seen: not seen["is_going"])
        assert page.first("run")["error"]
        assert served.volts() == 0.0


def test_stop_ends_another_s_run(page: Client, served: Bench) -> None:
    with served.rig() as other:
        hold(other, served, 1.0, "somebody else")
        assert page.ask("/api/stop", {})[0] == 200
        wait_for(lambda: served.volts() == 0.0)


def test_a_stop_is_not_refused_for_its_body(page: Client, served: Bench) -> None:
    begin(page, served)

    assert page.ask("/api/stop", b"\xff no JSON")[0] == 200
    wait_for(lambda: served.volts() == 0.0)


def test_what_another_has_is_refused_in_a_line(page: Client, served: Bench) -> None:
    with served.rig() as other:
        other.arm("somebody else")
        status, told = page.ask("/api/arm", {"owner": "me"})
        other.disarm()

    assert status == 502
    assert "somebody else" in told["error"]
    assert "\n" not in told["error"]


def test_arm_and_release(page: Client, served: Bench) -> None:
    assert page.ask("/api/arm", {"owner": "me"}) == (200, {"armed": True})
    page.wait("status", lambda seen: seen["owner"] == "me")
    assert page.ask("/api/release", {}) == (200, {"released": True})
    page.wait("status", lambda seen: seen["owner"] == "")


def test_two_runs_at_once_are_refused(page: Client, served: Bench) -> None:
    begin(page, served)

    status, told = page.ask("/api/run", {"owner": "me", "experiment": STEP})
    page.ask("/api/stop", {})

    assert status == 409
    assert "is in progress" in told["error"]
    page.wait("run", lambda seen: not seen["is_going"])


MARKUP = "<img src=x onerror=alert(1)>"


@pytest.mark.parametrize(
    ("experiment", "says"),
    [
        ({"kind": "step", "high": 6.0}, "high"),
        ({"kind": "step", "at": 9.0}, "step at 9 s: after the end"),
        ({"kind": "nonsense"}, "nonsense"),
        ({"kind": "step", "unknown": 1}, "unknown"),
        ({"kind": "csv", "text": "u\n7\n"}, "outside 0 to 5 V"),
        ({"kind": "csv", "text": "u\n1\n", "file": MARKUP, "seconds": 1e9}, "seconds"),
        ({"kind": "blackbox", "seconds": 80_000, "Ts": 0.001}, "(4000000 samples)"),
        ({"kind": "step", "name": "No!"}, "name"),
    ],
)
def test_what_is_not_possible_is_refused_before_anything_moves(
    page: Client, served: Bench, experiment: dict[str, Any], says: str
) -> None:
    for path, body in (
        ("/api/preview", experiment),
        ("/api/run", {"owner": "me", "experiment": experiment}),
    ):
        status, told = page.ask(path, body)
        if path == "/api/run" and status == 200:  # what depends on the rig's sampling time
            page.wait("run", lambda seen: not seen["is_going"])
            told = page.first("run")
        else:
            assert status == 400
        assert "\n" not in told["error"]
        assert says in told["error"]
    assert served.volts() == 0.0


COMMANDS = ("arm", "release", "reset", "preview", "run", "stop", "recordings", "mcap", "report")


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example:8807"},
        {"Host": "127.0.0.1"},
        {"Host": None},
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Authorization": None},
        {"Authorization": "Bearer "},
        {"Authorization": "Bearer wrong"},
        {"Authorization": "Bearer ÿ"},
        {"Authorization": "Basic bWU6bWU="},
    ],
    ids=str,
)
def test_a_stranger_commands_nothing(
    page: Client, served: Bench, headers: dict[str, str | None]
) -> None:
    for command in COMMANDS:
        status, told = page.ask(f"/api/{command}", {"owner": "evil"}, **headers)
        assert status in (400, 403)
        if isinstance(told, dict):
            assert "\n" not in told["error"]
    status, _ = page.ask("/api/stream", **headers)

    assert status in (400, 403)
    assert served.settled() == "safe"


def test_no_answer_lets_another_page_in(page: Client) -> None:
    link = socket.create_connection((page.host, page.port), 10.0)
    with link:
        link.sendall(f"GET / HTTP/1.1\r\nHost: {page.host}:{page.port}\r\n\r\n".encode())
        head = link.recv(65_536).partition(b"\r\n\r\n")[0].decode().lower()

    assert "script-src 'self'" in head
    assert "unsafe-inline" not in head
    assert "frame-ancestors 'none'" in head
    assert "access-control-allow" not in head
    assert "set-cookie" not in head


def test_nothing_of_the_disk_is_served_but_recordings(page: Client, served: Bench) -> None:
    served.recordings.mkdir(exist_ok=True)
    outside = served.folder / "outside.mcap"
    outside.write_bytes(b"of somebody")
    for name in (
        str(outside),
        "../outside.mcap",
        "../armrig.toml",
        "/etc/passwd",
        "x/../y.mcap",
        "..",
        "",
        "no.mcap",
    ):
        status, told = page.ask("/api/mcap", {"file": name})
        assert (status, "there is no such recording" in told["error"]) == (400, True)
    for path in ("/../pyproject.toml", "/vendor/", "/%2e%2e/app.py", "/app.py"):
        assert page.ask(path)[0] == 404


@pytest.mark.parametrize("question", ["mcap", "recording", "curves", "csv", "identify", "report"])
def test_a_link_in_the_folder_hands_out_no_file(page: Client, served: Bench, question: str) -> None:
    """A link could lead to any file that the user of the page may read."""
    outside = served.folder / "of-somebody"
    outside.write_bytes(b"secret")
    link = served.recordings / "evil.mcap"
    served.recordings.mkdir(exist_ok=True)
    link.symlink_to(outside)
    try:
        status, told = page.ask(f"/api/{question}", {"file": link.name})
    finally:
        link.unlink()

    assert status == 400
    assert "there is no such recording" in told["error"]


def test_a_file_that_is_no_recording_is_not_handed_out(page: Client, served: Bench) -> None:
    served.recordings.mkdir(exist_ok=True)
    (served.recordings / "words.mcap").write_bytes(b"secret")

    assert page.ask("/api/mcap", {"file": "words.mcap"}) == (
        400,
        {"error": "words.mcap: not an MCAP file"},
    )


def test_a_body_that_is_too_long_is_refused(page: Client, served: Bench) -> None:
    assert page.ask("/api/run", b"[", Content_Length=str(10 << 20))[0] == 413
    with socket.create_connection((page.host, page.port), 10.0) as link:
        head = "POST /api/run HTTP/1.1\r\nTransfer-Encoding: chunked\r\n"
        head += f"Host: {page.host}:{page.port}\r\nAuthorization: Bearer {page.token}\r\n\r\n"
        link.sendall(head.encode())
        chunk = b"10000\r\n" + bytes(0x10000) + b"\r\n"
        sent, answer = 0, b""
        link.settimeout(0.0)
        while not answer and sent < 1000:
            try:
                link.setblocking(True)
                link.settimeout(0.2)
                link.sendall(chunk)
                sent += 1
                link.settimeout(0.01)
                answer = link.recv(1000)
            except TimeoutError:
                continue
            except OSError:
                break
    assert sent < 1000
    assert served.settled() == "safe"
    assert page.ask("/api/stop", {})[0] == 200


def test_a_thousand_connections_keep_nobody_from_a_stop(page: Client, served: Bench) -> None:
    begin(page, served)
    with ExitStack() as links:
        opened = [
            links.enter_context(socket.create_connection((page.host, page.port), 10.0))
            for _ in range(1000)
        ]
        assert page.ask("/api/stop", {}) == (200, {"stopped": True})
        wait_for(lambda: served.volts() == 0.0)
        assert sum(map(_is_open, opened)) <= MOST


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
def test_questions_that_do_not_end_keep_nobody_from_a_stop(
    page: Client, served: Bench, asked: str
) -> None:
    begin(page, served)
    with ExitStack() as links:
        for _ in range(MOST + 10):
            link = links.enter_context(socket.socket())
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            link.connect((page.host, page.port))
            link.sendall(asked.format(f"{page.host}:{page.port}", page.token).encode())
            with suppress(ConnectionError):
                link.recv(1)  # the first answer, or that a body is waited for
        for _ in range(3):
            assert page.ask("/api/stop", {}) == (200, {"stopped": True})
        wait_for(lambda: served.volts() == 0.0)


@pytest.mark.parametrize(
    "said",
    [
        b"\x16\x03\x01 no HTTP\r\n\r\n",
        b"GET / HTTP/1.1\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n",
    ],
    ids=["no HTTP", "a WebSocket"],
)
def test_a_client_without_a_token_writes_nothing_on_the_terminal(
    page: Client, caplog: pytest.LogCaptureFixture, said: bytes
) -> None:
    with socket.create_connection((page.host, page.port), 10.0) as link:
        link.sendall(said + f"Host: {page.host}:{page.port}\r\n\r\n".encode())
        assert link.recv(100).startswith(b"HTTP/1.1 ")

    assert caplog.text == ""


def _is_open(link: socket.socket) -> bool:
    """Return whether the server has left an idle connection open."""
    link.setblocking(False)
    try:
        return link.recv(1) != b""
    except BlockingIOError:
        return True
    except ConnectionError:
        return False


@contextmanager
def deaf(page: Client) -> Iterator[socket.socket]:
    """Give the connection of a viewer who does not read."""
    with socket.socket() as link:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        link.connect((page.host, page.port))
        head = f"GET /api/stream HTTP/1.1\r\nHost: {page.host}:{page.port}\r\n"
        link.sendall(f"{head}Authorization: Bearer {page.token}\r\n\r\n".encode())
        assert link.recv(100)
        yield link


@pytest.mark.exhaustive
def test_a_viewer_that_does_not_read_is_dropped_and_delays_nobody(page: Client) -> None:
    with closing(page.events()) as events:

        def wait_for_viewers(n: int) -> None:
            page.wait("timing", lambda seen: seen["viewers"] == n, events=events)

        wait_for_viewers(1)  # the viewers of earlier tests have left
        with deaf(page):
            wait_for_viewers(2)
            wait_for_viewers(1)


def test_a_name_is_reported_unchanged(page: Client, served: Bench) -> None:
    """Markup in a name stays text: the answer is JSON, and no browser takes it for a page.

    Round brackets are removed, because they mark what the daemon has checked.
    """
    shown = MARKUP.replace("(", "[").replace(")", "]")
    with served.rig() as other:
        other.arm(MARKUP)
        page.wait("status", lambda seen: seen["owner"] == shown)
        other.disarm()


def test_nobody_waits_for_the_end(served: Bench) -> None:
    with ExitStack() as links:
        with watched(served) as page:
            begin(page, served)
            link = links.enter_context(deaf(page))
        wait_for(lambda: served.volts() == 0.0)
        link.settimeout(WITHIN_S)
        with suppress(ConnectionError):
            while link.recv(65_536):  # an end comes, or time runs out
                pass


def test_a_recording_is_looked_at(page: Client, served: Bench) -> None:
    begin(page, served, STEP | {"seconds": 2.0})
    page.wait("run", lambda seen: not seen["is_going"])
    file = page.first("run")["recording"]

    _, listed = page.ask("/api/recordings", {})
    status, facts = page.ask("/api/recording", {"file": file})
    _, text = page.ask("/api/csv", {"file": file, "start": 0.5, "stop": 1.0})
    _, whole = page.ask("/api/mcap", {"file": file})

    assert listed["recordings"][0]["file"] == file
    assert status == 200
    assert facts["summary"].startswith("the data")
    assert [len(x) for x in facts["curves"]["u"]] == [200, 200, 200]
    header, *rows = text.decode().splitlines()
    assert header == "t [s],u [V],theta_1 counted [deg],alpha [deg]"
    assert isclose(float(rows[0].split(",")[0]), 0.5, abs_tol=0.01)
    assert len(rows) in (50, 51)
    assert whole == (served.recordings / file).read_bytes()


def test_where_no_model_fits_it_says_why(page: Client, served: Bench) -> None:
    begin(page, served, {"kind": "csv", "text": "u\n" + "1\n" * 60, "file": "flat.csv"})
    page.wait("run", lambda seen: not seen["is_going"])
    file = page.first("run")["recording"]

    status, told = page.ask("/api/identify", {"file": file})

    assert status == 400
    assert told["error"]
    assert json.dumps(page.ask("/api/recording", {"file": file})[1]["curves"])


def test_a_model_is_estimated_on_request(page: Client, served: Bench) -> None:
    assert page.first("timing")["model"] is None
    assert page.ask("/api/model", {"wanted": True})[0] == 200
    begin(page, served, {"kind": "blackbox", "seconds": 20.0})
    page.wait("timing", lambda seen: "gain" in " ".join(seen["model"]))
    page.ask("/api/stop", {})
    page.ask("/api/model", {"wanted": False})

    assert page.first("timing")["model"] is None
