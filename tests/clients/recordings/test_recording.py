"""Recordings are read as the rig recorded them, and no broken file does harm."""

from __future__ import annotations

import hashlib
import struct
from io import BytesIO
from math import nan, radians, tau
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from armrig.recordings import grid
from armrig.recordings.channels import unwrap
from armrig.recordings.daemon_reports import Gap, gap_lines
from armrig.recordings.files import sample_rows
from armrig.recordings.files.loading import load
from armrig.recordings.jitter import disturbances, sampling_statistics
from armrig.recordings.recording import Recording
from armrig_core.commands.codes import GapCode
from armrig_core.errors import FileError
from armrig_core.recording_file import file_records
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.byte_source import ByteSource
from armrig_core.recording_file.file_records import RecordSelection
from armrig_core.recording_file.manifest import INPUT, Manifest, Outcome
from armrig_core.rig.calibration import Calibration, Driver, Potentiometer
from armrig_core.telemetry import protobuf, telemetry
from armrig_core.telemetry.channels import SAMPLE_NAMES
from google.protobuf.message import DecodeError
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType

from tests.clients.made_recordings import (
    POT,
    TS,
    event,
    gap,
    manifest,
    note,
    recorded,
    sample,
    timing,
    turning,
    written,
)

IDENTITY = Calibration(theta_1=Potentiometer(rad_per_count=tau / 65536))
ROW_HEAD = struct.pack("<BQHIQQ", 0x05, 22 + telemetry.SAMPLE_LENGTH, 1, 0, 0, 0)


METADATA = manifest().metadata()


def as_protobuf(one: telemetry.Sample, **unknown: bytes) -> bytes:
    """Return a sample in another layout: the same fields, the last first."""
    message = protobuf.message_class(protobuf.SAMPLE)(**dict(zip(SAMPLE_NAMES, one, strict=True)))
    fields = [message.__class__(**{n: getattr(message, n)}) for n in reversed(SAMPLE_NAMES)]
    return b"".join(part.SerializeToString() for part in fields) + b"".join(unknown.values())


def tried(path: Path) -> tuple[Recording | None, str]:
    try:
        return load(path), ""
    except FileError as err:
        return None, str(err)


def test_a_recording_returns_the_recorded_values(tmp_path: Path) -> None:
    samples = [sample(k, u_applied_v=k / 100, counts_1=32768 + k) for k in range(7, 107)]

    rec = load(path := written(tmp_path, recorded(samples)))

    assert rec.N == 100
    assert rec.dataset().source == hashlib.sha256(path.read_bytes()).hexdigest()
    np.testing.assert_allclose(rec.t, np.arange(100) * TS)
    np.testing.assert_allclose(rec.u, np.arange(7, 107) / 100)
    np.testing.assert_allclose(rec.alpha, np.arange(7, 107) * radians(352) / 65536)
    assert rec.valid.all()
    sha256 = hashlib.sha256(msgspec.json.encode(Calibration())).hexdigest()
    assert rec.manifest == manifest(calibration_sha256=sha256)
    assert rec.outcome is not None
    assert rec.outcome.outcome == "complete"
    assert not rec.truncated
    assert not rec.theta_1.flags.writeable


def test_the_first_of_two_attachments_of_one_name_is_used(tmp_path: Path) -> None:
    first, second = (
        recorded([sample(0, u_applied_v=2.0)], calibration=Calibration(driver=Driver(gain=gain)))
        for gain in (1.5, 0.5)
    )
    at = second.index(b"calibration.json") - 20 - 9
    length = 9 + struct.unpack_from("<Q", second, at + 1)[0]
    end = first.index(b"calibration.json") - 20 - 9 + length
    both = first[:end] + second[at : at + length] + first[end:]

    rec = load(written(tmp_path, both))

    assert rec.u.tolist() == [3.0]


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("empty.mcap", b"", "is empty, 0 B: nothing was recorded; record again"),
        ("run.mcap", b"\x89MCAP", "is not a recording of the rig; give"),
        ("run.csv", b"t,u,y\n", r"is not a recording of the rig; give a recording \(\*\.mcap"),
        ("run.bin", b"t,u,y\n", "is not a recording of the rig; .*`armrig import` makes one"),
    ],
)
def test_a_file_of_another_kind_is_refused_with_the_function_that_reads_it(
    tmp_path: Path, name: str, content: bytes, why: str
) -> None:
    with pytest.raises(FileError, match=rf"{name}: {why}"):
        load(written(tmp_path, content, name))


