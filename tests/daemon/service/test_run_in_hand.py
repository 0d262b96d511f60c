"""The current run: its samples in the recording, and its report at the end."""

from __future__ import annotations

from math import inf
from pathlib import Path
from types import SimpleNamespace

import pytest
from armrig_core.commands.codes import COMPLETE, GapCode, OutcomeCode
from armrig_core.commands.commands import RunRequest
from armrig_core.recording_file.manifest import OUTCOME, Outcome
from armrig_core.telemetry.telemetry import Outgoing, Sample, encode_sample
from armrig_daemon.config import Config
from armrig_daemon.pipe import Gap, Log, RunStarted, State
from armrig_daemon.service.protobuf_out import outgoing
from armrig_daemon.service.runs import Runs
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from tests.daemon.service.opened_run import open_run

REQUEST = RunRequest(lease="a" * 32, n=1, u=[1.0] * 10, dead_man=2.0)
STATE = State(t_host_ns=0, phase="active", reason="", owner="a test", ts_us=10_000, device={})
FIRST, END = 100, 110
T_NS = 5_000
NEARLY_FULL = SimpleNamespace(f_bavail=3000, f_bfree=10**8, f_blocks=10**9, f_frsize=1000)
"""3 MB for ordinary users; the reserve of root does not count."""


@pytest.fixture
def runs(tmp_path: Path) -> Runs:
    """Return runs of which none is in hand."""
    return Runs(Config(), tmp_path, lambda: None)


def _begin(runs: Runs, run_id: str = "") -> Path:
    """Begin a run of 10 samples; return its recording while it is written."""
    order, _ = open_run(runs, REQUEST, 0.01)
    started = RunStarted(
        run_id=run_id or order.run_id, k_first=FIRST, count=END - FIRST, t_host_ns=T_NS
    )
    return runs.begin(started, STATE, {}, 0)


def _sample(k: int) -> Outgoing:
    sample = Sample(k, T_NS, T_NS, 0, 0.0, 0.0, 1.0, 1.0, 0, 0, 0)
    return Outgoing("sample", T_NS, T_NS, k, encode_sample(sample))


def _gap(first: int, count: int) -> Gap:
    return Gap(
        k_first=first,
        count=count,
        t_from_ns=1,
        t_to_ns=2,
        u_held_v=0.0,
        reason="late",
        code=GapCode.HOST_LATE,
    )


def _ended(runs: Runs, expected: str = "info") -> str:
    """End the run; return the sentence on its recording, which has the expected level."""
    runs.end(COMPLETE)
    level, text = runs.completion_line(30)
    assert level == expected
    return text


def _missing_in_file(path: Path) -> int:
    with path.with_suffix("").open("rb") as file:
        metadata = {m.name: m.metadata for m in make_reader(file).iter_metadata()}
    return Outcome.of(metadata[OUTCOME]).missing


def test_a_recording_contains_only_the_samples_of_its_run(runs: Runs) -> None:
    assert not runs.includes_sample(FIRST)

    _begin(runs)

    assert [k for k in range(FIRST - 2, END + 2) if runs.includes_sample(k)] == [*range(FIRST, END)]
    runs.end(COMPLETE)
    assert not runs.includes_sample(FIRST)
    runs.completion_line(30)


@pytest.mark.parametrize(
    ("gap", "missing"),
    [
        (_gap(FIRST - 5, 10), 5),
        (_gap(END - 2, 10), 2),
        (_gap(FIRST - 5, 100), END - FIRST),
        (_gap(FIRST + 1, 1), 1),
        (_gap(FIRST - 5, 5), 0),
        (_gap(END, 3), 0),
    ],
)
def test_only_samples_of_the_run_count_as_missing_in_a_gap(
    runs: Runs, gap: Gap, missing: int
) -> None:
    """L2."""
    path = _begin(runs)

    assert runs.includes(gap) == (missing > 0)
    runs.add([outgoing(gap, 0)] if runs.includes(gap) else [])

    assert _ended(runs).endswith(f"complete, 0 samples, {missing} missing")
    assert _missing_in_file(path) == missing


