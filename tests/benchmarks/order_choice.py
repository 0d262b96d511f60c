"""Monte Carlo of `select_orders` and of `search`: the share of true orders.

Input ±1 V that switches with probability 0.3, N = 1000 to estimate and as many to validate ::

    ARX   A = 1 - 1.2 q^-1 + 0.6 q^-2, B = q^-1 + 0.5 q^-2, e of sd 0.5: [2 2 1] of the 600
          structures that `select_orders` tries, by each criterion
    OE    F = (1 - 1.5 q^-1 + 0.9 q^-2)(1 - 0.6 q^-1), B = q^-1 + 0.5 q^-2 + 0.2 q^-3, e of sd 1:
          order 3 of 1 to 5, by `search`

Each choice on validation data is printed with their lowest loss. Run it with the project's
environment::

    python -m tests.benchmarks.order_choice [runs]
"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np
from armrig import Dataset, search, select_orders, telegraph
from armrig.numerics.polynomial import filtered

SETTLED = 300  # samples before the first one that is taken
TRUE_ARX = (2, 2, 1)
TRUE_OE = "OE[3 3 1]"


def main() -> None:
    """Print the shares."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    rng = np.random.default_rng(2026)
    right: Counter[str] = Counter()
    small: Counter[str] = Counter()
    for _ in range(runs):
        table = select_orders(_arx(rng), validation=_arx(rng))
        chosen = {str(name): table.chosen(name) for name in table.criteria}
        chosen["lowest validation loss"] = int(np.nanargmin(table.values("validation")))
        for name, i in chosen.items():
            na, nb, nk = (int(x[i]) for x in (table.na, table.nb, table.nk))
            right[name] += (na, nb, nk) == TRUE_ARX
            small[name] += na < 2 or nk > 1 or nk + nb < 3
    print(f"ARX{list(TRUE_ARX)}, {runs} runs: chosen right, too small")
    for name in chosen:
        print(f"  {name:22} {100 * right[name] / runs:5.1f} %  {100 * small[name] / runs:5.1f} %")
    found: Counter[str] = Counter()
    lowest: Counter[str] = Counter()
    for _ in range(runs):
        result = search(_oe(rng), _oe(rng), families=("oe",))
        found[result.chosen.candidate.name] += 1
        lowest[result.ranked[0].candidate.name] += 1
    print(f"{TRUE_OE}, {runs} runs of the search: chosen {found}, lowest error {lowest}")


def _arx(rng: np.random.Generator) -> Dataset:
    A = [1.0, -1.2, 0.6]
    u = telegraph(1000 + SETTLED, 0.3, 1.5, 3.5, seed=rng) - 2.5
    y = filtered([0.0, 1.0, 0.5], A, u) + filtered([1.0], A, 0.5 * rng.standard_normal(u.size))
    return Dataset(u=u[SETTLED:], y=y[SETTLED:], Ts=1.0)


def _oe(rng: np.random.Generator) -> Dataset:
    F = np.convolve([1.0, -1.5, 0.9], [1.0, -0.6])
    u = telegraph(1000 + SETTLED, 0.3, 1.5, 3.5, seed=rng) - 2.5
    y = filtered([0.0, 1.0, 0.5, 0.2], F, u) + rng.standard_normal(u.size)
    return Dataset(u=u[SETTLED:], y=y[SETTLED:], Ts=1.0)


if __name__ == "__main__":
    main()
