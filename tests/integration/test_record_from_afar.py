"""A rig recorded from afar: no kept message is lost, and any other loss is reported."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
import zenoh
from armrig.cli import main
from armrig.recordings.files.verification import verify
from armrig.recordings.recording import Recording
from armrig.rig.remote_recording import RemoteRecording
from armrig.rig.remote_source import Piece, RemoteSource
from armrig.rig.session import open_session
from armrig_core.commands.codes import COMPLETE
from armrig_daemon.service.publish import Session

from tests.clients.made_recordings import gap
from tests.integration.fleet_lab import Publisher, publish, recorded_k
from tests.integration.processes import Bench, newest, wait_for
from tests.sampling import sampled


@pytest.fixture
def where() -> Iterator[str]:
    """Return an endpoint in a directory of its own."""
    with tempfile.TemporaryDirectory(prefix="armrig-") as directory:
        yield f"unixsock-stream/{directory}/1.sock"


def next_piece(source: RemoteSource) -> Piece:
    """Return the next piece; wait for a daemon that is away."""
    pieces: list[Piece | None] = []
    wait_for(lambda: pieces.append(source.next_piece()) or pieces[-1] is not None)
    assert pieces[-1] is not None
    return pieces[-1]


class Recorder:
    """The recorder and its source, driven by hand."""

    def __init__(self, session: zenoh.Session, path: Path) -> None:
        self.source = RemoteSource(session, "1")
        self.told: list[str] = []
        self.recording = RemoteRecording(
            path=path, rig="1", endpoint="there", tell=self.told.append
        )

    def take(self) -> Piece:
        """Record all messages; wait for a daemon that is away."""
        self.recording.add(piece := next_piece(self.source))
        while piece.is_full:
            self.recording.add(piece := next_piece(self.source))
        return piece

    def files(self) -> list[Recording]:
        """Return the recorded files, complete."""
        self.recording.finish(COMPLETE)
        return [armrig.load(file.path) for file in self.recording.done]


def test_a_late_recorder_receives_the_kept_messages(where: str, tmp_path: Path) -> None:
    with Session(where, "1", lambda: None) as daemon:
        publish([daemon], range(1000))
        with open_session(where, rig="1") as session:
            recorder = Recorder(session, tmp_path / "a.mcap")
            recorder.take()
            publish([daemon], range(1000, 5000))
            daemon.put("gap", gap(5000, 5, 2.5).SerializeToString())
            publish([daemon], range(5005, 5010))
            recorder.take()
            assert recorder.take().past.messages == ()
        [found] = recorder.files()

    assert recorded_k(found.path) == [*range(5000), *range(5005, 5010)]
    assert [(g.k_first, g.count, g.reason) for g in found.gaps] == [(5000, 5, "link silent")]
    assert found.missing == 5
    assert recorder.told == []
    assert found.Ts == 0.01
    assert found.manifest.device == {"uid": "7"}
    assert (found.manifest.experiment, found.manifest.details) == (
        "remote",
        {"recorded_from": "there"},
    )
    assert found.outcome is not None
    assert (found.outcome.outcome, found.outcome.missing) == ("complete", 5)
    assert verify(found.path).passed


@pytest.fixture
def published(where: str) -> Iterator[Publisher]:
    """Publish samples until the end."""
    with Session(where, "1", lambda: None) as daemon, Publisher(daemon) as published:
        yield published


def test_the_command_records_until_its_time_is_over(
    where: str,
    tmp_path: Path,
    published: Publisher,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["record", "--from", where, "-o", "a.mcap", "--seconds", "1"]) == 0
    told = capsys.readouterr()
    assert main(["record", "--from", where, "--seconds", "0.5", "--json"]) == 0
    [facts] = json.loads(capsys.readouterr().out)["recordings"]

    found = armrig.load("a.mcap")
    assert recorded_k(found.path) == list(range(found.N))
    assert told.out == f"a.mcap: {found.N} samples, 0 missing, complete\n"
    assert told.err.endswith("next: armrig info a.mcap\n")
    assert Path(facts["recording"]).name.startswith("1-remote-")
    assert facts["samples"] == armrig.load(facts["recording"]).N > 0


def test_every_message_published_before_the_end_is_recorded(where: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Session(where, "1", lambda: None) as daemon:
        publish([daemon], range(20_000))
        assert main(["record", "--from", where, "-o", str(path), "--seconds", "0.001"]) == 0

    assert recorded_k(path) == list(range(20_000))


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["-o", "a.txt"], "-o a.txt: a recording is an MCAP file; give a name that ends in .mcap"),
        (["-o", "there.mcap"], "there.mcap exists; give another name"),
        (["-o", "none/a.mcap"], "-o none/a.mcap: there is no directory none; create it first"),
        (["--rig", "9"], "no reply from rig 9"),
    ],
)
def test_a_mistake_of_the_record_command_is_reported(
    where: str,
    tmp_path: Path,
    published: Publisher,
    arguments: list[str],
    told: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("there.mcap").touch()
    published.wait_for_more(5)

    assert main(["record", "--from", where, "--seconds", "1", *arguments]) == 1

    assert told in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["there.mcap"]


@pytest.mark.parametrize(("number", "code"), sampled([(15, 128 + 15), (2, 0), (1, 128 + 1)]))
def test_a_signal_ends_the_recorder_with_a_complete_file(
    where: str, tmp_path: Path, published: Publisher, number: int, code: int
) -> None:
    path = tmp_path / "a.mcap"
    command = [sys.executable, "-m", "armrig", "record", "--from", where, "-o", str(path)]
    with subprocess.Popen([*command, "--json"], stdout=subprocess.PIPE) as process:
        wait_for(path.with_name("a.mcap.active").exists)
        came = published.k
        process.send_signal(number)
        out = process.communicate(timeout=60)[0]

    assert process.returncode == code
    assert json.loads(out)["recordings"][0]["outcome"] == "complete"
    ks = recorded_k(path)
    assert ks == list(range(len(ks)))
    assert len(ks) >= came


def test_a_remote_recording_has_the_samples_of_the_daemon_s_recording(
    bench: Bench, tmp_path: Path
) -> None:
    bench.configure()
    bench.emulate()
    bench.serve()
    path = tmp_path / "afar.mcap"
    command = [sys.executable, "-m", "armrig", "record", "--from", bench.endpoint, "-o", str(path)]
    pipe = subprocess.PIPE
    with subprocess.Popen([*command, "--json"], stdout=pipe, stderr=pipe) as process:
        assert process.stderr is not None
        assert process.stderr.readline().startswith(b"recording rig 1 from ")
        try:
            with bench.rig() as rig:
                rig.arm("a test", Ts=0.01)
                there = armrig.load(rig.run(np.full(150, 1.0)))
            afar = path.with_name("afar.mcap.active")
            wait_for(lambda: newest(afar, "k") >= there.samples["k"][-1])
        finally:
            process.send_signal(2)
        out: Any = process.communicate(timeout=60)[0]
    files = [armrig.load(file["recording"]) for file in json.loads(out)["recordings"]]

    assert process.returncode == 0
    rows = {int(row["k"]): bytes(row) for here in files for row in here.samples}
    assert len(rows) > there.samples.size
    assert all(rows[int(row["k"])] == bytes(row) for row in there.samples)
    assert all(here.missing == sum(gap.count for gap in here.gaps) for here in files)
