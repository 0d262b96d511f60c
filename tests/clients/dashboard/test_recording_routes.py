"""Requests for recordings: which files there are for the page, and what is sent of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from armrig.dashboard import recording_routes
from armrig.dashboard.app import application
from armrig.dashboard.feed import Feed
from armrig.dashboard.recording_routes import RecordingRoutes, whole_file
from armrig_core.errors import FileError
from armrig_core.recording_file.budget import DamageError
from msgspec.structs import replace

from tests.clients.dashboard.asking import asked
from tests.clients.fake_daemon import FakeDaemon
from tests.clients.made_recordings import manifest, recorded, sample, written

PAIRS = {"b": "c", "d": "a"}  # validation recordings, and the recordings that they validate


class _Routes(RecordingRoutes):
    """Routes whose computations run in this process."""

    def __init__(self, folder: Path) -> None:
        feed = Feed()
        feed.status = replace(FakeDaemon("there").status(), recordings=str(folder))
        super().__init__(feed, "1")
        self.asked: list[tuple[Any, ...]] = []

    async def _in_worker(self, does: Callable[..., Any], *arguments: Any) -> Any:
        self.asked.append((does.__name__, *arguments))
        return b"%PDF" if does.__name__ in ("report", "csv") else does.__name__


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Give a folder of four recordings of four days, two of them for the validation of others."""
    for day, name in enumerate("dcba", 1):
        details = {"validation_of": f"run-{PAIRS[name]}"} if name in PAIRS else {}
        about = manifest(
            run_id=f"run-{name}", started=f"2026-03-0{day}T10:00:00+00:00", details=details
        )
        written(tmp_path, recorded([sample(k) for k in range(3)], manifest=about), f"{name}.mcap")
    (tmp_path / "broken.mcap").write_bytes(b"none")
    return tmp_path


def _answer(routes: RecordingRoutes, path: str, **body: Any) -> tuple[int, bytes]:
    return asked(application(routes.routes()), f"/api/{path}", json.dumps(body).encode())


def test_the_newest_recordings_are_listed_first_and_the_damaged_ones_with_the_reason(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_routes, "_MOST_LISTED", 3)

    status, said = _answer(_Routes(folder), "recordings")

    told = json.loads(said)
    assert (status, told["folder"], told["count"]) == (200, str(folder), 4)
    assert [one["file"] for one in told["recordings"]] == ["a.mcap", "b.mcap", "c.mcap"]
    assert [one["at"] for one in told["recordings"]] == ["@run-a", "@run-b", "@run-c"]
    assert [one["validation_of"] for one in told["recordings"]] == [None, "run-c", None]
    assert told["recordings"][0]["started"].startswith("2026-03-04T10")
    assert any(line.startswith("damaged: broken.mcap: ") for line in told["left_out"])


def test_a_missing_folder_is_reported_with_a_remedy(tmp_path: Path) -> None:
    routes = _Routes(tmp_path / "none")
    routes._folder = lambda: tmp_path / "none"  # type: ignore[method-assign]

    status, said = _answer(routes, "recordings")

    told = f"{tmp_path}/none: No such file or directory; record an experiment first"
    assert (status, json.loads(said)["error"]) == (404, told)


@pytest.mark.parametrize(
    ("path", "more", "asks"),
    [
        ("recording", {}, [("facts",)]),
        ("curves", {"start": 0.5, "stop": 2.5}, [("curves", 0.5, 2.5)]),
        ("curves", {}, [("curves", None, None)]),
        ("csv", {"start": 1.0, "stop": 2.0}, [("csv", 1.0, 2.0)]),
        ("identify", {"output": "alpha"}, [("identified", "d", "alpha")]),
        ("identify", {}, [("identified", "d", "")]),
        ("report", {"output": "theta_1,alpha"}, [("report", "d", "theta_1,alpha")]),
    ],
)
def test_a_request_about_a_recording_is_forwarded_unchanged(
    folder: Path, path: str, more: dict[str, Any], asks: list[tuple[Any, ...]]
) -> None:
    routes = _Routes(folder)

    status, _ = _answer(routes, path, file="a.mcap", **more)

    assert status == 200
    shown = [
        (name, *(x.stem if isinstance(x, Path) else x for x in given))
        for name, file, *given in routes.asked
        if file == folder / "a.mcap"
    ]
    assert shown == asks


@pytest.mark.parametrize(("name", "validation"), [("a", "d"), ("b", None), ("c", "b"), ("d", None)])
def test_a_validation_recording_belongs_to_its_estimation_recording(
    folder: Path, name: str, validation: str | None
) -> None:
    found = _Routes(folder)._validation_of(folder / f"{name}.mcap")

    assert (found.stem if found else None) == validation


@pytest.mark.parametrize(
    "file",
    ["link.mcap", "folder.mcap", "none.mcap", "a.mca", "../a.mcap", "./a.mcap", "", "x/a.mcap"],
)
def test_a_file_that_is_not_a_recording_of_the_folder_is_refused(folder: Path, file: str) -> None:
    (folder / "a.mca").touch()
    (folder / "folder.mcap").mkdir()
    (folder / "link.mcap").symlink_to(folder / "a.mcap")
    routes = _Routes(folder)

    status, said = _answer(routes, "recording", file=file)

    told = f"{file!r}: there is no such file in "
    assert (status, json.loads(said)["error"][: len(told)]) == (400, told)
    assert routes.asked == []


@pytest.mark.parametrize("more", [{"start": -1}, {"stop": 1e8}, {"output": 1}, {"End": 1}])
def test_a_request_with_an_invalid_value_is_refused(folder: Path, more: dict[str, Any]) -> None:
    assert _answer(_Routes(folder), "curves", file="a.mcap", **more)[0] == 400


def test_a_process_that_died_is_restarted_by_the_next_request(folder: Path) -> None:
    routes = _Routes(folder)
    routes._worker = worker = SimpleNamespace()  # type: ignore[assignment]

    async def dies(*_: Any) -> Any:
        assert routes._worker is worker
        raise BrokenProcessPool

    routes._in_worker = dies  # type: ignore[method-assign]

    status, said = _answer(routes, "recording", file="a.mcap")

    assert (status, b"try again" in said) == (500, True)
    assert routes._worker is None


def test_the_folder_of_the_daemon_is_used_if_this_user_may_read_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "own"
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(own))
    of_daemon = tmp_path / "of the daemon"
    routes = _Routes(of_daemon)
    before = routes._folder()
    of_daemon.mkdir()
    there = routes._folder()
    routes._feed.status = None

    assert [before, there, routes._folder()] == [own, of_daemon, own]


def test_a_growing_file_is_sent_in_the_announced_size(folder: Path) -> None:
    path = folder / "a.mcap"
    data = path.read_bytes() + bytes(range(256)) * (1 << 11)  # longer than what is read at once
    path.write_bytes(data)

    size, pieces = whole_file(path)
    with path.open("ab") as file:
        file.write(b"more")

    assert size == len(data)
    assert b"".join(pieces) == data


def test_a_whole_file_is_sent_with_its_length(folder: Path) -> None:
    assert _answer(_Routes(folder), "mcap", file="b.mcap") == (
        200,
        (folder / "b.mcap").read_bytes(),
    )
    with pytest.raises(FileError, match=r"^broken\.mcap: not an MCAP file$"):
        whole_file(folder / "broken.mcap")
    (folder / "link.mcap").symlink_to(folder / "b.mcap")
    with pytest.raises((OSError, DamageError)):
        whole_file(folder / "link.mcap")
