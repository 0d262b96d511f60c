"""One table defines the channels of a sample, from the telemetry to the exported files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig.cli import main
from armrig.recordings.files import container, loading
from armrig_core.rig.channels import Channel
from armrig_core.telemetry import channels as rig_channels
from armrig_protocol.messages import Flag
from numpy.lib.recfunctions import append_fields

from tests.clients.made_recordings import recorded, sample, written

N = 60
COUNTS = np.linspace(1_000, 60_000, N).astype(np.uint32)


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a recording of a rig that has a third potentiometer, at its rail in sample 7."""
    beta = Channel("beta", "rad", rail="ADC1_RAIL", valid="valid_beta")
    monkeypatch.setattr(rig_channels, "CHANNELS", (*rig_channels.CHANNELS, beta))

    def read(*args: Any, **named: Any) -> Any:
        content = container.read(*args, **named)
        if content is not None and content.samples.size:
            k = content.samples["k"].astype(int)
            columns = (COUNTS[k], COUNTS[k] / 1e4)
            content.samples = append_fields(
                content.samples, (beta.counts_field, beta.value_field), columns, usemask=False
            )
        return content

    monkeypatch.setattr(loading, "read", read)
    flags = int(Flag.RUN | Flag.ADC1_RAIL)
    samples = [sample(k, **({"flags": flags} if k == 7 else {})) for k in range(N)]
    return written(tmp_path, recorded(samples))


def test_a_third_channel_of_the_table_reaches_a_recording_and_its_data(path: Path) -> None:
    recording = loading.load(path)

    shown, data = recording.channel("beta"), recording.dataset("beta")  # type: ignore[arg-type]

    np.testing.assert_array_equal(np.flatnonzero(~shown.valid), [7])
    np.testing.assert_array_equal(shown.y[shown.valid], np.delete(COUNTS, 7) / 1e4)
    assert (data.output, data.unit) == ("beta", "rad")
    np.testing.assert_array_equal(data.y, shown.y)


def test_a_third_channel_of_the_table_reaches_an_export(path: Path) -> None:
    out = path.with_name("out.csv")

    main(["export", str(path), str(out), "--raw"])

    table = np.genfromtxt(out, delimiter=",", names=True)
    np.testing.assert_array_equal(table["beta"], loading.load(path).channel("beta").y)
    np.testing.assert_array_equal(np.flatnonzero(table["valid_beta"] == 0), [7])
    np.testing.assert_array_equal(table["beta_counts"], COUNTS)
