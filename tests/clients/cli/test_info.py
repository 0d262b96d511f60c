"""`armrig info`: content of a recording, and its missing samples."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from armrig.cli import main
from armrig.cli.recording_info import _replay_verdict
from armrig.cli.replay import Replay

from tests.clients.made_recordings import manifest, note, recorded, sample, written
from tests.clients.told import told


def test_a_truncated_recording_is_used_and_the_loss_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = recorded([sample(k) for k in range(40)], flush_every=10)
    path = written(tmp_path, whole[: len(whole) // 2])

    assert main(["info", str(path), "--json"]) == 0

    facts = json.loads(capsys.readouterr().out)
    assert facts["truncated"] is True
    assert f"saved: {facts['samples']} samples" in facts["damage"]


def test_notes_are_listed_with_their_times_and_authors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    notes = [note(k, f"touched #{k}") for k in range(12)]
    path = str(written(tmp_path, recorded([*(sample(k) for k in range(40)), *notes])))

    assert main(["info", path]) == 0
    brief = capsys.readouterr().out
    assert main(["info", path, "--verbose"]) == 0
    full = capsys.readouterr().out

    assert re.search(r"^note +at 0\.09 s, Ada: touched #9\nnote +2 more; --verbose", brief, re.M)
    assert brief.count("touched") == 10
    assert re.search(r"^note +at 0\.11 s, Ada: touched #11$", full, re.M)


def test_damage_is_reported_wherever_a_recording_is_used(
    three_recordings: tuple[Path, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = three_recordings[1].read_bytes()
    path = written(tmp_path, whole[: len(whole) * 3 // 4])

    assert main(["identify", str(path), "--structure", "arx", "--json"]) == 0

    said = capsys.readouterr()
    assert json.loads(said.out)["structure"] == "arx"
    assert said.err.startswith(f"armrig: {path}: ")
    assert "saved: " in said.err
    assert said.err.count("\n") == 1


def test_info_says_what_a_recording_holds(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(three_recordings[2])

    assert main(["info", path]) == 0
    text = capsys.readouterr().out
    assert main(["info", path, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)

    assert "1195 at 0.01 s, 5 missing" in text
    assert "signal to noise" in text
    assert "\\x" not in text  # a blank between number and unit is no stranger's character
    assert facts["samples"] == 1195
    assert facts["missing"] == 5
    assert facts["gaps"][0]["count"] == 5
    assert facts["manifest"]["experiment"] == "blackbox"
    assert facts["sampling"]["Ts_us"] == 10_000


def test_info_says_lateness_as_the_bar_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for pacing, of in (
        ("scheduled", "arrival of the samples"),
        ("exchange", "request for each sample"),
    ):
        data = recorded([sample(k) for k in range(10)], manifest=manifest(pacing=pacing))

        assert main(["info", "--verbose", str(written(tmp_path, data))]) == 0

        lines = capsys.readouterr().out.splitlines()
        [line] = [x for x in lines if x.startswith("host's lateness")]
        [jitter] = [x for x in lines if x.startswith("jitter")]
        assert "p50 3.0, p99 3.0, max 3 µs" in line
        assert of in line
        assert jitter.endswith(" µs; spread of the sampling interval, by the device's clock")


def test_info_of_a_recording_cut_off_at_once_says_what_is_not_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = recorded([sample(k) for k in range(40)], flush_every=10)
    cut = written(tmp_path, whole[: len(whole) // 4], "cut.mcap")
    short = written(tmp_path, recorded([sample(0)]), "short.mcap")

    assert main(["info", str(cut)]) == 0
    of_cut = capsys.readouterr().out
    assert main(["info", str(short)]) == 0
    of_short = capsys.readouterr().out

    assert "not known: the file is cut off before the outcome" in of_cut
    assert re.search(r"; up to 0(\.\d+)? s of 0\.1 s\n", of_cut)
    assert "too few samples" in of_short
    assert "nan" not in of_cut + of_short


def test_info_names_the_owner_of_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    owner = "group 3\x1b[2J (certificate alice)"
    path = written(tmp_path, recorded([sample(0)], manifest=manifest(owner=owner)))

    assert main(["info", str(path)]) == 0

    said = capsys.readouterr().out
    assert re.search(r"^owner +group 3\\x1b\[2J \(certificate alice\)$", said, re.MULTILINE)


def test_info_of_a_cut_file_does_not_call_the_run_cut_short(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = {"manifest": manifest(samples=40, k_first=0), "flush_every": 10}
    whole = recorded([sample(k) for k in range(40)], **run, outcome_first=True)
    left = recorded([sample(k) for k in range(40)], **run, outcome=None)

    assert main(["info", str(written(tmp_path, whole[:-200]))]) == 0
    of_whole = capsys.readouterr().out
    assert main(["info", str(written(tmp_path, left[:-400], "run.mcap.active"))]) == 0
    of_left = capsys.readouterr().out

    assert "of the run: complete; but the file is cut off" in of_whole
    assert re.search(r"samples +\d+ at 0.01 s, 0 missing", of_whole)
    assert "s of 0.4 s" in of_whole
    assert "the file is cut off before the outcome, or is still being written" in of_left


def test_a_missing_option_is_reported_with_its_source(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", "F.mcap"]) == 2
    option = told(capsys)
    assert main(["validate"]) == 2
    argument = told(capsys)
    assert main(["compare", "F.mcap"]) == 2
    either = told(capsys)

    assert "--model JSON is missing: model file written by identify --save" in option
    assert "F is missing: recording (*.mcap, @last or @NAME)" in argument
    assert "--model FILE (from `armrig identify --save FILE`)" in either


@pytest.mark.parametrize(
    ("difference", "until", "verdict"),
    [
        ("", "", "replay made the same decisions, to the last bit"),
        (
            "",
            "cut off",
            "replay made the same decisions, to the last bit, up to the end of the file: cut off",
        ),
        ("frame 7", "cut off", "DIFFERS: frame 7"),
    ],
)
def test_a_replay_of_a_part_is_not_one_of_the_whole(
    difference: str, until: str, verdict: str
) -> None:
    found = Replay(
        steps=9, frames=9, samples=9, seconds=0.1, difference=difference, until=until, said=()
    )

    assert _replay_verdict(found) == verdict
