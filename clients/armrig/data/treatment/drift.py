"""Estimation of the output's drift: a linear change that the input does not explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_signals
from armrig.data.dataset import Signals
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
    output: str = "y"
    """Name of the output."""

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


@takes_signals
def drift(
    data: Signals, order: int = _DEFAULT_ORDER, *, integrator: bool | None = None
) -> tuple[Drift, ...]:
    """Estimate the drift of the output of each experiment, without the response to the input.

    For each output a model of high order, A(q) y(t) = B(q) u(t) + c + d t + e(t), is estimated by
    least squares. The drift of the output is d / A(1) per sample. A line through y
    alone would also contain the response to the input, and its standard deviation would ignore the
    colour of the noise.

    Parameters
    ----------
    data : Dataset or Signals
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
        A drift for each experiment, first those of the first output.

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
    for name in data.outputs:
        found = integrating(data, name) if integrator is None else None
        if found or integrator:
            reason = found.text if found else f"{name} integrates, as integrator=True says"
            raise InputError(
                f"{reason}: its line is the response to the mean of u, not a drift; estimate the "
                "input's offset instead, oe(data, ..., integrator=True).free[0].offset"
            )
    return tuple(_drift_of(part, i, order) for i in range(data.ny) for part in data.experiments())


def _drift_of(part: Signals, i: int, n: int) -> Drift:
    """Return the drift of output i in an experiment."""
    y, known = part.y[:, i], int(np.count_nonzero(part.valid[:, i]))
    needed = 4 * n + 10
    if known < needed:
        raise InputError(
            f"an experiment has {known} samples; a drift estimate of order {n} "
            f"needs {needed}: lower the order"
        )
    model = whitening([(part.u, y)], n, slope=True)
    if model.rows < needed - n:
        raise InputError(
            f"an experiment has {model.rows} samples after {n} samples without a gap; a drift "
            f"estimate of order {n} needs {needed - n}: lower the order"
        )
    Ts, gain = part.equidistant(), float(np.sum(model.A))
    rate = model.d / gain / Ts
    by_theta = np.zeros(len(model.covariance))
    by_theta[:n], by_theta[-1] = -rate / gain, 1 / gain / Ts
    variance = float(by_theta @ model.covariance @ by_theta)
    return Drift(
        rate=rate,
        std=variance**0.5,
        seconds=part.N * Ts,
        unit=part.units[i],
        output=part.outputs[i],
    )
