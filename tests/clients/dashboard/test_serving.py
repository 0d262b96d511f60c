"""The sockets of a dashboard, and the thread that listens to the rig."""

from __future__ import annotations

import http.client
import json
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import pytest
from armrig.dashboard import serving
from armrig.dashboard.feed import Feed
from armrig.dashboard.serving import HOST, DashboardSettings, FeedListener, _listening, dashboard
from armrig.rig.session import RigError
from armrig_core.commands.commands import StatusReport
from armrig_core.telemetry.history import Past
from armrig_core.telemetry.telemetry import Sample, encode_sample
from msgspec.structs import replace

from tests.clients.fake_daemon import FakeDaemon
from tests.clients.made_recordings import gap, note, sample


def test_two_dashboards_started_at_once_have_different_ports() -> None:
    """The first dashboard holds its port from the bind on, before it serves."""
    with closing(_listening(HOST, 0, None)) as free:
        port = free.getsockname()[1]
    with (
        closing(_listening(HOST, port, None)) as first,
        closing(_listening(HOST, port, None)) as second,
    ):
        assert first.getsockname()[1] == port
        assert second.getsockname()[1] != port


def test_the_page_has_both_names_of_this_machine_and_a_single_use_code(tmp_path: Path) -> None:
    with dashboard(DashboardSettings(connect=f"unixsock-stream/{tmp_path}/none.sock")) as served:
        shown, given = urlsplit(served.url), urlsplit(served.browser_url)
        once, token = given.fragment.removeprefix("once="), shown.fragment.removeprefix("token=")

        def ask(method: str, path: str, host: str, code: str) -> tuple[int, bytes]:
            with closing(http.client.HTTPConnection(HOST, int(shown.port or 0))) as link:
                headers = {"Host": f"{host}:{shown.port}", "Authorization": f"Bearer {code}"}
                link.request(method, path, headers=headers)
                answer = link.getresponse()
                assert answer.getheader("Access-Control-Allow-Origin") is None
                return answer.status, answer.read()

        pages = [ask("GET", "/", host, "")[0] for host in (HOST, "localhost", "evil")]
        opened = [ask("POST", "/api/token", HOST, once) for _ in range(2)]
        recordings = ask("POST", "/api/release", HOST, token)

    assert (shown[:3], once == token) == (given[:3], False)
    assert pages == [200, 200, 403]
    assert (opened[0][0], json.loads(opened[0][1])) == (200, {"token": token})
    assert opened[1][0] == 403
    assert recordings == (200, b'{"released":false}')


def test_the_page_and_the_visitors_have_the_requested_ports(tmp_path: Path) -> None:
    pytest.importorskip("cryptography", reason="no cryptography: no certificate for visitors")
    with closing(_listening(HOST, 0, None)) as one, closing(_listening(HOST, 0, None)) as two:
        port, share_port = (free.getsockname()[1] for free in (one, two))
    asked = DashboardSettings(
        connect=f"unixsock-stream/{tmp_path}/none.sock",
        port=port,
        share="127.0.0.1",
        share_port=share_port,
    )

    with dashboard(asked) as served:
        own, shared = urlsplit(served.url), urlsplit(served.shared_url)

    assert (own.scheme, own.port) == ("http", port)
    assert (shared.scheme, shared.hostname, shared.port) == ("https", "127.0.0.1", share_port)
    assert own.fragment != shared.fragment
    assert len(served.fingerprint) == 95


