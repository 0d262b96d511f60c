"""Thousands of recordings as one table, kept up to date after any change of the files."""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Callable
from functools import partial
from io import BytesIO
from pathlib import Path

import armrig
import numpy as np
import pyarrow.parquet
import pytest
from armrig.recordings.files import catalogue as catalogue_module
from armrig.recordings.files import recording_summary
from armrig.recordings.files.catalogue import (
    COLUMNS,
    catalogue,
    facts_of,
    may_answer_to,
    newest_first,
    recording_files,
)
from armrig.recordings.files.recording_summary import RecordingSummary, summary_of
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.file_records import RECORD_LIMIT
from armrig_core.recording_file.manifest import OUTCOME, RUN, Outcome
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Footer, MetadataIndex
from mcap.writer import Writer

from tests.clients.made_recordings import manifest, recorded, sample, written

OLD = 1_700_000_000  # s: files that were changed then are settled

NOW_NS = catalogue_module.time_ns


def made(folder: Path, number: int, *, experiment: str = "step", samples: int = 3) -> Path:
    """Write a small recording under the daemon's name, with the age of its number."""
    about = manifest(
        experiment=experiment,
        run_id=f"{number:08x}",
        started=f"2026-11-20T05:00:{number:02}+01:00",
        device={"uid": "0001"},
    )
    ended = Outcome(outcome="complete", samples=samples, missing=1)
    data = recorded([sample(k) for k in range(samples)], manifest=about, outcome=ended)
    path = written(folder, data, f"1-{experiment}-20261120T0500{number:02}-{number:08x}.mcap")
    os.utime(path, (OLD, OLD))
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "recordings"
    folder.mkdir()
    for number, experiment in enumerate(("step", "blackbox-monday", "blackbox-validation-monday")):
        made(folder, number, experiment=experiment)
    return folder


