"""The parts of one run are read as one recording, and what is missing of them is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from armrig.cli import main
from armrig.cli.replay import replay
from armrig.recordings.loading import load
from armrig.recordings.published import published
from armrig.recordings.verification import verify
from armrig_core.codes import COMPLETE
from armrig_core.errors import FileError
from armrig_core.manifest import RUN, Outcome, manifest_of
from armrig_core.recording_file import recorder
from armrig_core.recording_file.outgoing import Outgoing
from armrig_core.recording_file.part_names import part_number, part_paths
from made_recordings import gap, manifest, recorded, sample, written
from mcap.reader import make_reader


def _parts(directory: Path) -> list[Path]:
    """Write a run of 300 samples in three parts, a gap over the second boundary."""
    spans = [(0, 100), (100, 195), (205, 300)]
    paths = []
    for i, (first, end) in enumerate(spans, 1):
        about = manifest(k_first=0, samples=300, part=i, part_k_first=max(first - 5 * (i == 3), 0))
        messages = [sample(k, u_applied_v=k / 100) for k in range(first, end)]
        before = [gap(195, 10, 4.0)] if i == 3 else []
        ended = Outcome(
            outcome="complete" if i == 3 else "continued",
            samples=len(messages),
            missing=5 if i > 1 else 0,
        )
        data = recorded([*before, *messages], manifest=about, outcome=ended)
        paths.append(written(directory, data, f"run.part-{i:04}.mcap"))
    return paths


def test_the_parts_of_a_run_are_read_as_one(tmp_path: Path) -> None:
    """By the name of the run, or one by one in their order; and each by itself."""
    paths = _parts(tmp_path)

    whole = load(tmp_path / "run.mcap")
    again = load(paths)
    middle = load(paths[1])

    assert (whole.N, whole.missing, whole.damage) == (300, 10, "")
    np.testing.assert_array_equal(whole.u[[0, 99, 100, 194, 200, 205]], [0, 0.99, 1, 1.94, 4, 2.05])
    assert whole.outcome is not None
    assert whole.outcome.outcome == "complete"
    assert whole.sha256 == again.sha256 != middle.sha256
    assert (middle.k_first, middle.N, middle.missing) == (100, 100, 5)
    assert middle.t[0] == pytest.approx(1.0)
    np.testing.assert_array_equal(load(paths, start=1.5, stop=2.5).t, whole.t[150:250])


def test_a_run_one_of_whose_parts_is_missing_is_not_taken_for_whole(tmp_path: Path) -> None:
    """Not by its name; the parts that are there are read by their own names."""
    one, two, three = _parts(tmp_path)
    run = tmp_path / "run.mcap"
    kept = {path: path.read_bytes() for path in (one, two)}

    for missing, number in ((one, 1), (two, 2)):
        missing.unlink()
        for read in (load, verify, published, replay):
            with pytest.raises(FileError, match=f"part {number} of this run is missing"):
                read(run)
        missing.write_bytes(kept[missing])
    one.unlink()
    assert load([two, three]).N == 200
    one.write_bytes(kept[one])
    three.unlink()
    found = verify(run)

    assert load(run).N == 195
    assert [c.about for c in found.checks if c.result == "failed"] == ["file"]
    assert "its last part is missing" in repr(found)
    assert verify(two).checks[0].result == "passed"


def test_a_run_of_many_parts_is_read_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    """However many digits they have; another run whose name begins alike is none of it."""
    for number in (10_000, 9_999, 2, 1):
        (tmp_path / f"run.part-{number:04}.mcap").touch()
    (tmp_path / "run.part-0003.mcap.active").touch()
    for other in ("run.part-4.csv", "run.part-x.mcap", "run-b.part-0001.mcap", "run.part-²2.mcap"):
        (tmp_path / other).touch()

    found = part_paths(tmp_path / "run.mcap")

    assert [part_number(path) for path in found] == [1, 2, 3, 9_999, 10_000]
    others = ("run.mcap", "run.part-x.mcap", "1.mcap", ".part-1.mcap")
    assert {part_number(tmp_path / name) for name in others} == {0}


def test_a_second_part_given_as_a_calibration_is_told_how_parts_are_given(tmp_path: Path) -> None:
    """As who calls `load` with one part behind the other does."""
    one, two, _ = _parts(tmp_path)

    with pytest.raises(FileError, match=r"a recording, where a calibration.*as a list"):
        load(one, two)


def test_the_command_line_leads_from_the_parts_to_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """All parts, as a shell names them, and the run's name without its ending."""
    _parts(tmp_path)
    monkeypatch.chdir(tmp_path)

    for words, code, told in (
        (["info", "run.mcap"], 0, "290 at 0.01 s, 10 missing"),
        (["info", "run.part-0002.mcap"], 0, "95 at 0.01 s"),
        (["info", *sorted(p.name for p in tmp_path.iterdir())], 2, "by its name, run.mcap"),
        (["info", "run"], 1, "did you mean run.mcap?"),
        (["replay", "run.mcap"], 1, "run.mcap: holds no steps"),
    ):
        assert main(words) == code
        captured = capsys.readouterr()
        assert told in " ".join((captured.out + captured.err).split())


