"""Coverage of the bands that a design predicts: 300 identifications of the simulated arm.

Each identification has 30 s with noise, a converter of 10 bits, PWM of 8 bits, and the dead band
of θ1. `armrig.control.place` designs a law from each, with fixed poles. The bands of
`armrig.control.check_law` are compared with the law on the true arm.
`python -m tests.benchmarks.design_study [n] [friction]`: the friction, in V at the
motor, is in the data alone.
"""

from __future__ import annotations

import signal
import sys
from contextlib import suppress
from time import process_time

import armrig
import numpy as np
from armrig.control.law_check import _steps
from armrig.control.loop import LawMatrices, close_loop, margins
from armrig.control.plant import design_model
from armrig_core.rig.arm import arm_matrices, zero_order_hold

Ts, N, DRAWS, HEIGHT = 0.01, 3000, 200, 1.0
POLES = (-18 + 18j, -18 - 18j, -42)
_SUBSTEPS = 10
_STEP = 9.374327037078918e-5 * 64  # rad of a step of 10 bits
_NOISE = 0.5 * _STEP
_SCALE = np.radians(352)


def record(seed: int, friction_v: float) -> armrig.Signals:
    """Return a simulated recording of θ1, counted with its turns, and α."""
    rng = np.random.default_rng(seed)
    u = armrig.telegraph(N, 0.1, low=0.5, high=4.5, seed=seed)
    u = np.round(u * 51) / 51
    A, B, C = arm_matrices(armrig.physics.ArmParameters())
    substeps = _SUBSTEPS if friction_v else 1  # without friction, the held input is exact
    Phi, Gamma = zero_order_hold(A, B, Ts / substeps)
    x, y = np.zeros(4), np.zeros((N, 2))
    for k, volts in enumerate(u):
        y[k] = C @ x
        for _ in range(substeps):
            ahead = Phi @ x + Gamma[:, 0] * volts
            sign = np.sign(ahead[2] if x[2] == 0 else x[2])
            x = ahead - Gamma[:, 0] * sign * friction_v
            if friction_v and x[2] * sign < 0:  # the motor stops
                x[2] = 0.0
    wrapped = np.mod(y[:, 0] + rng.uniform(0, 2 * np.pi), 2 * np.pi)
    measured = y + _NOISE * rng.standard_normal(y.shape)
    measured = _STEP * np.round(measured / _STEP)
    measured[wrapped > _SCALE, 0] = np.nan
    names = {"outputs": ("theta_1", "alpha"), "units": ("rad", "rad"), "input_units": ("V",)}
    return armrig.Signals(u=u, y=measured, Ts=Ts, **names)


def main() -> None:
    """Print the shares of true values in their bands, and the median widths."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # in the background, too
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    friction_v = float(sys.argv[2]) if len(sys.argv) > 2 else 0.0
    true = design_model(armrig.physics.arm(armrig.physics.ArmParameters()), Ts=Ts)
    names = ("Ms", "phase_deg", "overshoot", "settling")
    inside, widths = {x: [] for x in names}, {x: [] for x in names}
    unstable = promised = refused = 0
    worst = []
    begun = process_time()
    with suppress(KeyboardInterrupt):  # the results so far are printed
        for seed in range(1, n + 1):
            data = record(seed, friction_v)
            fit = armrig.oe(data, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
            try:
                law = armrig.control.place(fit, POLES)
            except armrig.InputError:
                refused += 1
                continue
            check = armrig.control.check_law(law, fit, draws=DRAWS, height=HEIGHT)
            matrices = LawMatrices.of(law, ["theta_1", "alpha"])
            m = margins(matrices, true.plant, Ts)
            steps = _steps(law, true, close_loop(matrices, [true.plant]), HEIGHT)
            values = {"Ms": m.Ms, "phase_deg": m.phase_deg}
            values |= {"overshoot": steps.overshoot()[0], "settling": steps.settling()[0]}
            for name in names:
                low, high = check.band(name)
                room = Ts * (1 + 1e-9) if name == "settling" else 0.0
                inside[name].append(low - room <= values[name] <= high + room)
                widths[name].append(high - low)
            worst.append(check.worst_Ms)
            promised += check.worst_Ms <= 2
            unstable += check.worst_Ms <= 2 and not m.stable
    count = len(worst)
    for name in names:
        share = 100 * np.mean(inside[name])
        print(
            f"{name:10} in its band in {share:5.1f} %; median width {np.median(widths[name]):.3g}"
        )
    seconds = process_time() - begun
    print(
        f"n = {count}, seeds 1 to {count + refused}, {refused} refused, friction {friction_v:g} V"
    )
    print(f"the first number: median {np.median(worst):.3f}, at most 2 in {promised}, of which")
    print(f"{unstable} unstable on the true arm; {seconds:.0f} s of processor")


if __name__ == "__main__":
    main()