def test_a_completed_run_does_not_watch_its_client(runs: Runs) -> None:
    _begin(runs)
    assert runs.client_gone_s < inf

    runs.end(COMPLETE)

    assert runs.client_gone_s == inf
    runs.completion_line(30)


def test_the_loss_of_a_client_is_reported_once(runs: Runs) -> None:
    _begin(runs)

    assert runs.client_gone() == (
        OutcomeCode.CLIENT_GONE,
        "its client went away: no sign of it for 2 s",
    )

    assert runs.client_gone_s == inf
    _ended(runs)


def test_a_refusal_removes_only_the_refused_run(runs: Runs) -> None:
    order, _ = open_run(runs, REQUEST, 0.01)

    runs.forget("another")
    assert not runs.is_idle
    with pytest.raises(ValueError, match="an experiment is running"):
        open_run(runs, REQUEST, 0.01)

    runs.forget(order.run_id)
    assert runs.is_idle


def test_an_unrequested_run_is_not_recorded(runs: Runs, tmp_path: Path) -> None:
    with pytest.raises(LookupError, match="run another was not requested"):
        _begin(runs, "another")

    for recording in runs._dropped:
        recording.join(30)
    assert list(tmp_path.iterdir()) == []
    assert not runs.includes_sample(FIRST)


@pytest.mark.parametrize(("samples", "fits"), [(8_130, True), (8_131, False)])
def test_a_recording_that_would_fill_the_disk_is_not_begun(
    runs: Runs, monkeypatch: pytest.MonkeyPatch, samples: int, fits: bool
) -> None:
    """200 B a sample, 4000 B a second and 1 MiB."""
    monkeypatch.setattr(
        "armrig_core.recording_file.recording_part.os.statvfs", lambda _: NEARLY_FULL
    )
    request = RunRequest(lease="a" * 32, n=1, u=[0.0] * samples)

    if fits:
        open_run(runs, request, 0.01)
    else:
        with pytest.raises(ValueError, match="3 MB free, 3 MB needed; free disk space"):
            open_run(runs, request, 0.01)
    assert runs.is_idle != fits


def _note(text: str) -> Outgoing:
    fields = {"owner": "Ada"}
    return outgoing(Log(t_host_ns=1, level="info", message=text, fields=fields, is_note=True), 0)


def _notes(path: Path) -> list[str]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [m.decoded_message.message for m in reader.iter_decoded_messages()]


def test_a_note_between_the_request_and_the_first_sample_is_recorded_once(runs: Runs) -> None:
    refused, _ = open_run(runs, REQUEST, 0.01)
    runs.add_note(_note("of a refused run"))
    runs.forget(refused.run_id)
    assert not runs.takes_notes
    runs.add_note(_note("of no run"))

    order, answer = open_run(runs, REQUEST, 0.01)
    assert runs.takes_notes
    runs.add_note(_note("early"))
    started = RunStarted(run_id=order.run_id, k_first=FIRST, count=END - FIRST, t_host_ns=T_NS)
    runs.begin(started, STATE, {}, 0)
    runs.add_note(_note("during the run"))
    _ended(runs)

    assert _notes(Path(answer.recording)) == ["early", "during the run"]


def test_a_run_is_reported_as_finished_once_its_recording_is_complete(runs: Runs) -> None:
    open_run(runs, REQUEST, 0.01)
    planned = runs.last
    assert planned is not None
    assert planned.recording.endswith(f"-{planned.run_id}.mcap.active")
    runs.forget(planned.run_id)
    path = _begin(runs)
    assert runs.last is not None
    assert runs.last.recording == str(path)
    runs.end(COMPLETE)
    assert not runs.last.finished

    runs.completion_line(30)

    assert runs.last.finished
    assert runs.last.recording == str(path.with_suffix(""))
    assert (runs.last.code, runs.last.outcome) == (OutcomeCode.COMPLETE, "complete")
