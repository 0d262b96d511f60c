"""`armrig recover`: files and folders, its messages, and the exit code."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig.cli import main
from armrig_core.recording_file.opening import lock

from tests.clients.made_recordings import manifest, recorded, sample, written

N = 30
DATA = recorded(
    [sample(k) for k in range(N)],
    manifest=manifest(k_first=0, samples=2 * N),
    outcome=None,
    flush_every=10,
)[:-100]


def test_a_folder_is_recovered_except_files_in_use(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in "ab":
        written(tmp_path, DATA, f"1-{name}.mcap.active")
    with written(tmp_path, DATA, "1-c.mcap.active").open("rb") as file:
        lock(file)

        assert main(["recover", str(tmp_path)]) == 0

    out, err = capsys.readouterr()
    assert out.count(f"recovered, {N} samples, 0.3 s of 0.6 s") == 2
    assert "1-c.mcap.active: the file is being written; wait for its end" in err
    assert [p.name for p in sorted(tmp_path.iterdir())] == [
        *("1-a.mcap", "1-b.mcap", "1-c.mcap.active")
    ]
    assert main(["info", str(tmp_path / "1-a.mcap")]) == 0
    info = capsys.readouterr().out
    assert "cut off: its recorder died or could not write" in info
    assert "B were kept" in info


def test_a_remote_recording_is_recovered_without_its_length(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A killed `armrig record`: the run's length was not requested, and the daemon lives."""
    for name, n in (("a", N), ("b", 0)):
        data = recorded([sample(k) for k in range(n)], manifest=manifest(samples=0), outcome=None)[
            :-100
        ]
        written(tmp_path, data, f"{name}.mcap.active")

    assert main(["recover", str(tmp_path)]) == 0
    out, _ = capsys.readouterr()
    assert f"{tmp_path}/a.mcap: recovered, {N} samples, 0.3 s; the last " in out
    assert f"{tmp_path}/b.mcap: recovered, 0 samples, 0 s; the last " in out
    assert main(["verify", str(tmp_path / "b.mcap")]) == 1
    out, _ = capsys.readouterr()
    assert "samples        failed: the file was cut off before its first sample" in out