def test_a_requested_port_in_use_is_reported() -> None:
    with closing(_listening(HOST, 0, None)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(RigError, match=f"^port {port} of {HOST}: .*; take another --port$"):
            _listening(HOST, 0, port)


class _Clock:
    """Clock that goes on only while somebody waits; nothing ends before `until_s`."""

    def __init__(self, until_s: float) -> None:
        self.now_s, self._until_s = 0.0, until_s

    def wait(self, seconds: float) -> bool:
        self.now_s = round(self.now_s + seconds, 6)
        return self.is_set()

    def is_set(self) -> bool:
        return self.now_s >= self._until_s


class _Rig:
    """A rig that publishes by a table of times in s, and counts the questions for its status."""

    def __init__(self, clock: _Clock, Ts: float, published: dict[str, dict[float, Any]]) -> None:
        self.asked_s: list[float] = []
        self.report = replace(FakeDaemon("there").status(), Ts=Ts)
        self._clock, self._published = clock, published

    @contextmanager
    def arrivals(self, name: str) -> Iterator[Callable[[], list[Any]]]:
        """Yield a function that returns what was published since its last call."""
        left = sorted(self._published.get(name, {}).items())

        def since() -> list[Any]:
            came = [value for t, value in left if t <= self._clock.now_s]
            del left[: len(came)]
            return came

        yield since

    def status(self) -> StatusReport:
        """Return the status."""
        self.asked_s.append(self._clock.now_s)
        return self.report


class _Listener(FeedListener):
    """Listener without a past, which ends by a clock."""

    def __init__(self, feed: Feed, clock: _Clock, found: list[float]) -> None:
        super().__init__(
            feed,
            rig="1",
            connect=None,
            found=lambda: found.append(clock.now_s),
        )
        self._ends = clock  # type: ignore[assignment]

    def _take_past(self) -> None:
        pass


def _listened(
    monkeypatch: pytest.MonkeyPatch,
    Ts: float,
    published: dict[str, dict[float, Any]],
    until_s: float = 60.0,
) -> tuple[_Rig, Feed, float]:
    """Listen to a rig; return the rig, what was heard, and when the listener gave up."""
    clock, feed, found = _Clock(until_s), Feed(), list[float]()
    monkeypatch.setattr(serving.time, "monotonic", lambda: clock.now_s)
    rig: Any = _Rig(clock, Ts, published)
    _Listener(feed, clock, found)._listen(rig)
    assert found == [0.0]
    return rig, feed, clock.now_s


@pytest.mark.parametrize("Ts", [0.001, 0.01, 0.5, 1.0])
@pytest.mark.parametrize("last_s", [0.0, 3.0])
def test_a_rig_without_samples_is_connected_again_after_two_seconds_and_two_samples(
    monkeypatch: pytest.MonkeyPatch, Ts: float, last_s: float
) -> None:
    came = {"sample": {t: sample(round(100 * t)) for t in (last_s / 2, last_s) if last_s}}

    _, feed, ended_s = _listened(monkeypatch, Ts, came)

    assert ended_s == pytest.approx(last_s + 2.0 + 2 * Ts, abs=0.05)
    assert feed.news().newest == (sample(round(100 * last_s)) if last_s else None)


def test_the_status_is_requested_twice_a_second_and_after_each_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def state(**changed: str) -> Any:
        return SimpleNamespace(
            **{"t_host_ns": 1, "phase": "safe", "owner": "", "reason": ""} | changed
        )

    states = {
        0.1: state(),
        0.2: state(owner="Ada"),
        0.3: state(phase="armed"),
        0.4: state(reason="too steep"),
    }
    rig, feed, _ = _listened(monkeypatch, 0.01, {"state": states}, until_s=1.6)

    assert rig.asked_s == pytest.approx([0.0, 0.2, 0.3, 0.4, 0.9, 1.4], abs=0.03)
    assert (feed.trouble, feed.status) == ("", rig.report)


def test_the_dashboard_receives_every_message_of_a_rig(monkeypatch: pytest.MonkeyPatch) -> None:
    report = SimpleNamespace(
        **{
            name: SimpleNamespace(p50=1.0, p99=2.0, max=3.0)
            for name in ("wake_lateness_us", "device_tick_error_us", "link_round_trip_us")
        },
        cpu_pressure_percent=4.0,
    )
    came = {
        "sample": {0.1: sample(0), 0.3: sample(3)},
        "gap": {0.2: gap(1, 2, 1.0, "overrun")},
        "event": {0.2: note(2, "touched")},
        "timing": {0.2: report},
    }

    _, feed, _ = _listened(monkeypatch, 0.01, came, until_s=1.0)

    timing = feed.timing()
    assert (timing.missing, timing.last_gap, sum(timing.late)) == (2, "overrun", 2)
    assert timing.report["wake_max_us"] == 3.0
    assert feed.marks() == [(sample(2).t_host_ns / 1e9, "note", "touched")]


def test_the_whole_history_is_read_and_does_not_count_as_live(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def piece(is_full: bool, *messages: tuple[str, Any]) -> Any:
        sent = tuple(
            (name, encode_sample(m) if isinstance(m, Sample) else m.SerializeToString())
            for name, m in messages
        )
        return SimpleNamespace(is_full=is_full, past=Past(bytes(16), 0, 0, sent))

    pieces = [
        piece(True, ("sample", sample(0)), ("gap", gap(1, 2, 1.0, "overrun"))),
        piece(False, ("sample", sample(3)), ("event", note(2, "touched")), ("sample", sample(4))),
        piece(False, ("sample", sample(99))),
    ]
    monkeypatch.setattr(serving, "open_session", lambda *_, **__: nullcontext())
    source = SimpleNamespace(next_piece=lambda: pieces.pop(0))
    monkeypatch.setattr(serving, "RemoteSource", lambda *_: source)
    feed = Feed()

    FeedListener(feed, rig="1", connect=None, found=lambda: None)._take_past()

    news, timing = feed.news(), feed.timing()
    assert (news.newest, news.age_s) == (sample(4), float("inf"))
    assert (timing.missing, timing.last_gap, sum(timing.late)) == (2, "overrun", 0)
    assert [mark[1:] for mark in feed.marks()] == [("note", "touched")]
    assert len(pieces) == 1
