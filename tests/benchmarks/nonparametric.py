"""Monte Carlo of the estimates without a structure: coverage, regularisation, sampling time.

Sections: `coverage`, `spectral`, `bank`, `sampling`; all of them without an argument.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator

import armrig
import numpy as np
from armrig.data.dataset import Dataset
from armrig.estimation.nonparametric.sampling_time import nearest_125
from armrig.numerics.polynomial import filtered
from armrig_core.arm import ArmParameters, arm_matrices, zero_order_hold
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Noise = Callable[[np.random.Generator, int], Vector]
RUNS, SYSTEMS, SWEEPS = 1000, 60, 100
B, F = np.array([0.0, 1.0, 0.5]), np.array([1.0, -1.2, 0.6])


def coloured(pole: float) -> Noise:
    """Return a source of AR(1) noise of innovation variance 1."""
    return lambda rng, N: filtered([1.0], [1.0, -pole], rng.standard_normal(N + 300))[300:]


def moving(zero: float) -> Noise:
    """Return a source of MA(1) noise."""
    return lambda rng, N: filtered([1.0, zero], [1.0], rng.standard_normal(N + 1))[1:]


def switching(p: float) -> Noise:
    """Return a source of telegraph signals."""
    return lambda rng, N: armrig.telegraph(N, p, 0.0, 5.0, seed=rng)


CASES: dict[str, tuple[Noise, Noise]] = {
    "white u, white v": (coloured(0.0), coloured(0.0)),
    "AR(0.8) u, white v": (coloured(0.8), coloured(0.0)),
    "white u, AR(0.8) v": (coloured(0.0), coloured(0.8)),
    "AR(0.8) u, AR(0.8) v": (coloured(0.8), coloured(0.8)),
    "AR(0.8) u, MA(0.9) v": (coloured(0.8), moving(0.9)),
    "telegraph u, AR(0.8) v": (switching(0.1), coloured(0.8)),
}


def runs(name: str, N: int, missing: float = 0.0) -> Iterator[tuple[Dataset, Dataset]]:
    """Iterate over data sets of one case, each with its noise-free twin."""
    u_source, v_source = CASES[name]
    for seed in range(RUNS if missing == 0 else RUNS // 5):  # filling holes is slow
        rng = np.random.default_rng([seed, sum(map(ord, name))])
        u, v = u_source(rng, N), v_source(rng, N)
        y = filtered(B, F, u)
        valid = rng.random(N) >= missing
        yield (
            Dataset(u=u, y=y + v, Ts=1.0, valid=valid),
            Dataset(u=u, y=y, Ts=1.0, valid=valid),
        )


def coverage() -> None:
    """Print how often the 95 % band of the plain impulse response holds the truth."""
    n = 30
    truth = filtered(B, F, np.eye(1, n)[0])
    print(f"plain least squares, {n} lags, nominal 95 %, {RUNS} runs: mean (least … most of lags)")
    for N in (500, 2000):
        for name in CASES:
            for missing in (0.0, 0.1) if name == "AR(0.8) u, AR(0.8) v" else (0.0,):
                held = np.zeros(n)
                for data, _ in runs(name, N, missing):
                    found = armrig.impulse_response(data, n, kernel=None, integrator=False)
                    held += np.abs(found.g - truth) < found.band(0.95)
                count = RUNS if missing == 0 else RUNS // 5
                share = 100 * held / count
                case = f"N {N:4} {name:24} missing {100 * missing:2.0f} %, {count} runs"
                print(f"  {case}: {told(share)}", flush=True)
    held, runs_ = np.zeros(70), RUNS
    for seed in range(runs_):
        data, rate = arm(0.01, 3000, seed, 0.05)
        found = armrig.impulse_response(data, 70, kernel=None)
        held += np.abs(found.decaying[0] - rate[:70]) < 1.96 * found.decaying[1]
    share = 100 * held / runs_
    print(f"  arm, rate, 70 lags, N 3000, telegraph: {told(share)}", flush=True)


def told(share: Vector) -> str:
    """Return mean, least and most of some percentages."""
    return f"{share.mean():.1f} ({share.min():.1f} … {share.max():.1f})"


def spectral() -> None:
    """Print how often spa's 95 % bands hold the smoothed expectation."""
    w = np.linspace(0.05, 1.0, 20) * 0.98 * np.pi
    print(
        f"spa, gamma 30, N 1000, nominal 95 %, 20 frequencies, {RUNS} runs: mean (least … most) "
        "about E(G | u), phase where its sd is < 0.3 rad, and magnitude about E(G)"
    )
    for name in CASES:
        for missing in (0.0, 0.1) if name == "AR(0.8) u, AR(0.8) v" else (0.0,):
            held = np.zeros((2, w.size))
            G, std, turns = [], [], []
            for data, clean in runs(name, 1000, missing):
                found = armrig.spa(data, 30, w, integrator=False)
                expected = armrig.spa(clean, 30, w, integrator=False).G
                off = np.abs(np.abs(found.G) - np.abs(expected))
                turn = np.abs(np.angle(found.G / expected))
                held += [off < 1.96 * found.std_magnitude, turn < 1.96 * found.std_phase]
                G.append(found.G)
                std.append(found.std_magnitude)
                turns.append(found.std_phase)
            mean = np.abs(np.mean(G, axis=0))
            inside = np.abs(np.abs(G) - mean) < 1.96 * np.array(std)
            about = 100 * np.mean(inside, axis=0)
            sharp = np.mean(turns, axis=0) < 0.3  # beyond, a phase is not known to first order
            magnitude, phase = 100 * held[0] / len(G), 100 * held[1, sharp] / len(G)
            case = f"{name:24} missing {100 * missing:2.0f} %, {len(G)} runs"
            print(
                f"  {case}: magnitude {told(magnitude)}, phase {told(phase)} at {phase.size} of "
                f"them; about E(G) {told(about)}",
                flush=True,
            )


