"""Frames of chassis and arm for a 3D panel: foxglove-sdk's own message, with the right angles."""

from __future__ import annotations

from math import inf, nan, remainder, tau
from pathlib import Path

import numpy as np
import pytest
from armrig.cli import main
from armrig.physics.files.poses import transforms
from armrig.recordings.files.loading import load
from armrig.recordings.recording import Recording
from armrig_core.telemetry.topics import topic
from mcap.reader import make_reader

from tests.clients.made_recordings import manifest, of_the_arm, recorded, sample, written
from tests.layouts import frame_angles, frames_class

pytest.importorskip("foxglove", reason="no foxglove-sdk")
N = 200


@pytest.fixture
def rec(tmp_path: Path) -> Recording:
    """Return a run of the arm through the dead band, with missing samples."""
    u = np.full(N, 4.0)
    return load(written(tmp_path, of_the_arm(u, missing=slice(50, 60), start=2.5)))


@pytest.mark.parametrize(
    ("theta_1", "alpha", "left"),
    [(nan, 0.1, {"arm"}), (0.1, inf, {"chassis"}), (-inf, nan, set())],
)
def test_the_frame_of_an_unknown_angle_is_omitted(
    theta_1: float, alpha: float, left: set[str]
) -> None:
    """A viewer would place a frame of NaN anywhere; infinity, in a foreign file, has no sine."""
    assert {child for _, child in frame_angles(transforms(theta_1, alpha, 0).encode())} == left


@pytest.mark.parametrize("offset_ns", [-4 * 10**18, 72 * 10**17])
def test_times_outside_the_range_of_foxglove_are_refused(
    offset_ns: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The offset of a recording's clocks may be of any size."""
    data = recorded(map(sample, range(3)), manifest=manifest(clock_offset_ns=offset_ns))
    out = tmp_path / "frames.mcap"

    assert main(["export", str(written(tmp_path, data)), str(out), "--transforms"]) == 1

    assert "--transforms needs times from 1970 to 2106" in capsys.readouterr().err
    assert not out.exists()


def test_the_frames_of_a_recording_have_its_angles_at_its_times(
    rec: Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    out = rec.path.with_name("frames.mcap")

    assert main(["export", str(rec.path), str(out), "--transforms"]) == 0

    assert f"{N} samples, 10 of them missing" in capsys.readouterr().out
    times = {}
    for path, stream in ((rec.path, "sample"), (out, "transforms")):
        with path.open("rb") as file:
            messages = [m for *_, m in make_reader(file).iter_messages([topic("1", stream)])]
        times[stream] = [m.log_time for m in messages]
    assert times["transforms"] == times["sample"]
    stamps = [frames_class().FromString(m.data).transforms[-1].timestamp for m in messages]
    assert [stamp.ToNanoseconds() for stamp in stamps] == times["sample"]
    expected = zip(rec.theta_1[rec.present], rec.alpha[rec.present], strict=True)
    assert np.isnan(rec.theta_1[rec.present]).any()
    for message, angles in zip(messages, expected, strict=True):
        both = zip((("rig", "chassis"), ("chassis", "arm")), angles, strict=True)
        known = {frame: pytest.approx(remainder(a, tau)) for frame, a in both if not np.isnan(a)}
        assert frame_angles(message.data) == known
