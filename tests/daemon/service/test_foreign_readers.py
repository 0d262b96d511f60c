"""Other programs read the recordings: whole, recovered, and in parts."""

from __future__ import annotations

import json
import os
import subprocess
from collections import Counter
from pathlib import Path
from typing import Any

import armrig
import pytest
from armrig.recordings.files.container import read
from armrig_core.commands.commands import RunRequest
from armrig_core.recording_file.manifest import (
    CALIBRATION,
    CONFIG,
    DESCRIPTION,
    INPUT,
    OUTCOME,
    RECOVERED,
    RUN,
)
from armrig_core.recording_file.recording_part import RecordingPart
from armrig_core.recording_file.recovery import Recovery
from armrig_core.telemetry.telemetry import Outgoing, Sample, encode_sample
from armrig_core.telemetry.topics import RECORDED
from armrig_daemon.config import Config
from armrig_daemon.service import runs
from armrig_daemon.service.virtual_service import LEASE, VirtualService
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from tests.tools import require

NODE = Path(__file__).parents[2] / "node"
N, FLUSH = 400, 50
TORN = 1_500  # B: some of the samples of the last flush, and the index after them


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return recordings of the daemon, made in virtual time, by their special property."""
    folder = tmp_path_factory.mktemp("files")
    u = armrig.telegraph(N, 0.05, low=0.5, high=4.5, seed=1).tolist()
    service = VirtualService(Config(), folder, seed=1)
    whole = service.record(RunRequest(lease=LEASE, n=0, u=u, experiment="a"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "part_samples", lambda *_: 150)
        service.record(RunRequest(lease=LEASE, n=0, u=u, experiment="b"))
    parts = sorted(folder.glob("*.part-*"))
    assert len(parts) == 3
    named = {f"part {i}": part for i, part in enumerate(parts, 1)}
    return {"whole": whole, "recovered": _recovered(folder, armrig.load(whole)), **named}


def _recovered(folder: Path, recording: armrig.Recording) -> Path:
    """Return the recording of a daemon that died within a write, recovered."""
    about = {CONFIG: b"{}", CALIBRATION: b"{}", INPUT: b"u_v\n1.0\n"}
    part = RecordingPart(folder / "recovered.mcap").begin(recording.manifest, about, 0)
    for i, values in enumerate(recording.samples.tolist(), 1):
        s = Sample(*values)
        part.add(Outgoing("sample", s.t_host_ns, s.t_sched_ns, s.k, encode_sample(s)))
        if i % FLUSH == 0:
            part.flush()
    part.give_up()
    os.truncate(part.active, part.size - TORN)
    done = Recovery(armrig="0", now=lambda: "2026-01-01T00:00:00+00:00").recover(part.active)
    assert done.outcome.samples == N - FLUSH
    assert done.recovered.cut_off_bytes > 0
    return done.path


def _metadata(name: str) -> list[str]:
    return [RUN, OUTCOME, *([RECOVERED] if name == "recovered" else [])]


def _attachments(name: str) -> set[str]:
    described = set() if name == "recovered" else {DESCRIPTION}
    return {CONFIG, CALIBRATION} | described | (set() if name in ("part 2", "part 3") else {INPUT})


def _check(topics: dict[str, int], samples: dict[str, Any], path: Path) -> None:
    """Check another program's result against armrig's own reading."""
    ours = read(path, RECORDED)
    assert ours is not None
    counts = {"sample": ours.samples.size, **{s: len(m) for s, m in ours.messages.items()}}
    assert topics == {f"/rig/1/{stream}": n for stream, n in counts.items()}
    assert samples["k"] == ours.samples["k"].tolist()
    assert samples["counts"] == ours.samples["theta_1_counts"].sum()
    assert samples["u"] == pytest.approx(ours.samples["u_applied_v"].sum(), rel=1e-12)


def test_mcap_for_python_reads_a_recording_with_its_protobuf_support(
    files: dict[str, Path],
) -> None:
    """mcap-protobuf-support, from the schemas in the file alone."""
    for name, path in files.items():
        topics: Counter[str] = Counter()
        samples: list[Any] = []
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            for _, channel, _, message in reader.iter_decoded_messages():
                topics[channel.topic] += 1
                if channel.topic == "/rig/1/sample":
                    samples.append(message)
            metadata = [record.name for record in reader.iter_metadata()]
            attachments = {record.name for record in reader.iter_attachments()}

        found = {
            "k": [s.k for s in samples],
            "counts": sum(s.theta_1_counts for s in samples),
            "u": sum(s.u_applied_v for s in samples),
        }
        _check(topics, found, path)
        assert metadata == _metadata(name)
        assert attachments == _attachments(name)


def test_mcap_for_javascript_reads_a_recording(files: dict[str, Path]) -> None:
    """@mcap/core, by the index, and from front to back."""
    require("node")
    if not (NODE / "node_modules/@mcap/core").is_dir():
        pytest.skip("no @mcap/core: npm install --prefix tests/node")

    said = subprocess.run(
        ["node", NODE / "read_mcap.mjs", *files.values()],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )

    assert said.returncode == 0, said.stderr
    for (name, path), told in zip(files.items(), json.loads(said.stdout), strict=True):
        for way in ("index", "stream"):
            _check(told[way]["topics"], told[way]["samples"], path)
        assert told["stream"]["done"] is True
        assert told["index"]["profile"] == "armrig"
        assert told["index"]["metadata"] == _metadata(name)
        assert set(told["index"]["attachments"]) == _attachments(name)
