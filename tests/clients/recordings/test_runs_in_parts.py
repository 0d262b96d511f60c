"""The parts of one run are read as one recording, and missing parts are reported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from armrig.cli import main
from armrig.recordings.files.loading import load
from armrig.recordings.files.replay import replay
from armrig.recordings.files.verification import verify
from armrig.rig.playback import read_run
from armrig_core.commands.codes import COMPLETE
from armrig_core.errors import FileError
from armrig_core.recording_file import recorder
from armrig_core.recording_file.manifest import RUN, Manifest, Outcome
from armrig_core.recording_file.part_names import part_paths
from armrig_core.telemetry.telemetry import Outgoing
from mcap.reader import make_reader

from tests.clients.made_recordings import gap, manifest, recorded, sample, written


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


def test_a_run_with_a_missing_part_is_refused(tmp_path: Path) -> None:
    one, two, three = _parts(tmp_path)
    run = tmp_path / "run.mcap"
    kept = {path: path.read_bytes() for path in (one, two)}

    for missing, number in ((one, 1), (two, 2)):
        missing.unlink()
        for read in (load, verify, read_run, replay):
            with pytest.raises(FileError, match=f"part {number} of this run is missing"):
                read(run)
        missing.write_bytes(kept[missing])
    one.unlink()
    assert load([two, three]).N == 200
    one.write_bytes(kept[one])
    three.unlink()
    found = verify(run)

    assert load(run).N == 195
    assert [c.about for c in found.checks if c.level == "unusable"] == ["file"]
    assert "its last part is missing" in repr(found)
    assert verify(two).checks[0].level == "good"


def test_a_recording_given_as_a_calibration_is_refused_with_the_remedy(tmp_path: Path) -> None:
    one, two, _ = _parts(tmp_path)

    with pytest.raises(FileError, match=r"is a recording, not a calibration.*as a list"):
        load(one, two)


def test_the_name_of_a_run_selects_all_its_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _parts(tmp_path)
    monkeypatch.chdir(tmp_path)

    for words, code, told in (
        (["info", "run.mcap"], 0, "290 at 0.01 s, 10 missing"),
        (["info", "run.part-0002.mcap"], 0, "95 at 0.01 s"),
        (
            ["info", *sorted(p.name for p in tmp_path.iterdir())],
            2,
            "run.mcap means all parts",
        ),
        (["info", "run"], 1, "did you mean run.mcap?"),
        (["replay", "run.mcap"], 1, "run.mcap: nothing to replay"),
    ):
        assert main(words) == code
        captured = capsys.readouterr()
        assert told in " ".join((captured.out + captured.err).split())


def _record_in_parts(whole: Path, path: Path, *, samples: int) -> None:
    """Record the messages of a recording again, in parts of so many samples."""
    with whole.open("rb") as file:
        reader = make_reader(file)
        about = {record.name: record.metadata for record in reader.iter_metadata()}
        attached = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
        messages = list(reader.iter_messages(log_time_order=False))
    run = Manifest.of(about[RUN])
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
    recording = recorder.ActiveRecording.create(
        path,
        run,
        attached,
        t_first_ns=batch[0].t_host_ns,
        changed=lambda: None,
        part_samples=samples,
    )
    recording.add(batch)
    recording.finish(COMPLETE)
    recording.join(30)
    assert recording.error == ""


@pytest.mark.parametrize("pacing", ["exchange", "scheduled"])
def test_a_run_in_parts_is_replayed_as_one(tmp_path: Path, pacing: str) -> None:
    whole = Path(__file__).parents[2] / "data" / "0.2.0" / f"{pacing}.mcap"
    _record_in_parts(whole, tmp_path / "run.mcap", samples=60)

    again = replay(tmp_path / "run.mcap")

    assert len(part_paths(tmp_path / "run.mcap")) > 2
    assert again == replay(whole)
    with pytest.raises(FileError, match="nothing to replay"):
        replay(tmp_path / "run.part-0002.mcap")


def test_parts_that_do_not_follow_each_other_are_refused(tmp_path: Path) -> None:
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
        ([], "the list of paths is empty"),
        ([one, of_another_rig], "of rig 2 is not run"),
        ([one, before], "do not follow the samples of the previous part"),
    ):
        with pytest.raises(FileError, match=why):
            load(given_paths)
    with pytest.raises(TypeError, match="or a list of the parts of a run"):
        load({one, two})  # type: ignore[arg-type]


@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_cut_off_part_is_reported_with_its_number(tmp_path: Path, number: int) -> None:
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
