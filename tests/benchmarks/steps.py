"""Coverage of the intervals of `step_analysis`, on many plants.

The emulated rig's potentiometer has 10 bits over 352°, half a step of noise, and a dead band of 8°.
The step is of 1 to 4 V, up or down, from any angle. It is sampled every 2, 5, 10 or 20 ms, for 1 to
4 s after the step. Half of the plants are the handout's arm, three in ten have another J_1 and
K_lin, and two in ten are the chassis alone. Half of the steps have a dead time, of up to 50 ms.
`python -m tests.benchmarks.steps [--n 1000] [--seed 1]`.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import armrig
import numpy as np
from armrig_core.arm import ArmParameters, arm_matrices, chassis_matrices, zero_order_hold
from numpy.typing import NDArray

Vector = NDArray[np.float64]
TURN, TRACK = 2 * np.pi, np.deg2rad(352.0)
LSB = TRACK / 1024
HOLD_S = 1.0  # before the step
FINE_S = 1e-4  # the grid of the exact response


@dataclass(frozen=True, kw_only=True)
class Case:
    """A recorded step and the times of its exact answer."""

    data: armrig.Dataset
    kind: str
    tau: float
    dead_time: float
    settling: float


def responses(p: ArmParameters, *, alone: bool) -> tuple[Vector, Vector]:
    """Return angle and rate after a unit step from rest, every FINE_S."""
    A, G, _ = chassis_matrices(p) if alone else arm_matrices(p)
    Phi, Gamma = zero_order_hold(A, G, FINE_S)
    x, done = np.zeros((1, A.shape[0])), round(6.0 / FINE_S)
    later, reached = Phi, Gamma[:, 0]  # after as many steps as x has rows
    while len(x) < done:
        x = np.vstack([x, x @ later.T + reached])
        later, reached = later @ later, later @ reached + reached
    angle, rate = x[:done, 0], x[:done, A.shape[0] // 2]
    return angle, rate


def drawn(rng: np.random.Generator) -> Case:
    """Return one case."""
    kind = str(rng.choice(["arm", "other arm", "chassis"], p=[0.5, 0.3, 0.2]))
    p = ArmParameters()
    if kind != "arm":
        J_1 = p.J_1 * 2 ** rng.uniform(-1, 1.5)
        p = ArmParameters(J_1=J_1, K_lin=p.K_lin * 2 ** rng.uniform(-1, 1))
    angle, rate = responses(p, alone=kind == "chassis")
    y = rate / rate[-1]
    dead = float(rng.uniform(0.0, 0.05)) if rng.random() < 0.5 else 0.0
    Ts = float(rng.choice([0.002, 0.005, 0.01, 0.02]))
    low, size = 0.5, float(rng.uniform(1, 4))
    down, after = bool(rng.random() < 0.5), float(rng.uniform(1, 4))
    before, N = round(HOLD_S / Ts), round((HOLD_S + after) / Ts)
    high = low + size
    u = np.where(np.arange(N) < before, *((high, low) if down else (low, high)))
    t = Ts * (np.arange(N) - before)
    fine = FINE_S * np.arange(angle.size)
    moved = u[0] * rate[-1] * t
    moved += (u[-1] - u[0]) * np.interp(t - dead, fine, angle, left=0.0)
    turn, rest = np.divmod(moved + rng.uniform(0, TURN), TURN)
    hidden = rest >= TRACK
    hidden[1:] |= hidden[:-1].copy()  # the sample after the dead band is averaged with it
    shown = LSB * np.round((rest + 0.5 * LSB * rng.standard_normal(N)) / LSB) + TURN * turn
    return Case(
        data=armrig.Dataset(u=u, y=shown, Ts=Ts, valid=~hidden, output="theta_1", unit="rad"),
        kind=kind,
        tau=FINE_S * float(np.argmax(y >= 1 - np.exp(-1))),
        dead_time=dead,
        settling=dead + FINE_S * float(np.flatnonzero(np.abs(y - 1) > 0.05)[-1]),
    )


def share(held: NDArray[np.bool_]) -> str:
    """Return a share in per cent with its number."""
    return f"{100 * np.mean(held):5.1f} % of {held.size}" if held.size else "none"


def main() -> None:
    """Print coverage, bias and width by kind."""
    asked = argparse.ArgumentParser()
    asked.add_argument("--n", type=int, default=1000)
    asked.add_argument("--seed", type=int, default=1)
    given = asked.parse_args()
    rows, kinds, refused = [], [], 0
    for i in range(given.n):
        case = drawn(np.random.default_rng([given.seed, i]))
        try:
            found = armrig.step_analysis(case.data)
        except ValueError:
            refused += 1
            continue
        low, high = found.dead_time_interval
        # Code without a deviation of the settling time is asked for its point alone.
        std = getattr(found, "settling_std", 0.0)
        kinds.append(case.kind)
        rows.append(
            (
                abs(found.tau - case.tau) <= 2 * found.tau_std,
                low <= case.dead_time <= high,
                abs(found.settling - case.settling) <= 2 * std,
                found.tau / case.tau - 1,
                found.settling / case.settling - 1,
                case.dead_time,
                found.dead_time,
                found.tau_std / case.tau,
                std / case.settling,
                case.data.Ts,
                high - low,
            )
        )
    r, kind = np.array(rows), np.array(kinds)
    print(f"{len(r)} steps of seed {given.seed}, {refused} refused; 95 % intervals contain:")
    groups = [("all", np.ones(len(r), bool))]
    groups += [(k, kind == k) for k in ("arm", "other arm", "chassis")]
    groups += [(f"Ts {1e3 * Ts:g} ms", r[:, 9] == Ts) for Ts in np.unique(r[:, 9])]
    dead = r[:, 5] > 0
    for name, of in [*groups, ("no dead time", ~dead), ("dead time", dead)]:
        some = r[of]
        print(
            f"  {name:13} 63 % time {share(some[:, 0] > 0)}, dead time "
            f"{100 * np.mean(some[:, 1]):5.1f} %, settling {100 * np.mean(some[:, 2]):5.1f} %; "
            f"63 % time off by {100 * np.median(np.abs(some[:, 3])):.1f} % (median), "
            f"{100 * np.mean(np.abs(some[:, 3]) > 0.3):.1f} % by over 30 %, deviation "
            f"{100 * np.median(some[:, 7]):.1f} %; settling off by "
            f"{100 * np.median(np.abs(some[:, 4])):.1f} %, "
            f"{100 * np.mean(np.abs(some[:, 4]) > 0.1):.1f} % by over 10 %, deviation "
            f"{100 * np.median(some[:, 8]):.1f} %; dead time's interval "
            f"{1e3 * np.median(some[:, 10]):.1f} ms"
        )
    print(f"  claimed without a dead time: {share(r[~dead, 6] > 0)}")
    for a, b in ((0, 5), (5, 10), (10, 20), (20, 30), (30, 50)):
        of = (r[:, 5] > a / 1e3) & (r[:, 5] <= b / 1e3)
        print(f"  claimed of {a} to {b} ms: {share(r[of, 6] > 0)}", flush=True)


if __name__ == "__main__":
    main()
