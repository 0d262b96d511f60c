"""A rig whose description has a model: x' = A x + B v(t - delay_s), y = C x + offset.

The input v is the voltage at the pin less that at rest, which acts while the driver is off.

Between changes of the input the states are exact except for rounding, as those of the arm. A model
in discrete time makes a step at the first reading after its sampling time. A process of its own
integrates own equations.
"""

from __future__ import annotations

from collections import deque
from math import tau

import numpy as np
from armrig_core.rig.channels import COUNTS
from armrig_core.rig.description import Description, Output, require_model

from armrig_daemon.emulator import plant


class DescribedRig:
    """A rig of one input and one or two outputs, at rest at first."""

    is_loose = False  # it has no arm

    def __init__(self, description: Description, rng: np.random.Generator) -> None:
        """Put the rig at rest; `rng` is the source of the outputs' noise.

        Raises InputError if the description has no model.
        """
        model, system = require_model(description)
        self._outputs = tuple(description.outputs.values())
        self._A, self._B, self._C = (np.array(matrix) for matrix in system[:3])
        self._Ts_ns = round((system.Ts or 0.0) * 1e9)
        self._since_ns = 0  # since the last step of a model in discrete time
        self._offset = model.offset or [0.0] * len(self._outputs)
        self._noise = model.noise or [0.0] * len(self._outputs)
        self._process = system.process
        self._y = np.zeros(len(self._outputs))  # of own equations, without the offset
        is_exact = system.process is None and not system.Ts
        self._powers = plant.digit_powers(self._A, self._B) if is_exact else []
        self._xu = np.zeros(len(system.A) + 1)  # the states and, last, the delayed input
        self._delay_ns = round(model.delay_s * 1e9)
        self.rest_v = description.input.rest_v  # as while the driver is off
        self._origin = 0.0 if system.process is not None else self.rest_v
        self._changes = deque([(0, self.rest_v - self._origin)])  # delayed inputs with their times
        self._now_ns = 0
        self._rng = rng

    @property
    def state(self) -> tuple[float, ...]:
        """States of the model."""
        return tuple(self._xu[:-1].tolist())

    def advance(self, u: float, dt_ns: int) -> None:
        """Apply a constant voltage for a time."""
        changes, v = self._changes, u - self._origin
        if v != changes[-1][1]:
            changes.append((self._now_ns, v))
        end_ns = self._now_ns + dt_ns
        while self._now_ns < end_ns:
            seen_ns = self._now_ns - self._delay_ns
            while len(changes) > 1 and changes[1][0] <= seen_ns:
                changes.popleft()
            next_ns = changes[1][0] + self._delay_ns if len(changes) > 1 else end_ns
            self._xu[-1] = changes[0][1]
            self._flow(min(next_ns, end_ns) - self._now_ns)
            self._now_ns = min(next_ns, end_ns)

    def wiper(self, channel: int) -> float | None:
        """Return a sensor's voltage as a fraction of the reference; None in a dead band.

        Each call draws the noise of the output.
        """
        if channel >= len(self._outputs):
            return 0.5  # an unused input of the converter
        output = self._outputs[channel]
        model_y = self._C[channel] @ self._xu[:-1] if self._process is None else self._y[channel]
        y = float(model_y) + self._offset[channel]
        if self._noise[channel]:
            y += self._noise[channel] * self._rng.standard_normal()
        return _fraction(output, y)

    def _flow(self, dt_ns: int) -> None:
        if self._process is not None:
            self._y = self._process.run([float(self._xu[-1])], dt_ns * 1e-9)[-1]
        elif self._Ts_ns:
            self._since_ns += dt_ns
            # At the nearest sample: the device's clock is not exactly the model's.
            steps = (self._since_ns + self._Ts_ns // 2) // self._Ts_ns
            for _ in range(steps):
                self._xu[:-1] = self._A @ self._xu[:-1] + self._B[:, 0] * self._xu[-1]
            if steps:
                self._since_ns = 0
        if not self._powers:
            return
        while dt_ns > plant.MAX_STEP_NS:
            self._flow(plant.MAX_STEP_NS)
            dt_ns -= plant.MAX_STEP_NS
        for powers in self._powers:
            if digit := dt_ns & 0xFF:
                self._xu = powers[digit] @ self._xu
            dt_ns >>= plant.DIGIT_BITS


def _fraction(output: Output, y: float) -> float | None:
    """Return the reading of a value as a fraction of the full scale; None in the dead band."""
    if output.turning:
        counts = output.conversion.counts(y) % (tau / abs(output.per_count))
        return counts / COUNTS if counts <= COUNTS else None
    # An unstable model may grow to infinity, and then NaN: the converter reads an end of its range.
    return min(max(-1.0, output.conversion.counts(y) / COUNTS), 2.0)
