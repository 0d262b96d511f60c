"""The service says what is in `said.txt`; an odd rig records what is in `odd_runs.txt`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import armrig
import msgspec
import numpy as np
from armrig_core.commands.commands import RunRequest
from armrig_core.errors import OperationError
from armrig_daemon.service.virtual_service import LEASE, VirtualService
from mcap.reader import make_reader

from tests.clients.said import assert_said, compare
from tests.daemon.odd_bench import CONFIG, show

RAMP = [0.25 + 0.02 * k for k in range(180)]


def _lines(path: Path) -> Iterator[str]:
    """Give the content of a recording: its records, its parts, some rows of its samples."""
    recording = armrig.load(path)
    yield f"+ {path.name}"
    with path.open("rb") as file:
        records = make_reader(file)
        yield from (f"  {r.name}: {show(r.metadata)}" for r in records.iter_metadata())
        for r in records.iter_attachments():
            yield f"  {r.name} {r.media_type}: {r.data[:200].decode()!r}"
        kinds = [(c.topic, m.log_time) for _, c, m in records.iter_messages()]
    for topic in sorted({topic for topic, _ in kinds}):
        times = [t for name, t in kinds if name == topic]
        yield f"  {topic}: {len(times)}, {times[0]} to {times[-1]}"
    for part in (*recording.gaps, *recording.events, *recording.timing[:2], *recording.clock[:1]):
        yield f"  {type(part).__name__} {show(asdict(part))}"
    for row in recording.samples[::30]:
        yield "  " + ", ".join(f"{x:.6g}" for x in row.tolist())
    yield f"  u {show(np.round(recording.u[::45], 4).tolist())}"


def test_recordings_of_an_unusual_rig_equal_the_stored_recordings(tmp_path: Path) -> None:
    rig = VirtualService(msgspec.structs.replace(CONFIG), tmp_path, seed=2_000_000_000)
    runs: list[dict[str, Any]] = [
        {"u": RAMP, "experiment": "ramp", "details": {"a": [1, {"b": None}]}},
        {"u": [0.2, 1.5, 0.2] * 15, "experiment": "own", "pacing": "exchange"},
        {"u": [2.0, *[4.4] * 500], "experiment": "too-far"},
        {"u": [4.4], "experiment": "steep"},
    ]
    lines: list[str] = []
    for run in runs:
        lines.append(f"# {run['experiment']}")
        before = {*tmp_path.iterdir()}
        try:
            rig.record(RunRequest(lease=LEASE, n=0, **run))
        except (OperationError, ValueError) as err:
            lines.append(f"  {type(err).__name__}: {err}")
        for path in sorted({*tmp_path.iterdir()} - before):
            lines += _lines(path)

    text = "\n".join(lines).replace(str(tmp_path), "HERE").replace(version("armrig"), "VERSION")
    compare(Path(__file__).with_name("odd_runs.txt"), f"{text}\n")


def test_sentences_of_the_service_equal_the_stored_sentences(tmp_path: Path) -> None:
    assert_said(Path(__file__).with_name("said.txt"), tmp_path)
