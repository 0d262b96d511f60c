"""The commands before a model is estimated: model, plot, sampling, hints (handout 2.1 to 3.2)."""

from __future__ import annotations

import re
from pathlib import Path

import armrig
import pytest
from armrig.cli import main
from armrig.recordings.overview import overview

from tests.clients.made_recordings import gap, manifest, recorded, turning, written


def said(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Return the command's output for a person."""
    assert main(arguments) == 0
    return capsys.readouterr().out


def test_a_part_of_a_recording_is_drawn_at_its_times(tmp_path: Path) -> None:
    samples = turning([30_000 + 100 * k for k in range(200)])
    messages = [*samples[:150], gap(150, 10, 2.5), *samples[160:]]
    about = manifest(k_first=0, samples=200)
    rec = armrig.load(written(tmp_path, recorded(messages, manifest=about)), start=1.0)

    figure = overview(rec).plot()

    assert figure.axes[0].get_xlim() == pytest.approx((1.0, 1.99))
    [shade] = [p for p in figure.axes[1].patches if p.get_alpha() == 0.35]
    box = shade.get_window_extent().transformed(figure.axes[1].transData.inverted())
    assert (box.x0, box.x1) == pytest.approx((1.495, 1.595))


def test_plot_reports_the_speed_without_noise_of_the_converter(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One step of the converter in 2 ms would look like 3 rad/s."""
    counts = [32768 + 64 * (k % 2) for k in range(200)]
    data = recorded(turning(counts), manifest=manifest(samples=200, Ts=0.002))

    text = said(["plot", str(written(tmp_path, data)), "-o", str(tmp_path / "x.png")], capsys)

    [line] = [x for x in text.splitlines() if x.startswith("theta_1 ")]
    low, high = map(float, re.findall(r"at (\S+) to (\S+) rad/s over 0.1 s", line)[0])
    assert max(-low, high) < 0.1
