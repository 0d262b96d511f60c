"""An unfinished recording is completed up to its damage, or stays as it is."""

from __future__ import annotations

import os
import resource
import signal
import struct
import subprocess
import sys
from io import BytesIO
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.recordings.files.verification import verify
from armrig_core.recording_file import unfinished
from armrig_core.recording_file.file_records import MAGIC, RECORD_LIMIT
from armrig_core.recording_file.manifest import INPUT, OUTCOME, RECOVERED, RUN, Outcome
from armrig_core.recording_file.opening import lock
from armrig_core.recording_file.recovery import (
    CUT_OFF,
    MOST_CUT_OFF,
    Recovery,
    sentence,
)
from armrig_core.recording_file.unfinished import NotOursError, RecoveryError
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.telemetry import encode_sample
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import Writer

from tests.clients.made_recordings import gap, manifest, recorded, sample, written

NAME = "1-test-20261120T040000-0000abcd.mcap"
LEFT = f"{NAME}.active"
N = 60
RECOVERY = Recovery(armrig="0.2.0", now=lambda: "2026-11-20T06:00:00.000+01:00")


def _data(*, outcome: Outcome | None = None) -> bytes:
    """Return a recording of N samples less three in a gap, flushed every five messages."""
    samples = [sample(k) for k in range(N)]
    messages = [*samples[:20], gap(20, 3, 1.0), *samples[23:]]
    about = manifest(k_first=0, samples=2 * N)
    return recorded(messages, manifest=about, outcome=outcome, flush_every=5)


DATA = _data()


def _edges(data: bytes) -> list[int]:
    """Return where each record begins."""
    found, at = [], len(MAGIC)
    while at + 9 <= len(data):
        found.append(at)
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    return found


def _kept(path: Path) -> tuple[list[int], int]:
    recording = armrig.load(path)
    return recording.samples["k"].tolist(), recording.missing


def _untouched(path: Path, data: bytes, why: str, recovery: Recovery = RECOVERY) -> RecoveryError:
    """Check that a file is refused and unchanged, and that no other file remains."""
    before = sorted(path.parent.iterdir())
    with pytest.raises(RecoveryError, match=why) as refused:
        recovery.recover(path)
    assert path.read_bytes() == data
    assert sorted(path.parent.iterdir()) == before
    assert str(path) in str(refused.value)
    return refused.value


@pytest.mark.parametrize("off", [-1, 0, 1])
def test_recovery_keeps_all_complete_records_at_any_cut(tmp_path: Path, off: int) -> None:
    begins = _edges(DATA)
    first = next(i for i, at in enumerate(begins) if DATA[at] == Opcode.CHUNK)
    assert len(begins[first:]) > 2 * N / 5
    for cut in begins[first + 1 + off :: 3]:  # a third of them each way
        left = written(tmp_path, DATA[: cut + off], LEFT)
        before = _kept(left)

        done = RECOVERY.recover(left)

        assert [path.name for path in tmp_path.iterdir()] == [NAME]
        assert _kept(done.path) == before
        recording = armrig.load(done.path)
        assert not recording.truncated
        assert recording.outcome == Outcome(
            outcome=CUT_OFF, samples=len(before[0]), missing=before[1], code="cut_off"
        )
        checks = {check.about: check.level for check in verify(done.path).checks}
        assert checks["file"] == "good"
        assert checks["samples"] == ("good" if recording.N else "unusable")
        done.path.unlink()


def test_a_recovered_file_is_marked_as_recovered(tmp_path: Path) -> None:
    cut = _edges(DATA)[-20] + 7
    left = written(tmp_path, DATA[:cut], LEFT)

    done = RECOVERY.recover(left)

    said = armrig.load(done.path).recovered
    assert said is not None
    assert (said.when, said.armrig) == ("2026-11-20T06:00:00.000+01:00", "0.2.0")
    assert (said.kept_bytes, said.cut_off_bytes) == (cut - 7, 7)
    assert "cut off" in said.damage
    n, lost = done.outcome.samples, done.outcome.missing
    assert sentence(done) == (
        f"{done.path}: recovered, {n} samples, {(n + lost) * 0.01:g} s of 1.2 s; the last 7 B were "
        "incomplete and were cut off"
    )
    assert lost == 3
    assert armrig.load(written(tmp_path, DATA)).recovered is None


