"""A page's server in this process, and a client that speaks HTTP to it as a browser does."""

from __future__ import annotations

import http.client
import json
import ssl
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from armrig.dashboard.serving import DashboardSettings, dashboard

from tests.integration.processes import WITHIN_S, Bench, wait_for

STEP = {"kind": "step", "seconds": 120.0, "at": 0.1, "low": 1.0, "high": 4.0}
"""An experiment that lasts until it is stopped."""
WAIT_S = WITHIN_S
_ANSWER_S = WITHIN_S
_RUN_S = 60.0


class Client:
    """Client with the address that `armrig dashboard` printed."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self.url = url
        self.is_shared = parts.scheme == "https"
        self.host, self.port = str(parts.hostname), int(parts.port or 0)
        self.token = parts.fragment.removeprefix("token=")

    def ask(
        self, path: str, body: Any = None, method: str = "", **headers: str | None
    ) -> tuple[int, Any]:
        """Return status and answer; a header given as None is left out."""
        given = {"Authorization": f"Bearer {self.token}", "Host": f"{self.host}:{self.port}"}
        given |= {name.replace("_", "-"): value for name, value in headers.items()}  # type: ignore[misc]
        data = body if isinstance(body, bytes) or body is None else json.dumps(body).encode()
        if data is not None:
            given = {"Content-Length": str(len(data))} | given
        lines = [f"{method or ('GET' if body is None else 'POST')} {path} HTTP/1.1"]
        lines += [f"{name}: {value}" for name, value in given.items() if value is not None]
        link = self._link()
        try:
            link.connect()
            # In one piece: who refuses the head and shuts with bytes unread resets the connection.
            link.sock.sendall("\r\n".join([*lines, "", ""]).encode("latin-1") + (data or b""))
            answer = http.client.HTTPResponse(link.sock)
            answer.begin()
            text = answer.read()
        finally:
            link.close()
        return answer.status, (json.loads(text) if text[:1] in (b"{", b"[") else text)

    def events(self) -> Generator[tuple[str, Any], None, None]:
        """Give the events of the stream, with their names, for as long as it lasts."""
        link = self._link()
        try:
            link.request("GET", "/api/stream", headers={"Authorization": f"Bearer {self.token}"})
            answer = link.getresponse()
            assert answer.status == 200, answer.read()
            name = ""
            for line in answer:
                if line.startswith(b"event: "):
                    name = line[7:-1].decode()
                elif line.startswith(b"data: "):
                    yield name, json.loads(line[6:])
        finally:
            link.close()

    def _link(self) -> http.client.HTTPConnection:
        if not self.is_shared:
            return http.client.HTTPConnection(self.host, self.port, timeout=_ANSWER_S)
        trusting = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
        return http.client.HTTPSConnection(
            self.host, self.port, timeout=_ANSWER_S, context=trusting
        )

    def wait(
        self,
        wanted: str,
        what: Callable[[Any], object],
        within_s: float = WAIT_S,
        events: Iterator[tuple[str, Any]] | None = None,
    ) -> Any:
        """Return the first event of a name for which `what` is true; otherwise an assertion fails.

        Without `events`, a new stream is opened. A new stream repeats the whole past, and is a
        viewer of its own.
        """
        last_s = time.monotonic() + within_s
        for name, value in self.events() if events is None else events:
            if name == wanted and what(value):
                return value
            assert time.monotonic() < last_s, f"{wanted} did not become so in time"
        raise AssertionError("the stream has ended")

    def first(self, wanted: str) -> Any:
        """Return the first event of a name."""
        return next(value for name, value in self.events() if name == wanted)


def endpoint(bench: Bench) -> str:
    """Return where the bench's daemon listens."""
    return bench.endpoint


@contextmanager
def watched(bench: Bench) -> Iterator[Client]:
    """Serve a dashboard of the bench's rig."""
    with dashboard(DashboardSettings(connect=endpoint(bench))) as served:
        yield Client(served.url)


def recorded(client: Client, experiment: dict[str, Any]) -> str:
    """Have a dashboard run an experiment to its end, and return its recording's name."""
    status, told = client.ask("/api/run", {"owner": "a page", "experiment": experiment})
    assert status == 200, told
    run = client.wait("run", lambda seen: not seen["is_going"] and seen["experiment"], _RUN_S)
    assert not run["error"], run["error"]
    return str(run["recording"])


def begin(client: Client, bench: Bench, experiment: dict[str, Any] = STEP) -> None:
    """Have a dashboard that hears its rig run an experiment, and wait until the motor is driven."""
    client.wait("live", lambda seen: not seen["is_stale"])
    before = len(bench.voltage_changes())
    status, told = client.ask("/api/run", {"owner": "a page", "experiment": experiment})
    assert status == 200, told
    wait_for(lambda: any(volts > 0 for _, volts in bench.voltage_changes()[before:]))
