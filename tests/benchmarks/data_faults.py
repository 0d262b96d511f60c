"""False alarms and power of the warnings of wrong samples and of an offset of y.

The plants are random and stable (order 2 to 5, poles of radius 0.4 to 0.97). The noise is white or
AR(.6) to 0.95, 5 to 40 dB below the output; N is 500 or 3000. The input is white, a telegraph or
held binary, of mean zero or not. An OE model and an ARX model of the plant's order is estimated
from each record. The records are sound, have 1 % wrong samples of 3 to 30 standard deviations of y,
or have an offset of 0.2 to 2 of these. `python -m tests.benchmarks.data_faults [runs [seed]]`.
"""

from __future__ import annotations

import sys
import warnings
from collections import Counter

import numpy as np
from armrig import Dataset, arx, oe, telegraph
from armrig.numerics.polynomial import filtered
from numpy.typing import NDArray

Vector = NDArray[np.float64]
SETTLED = 500


def plant(order: int, rng: np.random.Generator) -> tuple[Vector, Vector]:
    """Return B and F, gain of any size."""
    z: list[complex] = []
    while len(z) < order:
        r = rng.uniform(0.4, 0.97)
        if order - len(z) >= 2 and rng.random() < 0.6:
            root = r * np.exp(1j * rng.uniform(0.1, 2.5))
            z += [root, root.conjugate()]
        else:
            z.append(complex(r))
    return np.append(0.0, rng.standard_normal(order)), np.real(np.poly(z))


def record(rng: np.random.Generator) -> tuple[Dataset, int]:
    """Return sound data of one plant, and its order."""
    order, N = int(rng.integers(2, 6)), int(rng.choice([500, 3000]))
    B, F = plant(order, rng)
    whole, kind = N + SETTLED, rng.integers(3)
    u = (
        rng.standard_normal(whole)
        if kind == 0
        else telegraph(whole, 0.1, 1.5, 3.5, seed=rng) - 2.5
        if kind == 1
        else np.repeat(rng.choice([-1.0, 1.0], whole // 7 + 1), 7)[:whole]
    )
    u = u + rng.choice([0.0, 1.5])
    clean = filtered(B, F, u)[SETTLED:]
    pole = rng.choice([0.0, rng.uniform(0.6, 0.95)])
    v = filtered([1.0], [1.0, -pole], rng.standard_normal(whole))[SETTLED:]
    v *= np.std(clean) / np.std(v) * 10 ** (-rng.uniform(5, 40) / 20)
    return Dataset(u=u[SETTLED:], y=clean + v, Ts=1.0), order


def told(data: Dataset, order: int, found: Counter[str], kind: str) -> None:
    """Count the faults that the two estimates report."""
    fits = {"arx": arx(data, na=order, nb=order), "oe": oe(data, nb=order, nf=order)}
    for name, fit in fits.items():
        found[f"{kind}: {name}, wrong samples"] += any("look wrong" in w for w in fit.warnings)
        found[f"{kind}: {name}, offset"] += any("at u = 0" in w for w in fit.warnings)


def main() -> None:
    """Print the share of reports of each fault, in percent."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 6151
    found: Counter[str] = Counter()
    warnings.simplefilter("ignore")
    for k in range(runs):
        rng = np.random.default_rng([seed, k])
        data, order = record(rng)
        std = float(np.std(data.y))
        told(data, order, found, "sound")
        y = data.y.copy()
        at = rng.choice(y.size, y.size // 100, replace=False)
        y[at] += rng.choice([-1.0, 1.0], at.size) * std * 10 ** rng.uniform(0.5, 1.5, at.size)
        told(Dataset(u=data.u, y=y, Ts=1.0), order, found, "1 % wrong")
        offset = std * 10 ** rng.uniform(-0.7, 0.3)
        told(Dataset(u=data.u, y=data.y + offset, Ts=1.0), order, found, "offset")
    print(f"{runs} random plants, seed {seed}: told of, in %")
    for what, count in found.items():
        print(f"  {what:32} {100 * count / runs:5.1f}")


if __name__ == "__main__":
    main()