def test_a_run_that_had_ended_keeps_its_outcome(tmp_path: Path) -> None:
    ended = Outcome(outcome="stopped by a student", samples=N - 3, missing=3, code="stopped")
    left = written(tmp_path, _data(outcome=ended), LEFT)

    done = RECOVERY.recover(left)

    assert armrig.load(done.path).outcome == done.outcome == ended
    assert done.recovered.cut_off_bytes == 0


@pytest.mark.parametrize("lost", [1, 3])
def test_a_truncated_copy_of_a_complete_recording_is_unchanged(tmp_path: Path, lost: int) -> None:
    """Its outcome precedes its samples, so keeping it would claim lost samples."""
    said = N - 3 + lost
    data = _data(outcome=Outcome(outcome="complete", samples=said, missing=0))
    left = written(tmp_path, data, LEFT)

    _untouched(left, data, f"only {N - 3} of its {said} samples are readable; .* copy it again")


def test_a_recovered_file_keeps_a_long_input(tmp_path: Path) -> None:
    u = [0.123456789012345 + 1e-7 * k for k in range(500_000)]
    data = recorded([sample(0)], manifest=manifest(k_first=0, samples=len(u)), outcome=None, u=u)
    left = written(tmp_path, data[:-20], LEFT)

    done = RECOVERY.recover(left)

    with done.path.open("rb") as file:
        (kept,) = [a for a in make_reader(file).iter_attachments() if a.name == INPUT]
    assert len(kept.data) > RECORD_LIMIT
    assert kept.data.count(b"\n") == len(u) + 1


def test_a_file_being_written_is_not_recovered(tmp_path: Path) -> None:
    left = written(tmp_path, DATA, LEFT)
    with left.open("rb") as file:
        lock(file)

        assert isinstance(_untouched(left, DATA, "is being written"), NotOursError)

    RECOVERY.recover(left)


@pytest.mark.parametrize("kind", ["a link", "a pipe", "a folder", "a link to itself"])
def test_a_link_pipe_or_folder_is_not_recovered(tmp_path: Path, kind: str) -> None:
    left, elsewhere = tmp_path / LEFT, written(tmp_path, DATA, "elsewhere")
    match kind:
        case "a link":
            left.symlink_to(elsewhere)
        case "a pipe":
            os.mkfifo(left)
        case "a folder":
            left.mkdir()
        case _:
            left.symlink_to(left)

    with pytest.raises(RecoveryError, match="not a regular file; it is skipped"):
        RECOVERY.recover(left)

    assert elsewhere.read_bytes() == DATA
    assert sorted(p.name for p in tmp_path.iterdir()) == [LEFT, "elsewhere"]


def test_a_symbolic_link_that_replaces_a_file_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left, elsewhere = written(tmp_path, DATA, LEFT), written(tmp_path, DATA, "elsewhere")
    check = unfinished._check_regular

    def replaced(*args: Any) -> None:
        check(*args)
        left.unlink()
        left.symlink_to(elsewhere)

    monkeypatch.setattr(unfinished, "_check_regular", replaced)
    with pytest.raises(RecoveryError, match="symbolic links"):
        RECOVERY.recover(left)

    assert left.is_symlink()
    assert elsewhere.read_bytes() == DATA


