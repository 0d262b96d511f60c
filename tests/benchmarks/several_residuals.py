"""False alarms and power of the tests of residuals of several signals, in many simulated runs.

The plants are those of `several_signals`. Each run estimates a model, and tests it on its own data
and on new data of the same plant. The summary gives the share of p values below 1 % and 5 % ::

    white      all outputs together, and each output
    dynamics   all pairs together, and each pair
    feedback   all pairs together, and each pair

With --wrong the model lacks something, or the data do ::

    delay      each delay is one sample too long
    channel    the model lacks the last input of the first output (arx, bj)
    feedback   the second input follows the noise of the first output (case oe)

The summary then contains the shares of rejected pairs, output by output. With --experiments the
data are several records, merged. Run it with the project's environment::

    python -m tests.benchmarks.several_residuals [--case ss] [--seed 1] [--runs 300] [--N 500]
        [--missing 0.2] [--experiments 3] [--wrong delay]
"""

from __future__ import annotations

import argparse
from typing import Any

import armrig
import numpy as np
from armrig.numerics.polynomial import filtered
from numpy.typing import NDArray

from tests.benchmarks.several_signals import Plant

CASES = {
    "none": ("arx", "bj", "shared", "ss"),
    "delay": ("arx", "bj", "shared", "ss"),
    "channel": ("arx", "bj"),
    "feedback": ("oe",),
}
"""Plants for each kind of --wrong."""
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


def study(
    case: str, seed: int, runs: int, N: int, missing: float, experiments: int, wrong: str
) -> None:
    """Print the share of rejections on estimation data and on new data."""
    plant = None if case == "oe" else Plant(case, seed)
    names = ("own data", "new data")
    found: dict[str, dict[str, list[list[float]]]] = {name: {} for name in names}
    for run in range(runs):
        both = []
        for k in range(2):
            at = [(seed, N, run, k + 2 * i) for i in range(experiments)]
            n = N // experiments
            parts = [
                _followed(one, n) if plant is None else plant.signals(n, missing, one) for one in at
            ]
            both.append(armrig.merge(parts) if experiments > 1 else parts[0])
        fit = _fit(case, both[0], wrong) if plant is None or wrong != "none" else plant.fit(both[0])
        for name, signals in zip(names, both, strict=True):
            for what, values in p_values(armrig.residuals(fit, signals)).items():
                found[name].setdefault(what, []).append(values)
    for name, tests in found.items():
        shares = [f"{what} {_shares(np.array(p), wrong)}" for what, p in tests.items()]
        print(f"{case} seed {seed}, {name}: " + "; ".join(shares), flush=True)


def _followed(seed: tuple[int, ...], N: int) -> armrig.Signals:
    """Return data in which u2 follows the noise of y1, one sample later."""
    rng = np.random.default_rng(seed)
    v = filtered([1.0], [1, -0.8], 0.3 * rng.standard_normal(N))
    u = np.where(np.cumsum(rng.random((N, 2)) < 0.3, axis=0) % 2, 1.0, -1.0)
    u[1:, 1] += v[:-1]
    y = [
        filtered([0, b], [1, -0.7], u[:, 0]) + filtered([0, 0.5], [1, -0.5], u[:, 1])
        for b in (1.0, 0.6)
    ]
    y[0] += v
    y[1] += 0.3 * rng.standard_normal(N)
    return armrig.Signals(u=u, y=np.column_stack(y), Ts=1.0)


def _fit(case: str, data: armrig.Signals, wrong: str) -> armrig.MultivariableFit:
    """Return a model of the data with an error in its delay or its channels."""
    late = int(wrong == "delay")
    gone = wrong == "channel"
    orders: dict[str, dict[str, Any]] = {
        "arx": {
            "na": [[2, 1], [1, 2]],
            "nb": [[2 - late, 0 if gone else 2 - late], [2 - late, 2 - late]],
            "nk": 1 + late,
        },
        "bj": {
            "nb": [[2, 0 if gone else 1]],
            "nf": [[2, 1]],
            "nk": [[1 + late, 2]],
            "nc": 1,
            "nd": 1,
        },
        "shared": {"nb": [[3], [2]], "nf": 3, "nk": 2, "integrator": "chassis"},
        "ss": {"order": 3, "nk": 2},
        "oe": {"nb": 1, "nf": 1},
    }
    if case == "shared":
        orders[case]["shared"] = "denominator"
    estimator: Any = getattr(armrig, {"shared": "oe"}.get(case, case))
    fit: armrig.MultivariableFit = estimator(data, **orders[case])
    return fit


def _shares(p: NDArray[np.float64], wrong: str) -> str:
    known = p[np.isfinite(p)]
    total = " ".join(f"{100 * np.mean(known < level):.1f}" for level in _LEVELS)
    if wrong == "none" or p.shape[1] == 1:
        return f"{total} % of {p.size}"
    each = " ".join(f"{100 * np.mean(column < _LEVELS[0]):.0f}" for column in p.T)
    return f"({each}) % of {p.shape[0]} at 1 %"


def main() -> None:
    """Run the studies."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--case", choices=CASES["none"])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("--N", type=int, default=500)
    parser.add_argument("--missing", type=float, default=0.0)
    parser.add_argument("--experiments", type=int, default=1)
    parser.add_argument("--wrong", choices=list(CASES), default="none")
    given = parser.parse_args()
    for case in [given.case] if given.case else CASES[given.wrong]:
        rest = given.N, given.missing, given.experiments, given.wrong
        study(case, given.seed, given.runs, *rest)


if __name__ == "__main__":
    main()