def bank() -> None:
    """Print mean squared errors of plain and regularised responses on random systems, paired."""
    n = 125
    kinds = (None, "tc", "dc", "ss")
    print(f"random systems of order 30, white u, {n} lags, {SYSTEMS} systems, paired")
    for N, ratio in ((500, 10.0), (375, 1.0)):
        errors = np.zeros((SYSTEMS, len(kinds)))
        fits = np.zeros_like(errors)
        for i in range(SYSTEMS):
            rng = np.random.default_rng([i, N])
            g = random_response(rng, n)
            u = rng.standard_normal(N)
            y = filtered(g, [1.0], u)
            y += np.std(y) / np.sqrt(ratio) * rng.standard_normal(N)
            for j, kernel in enumerate(kinds):
                found = armrig.impulse_response(
                    Dataset(u=u, y=y, Ts=1.0), n, kernel=kernel, integrator=False
                )
                sse = float(np.sum((found.g - g) ** 2))
                errors[i, j] = sse / n
                fits[i, j] = 100 * (1 - np.sqrt(sse / np.sum((g - g.mean()) ** 2)))
        for j, kernel in enumerate(kinds):
            better = 100 * np.mean(errors[:, j] < errors[:, 0])
            change = np.median(errors[:, j] / errors[:, 0])
            case = f"N {N} SNR {ratio:2.0f} {kernel or 'plain':5}"
            print(
                f"  {case}: mean fit {fits[:, j].mean():6.1f} %, MSE over plain's: median "
                f"{change:.3f}, lower in {better:.0f} %",
                flush=True,
            )


def random_response(rng: np.random.Generator, n: int) -> Vector:
    """Return n coefficients, g(0) = 0, of a random system with 30 poles, |z| < 0.95."""
    radius, angle = 0.95 * np.sqrt(rng.random(15)), np.pi * rng.random(15)
    h = np.zeros(n)
    k = np.arange(1, n)
    for r, a in zip(radius, angle, strict=True):
        weight, phase = rng.standard_normal(), 2 * np.pi * rng.random()
        h[1:] += weight * r ** (k - 1) * np.cos(a * (k - 1) + phase)
    return h


