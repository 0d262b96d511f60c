"""Drawn data without noise, without motion or of extreme size, and the codes of what armrig says.

`python -m tests.drawn_degenerate --seed 1 --count 200` prints a line of JSON for each data set. Run
it under several kernels of OpenBLAS (OPENBLAS_CORETYPE) and compare the lines: a rounding error
decides nothing, so the lines are equal.
"""

from __future__ import annotations

import argparse
import json
import re
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import armrig
import numpy as np
from armrig.validation.advice import preliminary_tests
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import lfilter

Vector = NDArray[np.float64]
_NUMBER = re.compile(r"[-+]?\d[\d.e+-]*")
SIZES = (1e-21, 1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e8)


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A degenerate data set and the kind of its construction."""

    kind: str
    """Name of the construction."""
    data: armrig.Dataset
    """The drawn data."""
    moving: int = -1
    """Index of the only sample that moves; -1 for other kinds."""


def drawn_input(rng: Generator, N: int) -> Vector:
    """Return an input: telegraph, several levels, noise, steps, or a sum of sines."""
    kind = rng.integers(5)
    if kind == 0:
        return np.asarray(armrig.telegraph(N, 0.1, low=0.5, high=4.5, seed=int(rng.integers(1e6))))
    if kind == 1:
        return np.repeat(rng.uniform(0, 5, N // 8 + 1), 8)[:N]
    if kind == 2:
        return rng.standard_normal(N)
    if kind == 3:
        return np.where(np.arange(N) < N // 4, 0.0, float(rng.choice([1.0, 3.3, 0.1])))
    t = np.arange(N)
    return np.asarray(2 + np.sin(0.1 * t) + np.sin(0.37 * t + 1) + np.sin(0.73 * t + 2))


def drawn_response(rng: Generator, u: Vector) -> Vector:
    """Return the exact response of a drawn stable plant of order 1 to 3, with nk from 1 to 3."""
    poles = [float(rng.uniform(0.3, 0.97))]
    if rng.random() < 0.5:
        z = rng.uniform(0.6, 0.97) * np.exp(1j * rng.uniform(0.1, 1.5))
        poles = [z, z.conjugate(), *poles[: rng.integers(2)]]
    nk = int(rng.integers(1, 4))
    b = np.append(np.zeros(nk), rng.uniform(0.2, 1.0, int(rng.integers(1, 3))))
    level = float(rng.choice([0.0, 20.0, -1e3]))
    return np.asarray(lfilter(b, np.real(np.poly(poles)), u) + level)


def constant(rng: Generator, N: int) -> Case:
    """Return a constant output with a moving input."""
    value = float(rng.choice([0.0, 0.1, 1 / 3, 5.0, -273.15, 1e6 / 7]))
    return _case("constant", drawn_input(rng, N), np.full(N, value), rng)


def constant_input(rng: Generator, N: int) -> Case:
    """Return a constant input with an output of noise, a ramp, or a transient."""
    t = np.arange(N)
    y = [rng.standard_normal(N), 0.1 * t, 3 + 0.9**t][rng.integers(3)]
    return _case("constant input", np.full(N, float(rng.choice([0.0, 2.5, 1 / 3]))), y, rng)


def exact(rng: Generator, N: int) -> Case:
    """Return the exact response of a plant that settles or integrates."""
    u = drawn_input(rng, N)
    integral = lfilter([0, 0.3, 0.1], [1, -1.5, 0.5], u - u.mean())
    return _case("exact", u, drawn_response(rng, u) if rng.random() < 0.6 else integral, rng)


def quantised(rng: Generator, N: int) -> Case:
    """Return an exact response in few steps of a converter."""
    u = drawn_input(rng, N)
    y = drawn_response(rng, u)
    step = float(np.ptp(y)) / rng.integers(3, 60)
    return _case("quantised", u, np.round(y / step) * step, rng)


def two_valued(rng: Generator, N: int) -> Case:
    """Return an output of two values, which follows the input or does not."""
    u = drawn_input(rng, N)
    y = drawn_response(rng, u) if rng.random() < 0.5 else rng.standard_normal(N)
    return _case("two-valued", u, np.where(y > np.median(y), 1.0, -0.3), rng)


def repeated(rng: Generator, N: int) -> Case:
    """Return data in which each row, or a block of rows, is repeated."""
    times = int(rng.integers(2, 6))
    u = drawn_input(rng, -(-N // times))
    y = drawn_response(rng, u) + float(rng.choice([0.0, 0.1])) * rng.standard_normal(u.size)
    if rng.random() < 0.5:
        return _case("repeated rows", np.repeat(u, times), np.repeat(y, times), rng)
    return _case("repeated rows", np.tile(u, times), np.tile(y, times), rng)


def output_is_input(rng: Generator, N: int) -> Case:
    """Return an output that is the input, a multiple of it, or the input later."""
    u = drawn_input(rng, N)
    late = np.append(np.repeat(u[0], 3), u[:-3])
    y = [u.copy(), -2.0 * u, 0.1 * u + 7, late][rng.integers(4)]
    return _case("y is u", u, y, rng)


def one_moving(rng: Generator, N: int) -> Case:
    """Return an output that is constant except for one sample."""
    at = int(rng.integers(N // 4, 3 * N // 4))
    y = np.full(N, float(rng.choice([0.0, 0.1, 20.0])))
    y[at] += float(rng.choice([1e-3, 1.0, -5.0]))
    return _case("one moving", drawn_input(rng, N), y, rng, moving=at)


def noisy(rng: Generator, N: int) -> Case:
    """Return the noisy response of a linear plant, with y and u of extreme sizes."""
    u = drawn_input(rng, N)
    return _case("noisy", u, drawn_response(rng, u) + 0.05 * rng.standard_normal(N), rng)


KINDS = (constant, constant_input, exact, quantised, two_valued, repeated)
KINDS = (*KINDS, output_is_input, one_moving, noisy)


def _case(kind: str, u: Vector, y: Vector, rng: Generator, moving: int = -1) -> Case:
    of_y, of_u = rng.choice(SIZES, 2)
    Ts = float(rng.choice([0.01, 0.1, 1.0, 60.0]))
    return Case(kind=kind, data=armrig.Dataset(u=u * of_u, y=y * of_y, Ts=Ts), moving=moving)


def drawn_cases(seed: int, count: int) -> Iterator[Case]:
    """Yield `count` cases, each kind in turn."""
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        yield KINDS[i % len(KINDS)](rng, int(rng.integers(120, 260)))


def codes(data: armrig.Dataset, *, search: bool = False) -> dict[str, Any]:
    """Return the codes of all verdicts on the data; a refusal is the name of its exception."""

    def of_tests() -> list[Any]:
        known = preliminary_tests(data, None, None)
        late = known.late
        decided = known.integration
        return [
            decided.integrates,
            decided.undecided,
            decided.unstable,
            None if known.loop is None else known.loop.feedback,
            late if isinstance(late, str) else [late.nk, *late.interval],
        ]

    def of_model(estimate: Callable[..., Any], **orders: int) -> list[Any]:
        fit = estimate(data, **orders)
        test = armrig.residuals(fit, data)
        ps = (test.missing_dynamics, test.feedback)
        return [test.white.coloured, *(None if np.isnan(p) else p < 0.01 for p in ps)]

    def of_step() -> list[Any]:
        found = armrig.step_analysis(data)
        return [found.dead_time > 0, bool(np.isnan(found.overshoot)), len(found.warnings)]

    asked: dict[str, Callable[[], Any]] = {
        "advice": lambda: [[f.level, f.about] for f in armrig.advice(data).findings],
        "tests": of_tests,
        "outliers": lambda: np.flatnonzero(data.valid & ~armrig.hampel(data).valid).tolist(),
        "linearity": lambda: armrig.linearity(data).kind,
        "step": of_step,
        "arx": lambda: of_model(armrig.arx, na=2, nb=2, nk=1),
        "oe": lambda: of_model(armrig.oe, nb=2, nf=2, nk=1),
        "hints": lambda: str(armrig.structure_hints(data).structures[0]),
    }
    if search:
        asked["search"] = lambda: armrig.search(data, orders=[1, 2]).fit.heading
    answers = {}
    for name, ask in asked.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            try:
                answers[name] = ask()
            except ValueError as err:
                answers[name] = "refused: " + _NUMBER.sub("#", str(err))
            except Exception as err:
                answers[name] = f"INTERNAL {type(err).__name__}: {err}"
    return answers


def false_sentences(kind: str, moving: int, answer: dict[str, Any]) -> list[str]:
    """Return what the construction of the data contradicts in the codes of the verdicts."""
    advice = answer["advice"]
    doubts = {about.split()[0] for level, about in advice if level != "good"}
    said = {about.split()[0] for _, about in advice}
    tests = answer["tests"]
    wrong = [f"{name}: {text}" for name, text in answer.items() if str(text).startswith("INTERNAL")]
    if kind == "constant":
        judges = ("tests", "linearity", "arx", "oe", "hints")
        wrong += [name for name in judges if "is always" not in str(answer[name])]
        if "u has no step" not in answer["step"] and "is always" not in answer["step"]:
            wrong.append("step")
        wrong += [] if "output" in doubts else ["not said to be constant"]
        wrong += sorted(said & {"drift", "integrator", "outliers", "feedback", "linearity"})
    if kind == "exact":
        wrong += sorted(doubts & {"drift", "outliers", "linearity", "feedback"})
        wrong += [f"outliers {answer['outliers']}"] if answer["outliers"] else []
        wrong += ["feedback tested"] if isinstance(tests, list) and tests[3] is not None else []
    if kind == "one moving":
        wrong += [] if answer["outliers"] == [moving] else [f"outliers {answer['outliers']}"]
        wrong += [] if "outliers" in doubts else ["the moving sample is not said"]
    if kind == "constant input" and "excitation" not in doubts:
        wrong.append("the input is not said to be constant")
    return wrong


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--search", type=int, default=0)
    options = parser.parse_args()
    for i, case in enumerate(drawn_cases(options.seed, options.count)):
        answer = codes(case.data, search=i < options.search)
        answer["false"] = false_sentences(case.kind, case.moving, answer)
        print(json.dumps({"i": i, "kind": case.kind, "moving": case.moving} | answer), flush=True)
