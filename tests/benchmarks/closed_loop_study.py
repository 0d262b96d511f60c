"""Bias of models from a run under a control law with coloured noise in the loop.

`python -m tests.benchmarks.closed_loop_study` simulates 200 runs of a plant of order 2 under a PI
law, which the core evaluates as on a rig: with limits, codes and one sample of delay. Half of the
noise's power at the output is AR(0.9), the other half is white. BJ and `two_stage` must have no
bias: less than 4 standard errors in each coefficient. OE must have a bias: more than 10 standard
errors in a coefficient.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress

import armrig
import numpy as np
from armrig.data.step import law_step
from armrig_core.control.control_law import ControlLaw, LawOutput, Reference
from armrig_core.control.evaluation import Latch, begin, decide, observe
from armrig_core.rig.description import builtin
from armrig_core.rig.volts import device_code, volts_of
from scipy.signal import lfilter

B, F = (0.1, 0.05), (-1.5, 0.7)
TRUE = np.array([*B, *F])
NAMES = ("b1", "b2", "f1", "f2")
U0_V = 2.5
NOISE_STD = 0.1  # in y's unit, of the sum of both parts
POLE = 0.9
ORDERS = {"nb": 2, "nf": 2}
MAX_UNBIASED, MIN_BIASED = 4.0, 10.0  # standard errors


def pi_law(k_p: float = 1.0, k_i: float = 0.1) -> ControlLaw:
    """Return a PI law of one output; its states are the integral and the newest control error."""
    return ControlLaw(
        Ts_us=10_000,
        outputs=(LawOutput(name="alpha", unit="rad"),),
        reference=Reference(name="alpha", unit="rad", low=-5.0, high=5.0),
        A=((1.0, 0.0), (0.0, 0.0)),
        B=((k_i, 0.0, -k_i), (1.0, 0.0, -1.0)),
        C=(1.0, k_p),
        x0=(0.0, 0.0),
        u0=U0_V,
    )


def controlled_run(seed: int, N: int = 3000, std: float = NOISE_STD) -> armrig.Dataset:
    """Return a run of the plant under the PI law, with its reference and the law in the history.

    The reference is a telegraph of ± 0.3 with a dither of ± 0.05 in each sample.
    """
    rng, law, latch = np.random.default_rng(seed), pi_law(), Latch(rest_code=round(U0_V * 13107))
    r = np.repeat(rng.choice([-0.3, 0.3], N), 20)[:N] + rng.choice([-0.05, 0.05], N)
    slow = lfilter([1.0], [1.0, -POLE], np.sqrt(1 - POLE**2) * rng.standard_normal(N + 200))[200:]
    noise = std * np.sqrt(0.5) * (slow + rng.standard_normal(N))
    program, reference = law.program(builtin("arm")), r.tolist()
    state, x, u, y = begin(program), np.zeros(N), np.zeros(N), np.zeros(N)
    for k in range(N):
        state, command = decide(program, state, k, reference, latch)
        u[k] = volts_of(device_code(command.code, latch.pwm_bits)) - U0_V
        before = [(x[k - 1], u[k - 1]), (x[k - 2], u[k - 2])] if k > 1 else [(0.0, 0.0)] * 2
        x[k] = sum(b * u_j - f * x_j for (x_j, u_j), b, f in zip(before, B, F, strict=True))
        y[k] = x[k] + noise[k]
        state = observe(program, state, k, (np.nan, float(y[k])), reference, latch)
    return armrig.Dataset(u=u, y=y, Ts=0.01, r=r, history=[law_step(law.sha256)])


ESTIMATORS: dict[str, Callable[[armrig.Dataset], armrig.Fit]] = {
    "OE": lambda data: armrig.oe(data, **ORDERS, starts="few"),
    "BJ": lambda data: armrig.bj(data, **ORDERS, nc=1, nd=1, starts="few"),
    "two_stage": lambda data: armrig.two_stage(data, **ORDERS, starts="few"),
}


Result = dict[str, tuple[np.ndarray, np.ndarray]]
"""Parameters b1, b2, f1, f2 and their reported deviations, by estimator."""


def study_run(seed: int) -> tuple[Result, tuple[bool, bool]]:
    """Return the estimates of a run, and whether two tests reject the truth.

    The tests are those of linearity (5 %), and of missing dynamics of the BJ model (1 %).
    """
    data, found, dynamics = controlled_run(seed), Result(), False
    for name, estimate in ESTIMATORS.items():
        fit = estimate(data)
        at = np.r_[fit.slice_of("b"), fit.slice_of("f")]
        found[name] = fit.theta[at], (fit.std if name == "BJ" else fit.std_robust)[at]
        if name == "BJ":
            dynamics = bool(armrig.residuals(fit, data).missing_dynamics < 0.01)
    return found, (bool(armrig.linearity(data).p < 0.05), dynamics)


def main() -> None:
    """Print bias, deviation and verdict of each estimator after each 50 runs."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    results: list[tuple[Result, tuple[bool, bool]]] = []
    with ProcessPoolExecutor(given.jobs) as pool, suppress(KeyboardInterrupt):
        for result in pool.map(study_run, range(given.runs)):
            results.append(result)
            if len(results) % 50 == 0 or len(results) == given.runs:
                print_study(results)


def print_study(results: Sequence[tuple[Result, tuple[bool, bool]]]) -> None:
    """Print the table of the study after some runs."""
    runs = len(results)
    print(f"{runs} runs: bias in standard errors of the mean (in deviations of one run)")
    print(f"{'':10}" + "".join(f"{name:>17}" for name in NAMES) + "   as expected")
    for name in ESTIMATORS:
        theta, reported = (np.array(x) for x in zip(*(r[name] for r, _ in results), strict=True))
        deviation = np.std(theta, axis=0, ddof=1)
        bias = (np.mean(theta, axis=0) - TRUE) / deviation
        errors = np.abs(bias) * np.sqrt(runs)
        is_right = errors.max() > MIN_BIASED if name == "OE" else errors.max() < MAX_UNBIASED
        cells = (f"{e:.1f} ({b:+.2f})" for e, b in zip(errors, bias, strict=True))
        print(f"{name:10}" + "".join(f"{cell:>17}" for cell in cells) + f"   {is_right}")
        ratio = deviation / np.median(reported, axis=0)
        print(f"{'':10}" + "".join(f"{x:17.2f}" for x in ratio) + "   deviation / reported")
    rejected = np.sum([tests for _, tests in results], axis=0)
    print("rejected by chance: linearity {}, dynamics of BJ {}".format(*rejected), flush=True)


if __name__ == "__main__":
    main()