def discrete(Ts: float) -> tuple[Vector, Vector]:
    """Return B and F of the handout's arm, held and sampled every Ts."""
    A, G, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, G, Ts)
    poles = np.real(np.poly(Phi))
    markov, x = [0.0], Gamma
    for _ in range(4):
        markov.append(float((C @ x)[0, 0]))
        x = Phi @ x
    return np.convolve(markov, poles)[:5], poles


def arm(Ts: float, N: int, seed: int, p: float, *, adc: bool = False) -> tuple[Dataset, Vector]:
    """Return data of the arm, 5 mrad noise or 10 bits of 352°, and the rate's response."""
    rng = np.random.default_rng(seed)
    b, f = discrete(Ts)
    u = armrig.telegraph(N, p, 0.0, 5.0, seed=rng)
    y = filtered(b, f, u)
    lsb = np.deg2rad(352.0) / 1024
    y = lsb * np.floor(y / lsb) if adc else y + 5e-3 * rng.standard_normal(N)
    rate = filtered(b, np.cumsum(f)[:-1], np.eye(1, 100)[0]) / Ts
    return Dataset(u=u, y=y, Ts=Ts, output="theta_1", unit="rad"), rate


INPUTS: tuple[tuple[str, Callable[[float], float], bool], ...] = (
    ("p 0.05 a sample, 5 mrad", lambda Ts: 0.05, False),
    ("5 switches a second, 5 mrad", lambda Ts: 5 * Ts, False),
    ("5 switches a second, 10-bit ADC", lambda Ts: 5 * Ts, True),
)


def sampling() -> None:
    """Print the error of a black-box model at the recommended Ts and around it."""
    duration = 30.0
    print("sampling_time of telegraph pilots of 30 s (p 0.05 a sample), 20 seeds each:")
    found = []
    for pilot in (0.002, 0.005, 0.01):
        said = [
            armrig.sampling_time(arm(pilot, round(duration / pilot), 1000 + s, 0.05)[0]).Ts
            for s in range(20)
        ]
        found += said
        values, counts = np.unique(said, return_counts=True)
        text = ", ".join(f"{1e3 * v:g} ms {c}×" for v, c in zip(values, counts, strict=True))
        print(f"  at {1e3 * pilot:g} ms: {text}", flush=True)
    best = nearest_125(float(np.median(found)))
    print(f"recommended {1e3 * best:g} ms; oe(nb=4, nf=4, integrator=True), {SWEEPS} runs, 30 s")
    for words, p, adc in INPUTS:
        medians, rms = [], []
        factors = (0.25, 0.5, 1.0, 2.0, 4.0)
        top = 0.9 * np.pi / (best * factors[-1])  # below every Nyquist frequency of the sweep
        omega = np.geomspace(0.5, min(100.0, top), 200)
        for factor in factors:
            Ts = best * factor
            errors = []
            for seed in range(SWEEPS):
                data, _ = arm(Ts, round(duration / Ts), seed, p(Ts), adc=adc)
                fit = armrig.oe(data, nb=4, nf=4, nk=1, integrator=True)
                x = np.exp(-1j * omega * Ts)
                b, f = discrete(Ts)
                truth = np.polyval(b[::-1], x) / np.polyval(f[::-1], x)
                G = fit.frequency_response(omega).G
                errors.append(np.sqrt(np.mean(np.abs(G / truth - 1) ** 2)))
            medians.append(float(np.median(errors)))
            rms.append(float(np.sqrt(np.mean(np.square(errors)))))
        print(f"  {words}, 0.5 … {omega[-1]:.0f} rad/s:")
        for factor, m, r in zip(factors, medians, rms, strict=True):
            print(
                f"    Ts {1e3 * best * factor:6.2f} ms: relative error median {m:.5f}, rms {r:.5f}"
            )
        print(
            f"    recommended over best: median {medians[2] / min(medians):.2f}, "
            f"rms {rms[2] / min(rms):.2f}",
            flush=True,
        )


SECTIONS = {"coverage": coverage, "spectral": spectral, "bank": bank, "sampling": sampling}

if __name__ == "__main__":
    for section in sys.argv[1:] or SECTIONS:
        SECTIONS[section]()
