"""Files of a recorder: each can be loaded, for any daemon."""

from __future__ import annotations

import threading
import time
from functools import partialmethod
from math import nan
from pathlib import Path
from typing import Any

import armrig
import pytest
from armrig.recordings.files.container import stream_messages
from armrig.recordings.files.verification import verify
from armrig.recordings.grid import MISSING_LIMIT
from armrig.rig import remote_recording
from armrig.rig.remote_recording import STARTED_ANEW, DiskError, RecordedFile, RemoteRecording
from armrig.rig.remote_source import Piece
from armrig.rig.session import RigError
from armrig.rig.telemetry_stream import decode
from armrig_core.commands.codes import COMPLETE, GapCode
from armrig_core.recording_file import recording_part
from armrig_core.recording_file.recorder import ActiveRecording
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.history import Past
from armrig_core.telemetry.telemetry import Outgoing, Sample, encode_sample
from mcap.reader import make_reader

from tests.integration.processes import wait_for

TS_NS = 10_000_000
OFFSET_NS = 1_750_000_000_000_000_000
Message = tuple[str, bytes]


def message(stream: str, **fields: Any) -> Message:
    made = protobuf.message_class(protobuf.OF_STREAM[stream])(**fields)
    return stream, made.SerializeToString()


def state(Ts: float = 0.01, device: str = '{"uid": "7"}') -> Message:
    return message("state", t_host_ns=5_000_000_000, phase="safe", Ts_s=Ts, device=device)


def sample(number: int, **changes: Any) -> Message:
    due = 5_000_000_000 + number * TS_NS
    made = Sample(number, due, due + 9, number * 10_000, 0.1, 0.0, 1.0, 1.0, 32768, 32768, 3)
    return "sample", encode_sample(made._replace(**changes))


def sample_ns(number: int) -> int:
    return 5_000_000_000 + number * TS_NS


def gap(k_first: int, count: int) -> Message:
    t_ns = 5_000_000_000 + k_first * TS_NS
    return message(
        "gap",
        k_first=k_first,
        count=count,
        t_from_ns=t_ns,
        t_to_ns=t_ns + min(count, 10**9) * TS_NS,
        u_held_v=2.5,
        reason="link silent",
    )


def piece(
    *messages: Message, lost: int = 0, anew: bool = False, offset_ns: int = OFFSET_NS
) -> Piece:
    return Piece(past=Past(bytes(16), 0, offset_ns, messages), is_new_life=anew, lost=lost)


@pytest.fixture
def recording(tmp_path: Path) -> RemoteRecording:
    told: list[str] = []
    return RemoteRecording(
        path=tmp_path / "monday.mcap", rig="1", endpoint="there", tell=told.append
    )


def files(recording: RemoteRecording) -> list[armrig.Recording]:
    """Return the recorded files; each can be loaded and has the right content."""
    recording.finish(COMPLETE)
    for file in recording.done:
        found = verify(file.path)
        assert found.passed, found
    return [armrig.load(file.path) for file in recording.done]


def ks(recording: armrig.Recording) -> list[int]:
    return [int(k) for k in recording.samples["k"]]


def test_a_gap_is_recorded_in_the_file_with_samples_on_both_sides(
    recording: RemoteRecording,
) -> None:
    recording.add(piece(state(), gap(0, 5), sample(5), sample(6), gap(7, 2)))
    recording.add(piece(sample(9), gap(10, 3)))

    [found] = files(recording)

    assert ks(found) == [5, 6, 9]
    assert [(g.k_first, g.count, g.reason) for g in found.gaps] == [(7, 2, "link silent")]


def test_the_decisions_of_a_law_are_recorded_with_the_samples(recording: RemoteRecording) -> None:
    decision = message("control", t_host_ns=sample_ns(5), k=5, r=2.0, v=1.5, u_v=1.5)
    recording.add(piece(state(), sample(5), decision, sample(6)))

    [found] = files(recording)

    assert ks(found) == [5, 6]
    assert [m.r for m in stream_messages(found.path, "control")] == [2.0]


