"""Black-box study: choice of the data, estimation of the models, comparison with other data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from armrig_core.arm import ArmParameters
from armrig_core.errors import FileError

from armrig.data.dataset import Dataset, Vector
from armrig.estimation.arx import arx
from armrig.estimation.oe import oe
from armrig.estimation.orders import require_sensible
from armrig.models.fit import Fit
from armrig.models.model import Model
from armrig.models.structure_table import ARM_POLES
from armrig.physics.physical_model import physical_model
from armrig.recordings.jitter import (
    Disturbances,
    SamplingStatistics,
    disturbances,
    sampling_statistics,
)
from armrig.recordings.recording import Recording
from armrig.validation.comparison import Comparison, compare
from armrig.validation.residuals import ResidualTest, residuals

STEP = "step"
"""Kind of experiment that a report shows, but from which it estimates no model."""
STAIRCASE = "staircase"
"""Another kind of experiment that a report shows, but from which it estimates no model."""


def kind_of(recording: Recording) -> str:
    """Return the kind of a recording's experiment, without the name that a person chose."""
    return recording.manifest.experiment.partition("-")[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class Orders:
    """Orders of the models; the arm has four poles, one of them an integrator."""

    na: int = ARM_POLES
    """Number of a coefficients of the ARX model."""
    nb: int = ARM_POLES
    """Number of b coefficients of both models."""
    nf: int = ARM_POLES
    """Number of f coefficients of the OE model, including the coefficient of an integrator."""
    nk: int = 1
    """Number of samples before u acts on y, in both models."""
    integrator: bool = True
    """Fix an integrator in the OE model; the ARX model estimates all its poles."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Assessed:
    """A model, and its simulation of the validation data."""

    comparison: Comparison
    """Comparison of the model with the validation data."""

    @property
    def name(self) -> str:
        """Name of the model in the report: ARX, OE or physics."""
        return self.comparison.name

    @property
    def model(self) -> Model:
        """The model."""
        return self.comparison.model


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AssessedFit(Assessed):
    """An estimated model, its residuals on the validation data, and its distance to the physics."""

    fit: Fit
    """The estimated model, with the results of its estimation."""
    tests: ResidualTest
    """Tests of the model's residuals on the validation data."""
    deviation: Vector
    """|G - G_physics| / |G_physics| at the study's frequencies, (n,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """Data, models and statistics of a report."""

    recordings: tuple[Recording, ...]
    """Given recordings, in their order."""
    estimation: Dataset
    """Data that the models were estimated from: u in V, theta_1 in rad."""
    validation: Dataset
    """Data with which the models are compared, in the same units."""
    halves: bool
    """True if estimation and validation data are the first and the second half of one recording."""
    estimated: tuple[AssessedFit, ...]
    """Models that were estimated from the estimation data."""
    reference: Assessed
    """The physical model, of which nothing was estimated."""
    note: str
    """Quantities that the comparisons estimated from the validation data."""
    timing: tuple[SamplingStatistics, ...]
    """Statistics of each recording, times in µs."""
    disturbances: tuple[Disturbances, ...]
    """Disturbances of the timing of each recording."""
    omega: Vector
    """Frequencies at which the models are compared with the physics, in rad/s, (n,)."""

    @property
    def models(self) -> tuple[Assessed, ...]:
        """The estimated models, then the physical model."""
        return (*self.estimated, self.reference)

    @property
    def best(self) -> AssessedFit:
        """The estimated model that simulates the validation data best."""
        return self.ranked[0]

    @property
    def ranked(self) -> tuple[AssessedFit, ...]:
        """The estimated models, sorted by rms error, the best first."""
        return tuple(sorted(self.estimated, key=lambda m: m.comparison.rms_error))

    def model(self, name: str) -> Assessed:
        """Return the model with this name in the report."""
        return next(m for m in self.models if m.name == name)

    def recording_of(self, sha256: str) -> Recording:
        """Return the recording with this hash."""
        return next(r for r in self.recordings if r.sha256 == sha256)


def study(
    recordings: Sequence[Recording],
    *,
    orders: Orders | None = None,
    treat: Callable[[Dataset], Dataset] | None = None,
) -> Study:
    """Estimate ARX and OE models, and compare them and the physical model with validation data.

    No model is estimated from a step or a staircase, or validated on it. The models are estimated
    from the first other recording, and validated on the second. If there is only one such
    recording, its first half is used for estimation, and its second half for validation.

    Parameters
    ----------
    recordings : sequence of Recording
        At least one recording that is neither a step nor a staircase.
    orders : Orders, optional
        Orders of the models; by default the orders of the arm.
    treat : callable, optional
        Treatment of the data of each recording before the estimation, such as `armrig.hampel`.
        The report prints every step of the treatment.

    Returns
    -------
    Study
        Models, their comparison and their residual tests.

    Raises
    ------
    ValueError
        There are no data to estimate from, or the orders are too high for the data.
    """
    orders = orders or Orders()
    excited = [r for r in recordings if kind_of(r) not in (STEP, STAIRCASE)]
    if not excited:
        raise FileError(
            "nothing to identify from: give a recording whose input is not a single step, such as "
            "a recording of `armrig collect blackbox`"
        )
    data = [r.dataset() if treat is None else treat(r.dataset()) for r in excited[:2]]
    estimation, validation = data if len(data) > 1 else data[0].split(2)
    samples, nk = estimation.N - estimation.missing, orders.nk
    require_sensible(samples=samples, nk=nk, na=orders.na, nb=orders.nb)
    require_sensible(
        samples=samples, nk=nk, integrator=orders.integrator, nb=orders.nb, nf=orders.nf
    )
    fits = {
        "ARX": arx(estimation, na=orders.na, nb=orders.nb, nk=nk),
        "OE": oe(estimation, nb=orders.nb, nf=orders.nf, nk=nk, integrator=orders.integrator),
    }
    return Study(
        recordings=tuple(recordings),
        estimation=estimation,
        validation=validation,
        halves=len(excited) == 1,
        timing=tuple(sampling_statistics(r) for r in recordings),
        disturbances=tuple(disturbances(r) for r in recordings),
        **assessed(fits, physical_model(ArmParameters(), estimation), validation),
    )


def assessed(fits: Mapping[str, Fit], physics: Model, validation: Dataset) -> dict[str, Any]:
    """Compare the models and the physics with the validation data; return fields of a `Study`.

    Parameters
    ----------
    fits : mapping of str to Fit
        Models by their names in the report.
    """
    # The comparison is first: it refuses a model of another sampling time.
    table = compare(validation, *fits.values(), physics, labels=(*fits, physics.label))
    omega = np.geomspace(0.5, min(100.0, np.pi / validation.Ts), 200)
    G = physics.frequency_response(omega).G
    *rows, reference = table.rows
    estimated = tuple(
        AssessedFit(
            comparison=row,
            fit=fit,
            tests=residuals(fit, validation),
            deviation=np.abs(fit.frequency_response(omega).G - G) / np.abs(G),
        )
        for row, fit in zip(rows, fits.values(), strict=True)
    )
    return {
        "estimated": estimated,
        "reference": Assessed(comparison=reference),
        "note": table.note,
        "omega": omega,
    }