def _record_in_parts(whole: Path, path: Path, *, samples: int) -> None:
    """Record the messages of a recording once more, in parts of so many samples."""
    with whole.open("rb") as file:
        reader = make_reader(file)
        about = {record.name: record.metadata for record in reader.iter_metadata()}
        attached = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
        messages = list(reader.iter_messages(log_time_order=False))
    run = manifest_of(about[RUN])
    batch = [
        Outgoing(
            channel.topic.rpartition("/")[2],
            message.log_time - run.clock_offset_ns,
            message.publish_time - run.clock_offset_ns,
            message.sequence,
            message.data,
        )
        for _, channel, message in messages
    ]
    recording = recorder.Recording(
        path,
        run,
        attached,
        t_first_ns=batch[0].t_host_ns,
        changed=lambda: None,
        limits=recorder.PartLimits(samples=samples, size=1 << 30),
    )
    recording.add(batch)
    recording.finish(COMPLETE)
    recording.join(30)
    assert recording.error == ""


@pytest.mark.parametrize("pacing", ["exchange", "scheduled"])
def test_a_run_in_parts_is_replayed_as_one(tmp_path: Path, pacing: str) -> None:
    """Its steps, samples and frames are those of the run in one file."""
    whole = Path(__file__).parents[2] / "data" / "0.1.0" / f"{pacing}.mcap"
    _record_in_parts(whole, tmp_path / "run.mcap", samples=60)

    again = replay(tmp_path / "run.mcap")

    assert len(part_paths(tmp_path / "run.mcap")) > 2
    assert again == replay(whole)
    with pytest.raises(FileError, match="holds no steps"):
        replay(tmp_path / "run.part-0002.mcap")


def test_parts_that_do_not_follow_each_other_are_refused(tmp_path: Path) -> None:
    """One left out, the wrong order, or another run's."""
    one, two, three = _parts(tmp_path)
    about = {"part": 2, "k_first": 0, "samples": 300}
    other, of_another_rig, before = (
        written(tmp_path, recorded([sample(50)], manifest=manifest(**about, **changes)), name)
        for name, changes in (("o.mcap", {"run_id": "x"}), ("r.mcap", {"rig": "2"}), ("b.mcap", {}))
    )

    for given_paths, why in (
        ([one, three], "part 3 does not follow part 1"),
        ([two, one], "part 1 does not follow part 2"),
        ([one, other], "only the parts of one run are joined"),
        ([], "no file"),
        ([one, of_another_rig], "of rig 2 is not run"),
        ([one, before], "do not stand behind those of the part before"),
    ):
        with pytest.raises(FileError, match=why):
            load(given_paths)
    with pytest.raises(TypeError, match="or a list of the parts of a run"):
        load({one, two})  # type: ignore[arg-type]


@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_part_that_was_cut_off_is_told(tmp_path: Path, number: int) -> None:
    """Which one it is; whichever it is, the recording is cut off."""
    paths = _parts(tmp_path)
    cut = paths[number - 1]
    sizes = [path.stat().st_size for path in paths]
    assert not load(tmp_path / "run.mcap").cut_off
    cut.write_bytes(cut.read_bytes()[:-20])

    rec = load(tmp_path / "run.mcap")

    assert rec.cut_off
    assert rec.damage.startswith(f"part {number}: the file is cut off")
    assert f" of {sum(sizes) - 20} B, " in rec.damage
    kept = int(rec.damage.partition(" samples, ")[2].partition(" of ")[0])
    assert sum(sizes) - 20 - cut.stat().st_size < kept < sum(sizes) - 20
    assert rec.N == 300