def test_a_file_renamed_before_the_lock_is_not_recovered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The daemon ends the file just before the lock is taken."""
    left = written(tmp_path, DATA, LEFT)

    def ended(_: object) -> None:
        left.rename(tmp_path / "elsewhere")
        left.write_bytes(b"precious")

    monkeypatch.setattr(unfinished, "lock", ended)
    with pytest.raises(NotOursError, match="the name now belongs to another file"):
        RECOVERY.recover(left)

    assert left.read_bytes() == b"precious"
    assert (tmp_path / "elsewhere").read_bytes() == DATA


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "0 B: nothing was recorded; delete it"),
        (b"something else", "not an MCAP file"),
        (DATA[:20], "no manifest of a run: the file is cut off"),
        (recorded([sample(0)]).replace(RUN.encode(), b"armrig.ran"), "no manifest of a run"),
    ],
)
def test_a_file_that_is_not_a_recording_is_unchanged(tmp_path: Path, data: bytes, why: str) -> None:
    _untouched(written(tmp_path, data, LEFT), data, why)


def test_a_complete_file_with_a_damaged_chunk_is_unchanged(tmp_path: Path) -> None:
    """The chunks after the damage can be read by the index, so they are not cut off."""
    data = bytearray(recorded([sample(k) for k in range(30)], flush_every=10))
    _, second, _ = (at for at in _edges(bytes(data)) if data[at] == Opcode.CHUNK)
    data[second + 100] ^= 1

    _untouched(written(tmp_path, bytes(data), LEFT), bytes(data), "the file stays as it is")
    assert _kept(tmp_path / LEFT)[0] == [*range(10), *range(20, 30)]


@pytest.mark.parametrize("name", [RUN, OUTCOME, RECOVERED])
def test_a_file_with_another_form_of_metadata_is_unchanged(tmp_path: Path, name: str) -> None:
    out = BytesIO()
    writer = Writer(out)
    writer.start()
    if name != RUN:
        writer.add_metadata(RUN, manifest().metadata())
    writer.add_metadata(name, {"outcome": "no JSON"})
    writer.finish()
    left = written(tmp_path, out.getvalue(), LEFT)

    _untouched(left, out.getvalue(), "metadata record of armrig is not valid")


def test_messages_without_a_channel_do_not_end_the_recovery(tmp_path: Path) -> None:
    out = BytesIO()
    writer = Writer(out, chunk_size=100)
    writer.start()
    writer.add_metadata(RUN, manifest(k_first=0).metadata())
    schema = writer.register_schema(
        protobuf.SAMPLE, "protobuf", protobuf.descriptor_set(protobuf.SAMPLE)
    )
    nowhere = writer.register_channel("/rig/1/other", "protobuf", 99)
    channel = writer.register_channel("/rig/1/sample", "protobuf", schema)
    for k in range(5):
        writer.add_message(77, k, b"of a channel that there is not", k)
        writer.add_message(nowhere, k, b"of a schema that there is not", k)
        writer.add_message(channel, k, encode_sample(sample(k)), k)
    writer.flush()

    done = RECOVERY.recover(written(tmp_path, out.getvalue(), LEFT))

    assert done.outcome.samples == 5
    assert armrig.load(done.path).samples["k"].tolist() == [0, 1, 2, 3, 4]


def test_the_file_of_another_user_is_unchanged(tmp_path: Path) -> None:
    left = written(tmp_path, DATA, LEFT)
    of_another = Recovery(armrig="0", now=lambda: "", owner=os.geteuid() + 1)

    _untouched(left, DATA, "another user's file; it is skipped", of_another)


def test_the_file_of_another_rig_is_left_to_its_daemon(tmp_path: Path) -> None:
    """Files of rig 1-b look like files of rig 1 by their names."""
    data = recorded([sample(0)], manifest=manifest(rig="1-b"), outcome=None)
    left = written(tmp_path, data, "1-b-test-20261120T040000-0000abcd.mcap.active")
    for rig in ("1", "1-b", ""):
        assert unfinished.unfinished_files(tmp_path, rig) == [left]
    assert unfinished.unfinished_files(tmp_path, "2") == []
    of_rig_1 = Recovery(armrig="0", now=lambda: "", rig="1")

    assert isinstance(_untouched(left, data, "to rig 1-b, not to rig 1", of_rig_1), NotOursError)


def test_a_recovery_does_not_overwrite_another_recording(tmp_path: Path) -> None:
    written(tmp_path, b"precious", NAME)

    _untouched(written(tmp_path, DATA, LEFT), DATA, f"{NAME} exists already")


def test_a_file_damaged_in_the_middle_is_not_truncated(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((24_000, 3)).tolist()
    samples = [sample(k, value_0=a, value_1=b, u_cmd_v=u) for k, (a, b, u) in enumerate(noise)]
    about = manifest(k_first=0, samples=len(samples))
    data = bytearray(recorded(samples, manifest=about, outcome=None, flush_every=100))
    assert len(data) > 1.2 * MOST_CUT_OFF
    data[len(data) // 10] ^= 1

    _untouched(written(tmp_path, bytes(data), LEFT), bytes(data), "B follow; the file stays")

    del data[MOST_CUT_OFF:]
    assert RECOVERY.recover(written(tmp_path, bytes(data), LEFT)).outcome.samples > 1000


def test_recovery_without_room_for_the_copy_keeps_the_file(tmp_path: Path) -> None:
    left = written(tmp_path, DATA, LEFT)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        _untouched(left, DATA, "File too large; the file stays as it is; .* `armrig recover` it")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

    RECOVERY.recover(left)


@pytest.mark.parametrize("is_link", [False, True])
def test_an_unfinished_copy_is_started_again(tmp_path: Path, is_link: bool) -> None:
    elsewhere = written(tmp_path, b"precious", "elsewhere")
    left, copy = written(tmp_path, DATA, LEFT), tmp_path / f"{NAME}.compact"
    if is_link:
        copy.symlink_to(elsewhere)
    else:
        copy.write_bytes(b"half a copy")

    done = RECOVERY.recover(left)

    assert done.outcome.samples == N - 3
    assert elsewhere.read_bytes() == b"precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == [NAME, "elsewhere"]


DYING = """
import os, signal, sys
from pathlib import Path
from armrig_core.recording_file.recovery import Recovery

