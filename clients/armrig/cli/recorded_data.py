"""The data that commands read from recordings, and what is told of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from armrig.cli.options import SAME_DATA, OutputName, tell, warned

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset
    from armrig.models.model import Model
    from armrig.models.spectral_estimate import SpectralEstimate
    from armrig.recordings.recording import Recording
    from armrig.validation.comparison import ComparisonTable


def loaded(files: Sequence[Path], calibration: Path | None) -> list[Recording]:
    """Return the recordings, and tell their damage."""
    from armrig.recordings.loading import load

    return [warned(load(file, calibration)) for file in files]


def dataset(file: Path, output: OutputName, calibration: Path | None) -> Dataset:
    """Return the data of one output, and tell the recording's damage."""
    return loaded([file], calibration)[0].dataset(output)


def warn_of_estimation_data(table: ComparisonTable) -> None:
    """Say it where a model is judged on the very data that it was estimated from."""
    if any(row.on_estimation_data for row in table.rows):
        tell(SAME_DATA)


def spectral_beside(data: Dataset) -> list[SpectralEstimate]:
    """Return the frequency response that the data show without a model; empty where they do not."""
    from armrig.nonparametric.spectral_reference import spectral_reference

    try:
        return [spectral_reference(data)]
    except ValueError as err:
        tell(f"no spectral analysis beside the model: {err}")
        return []


def dataset_of(recording: Recording, model: Model) -> Dataset:
    """Return the data of the output that the model is of."""
    for output in get_args(OutputName):
        if output == model.output:
            return recording.dataset(output)
    msg = f"the model is of {model.output!r}, a recording has {', '.join(get_args(OutputName))}"
    raise ValueError(msg)
