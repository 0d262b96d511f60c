"""Faults that the monitor of a law stops, and false stops: law and plant alone, without real time.

`python -m tests.benchmarks.monitor_study [share]` prints a table. Each run has a plant whose
parameters differ from the model's, a converter of 10 bits, noise, and PWM of 8 bits. A share below
1 takes fewer runs. Seeds count from 1 in each row.
"""

from __future__ import annotations

import signal
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from time import process_time

import armrig
import numpy as np
from armrig_core.control.control_law import ControlLaw
from armrig_core.rig.arm import ArmParameters, arm_matrices, zero_order_hold
from armrig_core.rig.description import Description, builtin
from numpy.random import Generator

from tests.benchmarks import design_study
from tests.clients.control.plants import Fault, TruePlant, play

TANK = b"""
[rig]
name = "tank"
[input]
name = "pump"
[outputs.level]
unit = "cm"
per_count = 0.001
high = 60
"""
_SUBSTEPS = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """A law with its rig, and how plants and references are drawn."""

    law: ControlLaw
    described: Description
    plant: Callable[[Generator, float], TruePlant]
    """Plant with a friction in V."""
    reference: Callable[[Generator, int], list[float]]
    N: int
    turning: bool = False


def _arm(Ts: float = 0.01) -> Rig:
    fit = armrig.oe(
        design_study.record(1, 0.0),
        nb=[[4], [3]],
        nf=3,
        integrator="theta_1",
        shared="denominator",
    )

    def plant(rng: Generator, friction_v: float) -> TruePlant:
        p = ArmParameters()
        shares = {"J_1": 0.05, "J_2": 0.05, "K_lin": 0.05, "K_m": 0.03, "R_m": 0.03}
        changed = {n: getattr(p, n) * (1 + s * rng.standard_normal()) for n, s in shares.items()}
        p = replace(p, **changed)
        A, B, C = arm_matrices(p)
        loose = arm_matrices(replace(p, K_lin=0.05 * p.K_lin))[0]
        part = Ts / _SUBSTEPS if friction_v else Ts
        rows, broken = (np.hstack(zero_order_hold(M, B, part)) for M in (A, loose))
        return TruePlant(
            rows=tuple(map(tuple, rows.tolist())),
            outputs=tuple(map(tuple, C.tolist())),
            rest=(0.0, 0.0),
            noise=(design_study._NOISE,) * 2,
            friction_v=friction_v,
            fault_rows=tuple(map(tuple, broken.tolist())),
        )

    def reference(rng: Generator, N: int) -> list[float]:
        holds = np.repeat(rng.uniform(1.0, 8.0, N // 100 + 1), 100)[:N]
        return holds.tolist()

    return Rig(
        law=armrig.control.place(fit, design_study.POLES),
        described=builtin("arm"),
        plant=plant,
        reference=reference,
        N=3000,
        turning=True,
    )


def _lag(
    described: Description, output: str, constants: tuple[float, float, float], Ts: float, N: int
) -> Rig:
    """Return a rig of one lag with the constants gain, time constant and dead time."""
    o = described.outputs[output]
    step = abs(o.per_count) * 64
    # A thermometer is calmer than a step of its converter; a level has waves.
    noise, rest = (0.05, 23.0) if output == "T1" else (step, 2.0)
    gain, T, dead = constants
    a, d = float(np.exp(-Ts / T)), round(dead / Ts)
    fit = armrig.Fit.of_channel(
        B=[0.0] * (d + 1) + [gain * (1 - a)],
        F=[1, -a],
        nk=d + 1,
        Ts=Ts,
        input=described.input.name,
        output=output,
        input_unit="V",
        unit=o.unit,
        covariance=1e-12 * np.eye(2),
        noise_covariance=np.array([[noise**2]]),
    )
    model = replace(fit, covariance_robust=fit.covariance)

    def plant(rng: Generator, friction_v: float) -> TruePlant:
        g, t, late = (x * (1 + 0.05 * rng.standard_normal()) for x in constants)
        pole = float(np.exp(-Ts / t))
        return TruePlant(
            rows=((pole, g * (1 - pole)),),
            outputs=((1.0,),),
            rest=(rest,),
            noise=(noise,),
            delay=round(late / Ts),
        )

    def reference(rng: Generator, N: int) -> list[float]:
        begun = max(round(0.04 * N), 60)
        return [rest] * begun + [rest + 20.0] * (N - begun)

    return Rig(
        law=armrig.control.pid(model, time_constant=T / 4, rig=described, y0=rest, u0=0.0),
        described=described,
        plant=plant,
        reference=reference,
        N=N,
    )


def rigs() -> dict[str, Rig]:
    """Return the arm, the heater and the tank."""
    return {
        "arm": _arm(),
        "heater": _lag(builtin("heater"), "T1", (9.0, 175.0, 15.0), 1.0, 1500),
        "tank": _lag(Description.of(TANK), "level", (10.0, 20.0, 1.0), 0.1, 1200),
    }


FAULTS = {
    "arm": [
        ("stuck", 0), ("stuck", 1), ("railed", 0), ("railed", 1), ("reversed", 0), ("reversed", 1),
        ("loose", 0),
    ],
    "heater": [("stuck", 0), ("railed", 0), ("reversed", 0)],
    "tank": [("stuck", 0), ("railed", 0), ("reversed", 0)],
}  # fmt: skip


def fault_row(rig: Rig, kind: str, output: int, n: int) -> str:
    """Return the row of a fault in n runs."""
    Ts, gates, waits, beyond = rig.law.Ts_us / 1e6, Counter(), [], []
    for seed in range(1, n + 1):
        rng = np.random.default_rng(seed)
        plant = rig.plant(rng, 0.0)
        N = 800 if rig.turning else rig.N
        r = rig.reference(rng, N)
        # After the prelude the arm turns; a lag rises for a time constant after its step.
        first = 100 if rig.turning else next(k for k in range(N) if r[k] != r[0]) + N // 60
        at = int(rng.integers(first, first + (500 if rig.turning else N // 20)))
        run = play(rig.law, rig.described, plant, r, rng, Fault(kind, output, at))
        # The device latches rest with the next sample, and the fault began after the last one.
        wait = (len(run.y) - run.k_fault + 1) * Ts
        if run.by and wait <= Ts:
            gates[f"{run.by}, before the fault"] += 1
            continue
        gates[run.by or "not stopped"] += 1
        waits += [wait] if run.by else []
        height = max(r) - min(r)
        beyond.append(float((run.y[:, 0] - max(r)).max()) / height)
    allowed = 0.2 if Ts <= 0.01 else 10 * Ts + 0.1
    in_time = sum(wait <= allowed + 1e-9 for wait in waits)
    reach = f"true output beyond r by at most {100 * max(beyond):.0f} %, "
    reach += f"35 % or less in {sum(x <= 0.35 for x in beyond)}"
    names = ", ".join(f"{name} {count}" for name, count in gates.most_common())
    times = f"{np.median(waits):.3g}, at most {max(waits):.3g} s" if waits else "-"
    return (
        f"{len(waits)}/{n} stopped after {times}; within {allowed:.3g} s {in_time}"
        f"{'' if rig.turning else f'; {reach}'}: {names}"
    )


def calm_row(rig: Rig, friction_v: float, n: int, x0: tuple[float, ...] = ()) -> str:
    """Return the row of n runs without a fault, from rest or from the state x0."""
    gates: Counter[str] = Counter()
    for seed in range(1, n + 1):
        rng = np.random.default_rng(10_000 + seed)
        plant, r = replace(rig.plant(rng, friction_v), x0=x0), rig.reference(rng, rig.N)
        gates[play(rig.law, rig.described, plant, r, rng).by] += 1
    stops = n - gates.pop("", 0)
    names = ", ".join(f"{name} {count}" for name, count in gates.most_common())
    return f"{stops}/{n} false stops{': ' if names else ''}{names}"


def main() -> None:
    """Print a row for each fault, and for runs without one."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # in the background, too
    share = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
    chosen = sys.argv[2:]
    began = process_time()
    with suppress(KeyboardInterrupt):  # the rows so far are printed
        for name, rig in rigs().items():
            if chosen and name not in chosen:
                continue
            m = rig.law.monitor
            assert m is not None
            print(f"{name}: deviations {', '.join(f'{x:.3g}' for x in m.deviations)}", flush=True)
            for kind, output in FAULTS[name]:
                row = fault_row(rig, kind, output, round(200 * share))
                what = "arm" if kind == "loose" else [*rig.described.outputs][output]
                print(f"{name}, {what} {kind}: {row}", flush=True)
            print(f"{name}: {calm_row(rig, 0.0, round(500 * share))}", flush=True)
            if rig.turning:
                row = calm_row(rig, 0.12, round(100 * share))
                print(f"{name}, friction 0.12 V: {row}", flush=True)
            else:
                row = calm_row(rig, 0.0, round(50 * share), (10.0,))
                print(f"{name}, begun 10 above rest: {row}", flush=True)
            print(f"{name}: {process_time() - began:.0f} s of processor so far", flush=True)


if __name__ == "__main__":
    main()
