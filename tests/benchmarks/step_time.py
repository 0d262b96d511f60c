"""Coverage of the intervals of `step_analysis`, for any position of the dead band.

The handout's arm turns at 0.5 V and steps to 4.5 V; its potentiometer has 10 bits over 352°, noise,
and a dead band of 8°. Banks of 300 positions: anywhere on the turn, and such that the dead band
begins up to 60 ms after the step's edge. An argument is the seed.
"""

from __future__ import annotations

import sys

import armrig
import numpy as np
from armrig_core.arm import ArmParameters, arm_matrices, zero_order_hold
from numpy.typing import NDArray

Vector = NDArray[np.float64]
RUNS = 300
TURN, TRACK = 2 * np.pi, np.deg2rad(352.0)
LOW, HIGH, AT_S, LENGTH_S = 0.5, 4.5, 1.0, 5.0
REACHED_S = 0.06  # longest way from the edge to the dead band in the second kind of bank


def states(Ts: float, u: Vector) -> Vector:
    """Return theta_1 (N,) and its rate (N,) of the arm, from rest, (2, N)."""
    A, G, _ = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, G, Ts)
    x, rows = np.zeros((4, 1)), []
    for value in u:
        rows.append((x[0, 0], x[2, 0]))
        x = Phi @ x + Gamma * value
    return np.array(rows).T


def true_time() -> float:
    """Return the time at which the arm's rate reaches 63 % of its final value, in s."""
    Ts = 1e-5
    rate = states(Ts, np.ones(200_000))[1]
    return Ts * float(np.argmax(rate >= (1 - np.exp(-1)) * rate[-1]))


def bank(Ts: float, noise: float, rng: np.random.Generator, *, near: bool) -> list[armrig.Dataset]:
    """Return the readings of the step from 300 positions."""
    at, N = round(AT_S / Ts), round(LENGTH_S / Ts)
    u = np.where(np.arange(N) < at, LOW, HIGH)
    angle = states(Ts, u)[0]
    reach = float(np.interp(REACHED_S, Ts * np.arange(N - at), angle[at:] - angle[at]))
    lsb, found = TRACK / 1024, []
    for _ in range(RUNS):
        # The dead band begins at TRACK.
        start = rng.uniform(TRACK - reach, TRACK) if near else rng.uniform(0, TURN)
        turn, rest = np.divmod(angle - angle[at] + start, TURN)
        dead = rest >= TRACK
        dead[1:] |= dead[:-1].copy()
        y = lsb * np.round((rest + noise * rng.standard_normal(N)) / lsb) + TURN * turn
        found.append(armrig.Dataset(u=u, y=y, Ts=Ts, valid=~dead, output="theta_1", unit="rad"))
    return found


def main() -> None:
    """Print a line for each bank."""
    rng = np.random.default_rng(int(sys.argv[1]) if len(sys.argv) > 1 else 1)
    truth, equivalent = true_time(), armrig.characteristics().equivalent_time
    print(
        f"63 % time of the arm {1e3 * truth:.2f} ms, equivalent time {1e3 * equivalent:.2f} ms; "
        f"{RUNS} steps in each bank"
    )
    for Ts in (0.001, 0.002, 0.005):
        for noise in (0.5e-3, 4e-3, 8e-3):
            for near in (False, True):
                found = [armrig.step_analysis(d) for d in bank(Ts, noise, rng, near=near)]
                error = np.array([f.tau for f in found]) - truth
                std = np.array([f.tau_std for f in found])
                held = 100 * np.mean(np.abs(error) <= 3 * std)
                lag = np.array([f.equivalent_time for f in found]) - equivalent
                lag_std = np.array([f.equivalent_time_std for f in found])
                of_lag = 100 * np.mean(np.abs(lag) <= 3 * lag_std)
                where = "near the dead band" if near else "anywhere"
                print(
                    f"  Ts {1e3 * Ts:g} ms, noise {1e3 * noise:g} mrad, {where:18}: 3 sigma holds "
                    f"{held:5.1f} %, mean error {1e3 * error.mean():+.2f} ms, worst "
                    f"{1e3 * np.abs(error).max():.1f} ms, median deviation "
                    f"{1e3 * np.median(std):.2f} ms, told {sum(bool(f.warnings) for f in found)}; "
                    f"equivalent {of_lag:5.1f} %, median error {1e3 * np.median(np.abs(lag)):.2f} "
                    f"ms, median deviation {1e3 * np.median(lag_std):.2f} ms",
                    flush=True,
                )


if __name__ == "__main__":
    main()
