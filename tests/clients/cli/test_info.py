"""`armrig info`: content of a recording, and its missing samples."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from armrig.cli import main

from tests.clients.made_recordings import manifest, note, recorded, sample, written


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
