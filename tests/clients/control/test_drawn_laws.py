"""Laws for drawn rigs: each method holds r on the rig, and the law's monitor stays calm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import armrig
import numpy as np
import pytest
from armrig_core.commands.control_rehearsal import rehearse_control
from armrig_core.control.control_law import MAX_DELAY, ControlLaw
from armrig_core.errors import InputError
from armrig_core.rig.arm import zero_order_hold
from armrig_core.rig.description import Description
from armrig_core.rig.volts import CODES_PER_V
from numpy.random import Generator
from numpy.typing import NDArray

from tests.clients.control.plants import TruePlant, play
from tests.drawn_chains import drawn_chain
from tests.drawn_rigs import drawn_rig

N_DATA = 800
PWM_V = 5 / 256
STEP = 64
"""Counts of a step of the converter."""
METHODS: dict[str, Any] = {
    "pid with Ms": lambda model, tau, **more: armrig.control.pid(model, **more),
    "pid with lambda": lambda model, tau, **more: armrig.control.pid(
        model, time_constant=tau, **more
    ),
    "place": lambda model, tau, **more: armrig.control.place(
        model, [-(1.2 + 0.1 * i) / tau for i in range(model[model.outputs[0]].F.size - 1)], **more
    ),
    "lqg": lambda model, tau, **more: armrig.control.lqg(model, effort=2.0, **more),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnLoop:
    """A rig with its plant, a model from noisy data, and a reference that it can follow."""

    described: Description
    plant: TruePlant
    model: armrig.Fit
    Ts: float
    tau: float
    """Shortest time constant, in s."""
    u: float
    """Voltage at which the first output is at the end of the reference, in V."""
    reference: NDArray[np.float64]
    gain: float
    """Gain of the first output, in its unit per V."""


def _drawn_loop(rng: Generator) -> DrawnLoop:
    """Return a loop; draw again until a reference of 10 steps of the converter is allowed."""
    while True:
        if rng.random() < 0.6:
            rig = drawn_rig(rng)
            text, Ts, taus = rig.text(model=True), rig.Ts, rig.tau
        else:
            chain = drawn_chain(rng)
            chain = replace(chain, taus=chain.taus[:1], gains=chain.gains[:1], curve=0.0)
            text, taus = chain.text(), chain.taus
            Ts = round(float(np.clip(taus[0] / 10, 0.005, 1.0)), 6)
            if taus[0] < 4 * Ts:
                continue
        try:
            described = Description.of(text.encode())
        except InputError:
            continue
        voltages = _allowed(described)
        loop = _loop(described, Ts, taus, voltages, rng) if voltages else None
        if loop is not None:
            return loop


def _allowed(described: Description) -> tuple[float, float] | None:
    """Return the rest and the voltage farthest from it with all outputs inside."""
    rest, system = described.input.rest_v, described.system
    assert system is not None
    gains = -(np.array(system[2]) @ np.linalg.solve(np.array(system[0]), np.array(system[1])))[:, 0]
    best = rest
    for far in (0.0, described.input.u_max_v):
        for u in np.linspace(rest, far, 60):
            y = _rest(described) + 1.3 * gains * (u - rest)
            inside = [
                o.low < value < o.high
                and (u == rest or 0.02 < o.conversion.counts(value) / 65536 < 0.98)
                for o, value in zip(described.outputs.values(), y, strict=True)
            ]
            if not all(inside) and (u != rest):
                continue
            best = float(u) if abs(u - rest) > abs(best - rest) else best
    return (rest, best) if abs(best - rest) > 0.5 else None


def _rest(described: Description) -> NDArray[np.float64]:
    assert described.model is not None
    return np.array(described.model.offset or [0.0] * len(described.outputs))


def _loop(
    described: Description,
    Ts: float,
    taus: Sequence[float],
    voltages: tuple[float, float],
    rng: Generator,
) -> DrawnLoop | None:
    """Return the loop of a rig; None without a change of u, or if r or the dead time is no case.

    r is at least 10 steps of the converter, and the dead time at most that of a law.
    """
    system, rig_model = described.system, described.model
    assert system is not None
    assert rig_model is not None
    A, B, C = (np.array(M) for M in system[:3])
    Phi, Gamma = zero_order_hold(A, B, Ts)
    steps = [abs(o.per_count) * STEP for o in described.outputs.values()]
    plant = TruePlant(
        rows=tuple(map(tuple, np.hstack([Phi, Gamma]).tolist())),
        outputs=tuple(map(tuple, C.tolist())),
        rest=tuple(_rest(described).tolist()),
        noise=tuple(float(rng.choice([0.3, 1.0])) * step for step in steps),
        delay=round(rig_model.delay_s / Ts),
    )
    rest, far = voltages
    gains = -(C @ np.linalg.solve(A, B))[:, 0]
    if plant.delay > MAX_DELAY or abs(gains[0] * (far - rest)) < 10 * steps[0]:
        return None
    u = np.where(np.cumsum(rng.random(N_DATA) < 0.5 * Ts / max(taus)) % 2 == 0, rest, far)
    if np.ptp(u) == 0:
        return None
    x, y = np.zeros(len(A)), np.zeros((N_DATA, len(C)))
    for k in range(N_DATA):
        y[k] = C @ x
        x = Phi @ x + Gamma[:, 0] * (u[k - plant.delay] - rest if k >= plant.delay else 0.0)
    y += rng.standard_normal(y.shape) * plant.noise
    y = steps * np.round(y / steps)
    n, own = len(A), described.input
    data = armrig.Signals(
        u=own.per_volt * (u - rest),
        y=y,
        Ts=Ts,
        inputs=(own.name,),
        outputs=tuple(described.outputs),
        input_units=(own.unit,),
        units=tuple(o.unit for o in described.outputs.values()),
    )
    ny, nk = len(C), plant.delay + 1
    orders = {"nb": [[n]] * ny, "nk": [[nk]] * ny, "nf": n}
    model = armrig.oe(data, **orders, **({"shared": "denominator"} if ny > 1 else {}))
    target = rest + 0.6 * (far - rest)
    settle = max(round(0.5 / Ts), 50) + round(25 * max(taus) / Ts) + 4 * plant.delay
    reference = np.full(100 + settle, plant.rest[0])
    reference[100:] += gains[0] * (target - rest)
    return DrawnLoop(
        described=described, plant=plant, model=model, Ts=Ts, tau=min(taus), u=target,
        reference=reference,
        gain=float(gains[0]),
    )  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
def test_a_law_holds_r_on_a_drawn_rig_and_its_monitor_stays_calm(method: str) -> None:
    """Rest and limits are those of the description; 8 rigs from a fresh seed."""
    seed = int(np.random.default_rng().integers(1_000_000))
    for i in range(8):
        judge(method, seed, i)


def judge(method: str, seed: int, i: int) -> None:
    """Assert that a law of a method holds r on drawn rig i."""
    rng = np.random.default_rng([seed, i])
    loop = _drawn_loop(rng)
    rest_v, own = loop.described.input.rest_v, loop.described.input
    case = f"seed {seed}, case {i}, {method}: {loop.described.text.decode()}"
    law: ControlLaw = METHODS[method](
        loop.model, loop.tau, rig=loop.described, u0=rest_v, y0=loop.plant.rest
    )
    law.check_rig(loop.described, law.Ts_us, 0.0, 5.0)
    r = loop.reference.tolist()

    run = play(law, loop.described, loop.plant, r, rng)
    rehearse_control(law, r, loop.described)

    assert not run.by, f"{run.by} at {len(run.y)} of {len(r)}: {case}"
    step = abs(next(iter(loop.described.outputs.values())).per_count) * STEP
    height = abs(r[-1] - r[0])
    late = run.y[-len(r) // 6 :, 0]
    # Within a step of the PWM, the law knows the voltage that is latched, and stays.
    near = max(1.5 * step, 0.03 * height, 0.6 * abs(loop.gain) * PWM_V)
    assert abs(late.mean() - r[-1]) < near, f"{late.mean()}, {r[-1]}: {case}"
    assert run.codes.min() >= law.lo * CODES_PER_V - 1, case
    assert run.codes.max() <= min(law.hi, own.u_max_v) * CODES_PER_V + 1, case
    still = run.codes[:50] / CODES_PER_V  # r is the value at rest
    assert np.abs(still - rest_v).max() < 0.1 * abs(loop.u - rest_v) + 0.01, case