def test_each_level_of_an_event_has_its_name(tmp_path: Path) -> None:
    names = ["unknown", "debug", "info", "warning", "error", "fatal"]
    events = [event(k, "said") for k in range(8)]
    for level, one in enumerate(events):
        one.level = level

    rec = load(written(tmp_path, recorded([sample(0), *events])))

    assert [e.level for e in rec.events] == [*names, "6", "7"]


def test_the_driver_s_line_holds_at_every_voltage_but_0(tmp_path: Path) -> None:
    volts = np.array([0.0, 0.01, 0.1, 2.0, 0.0, 5.0])
    driven = Calibration(driver=Driver(gain=0.9, offset_v=0.2))
    samples = [sample(k, u_applied_v=u) for k, u in enumerate(volts.tolist())]

    rec = load(written(tmp_path, recorded(samples, calibration=driven)))

    np.testing.assert_allclose(rec.u, [0.0, 0.209, 0.29, 2.0, 0.0, 4.7])


def test_a_note_is_recognised_by_its_field_and_not_by_its_text(
    tmp_path: Path,
) -> None:
    """Some lines of the daemon count as disturbances of the timing."""
    messages = [*(sample(k) for k in range(100, 120)), event(103, "note by Ada: hello")]
    messages += [note(105, "emulator held up 9999 ms"), note(115, "#set", "Bob")]
    path = written(tmp_path, recorded(messages))

    rec, part = load(path), load(path, start=0.1)

    assert [(n.text, n.owner) for n in rec.notes] == [
        ("emulator held up 9999 ms", "Ada"),
        ("#set", "Bob"),
    ]
    assert [n.t for n in rec.notes] == pytest.approx([5 * TS, 15 * TS], abs=1e-4)
    assert [e.message for e in rec.events] == ["note by Ada: hello"]
    assert disturbances(rec).held_up_ms == 0
    assert [n.owner for n in part.notes] == ["Bob"]


def test_a_missing_sample_has_a_row_with_the_held_voltage(tmp_path: Path) -> None:
    messages = [*(sample(k) for k in range(10)), gap(10, 3, 2.5), *(sample(k) for k in (13, 14))]

    rec = load(written(tmp_path, recorded(messages)))

    assert (rec.N, rec.missing, rec.hidden) == (15, 3, 0)
    np.testing.assert_array_equal(np.flatnonzero(~rec.valid), [10, 11, 12])
    np.testing.assert_array_equal(rec.u[9:14], [1, 2.5, 2.5, 2.5, 1])
    assert np.isnan(rec.theta_1[10:13]).all()
    assert np.isnan(rec.alpha[10:13]).all()
    assert rec.gaps[0].reason == "link silent"


def test_a_gap_record_does_not_overwrite_samples_that_came(tmp_path: Path) -> None:
    messages = [*(sample(k) for k in range(10)), gap(5, 100, 4.0), sample(11)]

    rec = load(written(tmp_path, recorded(messages)))

    np.testing.assert_array_equal(rec.u, [1.0] * 10 + [4.0, 1.0])


def a_run(**changes: Any) -> Manifest:
    """Return the manifest of a run of 100 samples from k = 40 on."""
    return manifest(**({"k_first": 40, "samples": 100} | changes))


