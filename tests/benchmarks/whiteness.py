"""Level and power of the test of white residuals, which allows for what was fitted to them.

Level: 5 % on white residuals of ARX, IV4, ARMAX, OE, BJ, n4sid and a grey box, at N 300, 1000 and
10 000. ARX is also tested with hardly any input, so that the noise alone determines A. Power: OE of
y = G u + v with v a random walk, AR(.5), AR(.95) and MA(.5). Run it with the project's
environment::

    python -m tests.benchmarks.whiteness [runs]
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable

import numpy as np
from armrig import Dataset, armax, arx, bj, greybox, iv4, n4sid, oe, telegraph
from armrig.numerics.polynomial import filtered
from armrig.physics.systems import chassis
from armrig_core.rig.arm import ArmParameters, chassis_matrices, zero_order_hold
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Colour = Callable[[Vector], Vector]
Study = Callable[[int, np.random.Generator], tuple[float, str]]

LEVEL = 0.05
B, F = [0.0, 1.0, 0.5], [1.0, -1.2, 0.6]
SIZES = (300, 1000, 10_000)
COLOURS: dict[str, Colour] = {
    "random walk": np.cumsum,
    "AR .5": lambda e: filtered([1.0], [1.0, -0.5], e),
    "AR .95": lambda e: filtered([1.0], [1.0, -0.95], e),
    "MA .5": lambda e: filtered([1.0, 0.5], [1.0], e),
}


def black_box(
    estimate: Callable[[Dataset], object], C: list[float], D: list[float], gain: float = 1.0
) -> Study:
    """Return a study of an estimator on data of B/F u + C/D e."""

    def run(N: int, rng: np.random.Generator) -> tuple[float, str]:
        u = telegraph(N + 200, 0.3, 1.5, 3.5, seed=rng) - 2.5
        v = filtered(C, D, 0.5 * rng.standard_normal(N + 200))
        data = Dataset(u=u[200:], y=(gain * filtered(B, F, u) + v)[200:], Ts=1.0)
        fit = estimate(data)
        return fit.whiteness, fit.whiteness_test  # type: ignore[attr-defined]

    return run


def grey(N: int, rng: np.random.Generator) -> tuple[float, str]:
    """Return the verdict on a grey box of the chassis."""
    A, B_, C = chassis_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B_, 0.01)
    u, x, y = telegraph(N, 0.1, 0.0, 5.0, seed=rng), np.zeros(A.shape[0]), np.empty(N)
    for k in range(N):
        y[k] = C[0] @ x
        x = Phi @ x + Gamma[:, 0] * u[k]
    y += 5e-3 * rng.standard_normal(N)
    fit = greybox(Dataset(u=u, y=y, Ts=0.01, output="theta_1", unit="rad"), chassis, ("J_1",))
    return fit.whiteness, fit.whiteness_test


def coloured(colour: Colour) -> Study:
    """Return a study of OE under a noise of this colour, of sd .5 unless the colour has its own."""

    def run(N: int, rng: np.random.Generator) -> tuple[float, str]:
        u = telegraph(N, 0.3, 1.5, 3.5, seed=rng) - 2.5
        y = filtered(B, F, u) + 0.5 * colour(rng.standard_normal(N))
        fit = oe(Dataset(u=u, y=y, Ts=1.0), nb=4, nf=4)
        return fit.whiteness, fit.whiteness_test

    return run


WHITE: dict[str, Study] = {
    "ARX": black_box(lambda d: arx(d, na=2, nb=2), [1.0], F),
    "ARX of order 4, weak u": black_box(lambda d: arx(d, na=4, nb=1), [1.0], F, gain=0.01),
    "IV4": black_box(lambda d: iv4(d, na=2, nb=2), [1.0], [1.0]),
    "ARMAX": black_box(lambda d: armax(d, na=2, nb=2, nc=2), [1.0, -0.5, 0.2], F),
    "OE": black_box(lambda d: oe(d, nb=2, nf=2), [1.0], [1.0]),
    "BJ": black_box(lambda d: bj(d, nb=2, nc=1, nd=1, nf=2), [1.0, 0.5], [1.0, -0.7]),
    "n4sid": black_box(lambda d: n4sid(d, order=2), [1.0, -0.5, 0.2], F),
    "grey box": grey,
}


def tell(name: str, study: Study, runs: int, seed: int) -> None:
    """Print the share that is rejected, and which test decided, at each N."""
    shares = []
    for N in SIZES:
        some = max(runs // 5, 1) if SIZES[-1] == N else runs
        found = [study(N, np.random.default_rng([seed, N, k])) for k in range(some)]
        rejected = 100 * np.mean([p < LEVEL for p, _ in found])
        by = Counter(test for _, test in found)["Ljung-Box test"]
        shares.append(f"N {N}: {rejected:.1f} % of {some}, Ljung-Box {100 * by / some:.0f} %")
    print(f"  {name:24} {'; '.join(shares)}", flush=True)


def main() -> None:
    """Print both tables."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    print("white residuals called coloured at 5 %")
    for name, study in WHITE.items():
        tell(name, study, runs, 31)
    print("coloured residuals found")
    for name, colour in COLOURS.items():
        tell(name, coloured(colour), max(runs // 5, 1), 32)


if __name__ == "__main__":
    main()