@pytest.fixture
def opened(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    """Have an index kept for so few files, by default one, and give the names of the files opened.

    The clock that says whether a file is settled is by default a minute ahead.
    """
    worth_keeping, ahead_s = getattr(request, "param", (1, 60))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(catalogue_module, "WORTH_KEEPING", worth_keeping)
    monkeypatch.setattr(catalogue_module, "time_ns", lambda: NOW_NS() + ahead_s * 10**9)
    names: list[str] = []

    def counted(path: Path) -> RecordingSummary:
        names.append(path.name)
        return summary_of(path)

    monkeypatch.setattr(catalogue_module, "summary_of", counted)
    return names


def index_files(tmp_path: Path) -> list[Path]:
    """Return the indexes in the cache, and any other file there."""
    return list((tmp_path / "cache").rglob("*.*"))


def test_a_catalogue_has_a_row_for_each_recording(folder: Path) -> None:
    found = armrig.catalogue(folder)

    assert len(found) == 3
    assert repr(found) == f"<Catalogue: 3 recordings in {folder}>"
    columns = found.columns()
    assert list(columns) == list(COLUMNS) == list(facts_of(found.recordings[0]))
    assert columns["experiment"].tolist() == ["blackbox", "blackbox", "step"]
    assert columns["name"].tolist() == ["monday", "monday", ""]
    assert columns["validation"].tolist() == [True, False, False]
    assert columns["missing"].tolist() == [1, 1, 1]
    np.testing.assert_allclose(columns["seconds"], 0.04)
    assert columns["started"][0] == np.datetime64("2026-11-20T04:00:02")
    assert armrig.load(found.recordings[-1].path).manifest.run_id == "00000000"


def test_pandas_and_parquet_have_the_same_columns(folder: Path, tmp_path: Path) -> None:
    nothing = tmp_path / "nothing"
    nothing.mkdir()
    for where, n in ((folder, 3), (nothing, 0)):
        found = catalogue(where)
        frame = found.to_pandas()
        found.to_parquet(tmp_path / "table.parquet")
        table = pyarrow.parquet.read_table(tmp_path / "table.parquet")

        assert list(frame.columns) == table.column_names == list(COLUMNS)
        assert len(frame) == table.num_rows == n
        assert str(frame["started"].dtype) == "datetime64[ms, UTC]"
        assert str(table.schema.field("started").type) == "timestamp[ms, tz=UTC]"
        assert table["experiment"].to_pylist() == frame["experiment"].tolist()


def test_no_chunk_is_unpacked(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = made(folder, 9)
    data = bytearray(path.read_bytes())
    chunk = data.index(b"zstd") + 12  # after the name of the compression, and its length
    data[chunk : chunk + 20] = bytes(20)
    path.write_bytes(data)
    assert armrig.load(path).truncated

    assert catalogue(folder).recordings[0].path == path


def test_an_unreadable_file_is_listed_with_the_reason(folder: Path) -> None:
    cut = written(folder, made(folder, 5).read_bytes()[:-20], "cut.mcap")
    text = written(folder, b"not a recording", "text.mcap")
    written(folder, b"", "1-step-20261120T140000-0000000f.mcap.active")
    (folder / "nowhere.mcap").symlink_to(folder / "gone")
    (folder / "folder.mcap").mkdir()
    os.mkfifo(folder / "pipe.mcap")

    found = catalogue(folder)

    assert len(found) == 4
    why = {left.path: left.why for left in found.left_out}
    assert set(why) == {cut, text}
    assert "cut off" in why[cut]
    assert why[text] == "not an MCAP file"
    assert [path.name for path in found.unfinished] == [
        "1-step-20261120T140000-0000000f.mcap.active"
    ]
    assert "2 left out, 1 unfinished" in repr(found)


def test_a_file_without_a_time_in_its_name_has_that_of_its_last_change(tmp_path: Path) -> None:
    for name, clock in (
        ("2-step-20261120T050000-00000001.mcap", "20200101T000000"),
        ("1-step-20261120T070000-00000002.mcap", "20200101T000000"),
        ("mine.mcap", "20261120T060000"),
        ("older.mcap", "20261119T080000"),
    ):
        changed = time.mktime(time.strptime(clock, "%Y%m%dT%H%M%S"))
        os.utime(written(tmp_path, b"", name), (changed, changed))

    assert [file.name[:5] for file in recording_files(tmp_path)] == [
        "1-ste",
        "mine.",
        "2-ste",
        "older",
    ]
    assert newest_first(tmp_path)[0] == tmp_path / "1-step-20261120T070000-00000002.mcap"
    assert newest_first(tmp_path / "none") == newest_first(tmp_path / "mine.mcap") == []


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    """An empty table would mean that nothing was recorded."""
    with pytest.raises(FileNotFoundError, match="none"):
        catalogue(tmp_path / "none")


def test_a_catalogue_opens_only_new_and_changed_files(folder: Path, opened: list[str]) -> None:
    cold = catalogue(folder)
    assert len(opened) == 3
    opened.clear()

    assert catalogue(folder) == cold
    assert opened == []
    new = made(folder, 9)
    assert catalogue(folder).recordings[0].path == new
    assert opened == [new.name]


@pytest.mark.parametrize("opened", [(2, 60)], indirect=True)
def test_the_index_is_written_again_only_for_enough_new_files(
    folder: Path, tmp_path: Path, opened: list[str]
) -> None:
    catalogue(folder)
    [index] = index_files(tmp_path)
    written_ns = index.stat().st_mtime_ns
    rewritten = []

    for number in (7, 8, 9):
        made(folder, number)
        catalogue(folder)
        rewritten.append(index.stat().st_mtime_ns != written_ns)

    assert rewritten == [False, True, True]


@pytest.mark.parametrize(
    ("file", "name", "validation", "may"),
    [
        ("1-blackbox-20261120T050000-0000000a.mcap", "0000000a", False, True),
        ("1-blackbox-20261120T050000-0000000a.mcap", "blackbox", False, True),
        ("1-blackbox-20261120T050000-0000000a.mcap", "monday", False, False),
        ("1-blackbox-20261120T050000-0000000a.mcap", "0000000a", True, False),
        ("1-blackbox-validation-20261120T050000-0000000b.mcap", "0000000a", True, True),
        ("mine.mcap", "0000000a", False, True),
        ("mine.mcap", "0000000a", True, True),
    ],
)
def test_a_file_is_opened_only_if_its_name_may_match_the_experiment(
    file: str, name: str, validation: bool, may: bool
) -> None:
    assert may_answer_to(Path(file), name, validation=validation) is may


def rewritten(path: Path, *, is_same_file: bool) -> str:
    """Give a file other bytes, of the same size and with the same time."""
    other = path.read_bytes().replace(b"00000000", b"000000bb")
    if not is_same_file:
        path.unlink()
    path.write_bytes(other)
    os.utime(path, (OLD, OLD))
    return path.name


CHANGES: dict[str, Callable[[Path], str]] = {
    "renamed": lambda path: path.rename(path.with_stem("1-step-20261120T050000-000000aa")).name,
    "deleted": lambda path: path.unlink() or "",
    "replaced": partial(rewritten, is_same_file=False),
    "overwritten": partial(rewritten, is_same_file=True),
    "cut off": lambda path: os.truncate(path, path.stat().st_size - 1) or path.name,
}
"""Changes of a file; each returns the name of the file to read again."""


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_file_that_changed_is_read_again(
    folder: Path, opened: list[str], change: Callable[[Path], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = folder / "1-step-20261120T050000-00000000.mcap"
    before = catalogue(folder)
    opened.clear()

    again = change(path)

    found = catalogue(folder)
    assert opened == [again] * bool(again)
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "another"))
    assert found == catalogue(folder) != before


@pytest.mark.parametrize("opened", [(1, 0)], indirect=True)
def test_the_index_entry_of_a_file_just_written_is_not_used(
    folder: Path, opened: list[str]
) -> None:
    """Within a tick of the file system's clock a file may change and keep its times."""
    catalogue(folder)
    opened.clear()

    catalogue(folder)

    assert len(opened) == 3


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda text: b"",
        lambda text: text[:-5],
        lambda text: text.replace(b'"step"', b"5"),
        lambda text: text.replace(b'"folder":"/', b'"folder":"/other/'),
        lambda text: text.replace(b'"armrig":"', b'"armrig":"9.'),
        lambda text: b"[" * 100_000,
        lambda text: b"\xff" * 100,
    ],
)
def test_an_invalid_index_is_rebuilt(
    folder: Path, tmp_path: Path, opened: list[str], spoilt: Callable[[bytes], bytes]
) -> None:
    cold = catalogue(folder)
    [index] = index_files(tmp_path)
    good = index.read_bytes()
    index.write_bytes(spoilt(good))
    assert index.read_bytes() != good
    opened.clear()

    with index.open("rb") as read_by_another:
        assert catalogue(folder) == cold
        assert len(opened) == 3
        assert index.read_bytes() == good
        assert read_by_another.read() == spoilt(good)  # whole, as it was