def test_samples_missing_at_both_ends_have_rows(tmp_path: Path) -> None:
    messages = [gap(40, 2, 0.0), *(sample(k) for k in range(42, 137)), gap(137, 3, 2.5)]
    ended = Outcome(outcome="complete", samples=95, missing=5)

    rec = load(written(tmp_path, recorded(messages, manifest=a_run(), outcome=ended)))
    data = rec.dataset()
    statistics = sampling_statistics(rec)

    assert (rec.k_first, rec.N, rec.missing) == (40, 100, 5)
    np.testing.assert_array_equal(np.flatnonzero(~rec.present), [0, 1, 97, 98, 99])
    np.testing.assert_array_equal(rec.u[[0, 1, 2, 96, 97, 99]], [0, 0, 1, 1, 2.5, 2.5])
    assert np.isnan(rec.theta_1[:2]).all()
    assert [g.t for g in rec.gaps] == pytest.approx([0.0, 97 * TS])
    assert (data.N, data.missing, data.starts) == (100, 5, (0,))
    assert (statistics.samples, statistics.missing, statistics.longest_gap) == (95, 5, 3)
    assert "100 samples at 0.01 s; 5 missing" in repr(rec)


CAME, HELD = [sample(k) for k in range(42, 60)], gap(60, 4, 1.0)
COMPLETE = Outcome(outcome="complete", samples=0, missing=0)
STOPPED = Outcome(outcome="stopped", samples=18, missing=6)


@pytest.mark.parametrize(
    ("messages", "ended", "N", "missing", "unknown"),
    [
        pytest.param([sample(k) for k in range(43, 140)], COMPLETE, 100, 3, 3, id="without a gap"),
        pytest.param([gap(40, 100, 0.0)], COMPLETE, 100, 100, 0, id="nothing came"),
        pytest.param([*CAME, HELD], STOPPED, 24, 6, 2, id="stopped"),
        pytest.param(CAME, STOPPED, 24, 6, 6, id="stopped, without a gap"),
        pytest.param(CAME, None, 20, 2, 2, id="cut off"),
        pytest.param([*CAME, HELD], None, 24, 6, 2, id="cut off after a gap"),
    ],
)
def test_the_number_of_rows_follows_from_manifest_outcome_and_samples(
    tmp_path: Path, messages: list[Any], ended: Outcome | None, N: int, missing: int, unknown: int
) -> None:
    """Without a gap record the voltage is unknown."""
    rec = load(written(tmp_path, recorded(messages, manifest=a_run(), outcome=ended)))

    assert (rec.N, rec.missing, np.count_nonzero(np.isnan(rec.u))) == (N, missing, unknown)
    assert rec.events == ()


def test_samples_after_a_cut_are_not_missing(tmp_path: Path) -> None:
    """A rewritten file contains its outcome first, so a cut may take samples that were there."""
    messages = [sample(k) for k in range(40, 60)]
    ended = Outcome(outcome="complete", samples=300, missing=0, code="complete")
    whole = recorded(messages, manifest=a_run(), outcome=ended, outcome_first=True, flush_every=5)

    sizes = range(whole.index(b"armrig.outcome") + 200, len(whole) - 1, 97)
    cuts = [load(written(tmp_path, whole[:size])) for size in sizes]

    assert {5, 10, 15} <= {cut.N for cut in cuts}
    for cut in cuts:
        assert cut.outcome == ended
        assert cut.cut_off
        assert cut.missing == 0
        assert f"{cut.N * cut.Ts:g} s of {cut.asked_s:g} s" in cut.damage


@pytest.mark.parametrize("k", [39, 140])
def test_a_sample_outside_its_run_is_reported(tmp_path: Path, k: int) -> None:
    messages = sorted([sample(50), sample(k)])

    with pytest.raises(FileError, match=r"the samples of the run are k=40 to 139"):
        load(written(tmp_path, recorded(messages, manifest=a_run())))


def test_a_dead_band_of_any_length_does_not_lose_the_turns(tmp_path: Path) -> None:
    """The shaft may rest in the dead band."""
    rec = load(written(tmp_path, recorded(turning([60000] * 5 + [0] * 100 + [3000] * 5))))

    assert rec.turns_unknown == ()
    assert rec.theta_1[-1] == pytest.approx(POT.value(3000) + tau)


