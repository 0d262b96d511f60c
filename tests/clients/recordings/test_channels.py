"""The description in a recording names its channels, up to the data and the exported files."""

from __future__ import annotations

from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig_core.commands.commands import RunRequest
from armrig_core.errors import InputError
from armrig_core.rig.description import Description, builtin
from armrig_daemon.config import Config
from armrig_daemon.service.virtual_service import LEASE, VirtualService

N = 60
TWO = Description.of(
    b'[rig]\nname = "two"\n'
    b'[outputs.T1]\nunit = "degC"\nzero_counts = 6553.6\nper_count = 0.0076\n'
    b'[outputs.beta]\nunit = "rad"\nper_count = -0.5\n'
)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of a rig with other channels than the arm."""
    service = VirtualService(Config(), tmp_path_factory.mktemp("two"), seed=1, description=TWO)
    return service.record(RunRequest(lease=LEASE, n=0, u=[2.0] * N, experiment="own"))


def test_the_channels_of_a_recording_have_the_names_and_units_of_its_rig(path: Path) -> None:
    recording = armrig.load(path)

    shown, data = recording.channel("T1"), recording.dataset("T1")  # type: ignore[arg-type]

    counts = recording.samples["T1_counts"].astype(float)
    np.testing.assert_array_equal(shown.y, (counts - 6553.6) * 0.0076)
    assert shown.valid.all()
    assert (data.output, data.unit) == ("T1", "degC")
    assert recording.signals(["T1", "beta"]).outputs == ("T1", "beta")  # type: ignore[list-item]
    assert recording.description == TWO


def test_a_channel_that_the_rig_does_not_have_is_refused_with_its_channels(path: Path) -> None:
    recording = armrig.load(path)

    for ask in (recording.channel, recording.dataset):
        with pytest.raises(InputError, match=r"theta_1.*has T1, beta$"):
            ask("theta_1")


def test_an_export_has_the_channels_of_the_rig(path: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"

    main(["export", str(path), str(out), "--raw"])

    table, recording = np.genfromtxt(out, delimiter=",", names=True), armrig.load(path)
    np.testing.assert_array_equal(table["beta"], recording.channel("beta").y)
    np.testing.assert_array_equal(table["beta_counts"], recording.samples["beta_counts"])
    assert "alpha" not in (table.dtype.names or ())


def test_a_recording_without_a_description_is_of_the_arm() -> None:
    assert armrig.example_recording().description is builtin("arm")
