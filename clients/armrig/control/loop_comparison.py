"""Comparison of a recorded run in control with its prediction by a model.

The prediction evaluates the recorded law on the plant of the model, from rest and for the recorded
reference, with the limits of the law and without noise. It uses no measured output.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nan
from typing import Any

import numpy as np
from armrig_core.control.control_law import ControlLaw
from armrig_core.control.evaluation import Latch, begin, decide, observe
from armrig_core.errors import InputError
from armrig_core.process.calls import with_argument_checks
from armrig_core.rig.description import Description
from armrig_core.rig.volts import code_of, volts_of
from numpy.typing import NDArray

from armrig.control.loop import find_tracked_output
from armrig.control.plant import (
    DesignModel,
    Plant,
    PlantModel,
    Validation,
    design_model,
    doubts_about,
)
from armrig.control.requirement import requirement_of
from armrig.models.state_space import Matrix, Vector
from armrig.numerics.quantities import digits, plural
from armrig.plots.layout import plot_method
from armrig.recordings.files.control_run import ControlRun, control_run
from armrig.recordings.recording import Recording

DRAWS = 30
RATE_SAMPLES = 5
"""Number of samples over which a rate is measured, of the run and of the prediction alike."""
SETTLED = 0.05
"""Share of a step within which the output has settled."""
_BAND = (2.5, 97.5)
_HELD_BEFORE, _HELD_AFTER = 20, 50
"""Least numbers of samples with one value of r before and after a step."""
_MEAN_SAMPLES = 15
"""Number of samples over which the deviation from the prediction is averaged."""
_NOISE = 2.0
"""Half the width of the noise's band, in deviations."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepFigures:
    """Overshoot and settling after one change of the reference."""

    at: float
    """Time of the change, in s from the first sample of the run."""
    before: float
    after: float
    """r before and after the change."""
    overshoot: float
    """Largest value beyond `after`, in percent of the change. The measured value is the prediction
    with its mean deviation over 15 samples, because the peak of a noisy signal is too high."""
    settling: float
    """Time after which the value stays within 5 % of the change, in s; infinite if it does not. The
    measured value is that of the prediction with its mean deviation, too."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class LoopComparison:
    """A run in control next to its prediction; element i of an array (N,) belongs to sample i."""

    law: ControlLaw
    source: str
    """Hash of the recording."""
    model_sha256: str
    """Hash of the model's parameters."""
    Ts: float
    """Sampling time, in s."""
    prelude: int
    """Number of samples of feed-forward before the loop closes."""
    t: Vector
    """Time, in s, (N,)."""
    r: Vector
    z: Vector
    """Measured variable that follows r, (N,); NaN if it is missing."""
    predicted: Matrix
    """Prediction of z by the model and then by each draw, (1 + m, N)."""
    u: Vector
    """Commanded voltage, in V, (N,)."""
    predicted_u: Matrix
    """Prediction of u, (1 + m, N)."""
    noise: float
    """Upper bound of the noise of z: the deviation of the innovations in the law's monitor, which
    also contain the drift that its observer assumes. NaN without a monitor."""
    limited_share: float
    """Share of samples in which the voltage was at a limit."""
    doubts: tuple[str, ...]

    @property
    def deviation(self) -> float:
        """Effective value of z minus its prediction after the prelude, in the unit of r."""
        error = (self.z - self.predicted[0])[self.prelude :]
        error = error[np.isfinite(error)]
        return float(np.sqrt(np.mean(error**2))) if error.size else nan

    @property
    def height(self) -> float:
        """Largest change of r in the run; its size if r is constant."""
        return float(np.ptp(self.r)) or float(np.abs(self.r).max()) or 1.0

    @property
    def inside(self) -> float:
        """Share of the samples within the band of the draws, widened by twice the noise."""
        low, high = self.band()
        noise = 0.0 if np.isnan(self.noise) else _NOISE * self.noise
        z = self.z[self.prelude :]
        finite = np.isfinite(z)
        within = (z >= low[self.prelude :] - noise) & (z <= high[self.prelude :] + noise)
        return float(np.mean(within[finite])) if finite.any() else nan

    def band(self) -> tuple[Vector, Vector]:
        """Return the ends of the 95 % band of z over the draws, each (N,).

        Without draws, both are the prediction of the model.
        """
        draws = self.predicted[1:] if len(self.predicted) > 1 else self.predicted
        low, high = np.percentile(draws, _BAND, axis=0)
        return np.asarray(low), np.asarray(high)

    def steps(self) -> list[tuple[StepFigures, StepFigures]]:
        """Return the figures of each step of r after the prelude: measured, and predicted.

        A step is a change of r that is held for 50 samples after 20 samples with one value. Next
        to missing samples, the mean deviation is interpolated.
        """
        changes = [0, *(np.flatnonzero(np.diff(self.r)) + 1).tolist(), self.r.size]
        error = self.z - self.predicted[0]
        z = self.predicted[0] + _running_mean(error, _MEAN_SAMPLES)
        return [
            (self._step(z, a, b), self._step(self.predicted[0], a, b))
            for before, a, b in zip(changes, changes[1:], changes[2:], strict=False)
            if a - max(before, self.prelude) >= _HELD_BEFORE and b - a >= _HELD_AFTER
        ]

    def _step(self, z: Vector, a: int, b: int) -> StepFigures:
        before, after = float(self.r[a - 1]), float(self.r[a])
        share = (z[a:b] - after) / (after - before)
        finite = np.isfinite(share)
        outside = np.flatnonzero(finite & (np.abs(share) > SETTLED))
        settled = int(outside[-1]) + 1 if outside.size else 0
        if not finite.any():
            settled = b - a
        return StepFigures(
            at=float(self.t[a]),
            before=before,
            after=after,
            overshoot=100 * float(share[finite].max(initial=0.0)) if finite.any() else nan,
            settling=settled * self.Ts if settled < b - a else inf,
        )

    @property
    def worst_step(self) -> dict[str, float]:
        """Largest measured overshoot and settling of all steps, by name; NaN if one is unknown."""
        measured = [figures for figures, _ in self.steps()]
        return {
            name: float(np.max([getattr(figures, name) for figures in measured] or [nan]))
            for name in ("overshoot", "settling")
        }

    @property
    def verdict(self) -> str:
        """Deviation of the run from its prediction, and its steps; a line of doubts comes first."""
        r, share = self.law.reference, 100 * self.deviation / self.height
        unit = f" {r.unit}" if r.unit else ""
        lines = [
            f"{r.name} deviates from its prediction by {digits(self.deviation, 2)}{unit} rms, "
            f"{digits(share, 2)} % of {digits(self.height, 3)}{unit}"
            + (
                ""
                if np.isnan(self.noise)
                else f"; its noise is at most {digits(self.noise, 2)}{unit}"
            )
            + f"; {100 * self.inside:.0f} % of the samples are in the band.",
        ]
        lines += [
            f"Step {measured.before:.4g} to {measured.after:.4g}{unit} at {measured.at:.4g} s: "
            f"overshoot {measured.overshoot:.0f} % (predicted {model.overshoot:.0f} %), 5 % "
            f"settling {_seconds(measured.settling)} (predicted {_seconds(model.settling)})."
            for measured, model in self.steps()
        ]
        lines.append(
            f"The input is at its limit in {digits(100 * self.limited_share, 2)} % of the samples."
        )
        if (requirement := requirement_of(self.law.design)) and self.steps():
            lines.insert(0, requirement.sentence(self.worst_step, "The run"))
        if self.doubts:
            lines.insert(0, f"In doubt: {'; '.join(self.doubts)}.")
        return "\n".join(lines)

    def facts(self) -> dict[str, Any]:
        """Return the figures by name, for programs."""
        requirement = requirement_of(self.law.design)
        return {
            "recording": self.source,
            "law_sha256": self.law.sha256,
            "model_sha256": self.model_sha256,
            "deviation": self.deviation,
            "height": self.height,
            "noise": self.noise,
            "inside_share": self.inside,
            "limited_share": self.limited_share,
            "steps": [
                {name: _fields(figures) for name, figures in zip(_WHICH, pair, strict=True)}
                for pair in self.steps()
            ],
            "requirement": requirement.facts if requirement else None,
            "missed": requirement.misses(self.worst_step) if requirement else [],
            "doubts": [*self.doubts],
        }

    def __repr__(self) -> str:
        """Return the verdict."""
        return self.verdict

    plot = plot_method("plot_loop_comparison", "a run in control next to its prediction")


