"""Estimation of the output's drift: a linear change that the input does not explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.treatment.integrating import integrating
from armrig.data.treatment.whitening import whitening

_DEFAULT_ORDER = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """Straight-line drift of the output of one experiment, with its standard deviation."""

    rate: float
    """Slope, in `unit` per s."""
    std: float
    """Standard deviation of the slope, in `unit` per s."""
    seconds: float
    """Length of the experiment, in s."""
    unit: str
    """Unit of the output."""

    @property
    def z(self) -> float:
        """Rate divided by its standard deviation; |z| > 2.58 is significant at the 1 % level."""
        return self.rate / self.std if self.std > 0 else float("nan")

    def __str__(self) -> str:
        """Describe the drift in one line."""
        found = "a drift" if abs(self.z) > 2.58 else "no significant drift"
        return (
            f"{found}: {self.rate:.3g} ± {self.std:.2g} {self.unit or '1'}/s, "
            f"{f'{self.rate * self.seconds:.3g} {self.unit}'.rstrip()} in {self.seconds:g} s"
        )


@takes_recordings
def drift(
    data: Dataset, order: int = _DEFAULT_ORDER, *, integrator: bool | None = None
) -> tuple[Drift, ...]:
    """Estimate the drift of the output of each experiment, without the response to the input.

    A model of high order, A(q) y(t) = B(q) u(t) + c + d t + e(t), is estimated by least squares;
    the drift of the output is d / A(1) per sample. A line through y alone would also contain the
    response to the input, and its standard deviation would ignore the colour of the noise.

    Parameters
    ----------
    data : Dataset
        N samples; equations that contain a missing sample are left out.
    order : int, default 10
        Order of A and B.
    integrator : bool, optional
        True if the output integrates. By default, the name of the output (theta_1) or a unit root
        test decides. On a short record the test can mistake a stable output for an integrator. If
        the output is known to be stable, give False.

    Returns
    -------
    tuple of Drift
        A drift for each experiment.

    Raises
    ------
    ValueError
        The output integrates (its trend is then the response to the input), or there are too few
        samples.

    Examples
    --------
    The drift of alpha is less than two standard deviations.

    >>> import armrig
    >>> (found,) = armrig.drift(armrig.example_recording().dataset("alpha"))
    >>> print(f"{1e3 * found.rate:.2f} ± {1e3 * found.std:.2f} mrad/s")
    -0.02 ± 0.06 mrad/s
    """
    found = integrating(data) if integrator is None else None
    if found or integrator:
        reason = found.text if found else f"{data.output} integrates, as integrator=True says"
        raise InputError(
            f"{reason}: its line is the response to the mean of u, not a drift; estimate the "
            "input's offset instead, oe(data, ..., integrator=True).free[0].offset"
        )
    return tuple(_drift_of(part, order) for part in data.experiments())


def _drift_of(part: Dataset, n: int) -> Drift:
    needed = 4 * n + 10
    if part.N - part.missing < needed:
        raise InputError(
            f"an experiment has {part.N - part.missing} samples; a drift estimate of order {n} "
            f"needs {needed}: lower the order"
        )
    model = whitening([(part.u, part.y)], n, slope=True)
    if model.rows < needed - n:
        raise InputError(
            f"an experiment has {model.rows} samples after {n} samples without a gap; a drift "
            f"estimate of order {n} needs {needed - n}: lower the order"
        )
    gain = float(np.sum(model.A))
    rate = model.d / gain / part.Ts
    by_theta = np.zeros(2 * n + 3)
    by_theta[:n], by_theta[-1] = -rate / gain, 1 / gain / part.Ts
    variance = float(by_theta @ model.covariance @ by_theta)
    return Drift(rate=rate, std=variance**0.5, seconds=part.N * part.Ts, unit=part.unit)