def test_a_catalogue_without_a_cache_is_complete(
    folder: Path, tmp_path: Path, opened: list[str]
) -> None:
    (tmp_path / "cache").write_text("a file where the folder should be")
    folder.chmod(0o555)

    for _ in range(2):
        assert len(catalogue(folder)) == 3
    assert len(opened) == 6


def test_an_index_that_cannot_be_renamed_leaves_no_file(
    folder: Path, tmp_path: Path, opened: list[str]
) -> None:
    assert len(catalogue(folder)) == 3
    (index,) = index_files(tmp_path)
    index.unlink()
    index.mkdir()

    assert len(catalogue(folder)) == 3

    assert index_files(tmp_path) == [index]
    assert list(index.parent.iterdir()) == [index]


def test_a_file_name_without_utf_8_is_listed(
    folder: Path, tmp_path: Path, opened: list[str]
) -> None:
    strange = os.fsdecode(os.fsencode(folder) + b"/\xff.mcap")
    Path(folder / "1-step-20261120T050000-00000000.mcap").rename(strange)

    found = catalogue(folder)
    found.to_parquet(tmp_path / "table.parquet")

    shown = pyarrow.parquet.read_table(tmp_path / "table.parquet")["recording"].to_pylist()
    assert sum(text.endswith(r"\udcff.mcap") for text in shown) == 1
    opened.clear()
    assert catalogue(folder) == found
    assert opened == [Path(strange).name]


def with_metadata(folder: Path, run: dict[str, str], outcome: dict[str, str] | None = None) -> Path:
    out = BytesIO()
    writer = Writer(out)
    writer.start()
    writer.add_metadata(RUN, run)
    ended = Outcome(outcome="complete", samples=1, missing=0)
    writer.add_metadata(OUTCOME, ended.metadata() | (outcome or {}))
    writer.finish()
    return written(folder, out.getvalue(), "hostile.mcap")