def test_turns_cannot_be_counted_at_a_long_sampling_time(tmp_path: Path) -> None:
    """At 5 V the shaft makes half a turn in less than 0.34 s."""
    samples = [sample(k) for k in range(5)]

    slow = load(written(tmp_path, recorded(samples, manifest=manifest(Ts=0.4))))

    assert slow.turns_unknown == (1, 2, 3, 4)


@pytest.mark.parametrize("direction", [1, -1])
def test_turns_are_counted_through_the_dead_band(tmp_path: Path, direction: int) -> None:
    true = direction * np.arange(600) * tau / 97 + 3.0
    track = radians(352)
    counts = [int(a % tau / track * 65536) if a % tau < track else 0 for a in true]

    rec = load(written(tmp_path, recorded(turning(counts))))

    error = rec.theta_1 - true
    assert np.nanmax(np.abs(error)) < 2 * abs(POT.rad_per_count)
    dead = np.flatnonzero([c < 64 or c >= 65472 for c in counts])
    assert dead.size >= 6
    assert not rec.valid[dead].any()
    assert not rec.valid[np.minimum(dead + 1, 599)].any()
    np.testing.assert_array_equal(np.isnan(rec.theta_1), ~rec.valid)
    assert rec.valid.sum() > 560


def test_turns_are_counted_as_numpy_counts_them() -> None:
    """Half a turn goes on in its direction."""
    quarters = np.random.default_rng(4).integers(-9, 10, 400) * tau / 4
    valid = np.random.default_rng(5).random(400) < 0.8

    found = unwrap(quarters.copy(), valid)

    np.testing.assert_array_equal(found[valid], np.unwrap(quarters[valid]))
    assert np.isnan(found[~valid]).all()


def test_a_sample_between_two_rail_readings_has_no_angle(tmp_path: Path) -> None:
    counts = [60000, 62000, 64000, 0, 31000, 0, 900, 1500, 3000]

    rec = load(written(tmp_path, recorded(turning(counts))))

    np.testing.assert_array_equal(rec.valid, [True, True, True] + [False] * 4 + [True, True])
    assert rec.theta_1[7] == pytest.approx(POT.value(1500) + tau)


def test_the_first_sample_after_a_rail_and_a_gap_is_not_valid(tmp_path: Path) -> None:
    samples = turning([60000, 65500, 20000, 700, 1300])

    rec = load(written(tmp_path, recorded([*samples[:2], gap(2, 1, 1.0), *samples[3:]])))

    np.testing.assert_array_equal(rec.valid, [True, False, False, False, True])


def test_a_calibration_is_repaired_on_reading(tmp_path: Path) -> None:
    """The raw counts and the attached calibration decide, not the angle of the daemon."""
    samples = [sample(0, counts_0=16384, value_0=99.0)]

    right = load(written(tmp_path, recorded(samples, calibration=IDENTITY)))
    without = load(written(tmp_path, recorded(samples, calibration=None)))

    assert right.theta_1[0] == pytest.approx(tau / 4)
    assert without.theta_1[0] == 99.0


def test_another_layout_of_the_sample_reads_the_same(tmp_path: Path) -> None:
    samples = [
        sample(k, u_applied_v=k * 0.1, value_0=nan if k % 5 == 0 else k * 0.01, flags=k)
        for k in range(64)
    ]
    later = b"\x79" + bytes(8)  # field 15, fixed64: of a later version
    mixed: list[Any] = [
        as_protobuf(s, later=later) if i % 3 == 1 else s for i, s in enumerate(samples)
    ]

    fast = load(written(tmp_path, recorded(samples), "fast.mcap"))
    slow = load(written(tmp_path, recorded([as_protobuf(s) for s in samples]), "slow.mcap"))
    both = load(written(tmp_path, recorded(mixed), "both.mcap"))

    assert not slow.truncated
    for other in (slow, both):
        assert other.samples.tobytes() == fast.samples.tobytes()
        np.testing.assert_array_equal(other.theta_1, fast.theta_1)


