"""Margins and steps of a law: on the model, on draws of its covariance, and on corners."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
from armrig_core.control.control_law import ControlLaw
from armrig_core.errors import InputError
from armrig_core.process.calls import with_argument_checks
from armrig_core.rig.description import Description

from armrig.control.loop import (
    ClosedLoop,
    LawMatrices,
    Margins,
    are_stable,
    close_loop,
    count_hidden_modes,
    find_tracked_output,
    frequency_grid,
    loop_response,
    margins,
    margins_of_draws,
    simulate,
)
from armrig.control.plant import (
    DesignModel,
    Plant,
    PlantModel,
    Validation,
    design_model,
    doubts_about,
)
from armrig.control.requirement import requirement_of
from armrig.models.state_space import Complex, Matrix, Vector
from armrig.numerics.quantities import digits, plural
from armrig.plots.layout import plot_method

DRAWS = 500
GAIN_SHARE = 0.2
"""Change of the gain in a corner."""
ENOUGH = 2.0
"""Ms above which a law has too little room for errors of the model."""
_BAND = (2.5, 97.5)
_SETTLED = 0.05
"""Share of the step within which the output has settled."""
_MOST_SAMPLES = 4000
_PASSED = 6.0
"""Length of a predicted step, in time constants of the slowest mode that matters."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LawStepResponse:
    """Response to a step of r from rest, without limits of the input."""

    t: Vector
    """Time, in s, (N,)."""
    z: Matrix
    """Variable that follows r, in its unit, of the model and then of each draw, (1 + m, N)."""
    u: Matrix
    """Change of the voltage, in V, (1 + m, N)."""
    height: float
    """Height of the step of r."""

    def overshoot(self) -> Vector:
        """Return how far z passes r, in percent of the step, (1 + m,).

        Examples
        --------
        >>> arm = armrig.physics.arm(armrig.physics.ArmParameters())
        >>> law = armrig.control.place(arm, [-18+18j, -18-18j, -42], rate=True, Ts=0.01)
        >>> armrig.control.check_law(law, arm).steps.overshoot().round(1)
        array([...])
        """
        return np.asarray(np.maximum(self.z.max(axis=1) / self.height - 1, 0.0) * 100)

    def settling(self) -> Vector:
        """Return the time after which z stays within 5 % of the step, in s, (1 + m,).

        It is infinite if z does not settle within the response.

        Examples
        --------
        >>> arm = armrig.physics.arm(armrig.physics.ArmParameters())
        >>> law = armrig.control.place(arm, [-18+18j, -18-18j, -42], rate=True, Ts=0.01)
        >>> armrig.control.check_law(law, arm).steps.settling().round(2)
        array([0.22])
        """
        outside = np.abs(self.z / self.height - 1) > _SETTLED
        last = outside.shape[1] - outside[:, ::-1].argmax(axis=1)
        last = np.where(outside.any(axis=1), last, 0)
        late = last >= outside.shape[1]
        return np.asarray(np.where(late, inf, self.t[np.minimum(last, self.t.size - 1)]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class LawCheck:
    """Margins and steps of a law with their uncertainty."""

    law: ControlLaw
    nominal: Margins
    """Margins on the model itself."""
    draws: Mapping[str, Vector]
    """Ms, gain, phase_deg, delay_s and stable of each draw, (m,)."""
    corners: Mapping[str, Margins]
    """Margins on changed models, by name: the gain 20 % lower and higher, one more sample of
    delay."""
    steps: LawStepResponse
    omega: Vector
    """Frequencies, in rad/s, (nf,)."""
    L: Complex
    """Response of the open loop, of the model and then of each draw, (1 + m, nf)."""
    root_locus: tuple[Vector, Complex]
    """Factors of the gain, and the poles of the closed loop at each factor."""
    Ts: float
    unit: str
    """Unit of r."""
    doubts: tuple[str, ...]

    @property
    def unstable_share(self) -> float:
        """Share of the draws whose loop is unstable; 0 without draws."""
        stable = self.draws["stable"]
        return float(1 - np.mean(stable)) if stable.size else 0.0

    @property
    def worst_Ms(self) -> float:
        """Worst of the 97.5 % quantile of Ms over the draws, the corners and the model itself."""
        Ms = self.draws["Ms"]
        quantile = float(np.quantile(Ms, 0.975, method="higher")) if Ms.size else 0.0
        return max(quantile, self.nominal.Ms, *(m.Ms for m in self.corners.values()))

    def band(self, name: str) -> tuple[float, float]:
        """Return the 95 % band over the draws; without draws, the value of the model twice.

        Parameters
        ----------
        name : str
            "Ms", "gain", "phase_deg", "delay_s", "overshoot" in percent, or "settling" in s.

        Examples
        --------
        >>> arm = armrig.physics.arm(armrig.physics.ArmParameters())
        >>> law = armrig.control.place(arm, [-18+18j, -18-18j, -42], rate=True, Ts=0.01)
        >>> low, high = armrig.control.check_law(law, arm).band("phase_deg")
        >>> round(low), round(high)
        (81, 81)
        """
        if name in ("overshoot", "settling"):
            values = getattr(self.steps, name)()
            values = values[1:] if values.size > 1 else values
        else:
            values = self.draws[name]
            values = values if values.size else np.array([getattr(self.nominal, name)])
        low, high = np.quantile(values, np.array(_BAND) / 100, method="nearest")
        return float(low), float(high)

    @property
    def latest(self) -> dict[str, float]:
        """Upper end of the band of overshoot and settling, by name."""
        return {name: self.band(name)[1] for name in ("overshoot", "settling")}

    @property
    def verdict(self) -> str:
        """Two lines, a line of doubts before them if there are any, and the requirement."""
        worst = (
            {"the draws": float(np.quantile(self.draws["Ms"], 0.975, method="higher"))}
            if len(self.draws["Ms"])
            else {"the model": self.nominal.Ms}
        )
        worst |= {f"the corner '{name}'": m.Ms for name, m in self.corners.items()}
        where = max(worst, key=lambda name: worst[name])
        n = len(self.draws["Ms"])
        share = (
            f"{digits(100 * self.unstable_share, 2)} % of {plural(n, 'draw')} unstable"
            if n
            else "no draws"
        )
        size = f"{self.worst_Ms:.2f}" if np.isfinite(self.worst_Ms) else "infinite: unstable"
        judged = "" if self.worst_Ms <= ENOUGH else f"; above {ENOUGH:g}, ask for a slower loop"
        lines = [f"Ms at most {size} (worst: {where}), {share}{judged}."]
        phase, gain = _range(self.band("phase_deg"), 0), _range(self.band("gain"), 1)
        delay, settling = _time(self.band("delay_s")), _time(self.band("settling"))
        overshoot = _range(self.band("overshoot"), 0)
        lines.append(
            f"Phase margin {phase}°, gain margin {gain}, delay margin {delay}; overshoot "
            f"{overshoot} %, 5 % settling {settling}."
        )
        if requirement := requirement_of(self.law.design):
            lines.append(requirement.sentence(self.latest, "The step on the model"))
        if self.doubts:
            lines.insert(0, f"In doubt: {'; '.join(self.doubts)}.")
        return "\n".join(lines)

    def __repr__(self) -> str:
        """Return the verdict and a table of the corners."""
        rows = {"model": self.nominal} | dict(self.corners)
        table = [
            f"  {name:24} {m.Ms:6.3f} {m.gain:7.2f} {m.phase_deg:7.1f} {m.delay_s:9.4g}"
            for name, m in rows.items()
        ]
        head = f"  {'':24} {'Ms':>6} {'gain':>7} {'phase/°':>7} {'delay/s':>9}"
        return "\n".join([self.verdict, head, *table])

    plot = plot_method("plot_law_steps", "a step of r with bands over the draws")


def _range(band: Sequence[float], places: int) -> str:
    """Return a band as text; one number if both ends are equal to the digits shown."""
    low, high = (f"{x:.{places}f}" if np.isfinite(x) else "infinite" for x in band)
    return low if low == high else f"{low} to {high}"


def _time(band: Sequence[float]) -> str:
    """Return a band of times in ms or s."""
    finite = [x for x in band if np.isfinite(x)]
    if max(finite, default=0.0) < 1:
        return f"{_range([1e3 * x for x in band], 0)} ms"
    return f"{_range(band, 2 if max(finite) < 10 else 0)} s"


@with_argument_checks
def check_law(
    law: ControlLaw,
    model: PlantModel,
    *,
    draws: int = DRAWS,
    height: float | None = None,
    rig: Description | None = None,
    u0: float | None = None,
    y0: float | Sequence[float] = 0.0,
    validation: Validation | None = None,
) -> LawCheck:
    """Return what a law will do: margins, steps and their bands over draws of the model.

    The corners are the model with a gain 20 % lower and higher, and with one more sample of delay.
    A covariance does not know such errors; friction is one of them.

    Parameters
    ----------
    law : ControlLaw
        Law of `armrig.control.pid`, `armrig.control.place`, `armrig.control.lqg` or a file.
    model : Fit, GreyFit or python-control system
        Model that the law is judged on. If the law was designed on another one, this is a doubt.
    draws : int
        Number of draws of the parameters.
    height : float, optional
        Height of the step of r; a tenth of the range of r by default.
    rig, u0, y0, validation
        As in `armrig.control.place`.

    Raises
    ------
    InputError
        The model has other outputs or another sampling time than the law.

    Examples
    --------
    >>> arm = armrig.physics.arm(armrig.physics.ArmParameters())
    >>> law = armrig.control.place(arm, [-18+18j, -18-18j, -42], rate=True, Ts=0.01)
    >>> check = armrig.control.check_law(law, arm)
    >>> round(check.nominal.Ms, 2), round(check.worst_Ms, 2)
    (1.34, 1.47)
    """
    Ts = law.Ts_us / 1e6
    dt = getattr(model, "Ts", getattr(model, "dt", None)) or Ts
    if abs(dt - Ts) > 1e-9 and not isinstance(dt, bool):
        raise InputError(
            f"the law has Ts = {Ts:g} s, and the model {dt:g} s: give the model that the law was "
            "designed on"
        )
    design = design_model(
        model,
        rig=rig,
        Ts=Ts,
        u0=u0,
        y0=y0,
        validation=validation,
    )
    if law.input != design.input:
        raise InputError(f"the law drives {law.input}, and the model's input is {design.input}")
    matrices = LawMatrices.of(law, [o.name for o in design.outputs])
    doubts = doubts_about(law.design, design, validation)
    if law.monitor is None:
        doubts += ("the law has no monitor: it runs only with unmonitored=True (--unmonitored)",)
    elif design.rig and (doubt := law.monitor_doubt(design.rig)):
        doubts += (f"{doubt}: it runs only with unmonitored=True (--unmonitored)",)
    plants = [p for p in design.draw(draws) if np.isfinite(p.A).all() and np.isfinite(p.B).all()]
    omega = frequency_grid(matrices, design.plant, Ts)
    hidden = count_hidden_modes(close_loop(matrices, [design.plant]))
    kinds = {
        f"gain {-100 * GAIN_SHARE:.0f} %": design.plant.rescale(1 - GAIN_SHARE),
        f"gain +{100 * GAIN_SHARE:.0f} %": design.plant.rescale(1 + GAIN_SHARE),
        "one more sample of delay": design.plant.rescale(delay=1),
    }
    every = [design.plant, *plants]
    L = loop_response(matrices, every, np.exp(1j * omega * Ts))
    loops = close_loop(matrices, every)
    stable = are_stable(loops, hidden)
    return LawCheck(
        law=law,
        nominal=margins(matrices, design.plant, Ts),
        draws=margins_of_draws(L[1:], stable[1:], omega),
        corners={name: margins(matrices, plant, Ts) for name, plant in kinds.items()},
        steps=_steps(law, design, loops, height),
        omega=omega,
        L=L,
        root_locus=_root_locus(matrices, design.plant),
        Ts=Ts,
        unit=law.reference.unit,
        doubts=tuple(doubts),
    )


def _steps(
    law: ControlLaw,
    design: DesignModel,
    loops: ClosedLoop,
    height: float | None,
) -> LawStepResponse:
    """Return the responses of the model and the draws to a step of r."""
    sizes = np.abs(np.linalg.eigvals(loops.M[0]))
    slowest = float(sizes[sizes < 1 - 1e-7].max(initial=0.5))
    N = int(np.clip(_PASSED / -np.log(slowest), 20, _MOST_SAMPLES)) + design.plant.delay + 1
    r = law.reference
    height = height or 0.1 * (r.high - r.low) or 1.0
    y, u = simulate(loops, np.full(N + 1, height))
    i, is_rate = find_tracked_output(law, design)
    z = np.diff(y[..., i], axis=1) / design.Ts if is_rate else y[:, :-1, i]
    if is_rate:  # that of the sample before k
        z = np.hstack([np.zeros((len(z), 1)), z[:, :-1]])
    return LawStepResponse(t=np.asarray(design.Ts * np.arange(N)), z=z, u=u[:, :N], height=height)


def _root_locus(law: LawMatrices, plant: Plant) -> tuple[Vector, Complex]:
    """Return factors of the plant's gain, and the poles of the closed loop at each of them."""
    factors = np.unique(np.append(np.geomspace(0.02, 50, 300), 1.0))
    loops = close_loop(law, [plant.rescale(float(k)) for k in factors])
    return factors, loops.poles
