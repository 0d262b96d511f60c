"""Monte Carlo of the grey box: J_1, its standard deviation, and the split study.

Data as the emulator's recordings without the rotating part: 30 s at 1 kHz, telegraph, 10-bit
potentiometer with its dead band. `python -m tests.benchmarks.greybox [runs]`, 400 by default.
"""

from __future__ import annotations

import sys
from math import tau
from time import perf_counter

import armrig
import numpy as np
from armrig.physics.grey_box.response import linear_parts
from armrig.physics.grey_box.sampled_model import Physics
from armrig.physics.systems import ArmParameters, chassis
from armrig.recordings.channels import outside_dead_band, unwrap
from armrig_daemon.emulator import plant
from numpy.typing import NDArray

Vector = NDArray[np.float64]
N, Ts = 30_000, 1e-3
TRUTH = ArmParameters()
RANGE, STEPS = np.deg2rad(352.0), 1024
LSB = RANGE / STEPS


def angle(u: Vector) -> Vector:
    """Return theta_1 in rad without friction, exactly."""
    model = Physics(model=chassis, fixed=TRUTH, output="theta_1").sampled({}, (), Ts)
    return linear_parts(model, u)[0]


def angle_with_friction(u: Vector, p: ArmParameters, coulomb_nm: float) -> Vector:
    """Return theta_1 in rad from the emulator's plant."""
    built = plant.build(p, arm_removed=True, coulomb_nm=coulomb_nm)
    x, y = plant.REST, np.empty(u.size)
    for k, volts in enumerate(u.tolist()):
        y[k] = x[0]
        x = plant.advance(built, x, volts, round(Ts * 1e9))
    return y


def read(theta_1: Vector, noise_lsb: float, rng: np.random.Generator, u: Vector) -> armrig.Dataset:
    """Return the reading of a recording: 10 bits, noise, missing dead band, unwrapped."""
    turned = (theta_1 + rng.uniform(0, tau)) % tau
    fraction = turned / RANGE
    noisy = fraction + noise_lsb / STEPS * rng.standard_normal(u.size)
    counts = np.clip(np.floor(noisy * STEPS + 0.5), 0, STEPS - 1)
    counts[fraction > 1] = 0
    valid = outside_dead_band((counts == 0) | (counts == STEPS - 1))
    y = unwrap(counts * LSB, valid)
    return armrig.Dataset(u=u, y=y, Ts=Ts, valid=valid, output="theta_1", unit="rad")


def recorded(seed: int, noise_lsb: float) -> armrig.Dataset:
    """Return one recording without friction; input, angle and noise are the seed's."""
    rng = np.random.default_rng([seed, 7])
    u = armrig.telegraph(N, 0.01, 0.5, 4.5, seed=rng)
    return read(angle(u), noise_lsb, rng, u)


def tell(name: str, z: Vector, extra: str = "") -> None:
    """Print how normalised errors are spread."""
    inside = int(np.count_nonzero(np.abs(z) <= 3))
    print(
        f"{name}: n {z.size}, within 3 sd {inside}, mean {z.mean():+.3f} sd, sd ratio "
        f"{z.std(ddof=1):.3f}, 95 % interval covers {np.mean(np.abs(z) < 1.96):.3f}{extra}",
        flush=True,
    )


def trust(runs: int, noise_lsb: float) -> None:
    """Print errors over reported standard deviations, of both estimators."""
    z, robust, other, p_values, warned, seconds, share = [], [], [], [], 0, [], []
    for seed in range(runs):
        data = recorded(seed, noise_lsb)
        begin = perf_counter()
        fit = armrig.greybox(data)
        seconds.append(perf_counter() - begin)
        error = fit.values["J_1"] - TRUTH.J_1
        z.append(error / fit.std["J_1"])
        robust.append(error / fit.std_robust["J_1"])
        share.append(fit.std["J_1"] / TRUTH.J_1)
        warned += any("conservative" in w for w in fit.warnings)
        second = armrig.inverse_dynamics(data)
        other.append((second.values["J_1"] - TRUTH.J_1) / second.std["J_1"])
        p_values.append(armrig.agreement(fit, second)[0].p_value)
    print(f"noise {noise_lsb:.3f} LSB, J_1 sd {100 * np.mean(share):.4f} %, warned {warned}")
    tell("  output error", np.array(z), f", median {np.median(seconds):.2f} s a fit")
    tell("  output error, robust sd", np.array(robust))
    tell("  inverse dynamics", np.array(other))
    print(f"  the two disagree at 5 %: {np.mean(np.array(p_values) < 0.05):.3f}", flush=True)


def friction(runs: int) -> None:
    """Print what neglecting the friction costs, and what estimating it gives."""
    p, coulomb_nm = ArmParameters(b_1=5e-3), 0.02
    for low, high in ((0.5, 4.5), (0.0, 5.0)):
        errors: dict[str, list[float]] = {}
        z: dict[str, list[float]] = {}
        for seed in range(runs):
            rng = np.random.default_rng([seed, 8])
            u = armrig.telegraph(N, 0.01, low, high, seed=rng)
            data = read(angle_with_friction(u, p, coulomb_nm), 0.5, rng, u)
            for option in (None, "viscous", "both"):
                fit = armrig.greybox(data, friction=option)
                error = fit.values["J_1"] - TRUTH.J_1
                errors.setdefault(str(option), []).append(100 * error / TRUTH.J_1)
                z.setdefault(str(option), []).append(error / fit.std["J_1"])
        print(f"friction b_1 {p.b_1} Nms/rad, T_c {coulomb_nm} Nm, input {low}/{high} V:")
        for option, values in errors.items():
            worst = np.abs(z[option]).max()
            print(
                f"  friction={option}: J_1 off by {np.mean(values):+.3f} % "
                f"(sd {np.std(values, ddof=1):.3f} %), n {runs}, worst {worst:.1f} reported sd",
                flush=True,
            )


def splits(runs: int) -> None:
    """Print sd sqrt(N) for 1, 2 and 4 parts, and how often parts are called different."""
    scaled, different, exponents = [], [], []
    for seed in range(runs):
        study = armrig.split_study(recorded(seed, 0.5), (1, 2, 4))
        scaled.append([s.scaled_std for s in study.splits])
        different.append([s.p_value < 0.05 for s in study.splits[1:]])
        exponents.append(study.exponent)
    mean = np.mean(scaled, axis=0)
    print(f"split study, n {runs}: mean sd sqrt(N) for 1, 2, 4 parts {mean}")
    print(f"  over the whole's {mean / mean[0]}, exponent {np.mean(exponents):+.4f}")
    print(f"  2 and 4 parts differ at 5 %: {np.mean(different, axis=0)}", flush=True)


def main() -> None:
    """Print all of it."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 400
    trust(runs, 0.5)
    trust(runs, 1 / 3)
    for noise in (0.2, 0.1, 0.0):
        trust(max(runs // 4, 4), noise)
    splits(max(runs // 4, 4))
    friction(max(runs // 20, 2))


if __name__ == "__main__":
    main()