def test_an_angle_that_a_file_lacks_is_not_0_rad(tmp_path: Path) -> None:
    older = []
    for k in range(8):
        message = protobuf.message_class(protobuf.SAMPLE)(
            **dict(zip(SAMPLE_NAMES, sample(k), strict=True))
        )
        message.ClearField("alpha_rad")
        message.ClearField("alpha_counts")
        older.append(message.SerializeToString())
    path = written(tmp_path, recorded(older))

    as_sent, by_counts = load(path), load(path, calibration=IDENTITY)

    for rec in (as_sent, by_counts):
        assert not rec.truncated
        assert np.isnan(rec.alpha).all()
        assert not rec.valid_alpha.any()
        assert rec.valid.all()
        np.testing.assert_array_equal(rec.samples["k"], np.arange(8))


def test_the_code_of_a_gap_is_read_from_its_field_and_not_its_text(tmp_path: Path) -> None:
    """A release without codes sends the sentence alone; a later release may have other codes."""
    first, second = (gap(k, 1, 0.0, "a frame was lost") for k in (3, 6))
    second.code = "a code of tomorrow"

    rec = load(written(tmp_path, recorded([*map(sample, (0, 1, 2, 4, 5, 7)), first, second])))

    assert [g.code for g in rec.gaps] == [GapCode.FRAME_LOST, "a code of tomorrow"]


def test_a_stall_of_an_emulator_is_read_from_its_field_and_not_its_text(
    tmp_path: Path,
) -> None:
    """Two stalls of 0.4 ms are one of 0.8 ms."""
    events = [event(k, "emulator held up 9999 ms") for k in (4, 5, 6)]
    for message, stall_ns in zip(events, (7_400_000, 400_000, 0), strict=True):
        message.emulator_stall_ns = stall_ns

    rec = load(written(tmp_path, recorded([*map(sample, range(10)), *events])))

    assert [e.emulator_stall_ns for e in rec.events] == [7_400_000, 400_000, 0]
    assert disturbances(rec).held_up_ms == 8


def test_values_missing_in_the_reports_are_unknown(tmp_path: Path) -> None:
    report = timing(5)
    for name in ("collections", "cpu_pressure_percent", "run_queue"):
        report.ClearField(name)

    rec = load(written(tmp_path, recorded([*map(sample, range(10)), report, report])))

    found = disturbances(rec)
    assert (found.seconds, found.collections, found.run_queue) == (2, -1, -1)
    assert np.isnan(found.cpu_pressure_percent)
    assert found.texts() == {}


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
@pytest.mark.parametrize("chunk_size", [200, 4096, 1 << 20])
def test_chunks_of_any_size_read_the_same(
    tmp_path: Path, compression: CompressionType, chunk_size: int
) -> None:
    messages: list[Any] = []
    for k in range(300):
        messages += [sample(k)] + ([timing(k)] if k % 10 == 0 else [])

    rec = load(
        written(tmp_path, recorded(messages, chunk_size=chunk_size, compression=compression))
    )

    np.testing.assert_array_equal(rec.samples["k"], np.arange(300))
    assert len(rec.timing) == 30


@pytest.mark.parametrize("Ts", [5e-324, 0.9e-6, 86_400.0, -1.0])
def test_a_sampling_time_out_of_range_is_refused(tmp_path: Path, Ts: float) -> None:
    with pytest.raises(FileError, match="from 1 µs to below a day"):
        load(written(tmp_path, recorded([sample(0)], manifest=manifest(Ts=Ts))))


def test_a_recording_without_samples_has_no_dataset(tmp_path: Path) -> None:
    rec = load(written(tmp_path, recorded([])))

    assert rec.N == 0
    with pytest.raises(FileError, match="none of its 0 samples"):
        rec.dataset()