def _running_mean(x: Vector, count: int) -> Vector:
    """Return the mean of `count` samples around each one, interpolated where one is not finite.

    The mean of fewer samples is no substitute: neighbouring errors of a rate cancel in the mean.
    """
    mean = np.convolve(x, np.ones(count) / count, "valid") if x.size >= count else x[:0]
    finite = np.flatnonzero(np.isfinite(mean))
    if not finite.size:
        return np.full(x.size, nan)
    return np.interp(np.arange(x.size), finite + count // 2, mean[finite])


_WHICH = ("measured", "predicted")


def _fields(figures: StepFigures) -> dict[str, float]:
    return {name: getattr(figures, name) for name in StepFigures.__slots__}


def _seconds(value: float) -> str:
    return f"{digits(value, 3)} s" if np.isfinite(value) else "not reached"


@with_argument_checks
def compare_loop(
    recording: Recording,
    model: PlantModel,
    *,
    draws: int = DRAWS,
    rig: Description | None = None,
    u0: float | None = None,
    y0: float = 0.0,
    validation: Validation | None = None,
) -> LoopComparison:
    """Return a recorded run in control next to what a model predicts of it.

    The recorded law is evaluated on the model from rest, for the recorded reference. A rate is
    measured over five samples, of the run and of the prediction alike.

    Parameters
    ----------
    recording : Recording
        Run under a control law, of `Rig.control` or `armrig collect control`.
    model : Fit, GreyFit or python-control system
        Model with all outputs of the law, at the law's sampling time.
    draws : int, default 30
        Number of draws of the parameters, for the band of the prediction.
    rig : Description, optional
        Description of the rig; by default that of the recording.
    u0, y0, validation
        As in `armrig.control.place`.

    Raises
    ------
    InputError
        The recording has no law, or the model has other outputs or another sampling time.

    Examples
    --------
    >>> recording = armrig.load(armrig.example_recording().path)
    >>> model = armrig.physics.arm(armrig.physics.ArmParameters())
    >>> armrig.control.compare_loop(recording, model)
    Traceback (most recent call last):
        ...
    armrig_core.errors.InputError: ... is no run in control: it has no law
    """
    run = control_run(recording)
    if run is None:
        raise InputError(f"{recording.name} is no run in control: it has no law")
    if not run.k.size:
        raise InputError(f"{recording.name}: its law has made no decision")
    if np.ptp(run.k) >= recording.manifest.samples or (np.diff(run.k) <= 0).any():
        raise InputError(
            f"{recording.name}: its decisions are not those of a run of "
            f"{plural(recording.manifest.samples, 'sample')}; see `armrig verify`"
        )
    law, rig = run.law, recording.description if rig is None else rig
    Ts = law.Ts_us / 1e6
    design = design_model(model, rig=rig, Ts=Ts, u0=u0, y0=y0, validation=validation)
    names = [output.name for output in design.outputs]
    if missing := [output.name for output in law.outputs if output.name not in names]:
        raise InputError(
            f"the law uses {missing[0]}, and the model has {', '.join(names)}: give the model that "
            "the law was designed on"
        )
    doubts = doubts_about(law.design, design, validation)
    r, u = _of_decisions(run)
    i, is_rate = find_tracked_output(law, design)
    plants = [design.plant, *design.draw(draws)]
    responses = [_response(law, plant, design, rig, r) for plant in plants]
    measured = _output_of_run(recording, names[i], run, r.size)
    if design.outputs[i].turning and np.isfinite(measured).any():
        measured = measured - measured[np.isfinite(measured)][0]
    z, predicted = measured, np.array([y[:, i] for y, _ in responses])
    noise = _noise(law, names[i])
    if is_rate:
        z, predicted = _rate(z, Ts), np.array([_rate(y, Ts) for y in predicted])
        noise *= _rate_gain(Ts)
    return LoopComparison(
        law=law,
        source=recording.sha256,
        model_sha256=design.sha256,
        Ts=Ts,
        prelude=law.monitor.prelude if law.monitor else 0,
        t=np.asarray(Ts * np.arange(r.size), np.float64),
        r=r,
        z=z,
        predicted=predicted,
        u=u,
        predicted_u=np.array([voltage for _, voltage in responses]),
        noise=noise,
        limited_share=run.facts()["limited_share"],
        doubts=tuple(doubts),
    )


def model_path(law: ControlLaw) -> str:
    """Return the path of the model that a law was designed on.

    Raises InputError if the law names none.
    """
    files = law.design.get("files")
    name = files.get("model") if isinstance(files, dict) else None
    if not isinstance(name, str):
        raise InputError("the law does not name its model: give --model MODEL.json")
    return name


def _of_decisions(run: ControlRun) -> tuple[Vector, Vector]:
    """Return r and u of each sample from the first decision on; a skipped one holds the last."""
    at = run.k - run.k[0]
    newest = np.maximum.accumulate(np.bincount(at, np.arange(at.size), int(at[-1]) + 1))
    return run.r[newest.astype(int)], run.u[newest.astype(int)]


def _output_of_run(recording: Recording, name: str, run: ControlRun, N: int) -> Vector:
    """Return the output at the N samples from the first decision on; NaN where it is missing."""
    rows = int(run.k[0]) - recording.k_first + np.arange(N)
    inside = (rows >= 0) & (rows < recording.N)
    y = np.full(N, nan)
    y[inside] = recording.channel(name).y[rows[inside]]
    return y


def _noise(law: ControlLaw, name: str) -> float:
    """Return the deviation of an output's innovation in the law's monitor; NaN without one."""
    names = [output.name for output in law.outputs]
    return law.monitor.deviations[names.index(name)] if law.monitor and name in names else nan


def _rate(y: Vector, Ts: float) -> Vector:
    """Return the slope of a line through the samples around each one, in the unit of y per s."""
    half = RATE_SAMPLES // 2
    weights = np.arange(-half, half + 1) / (Ts * float(np.sum(np.arange(-half, half + 1) ** 2)))
    slope = np.full(y.size, nan)
    if y.size >= RATE_SAMPLES:
        slope[half : y.size - half] = np.correlate(y, weights, "valid")
    return slope


def _rate_gain(Ts: float) -> float:
    """Return the deviation of a rate by white noise of deviation 1."""
    half = RATE_SAMPLES // 2
    return float(1 / (Ts * np.sqrt(np.sum(np.arange(-half, half + 1) ** 2))))


def _response(
    law: ControlLaw, plant: Plant, design: DesignModel, rig: Description, r: Vector
) -> tuple[NDArray[np.float64], Vector]:
    """Return the outputs (N, ny) of a plant under the law from rest, and the voltage (N,)."""
    program, latch = law.program(rig), Latch(code_of(design.rest))
    first = int(plant.integrator)
    rest_v = design.rest - design.u0
    x = np.zeros(plant.order)
    x[first:] = np.linalg.solve(
        np.eye(plant.order - first) - plant.A[first:, first:], plant.B[first:] * rest_v
    )
    underway = [rest_v] * plant.delay
    channels = [[*rig.outputs].index(output.name) for output in design.outputs]
    values, reference = [nan] * len(rig.outputs), r.tolist()
    state = begin(program)
    y, u = np.zeros((r.size, len(channels))), np.zeros(r.size)
    for k in range(r.size):
        y[k] = plant.C @ x
        for channel, value in zip(channels, y[k].tolist(), strict=True):
            values[channel] = value
        state, command = decide(program, state, k, reference, latch)
        u[k] = volts_of(command.code)
        state = observe(program, state, k, values, reference, latch)
        underway.append(u[k] - design.u0)
        x = plant.A @ x + plant.B * underway.pop(0)
    return y, u
