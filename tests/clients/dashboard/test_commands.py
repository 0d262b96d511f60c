"""Commands of the page: each reaches the rig with what was given, and is answered."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from armrig.dashboard.app import RigRoutes, application
from armrig.dashboard.driver import RunState
from armrig.dashboard.experiments import ExperimentRequest, plan_of
from armrig.dashboard.feed import Feed
from armrig.dashboard.guard import Connections
from armrig.dashboard.stream import Stream
from armrig.rig.collection import Plan
from armrig.rig.session import RigError
from msgspec.structs import replace
from starlette.applications import Starlette

from tests.clients.dashboard.asking import asked
from tests.clients.fake_daemon import FakeDaemon
from tests.core.control.laws import arm_law

VISITOR = "a visitor of the dashboard"


class _Driver:
    """Keeps the commands, and answers True once."""

    def __init__(self) -> None:
        self.run = RunState()
        self.given: list[tuple[Any, ...]] = []
        self.error: RigError | None = None

    def __getattr__(self, name: str) -> Any:
        def does(*given: Any) -> bool:
            self.given.append((name, *given))
            if self.error is not None:
                raise self.error
            return self.given.count((name, *given)) == 1

        return does

    def start(self, plan: Plan, *, asked_s: float) -> None:
        """Keep what is played, and for whom."""
        self.given.append(("start", plan.experiment, plan.seconds, plan.owner, asked_s > 0))


@pytest.fixture
def driver() -> Any:
    """Give what keeps the commands."""
    return _Driver()


def _app(driver: Any, feed: Feed, *, may_command: bool) -> Starlette:
    routes = RigRoutes(feed, driver, Stream(feed, driver, may_command=may_command))
    return application([*routes.watching(Connections()), *routes.commanding()])


@pytest.mark.parametrize(
    ("path", "body", "given", "answers"),
    [
        ("arm", {"owner": "Ada", "Ts": 0.02}, ("arm", "Ada", 0.02), [{"armed": True}] * 2),
        ("arm", {"owner": "Bob"}, ("arm", "Bob", None), [{"armed": True}] * 2),
        ("release", {}, ("release",), [{"released": True}, {"released": False}]),
        ("reset", {}, ("reset",), [{"was_latched": True}, {"was_latched": False}]),
        (
            "note",
            {"owner": "Ada", "text": "touched"},
            ("note", "touched", "Ada"),
            [{"recorded": True}, {"recorded": False}],
        ),
        ("reference", {"r": 2.5}, ("set_reference", 2.5), [{"sent": True}] * 2),
        (
            "run",
            {"owner": "Bob", "experiment": {"kind": "step", "seconds": 2.5, "name": "x"}},
            ("start", "step-x", 2.5, "Bob", True),
            [{"started": True}] * 2,
        ),
        ("stop", {"owner": "Ada"}, ("stop", "Ada"), [{"stopped": True}] * 2),
    ],
)
def test_a_command_is_forwarded_with_all_its_fields(
    driver: Any, path: str, body: dict[str, Any], given: tuple[Any, ...], answers: list[Any]
) -> None:
    app = _app(driver, Feed(), may_command=True)

    found = [asked(app, f"/api/{path}", json.dumps(body).encode()) for _ in range(2)]

    assert driver.given == [given] * 2
    assert [(status, json.loads(text)) for status, text in found] == [(200, a) for a in answers]


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("arm", b'{"owner": "", "Ts": 0.01}'),
        ("arm", b'{"owner": "Ada", "Ts": 60.1}'),
        ("arm", b'{"owner": "Ada", "Ts": 0}'),
        ("arm", b'{"owner": "Ada", "ts": 0.01}'),
        ("note", b'{"owner": "%s", "text": "a"}' % (81 * b"x")),
        ("reference", b'{"r": "fast"}'),
        ("run", b'{"owner": "Ada", "experiment": {"kind": "steps"}}'),
        ("run", b'{"owner": "Ada", "experiment": {"kind": "step", "name": "A"}}'),
        ("run", b'{"owner": "Ada", "experiment": {"kind": "step", "at": 9}}'),
    ],
)
def test_a_forbidden_command_does_not_reach_the_rig(driver: Any, path: str, body: bytes) -> None:
    status, said = asked(_app(driver, Feed(), may_command=True), f"/api/{path}", body)

    assert (status, driver.given) == (400, [])
    assert json.loads(said)["error"]


@pytest.mark.parametrize("body", [b"", b"{}", b"[", b'{"owner": 7}', b'{"owner": "\xff"}'])
@pytest.mark.parametrize(("may_command", "by"), [(True, ""), (False, VISITOR)])
def test_a_stop_with_an_invalid_body_stops_the_rig(
    driver: Any, body: bytes, may_command: bool, by: str
) -> None:
    app = _app(driver, Feed(), may_command=may_command)

    assert asked(app, "/api/stop", body)[0] == 200
    assert driver.given == [("stop", by)]


def test_a_visitor_cannot_choose_the_name_of_a_stop(driver: Any) -> None:
    asked(_app(driver, Feed(), may_command=False), "/api/stop", b'{"owner": "Ada"}')

    assert driver.given == [("stop", VISITOR)]


def test_an_undelivered_stop_is_reported(driver: Any) -> None:
    """With the reason that the page shows already, if there is one."""
    driver.error, feed = RigError("no daemon"), Feed()
    found = []

    for feed.trouble in ("", "start `armrig lab`"):
        found.append(asked(_app(driver, feed, may_command=True), "/api/stop", b"{}"))

    assert found == [
        (502, b'{"error":"no daemon"}'),
        (502, b'{"error":"start `armrig lab`"}'),
    ]


def test_a_preview_without_a_rig_reports_the_reason(driver: Any) -> None:
    feed = Feed()
    feed.trouble = "the service of rig 1 has stopped"

    status, said = asked(_app(driver, feed, may_command=True), "/api/preview", b'{"kind": "step"}')

    assert (status, json.loads(said)["error"]) == (502, feed.trouble)


def test_the_laws_are_those_of_the_folder_of_the_recordings(driver: Any, tmp_path: Path) -> None:
    feed = Feed()
    feed.take_status(replace(FakeDaemon("there").status(), recordings=str(tmp_path)))
    (tmp_path / "law.json").write_bytes(arm_law().text)
    app = _app(driver, feed, may_command=True)

    status, said = asked(app, "/api/laws", b"{}")
    body = {"owner": "Ada", "experiment": {"kind": "control", "law": "law.json", "seconds": 2.0}}
    refused, why = asked(app, "/api/run", json.dumps(body).encode())
    body["experiment"] |= {"word": "unmonitored"}  # type: ignore[operator]
    started, _ = asked(app, "/api/run", json.dumps(body).encode())

    assert (status, [law["file"] for law in json.loads(said)["laws"]]) == (200, ["law.json"])
    assert (refused, "unmonitored" in json.loads(why)["error"]) == (400, True)
    assert (started, driver.given) == (200, [("start", "control", 2.0, "Ada", True)])


@pytest.mark.parametrize(
    ("file", "stored"), [("a/mine.csv", "mine.csv"), ("u.txt", "u.txt"), ("", "input.csv")]
)
def test_only_the_name_of_a_user_s_file_is_stored(file: str, stored: str) -> None:
    plan = plan_of(ExperimentRequest(kind="csv", file=file, text="u\n1\n2\n"), "Ada")

    assert plan.details == {"input": "csv", "file": stored}
    assert plan.make(0, 0.01).tolist() == [1.0, 2.0]