def test_a_break_too_long_for_a_file_begins_a_new_file(recording: RemoteRecording) -> None:
    behind = 6 + MISSING_LIMIT + 1
    recording.add(piece(state(), sample(5)))
    recording.add(piece(sample(behind), sample(behind + 1), lost=7))

    first, second = files(recording)

    assert (ks(first), ks(second)) == ([5], [behind, behind + 1])
    assert first.outcome is not None
    assert first.outcome.outcome == "200001 samples are missing after its last sample"
    assert second.path.name == "monday-2.mcap"


def test_a_file_ends_before_it_is_too_long_to_be_loaded(
    recording: RemoteRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote_recording, "MOST_ROWS", 10)
    recording.add(piece(state(), *(sample(k) for k in range(25))))

    found = files(recording)

    assert [ks(file) for file in found] == [[*range(10)], [*range(10, 20)], [*range(20, 25)]]
    assert [file.outcome for file in recording.done] == ["continued", "continued", "complete"]


def test_samples_received_before_the_first_state_are_recorded(recording: RemoteRecording) -> None:
    recording.add(piece(sample(0), gap(1, 1), sample(2)))
    recording.add(piece(state(), sample(3)))

    [found] = files(recording)

    assert ks(found) == [0, 2, 3]
    assert [(g.k_first, g.count) for g in found.gaps] == [(1, 1)]


