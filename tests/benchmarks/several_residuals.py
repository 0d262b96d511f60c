"""False alarms and power of the tests of residuals of several signals, in many simulated runs.

The plants are those of `several_signals`. Each run estimates a model, and tests it on its own data
and on new data of the same plant. The summary gives the share of p values below 1 % and 5 % ::

    white      all outputs together, and each output
    dynamics   all pairs together, and each pair
    feedback   all pairs together, and each pair

With --wrong the plant is tested with a model that lacks something: `bj` and `arx` without their
last input, and a delay one sample too long. Run it with the project's environment::

    python -m tests.benchmarks.several_residuals [--case ss] [--seed 1] [--runs 300] [--N 500]
        [--missing 0.2] [--wrong]
"""

from __future__ import annotations

import argparse
from typing import Any

import armrig
import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.several_signals import Plant

CASES = ("arx", "bj", "shared", "ss")
_LEVELS = (0.01, 0.05)


def p_values(test: Any) -> dict[str, list[float]]:
    """Return the p values of a test by the names of the summary."""
    return {
        "white": [test.white.p_value],
        "white, each": [w.p_value for w in test.white_by_output],
        "dynamics": [test.missing_dynamics],
        "dynamics, each": test.missing_dynamics_by_pair.ravel().tolist(),
        "feedback": [test.feedback],
        "feedback, each": test.feedback_by_pair.ravel().tolist(),
    }


def study(case: str, seed: int, runs: int, N: int, missing: float, *, wrong: bool) -> None:
    """Print the share of rejections on estimation data and on new data."""
    plant = Plant(case, seed)
    found: dict[str, dict[str, list[float]]] = {"own data": {}, "new data": {}}
    for run in range(runs):
        data, other = (plant.signals(N, missing, (seed, N, run, k)) for k in range(2))
        fit = _wrong(case, data) if wrong else plant.fit(data)
        for name, signals in (("own data", data), ("new data", other)):
            for what, values in p_values(armrig.residuals(fit, signals)).items():
                found[name].setdefault(what, []).extend(values)
    for name, tests in found.items():
        shares = [f"{what} {_shares(np.array(p))}" for what, p in tests.items()]
        print(f"{case} seed {seed}, {name}: " + "; ".join(shares), flush=True)


def _wrong(case: str, data: armrig.Signals) -> armrig.MultivariableFit:
    """Return a model of the data with a delay that is one sample too long."""
    orders: dict[str, dict[str, Any]] = {
        "arx": {"na": [[2, 1], [1, 2]], "nb": 1, "nk": 2},
        "bj": {"nb": [[2, 1]], "nf": [[2, 1]], "nk": [[2, 2]], "nc": 1, "nd": 1},
        "shared": {"nb": [[3], [2]], "nf": 3, "nk": 2, "integrator": "chassis"},
        "ss": {"order": 3, "nk": 2},
    }
    if case == "shared":
        orders[case]["shared"] = "denominator"
    estimator: Any = getattr(armrig, {"shared": "oe"}.get(case, case))
    fit: armrig.MultivariableFit = estimator(data, **orders[case])
    return fit


def _shares(p: NDArray[np.float64]) -> str:
    known = p[np.isfinite(p)]
    return " ".join(f"{100 * np.mean(known < level):.1f}" for level in _LEVELS) + f" % of {p.size}"


def main() -> None:
    """Run the studies."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--case", choices=CASES)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("--N", type=int, default=500)
    parser.add_argument("--missing", type=float, default=0.0)
    parser.add_argument("--wrong", action="store_true")
    given = parser.parse_args()
    for case in [given.case] if given.case else CASES:
        study(case, given.seed, given.runs, given.N, given.missing, wrong=given.wrong)


if __name__ == "__main__":
    main()