@settings(max_examples=40)
@given(
    st.lists(st.lists(st.integers(0, 12) | st.integers(2**62 - 2, 2**62 + 1), max_size=4)),
    st.integers(0, 30),
)
def test_samples_are_kept_until_k_does_not_rise(packs: list[list[int]], spoilt: int) -> None:
    rows, failed, expected = sample_rows.SampleRows(), False, []
    all_k = [k for pack in packs for k in pack]
    for k, last in zip(all_k, [-1, *all_k], strict=False):
        if not last < k < 2**62 or len(expected) == spoilt:
            break
        expected.append(k)

    count = 0
    try:
        for pack in packs:
            for k in pack:
                data = telemetry.encode_sample(sample(0)._replace(k=k))
                if count == spoilt:
                    data = data[:-5] + b"\xff" * 5  # its last field; k can still be read
                rows.add_run(memoryview(ROW_HEAD + data), 0)
                rows.settle()
                count += 1
            rows.pack()
    except (DamageError, DecodeError):
        failed = True

    assert rows.finish()["k"].tolist() == expected
    assert failed == (len(expected) < len(all_k))


@given(
    st.lists(st.tuples(st.integers(0, 60), st.integers(0, 2**64), st.floats(-9, 9)), max_size=12)
    | st.lists(st.tuples(st.integers(0, 60), st.integers(0, 20), st.floats(-9, 9)), max_size=12)
)
def test_gaps_fill_rows_as_if_applied_in_order(gaps: list[tuple[int, int, float]]) -> None:
    rows = grid.SampleGrid(k_first=10, N=40, present=np.zeros(40, np.bool_), taken=slice(0))
    expected = np.full(40, nan)
    for k_first, count, value in gaps:
        expected[max(k_first - 10, 0) : max(k_first + count - 10, 0)] = value

    np.testing.assert_array_equal(rows.filled(gaps), expected)


def test_overlapping_gaps_write_each_row_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The work is rows plus gaps, not rows times gaps."""
    written_rows = 0

    class Counting(np.ndarray[Any, Any]):
        def __setitem__(self, rows: Any, value: Any) -> None:
            nonlocal written_rows
            written_rows += rows.stop - rows.start
            super().__setitem__(rows, value)

    full = np.full
    monkeypatch.setattr(np, "full", lambda *args: full(*args).view(Counting))

    grid.SampleGrid(k_first=0, N=500, present=np.zeros(40, np.bool_), taken=slice(0)).filled(
        [(0, 10**9, 1.0)] * 300
    )

    assert written_rows == 500


class _Counted(BytesIO):
    count = 0

    def read(self, n: int | None = -1) -> bytes:
        data = super().read(n)
        self.count += len(data)
        return data


def test_a_file_is_read_once() -> None:
    """The checksum and the hash are made of the same bytes."""
    data = recorded([sample(k) for k in range(300)], u=[1.0] * 100_000) + b"behind its end"
    file = _Counted(data)
    source = ByteSource(file, len(data), is_hashed=True)

    source.read(len(file_records.MAGIC))
    for _ in file_records.file_records(source, RecordSelection(left=INPUT), lambda _: None):
        pass

    assert source.sha256() == hashlib.sha256(data).hexdigest()
    assert file.count == len(data)


def test_seconds_without_a_round_trip_have_no_longest_one(tmp_path: Path) -> None:
    rec = load(written(tmp_path, recorded([*map(sample, range(10)), timing(5)])))

    assert "longest round trip" not in disturbances(rec).texts()


def _gap(t: float, count: int = 1, code: GapCode = GapCode.FRAME_LOST) -> Gap:
    k = round(t * 100)
    return Gap(k_first=k, count=count, t=t, u_held_v=1.0, reason=code.sentence, code=code)


def test_a_single_gap_is_reported_unchanged() -> None:
    assert gap_lines([_gap(3.25, 7)]) == ["7 samples at 3.250 s, a frame was lost"]
    assert gap_lines([]) == []


def test_the_gaps_of_a_second_share_a_line() -> None:
    gaps = [_gap(0.5), *(_gap(2 + i / 100) for i in range(50)), _gap(2.9, 3, GapCode.HOST_LATE)]

    assert gap_lines(gaps) == [
        "1 sample at 0.500 s, a frame was lost",
        "53 samples in 51 gaps from 2.000 s to 2.900 s, a frame was lost, the host was late",
    ]