def die(event, _):
    if event == left[0] and len(left) == 3 - int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)
    if event == left[0]:
        del left[0]

left = ["os.rename", "os.rename", "open"]
sys.addaudithook(die)
Recovery(armrig="0.2.0", now=lambda: "2026-11-20T06:00:00.000+01:00").recover(Path(sys.argv[1]))
"""


@pytest.mark.parametrize("n", [0, 1, 2])
def test_a_recovery_that_dies_is_completed_by_the_next_recovery(tmp_path: Path, n: int) -> None:
    left = written(tmp_path, DATA, LEFT)

    done = subprocess.run([sys.executable, "-c", DYING, str(left), str(n)], check=False)

    assert done.returncode == -signal.SIGKILL
    names = [[LEFT, f"{NAME}.compact"], [LEFT], [NAME]][n]
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names)
    if n < 2:
        RECOVERY.recover(left)

    assert [p.name for p in tmp_path.iterdir()] == [NAME]
    recording = armrig.load(tmp_path / NAME)
    assert (recording.samples.size, recording.missing) == (N - 3, 3)
    assert recording.recovered is not None
    with recording.path.open("rb") as file:
        names = [record.name for record in make_reader(file).iter_metadata()]
    assert names.count(RECOVERED) == 1


def test_the_copy_is_on_the_disk_before_it_has_the_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """L1: a machine that loses its power in between has one complete recording."""
    synced = []
    fsync = os.fsync

    def noted(fd: int) -> None:
        fsync(fd)
        path = Path(f"/proc/self/fd/{fd}").readlink()
        whole = path.is_dir() or path.read_bytes().endswith(MAGIC)
        synced.append((path.name, whole, sorted(p.name for p in tmp_path.iterdir())))

    monkeypatch.setattr(os, "fsync", noted)
    RECOVERY.recover(written(tmp_path, DATA[:-500], LEFT))

    copy = f"{NAME}.compact"
    assert synced == [(copy, True, [LEFT, copy]), (tmp_path.name, True, [NAME])]


def test_only_a_file_named_as_an_unfinished_recording_is_recovered(tmp_path: Path) -> None:
    whole = written(tmp_path, DATA[:-500], "copy.mcap")

    _untouched(whole, DATA[:-500], r"ends in \.mcap\.active")
    with pytest.raises(NotOursError, match="there is no such file"):
        RECOVERY.recover(tmp_path / LEFT)
    assert unfinished.unfinished_files(tmp_path) == []
    assert unfinished.unfinished_files(tmp_path / "nowhere") == []


def test_the_files_of_a_rig_are_those_with_its_id_and_a_dash(tmp_path: Path) -> None:
    """Rig 10 is not rig 1."""
    names = [
        f"{rig}-test.mcap{end}" for rig in ("1", "10", "a-1") for end in (".active", ".compact")
    ]
    for name in names:
        (tmp_path / name).write_bytes(b"a")

    found = unfinished.unfinished_files(tmp_path, "1")
    removed = unfinished.remove_copies(tmp_path, "1", os.geteuid())

    assert [path.name for path in found] == ["1-test.mcap.active"]
    assert [path.name for path in removed] == ["1-test.mcap.compact"]
    assert {path.name for path in tmp_path.iterdir()} == set(names) - {"1-test.mcap.compact"}


def test_a_damaged_attachment_is_omitted_and_reported(tmp_path: Path) -> None:
    spoilt = bytearray(DATA)
    spoilt[DATA.index(b"zero_counts")] ^= 1
    before = armrig.load(written(tmp_path, bytes(spoilt), "before.mcap"))

    done = RECOVERY.recover(written(tmp_path, bytes(spoilt), LEFT))

    after = armrig.load(done.path)
    assert done.recovered.damage.startswith("the checksum of the attachment 'calibration.json' is")
    assert after.samples.tobytes() == before.samples.tobytes()
    assert after.samples.size
    assert (after.calibration, after.truncated) == (None, False)