@pytest.mark.parametrize(
    ("run", "outcome", "why"),
    [
        ({"run_id": '"' + "a" * 5000 + '"'}, {}, "its run_id has 5000 characters, more than 4096"),
        ({}, {"samples": "1" + "0" * 400}, "not armrig's"),
        ({}, {"samples": str(2**63)}, "not armrig's"),
        ({"Ts": "1e999"}, {}, "not armrig's"),
        ({"Ts": "-1.0"}, {}, "Ts=-1.0 s"),
        ({"details": "[" * 5000 + "]" * 5000}, {}, "not armrig's"),
    ],
)
def test_a_hostile_recording_is_left_out(
    tmp_path: Path, run: dict[str, str], outcome: dict[str, str], why: str
) -> None:
    with_metadata(tmp_path, manifest().metadata() | run, outcome)

    [left] = catalogue(tmp_path).left_out

    assert why in left.why


def test_a_text_may_have_4096_characters(tmp_path: Path) -> None:
    with_metadata(tmp_path, manifest().metadata() | {"run_id": '"' + "a" * 4096 + '"'})

    [row] = catalogue(tmp_path).recordings

    assert len(row.run_id) == 4096


@pytest.mark.parametrize("started", ["yesterday", "2026-11-20T05:00:00", "9999-12-31T23:00-05:00"])
def test_an_invalid_start_date_is_not_a_time(tmp_path: Path, started: str) -> None:
    with_metadata(tmp_path, manifest(started=started).metadata())

    found = catalogue(tmp_path)

    assert np.isnat(found.columns()["started"]).all()
    assert found.to_pandas()["started"].isna().all()


def test_an_index_of_thousands_of_records_is_read_in_two_reads(tmp_path: Path) -> None:
    """Otherwise a file of 8 MB would cause reads of terabytes."""
    path = with_metadata(tmp_path, manifest().metadata())
    data = path.read_bytes()
    summary = struct.unpack_from("<Q", data, len(data) - 8 - 20)[0]
    builder = RecordBuilder()
    place = data.index(RUN.encode()) - 4 - 9
    for _ in range(5_000):
        MetadataIndex(offset=place, length=len(data), name=RUN).write(builder)
    Footer(summary_start=summary, summary_offset_start=0, summary_crc=0).write(builder)
    path.write_bytes(data[:summary] + builder.end() + b"\x89MCAP0\r\n")
    reads = 0
    whole = recording_summary.read_metadata.__globals__["_record"]

    def counted(*arguments: object) -> object:
        nonlocal reads
        reads += 1
        return whole(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(recording_summary.read_metadata.__globals__, "_record", counted)
        assert "no metadata named armrig.outcome" in catalogue(tmp_path).left_out[0].why

    assert reads == 1


def test_a_summary_longer_than_any_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = recorded([sample(0)])
    path = written(tmp_path, data)
    (start,) = struct.unpack_from("<Q", data, len(data) - 8 - 4 - 8 - 8)
    length = len(data) - start - 8 - 29  # up to the footer

    monkeypatch.setattr(recording_summary, "RECORD_LIMIT", length)
    assert RUN in recording_summary.read_metadata(path)
    nowhere = data[:-28] + bytes(8) + data[-20:]
    for limit, content in ((length - 1, data), (RECORD_LIMIT, nowhere)):
        monkeypatch.setattr(recording_summary, "RECORD_LIMIT", limit)
        path.write_bytes(content)
        with pytest.raises(DamageError, match="its footer does not point to a summary"):
            recording_summary.read_metadata(path)


def test_a_record_longer_than_any_is_not_read(tmp_path: Path) -> None:
    data = bytearray(recorded([sample(0)]))
    summary = make_reader(BytesIO(bytes(data))).get_summary()
    assert summary is not None
    [place] = [index.offset for index in summary.metadata_indexes if index.name == RUN]
    struct.pack_into("<Q", data, place + 1, RECORD_LIMIT)
    assert RUN in recording_summary.read_metadata(written(tmp_path, bytes(data)))
    struct.pack_into("<Q", data, place + 1, RECORD_LIMIT + 1)
    with pytest.raises(DamageError, match="is longer than the"):
        recording_summary.read_metadata(written(tmp_path, bytes(data)))