def test_a_restart_of_the_daemon_begins_a_new_file(recording: RemoteRecording) -> None:
    hour_ns = 3_600_000_000_000
    at = {"seconds": OFFSET_NS // 10**9 + 5, "nanos": 8 * TS_NS}
    hello = message("event", message="hello", timestamp=at)
    recording.add(piece(state(0.0), state(0.02), sample(5), gap(6, 2), sample(8), hello))
    gone = sample(11, t_host_ns=sample_ns(11) + 500)
    recording.add(piece(sample(10), gone, gap(24, 3), lost=4))
    changed = {"anew": True, "offset_ns": OFFSET_NS + hour_ns}
    recording.add(piece(sample(20), sample(21), sample(23), **changed))
    recording.add(piece(state(0.05, '{"uid": "8"}'), sample(27), offset_ns=OFFSET_NS + hour_ns))

    first, second = files(recording)

    assert (ks(first), ks(second)) == ([5, 8, 10, 11], [20, 21, 23, 27])
    assert [
        (f.manifest.Ts, f.manifest.device, f.manifest.clock_offset_ns - OFFSET_NS)
        for f in (first, second)
    ] == [(0.02, {"uid": "7"}, 0), (0.05, {"uid": "8"}, hour_ns)]
    assert {f.manifest.rig for f in (first, second)} == {"1"}
    assert first.manifest.details == {"recorded_from": "there"}
    assert [(g.k_first, g.count, g.u_held_v, g.code) for g in first.gaps] == [
        (6, 2, 2.5, GapCode.UNKNOWN),
        (9, 1, pytest.approx(nan, nan_ok=True), GapCode.RECORDER_CUT_OFF),
    ]
    assert [(g.k_first, g.count, g.code) for g in second.gaps] == [
        (22, 1, GapCode.RECORDER_CUT_OFF),
        (24, 3, GapCode.RECORDER_CUT_OFF),
    ]
    assert next((e.t, e.message) for e in first.events) == (pytest.approx(0.03, abs=1e-6), "hello")
    assert recording.done == [
        RecordedFile(path=first.path, outcome=STARTED_ANEW, samples=4, missing=3),
        RecordedFile(path=second.path, outcome="complete", samples=4, missing=4),
    ]
    with first.path.open("rb") as file:
        raw = [
            (about.topic, m.log_time - OFFSET_NS, m.publish_time - OFFSET_NS, m.sequence, m.data)
            for _, about, m in make_reader(file).iter_messages(log_time_order=False)
        ]
    assert [entry for entry in raw if "sample" in entry[0]] == [
        ("/rig/1/sample", sample_ns(k) + late, sample_ns(k), k, sample(k)[1])
        for k, late in ((5, 9), (8, 9), (10, 9))
    ] + [("/rig/1/sample", sample_ns(11) + 500, sample_ns(11), 11, gone[1])]
    held, lost = (decode("gap", entry[4]) for entry in raw if "gap" in entry[0])
    assert (held.reason, lost.reason) == ("link silent", GapCode.RECORDER_CUT_OFF.sentence)
    assert (held.t_from_ns, held.t_to_ns) == (sample_ns(6), sample_ns(8))
    assert (lost.t_from_ns, lost.t_to_ns) == (sample_ns(8) + 9, sample_ns(10) + 9)
    assert next(entry[1] for entry in raw if "event" in entry[0]) == sample_ns(8) + 9
    assert recording.tell.__self__ == [
        f"{GapCode.RECORDER_CUT_OFF.sentence}: 4 messages are lost",
        STARTED_ANEW,
    ]  # type: ignore[attr-defined]


def test_lost_messages_are_an_event_at_the_time_of_the_rig_s_machine(
    recording: RemoteRecording,
) -> None:
    offset_ns = time.time_ns() - sample_ns(0)
    recording.add(piece(state(), sample(0), offset_ns=offset_ns))
    recording.add(piece(sample(1), lost=3, offset_ns=offset_ns))

    [found] = files(recording)

    [warning] = found.events
    assert warning.message == f"{GapCode.RECORDER_CUT_OFF.sentence}: 3 messages are lost"
    assert warning.t == pytest.approx(0.0, abs=30.0)


def test_an_existing_file_is_not_replaced(recording: RemoteRecording, tmp_path: Path) -> None:
    for name in ("monday-2.mcap", "monday-3.mcap.active"):
        (tmp_path / name).write_bytes(b"precious")
    recording.add(piece(state(), sample(0), state(0.02), sample(1)))
    recording.finish(COMPLETE)

    assert [file.path.name for file in recording.done] == ["monday.mcap", "monday-4.mcap"]
    assert (tmp_path / "monday-2.mcap").read_bytes() == b"precious"
    assert (tmp_path / "monday-3.mcap.active").read_bytes() == b"precious"


@pytest.mark.parametrize(
    "messages",
    [
        (state(float("nan")),),
        (state(float("inf")),),
        (state(5e-324),),
        (state(-1.0),),
        (state(), sample(0, k=1 << 62)),
        (state(), sample(0, t_host_ns=-1)),
        (state(), sample(0, t_sched_ns=-(2**63))),
        (state(), sample(0, t_host_ns=2**63 - 1)),
        (state(), message("gap", k_first=2**63, count=2**63)),
        (message("timing", t_host_ns=-1),),
        (("sample", b"\xff" * 87),),
        (state(), sample(5), sample(5)),
        (state(), sample(5), sample(4)),
    ],
)
def test_an_invalid_message_is_refused(
    recording: RemoteRecording, messages: tuple[Message, ...]
) -> None:
    recording.add(piece(state(), sample(1), sample(2)))

    with pytest.raises(RigError, match=r"not a message of armrigd|not an armrigd"):
        recording.add(piece(*messages))

    [found] = files(recording)
    assert ks(found)[:2] == [1, 2]


@pytest.mark.parametrize("offset_ns", [-1, 1 << 62, -(2**63)])
def test_an_invalid_clock_offset_is_refused(recording: RemoteRecording, offset_ns: int) -> None:
    with pytest.raises(RigError, match="the clock offset"):
        recording.add(piece(state(), sample(1), offset_ns=offset_ns))


@pytest.mark.parametrize("seconds", [2**62, -(2**62), 0])
def test_an_event_with_any_time_stamp_is_recorded(recording: RemoteRecording, seconds: int) -> None:
    event = message("event", message="hello", timestamp={"seconds": seconds})
    recording.add(piece(state(), sample(1), event, sample(2)))

    [found] = files(recording)

    assert [e.message for e in found.events] == ["hello"]


@pytest.mark.parametrize(
    "device",
    ["[1]", "none", '{"a": "\\ud800"}', "[" * 5000, '{"a":' * 40 + "1" + "}" * 40, '{"a": 1e999}'],
)
def test_an_invalid_device_description_is_recorded_as_empty(
    recording: RemoteRecording, device: str
) -> None:
    recording.add(piece(state(device=device), sample(1)))

    [found] = files(recording)

    assert ks(found) == [1]
    assert found.manifest.device == {}


def test_messages_without_a_sampling_time_do_not_accumulate(recording: RemoteRecording) -> None:
    """16 MB of them cannot come from a daemon, whose second is far smaller."""
    large = message("event", message="x" * 1_000_000)

    for _ in range(16):
        recording.add(piece(large))
    with pytest.raises(RigError, match="its sampling time is unknown"):
        recording.add(piece(large))


def test_a_recorder_begins_at_most_60_files_in_a_minute(recording: RemoteRecording) -> None:
    changing = [m for i in range(100) for m in (state(0.01 + i / 1000), sample(i))]

    with pytest.raises(RigError, match="60 files in a minute"):
        recording.add(piece(*changing))

    assert len(recording.done) == 60


def test_long_gaps_without_a_sample_do_not_accumulate(recording: RemoteRecording) -> None:
    """A daemon sends no reason of 100 kB: 1 MiB of them is kept."""
    when = {"t_from_ns": 0, "t_to_ns": 0}
    reason = "x" * 100_000
    long = [message("gap", k_first=k, count=1, reason=reason, **when) for k in range(1, 30)]

    recording.add(piece(state(), sample(0), *long))

    assert [int(told.k_first) for told in recording._told] == list(range(20, 30))


def test_the_recorder_waits_for_a_slow_disk(
    recording: RemoteRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    goes = threading.Event()
    add = recording_part.RecordingPart.add

    def slow(part: recording_part.RecordingPart, message: Outgoing) -> None:
        goes.wait(30)
        add(part, message)

    monkeypatch.setattr(recording_part.RecordingPart, "add", slow)

    def fill() -> None:
        recording.add(piece(state()))
        for k in range(40):
            recording.add(piece(sample(k)))

    filling = threading.Thread(target=fill)
    filling.start()
    time.sleep(0.5)
    waits = filling.is_alive()
    goes.set()
    filling.join(30)

    assert waits
    [found] = files(recording)
    assert ks(found) == list(range(40))


def test_a_disk_that_does_not_answer_ends_the_recorder(
    recording: RemoteRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also if only the sync waits, and no message."""
    goes = threading.Event()
    monkeypatch.setattr(recording_part.RecordingPart, "sync", lambda _: goes.wait(60))
    recording.add(piece(state()))
    recording.add(piece(sample(0)))
    monkeypatch.setattr(ActiveRecording, "look", partialmethod(ActiveRecording.look, 0.0))

    def fill() -> None:
        for k in range(1, 100_000):
            recording.add(piece(sample(k)))

    with pytest.raises(DiskError, match=r"up to \d+ of \d+ samples are lost; `armrig"):
        fill()
    goes.set()


def test_a_file_ended_by_a_full_disk_is_complete_and_listed(
    recording: RemoteRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reserve completes the file; the error names the disk's reason."""
    flush = recording_part.RecordingPart.flush
    added = threading.Event()

    def full(self: recording_part.RecordingPart) -> None:
        added.wait(30)
        flush(self)
        raise recording_part.EndsHereError("No space left on device")

    monkeypatch.setattr(recording_part.RecordingPart, "flush", full)
    recording.add(piece(state(), *map(sample, range(5))))
    added.set()
    wait_for(recording.path.exists)

    with pytest.raises(RigError, match="No space left on device"):
        recording.finish(COMPLETE)

    [file] = recording.done
    assert (file.outcome, file.samples) == ("its recording ended early", 5)
    assert armrig.load(file.path).samples.size == 5


def test_a_removed_folder_is_reported(recording: RemoteRecording, tmp_path: Path) -> None:
    recording.path = tmp_path / "gone" / "monday.mcap"

    with pytest.raises(RigError, match=r"monday\.mcap: No such file or directory; .* by -o"):
        recording.add(piece(state(), sample(1)))
