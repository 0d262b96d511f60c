"""The course of a black-box study: what to identify from, with what, and how it is judged."""

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
"""Kind of an experiment that is shown, and not identified from."""
STAIRCASE = "staircase"
"""Another one."""


def kind_of(recording: Recording) -> str:
    """Return the kind of a recording's experiment, without the name that it was given."""
    return recording.manifest.experiment.partition("-")[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class Orders:
    """Orders of the models; the arm has four poles, one of them an integrator."""

    na: int = ARM_POLES
    """Number of a's of the ARX model."""
    nb: int = ARM_POLES
    """Number of b's of both."""
    nf: int = ARM_POLES
    """Number of all f's of the OE model, the integrator's included."""
    nk: int = 1
    """Samples before u reaches y, of both."""
    integrator: bool = True
    """Of the OE model; an ARX model finds its own."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Assessed:
    """A model, and how it simulates data that it has not seen."""

    comparison: Comparison
    """The model against the validation data."""

    @property
    def name(self) -> str:
        """What the report calls it: ARX, OE or physics."""
        return self.comparison.name

    @property
    def model(self) -> Model:
        """The model."""
        return self.comparison.model


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AssessedFit(Assessed):
    """An estimated model, its residuals on data that it has not seen, and the physics beside it."""

    fit: Fit
    """The model, with what it was estimated from."""
    tests: ResidualTest
    """Of its residuals on the validation data."""
    deviation: Vector
    """|G - G_physics| / |G_physics| at the study's frequencies, (n,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """Everything that a report tells."""

    recordings: tuple[Recording, ...]
    """All that were given, in their order."""
    estimation: Dataset
    """What the models were estimated from: u in V, theta_1 in rad."""
    validation: Dataset
    """What they were judged by, in the same units."""
    halves: bool
    """There was one recording: its first half estimates, its second half validates."""
    estimated: tuple[AssessedFit, ...]
    """The models of the data."""
    reference: Assessed
    """The physics, nothing of which was estimated."""
    note: str
    """What the comparisons estimated from the validation data themselves."""
    timing: tuple[SamplingStatistics, ...]
    """Of each recording, times in µs."""
    disturbances: tuple[Disturbances, ...]
    """What disturbed the timing of each recording."""
    omega: Vector
    """Frequencies at which the models are held against the physics, in rad/s, (n,)."""

    @property
    def models(self) -> tuple[Assessed, ...]:
        """The models of the data, then the physics."""
        return (*self.estimated, self.reference)

    @property
    def best(self) -> AssessedFit:
        """The estimated model that simulates the validation data best."""
        return self.ranked[0]

    @property
    def ranked(self) -> tuple[AssessedFit, ...]:
        """The estimated models, the one that simulates best first."""
        return tuple(sorted(self.estimated, key=lambda m: m.comparison.rms_error))

    def model(self, name: str) -> Assessed:
        """Return the model that the report calls by this name."""
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
    """Identify ARX and OE models and judge them, with the physics, on other data.

    The first recording that is no step and no staircase estimates, the next one validates; where
    there is only one, its second half validates.

    Parameters
    ----------
    recordings : sequence of Recording
        At least one that is no step and no staircase.
    orders : Orders, optional
        Of the models; the arm's by default.
    treat : callable, optional
        What is done to the data of each recording first, such as `armrig.hampel`; the report
        prints every step. The models are of what it leaves.

    Returns
    -------
    Study
        Models, their comparison and their residual tests.

    Raises
    ------
    ValueError
        There is nothing to identify from, or the orders are too high for it.
    """
    orders = orders or Orders()
    excited = [r for r in recordings if kind_of(r) not in (STEP, STAIRCASE)]
    if not excited:
        raise FileError(
            "nothing to identify from: give a recording whose input is no single step, such as "
            "one of `armrig collect blackbox`"
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
    """Return models and physics held against each other and the data, as fields of a `Study`.

    Parameters
    ----------
    fits : mapping of str to Fit
        What the report calls each, and the model.
    """
    # First: a model of another sampling time has no response at these frequencies.
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
