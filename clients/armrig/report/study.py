"""The course of a black-box study: what to identify from, with what, and how it is judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from armrig_core.arm import ArmParameters
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.estimation.arx import arx
from armrig.estimation.oe import oe
from armrig.estimation.orders import require_sensible
from armrig.models.fit import Fit
from armrig.physics.physical_model import physical_model
from armrig.recordings.jitter import SamplingStatistics, sampling_statistics
from armrig.recordings.recording import Recording, RecordingError
from armrig.recordings.timing_disturbances import Disturbances, disturbances
from armrig.validation.comparison import ComparisonTable, compare
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

    na: int = 4
    """Number of a's of the ARX model."""
    nb: int = 4
    """Number of b's of both."""
    nf: int = 4
    """Number of all f's of the OE model, the integrator's included."""
    nk: int = 1
    """Samples before u reaches y, of both."""
    integrator: bool = True
    """Of the OE model; an ARX model finds its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A model, and what data that it has not seen say of it."""

    name: str
    """ARX, OE or physics."""
    fit: Fit
    """The model."""
    tests: ResidualTest | None
    """Of its residuals; None for the physics, which has no noise model to test."""


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
    models: tuple[Judged, ...]
    """ARX, OE and the physics."""
    table: ComparisonTable
    """The models simulated on the validation data, in the same order."""
    timing: tuple[SamplingStatistics, ...]
    """Of each recording, times in µs."""
    causes: tuple[Disturbances, ...]
    """What disturbed the timing of each recording."""
    omega: NDArray[np.float64]
    """Frequencies of `deviation`, in rad/s."""
    deviation: NDArray[np.float64]
    """|G - G_physics| / |G_physics| of ARX and OE at `omega`, (2, n)."""

    @property
    def estimated(self) -> tuple[Judged, Judged]:
        """ARX and OE."""
        return self.models[0], self.models[1]

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
        msg = "nothing to identify from: give a recording whose input is no single step, such as "
        msg += "one of `armrig collect blackbox`"
        raise RecordingError(msg)
    data = [r.dataset() if treat is None else treat(r.dataset()) for r in excited[:2]]
    estimation, validation = data if len(data) > 1 else data[0].split(2)
    samples, nk = estimation.N - estimation.missing, orders.nk
    require_sensible(samples=samples, nk=nk, na=orders.na, nb=orders.nb)
    require_sensible(
        samples=samples, nk=nk, integrator=orders.integrator, nb=orders.nb, nf=orders.nf
    )
    models = (
        ("ARX", arx(estimation, na=orders.na, nb=orders.nb, nk=orders.nk)),
        (
            "OE",
            oe(
                estimation,
                nb=orders.nb,
                nf=orders.nf,
                nk=orders.nk,
                integrator=orders.integrator,
            ),
        ),
    )
    physics = physical_model(ArmParameters(), estimation)
    judged = [Judged(name=n, fit=f, tests=residuals(f, validation)) for n, f in models]
    omega = np.geomspace(0.5, min(100.0, np.pi / estimation.Ts), 200)
    G = [fit.frequency_response(omega).G for fit in (*(f for _, f in models), physics)]
    return Study(
        recordings=tuple(recordings),
        estimation=estimation,
        validation=validation,
        halves=len(excited) == 1,
        models=(*judged, Judged(name="physics", fit=physics, tests=None)),
        table=compare(
            validation, *(f for _, f in models), physics, labels=("ARX", "OE", "physics")
        ),
        timing=tuple(sampling_statistics(r) for r in recordings),
        causes=tuple(disturbances(r) for r in recordings),
        omega=omega,
        deviation=np.array([np.abs(g - G[-1]) / np.abs(G[-1]) for g in G[:-1]]),
    )
