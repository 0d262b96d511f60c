"""Data without noise, without motion or of extreme size: rounding errors decide no sentence."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.validation.feedback_and_delay.sims import sims
from scipy.signal import lfilter

from tests.drawn_degenerate import KINDS, codes, drawn_cases, false_sentences

_FLAGS = Path("/proc/cpuinfo").read_text(encoding="utf-8")
KERNELS = ["Haswell", "Nehalem"] + ["SkylakeX"] * ("avx512f" in _FLAGS)
_ALONE = {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(Path(__file__).parents[3])}
if "avx2" not in _FLAGS:
    KERNELS = []  # another make of processor has kernels of its own


def fresh_seed() -> int:
    return int(np.random.default_rng().integers(1_000_000))


def test_no_sentence_contradicts_the_construction_of_the_data() -> None:
    """One case of each kind, from a fresh seed."""
    seed = fresh_seed()
    for i, case in enumerate(drawn_cases(seed, len(KINDS))):
        false = false_sentences(case.kind, case.moving, codes(case.data))

        assert not false, f"seed {seed}, case {i}, {case.kind}: {false}"


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("seed", "allowed"),
    [(5, 0), (972809, 0), (fresh_seed(), 1)],
    ids=["seed 5", "seed 972809", "fresh"],
)
def test_each_kernel_of_openblas_gives_the_same_codes(seed: int, allowed: int) -> None:
    """10 cases of each seed, and a search in two of them.

    Two kernels differed in 4 of 550 fresh cases (flat minima, outliers that change in turn).
    """
    asked = ["--seed", str(seed), "--count", "10", "--search", "2"]
    answers = _answers_by_kernel(asked)

    differing = [
        (lines[0]["i"], lines[0]["kind"], name)
        for lines in zip(*answers, strict=True)
        for name in lines[0]
        if any(line[name] != lines[0][name] for line in lines)
    ]
    assert len({i for i, *_ in differing}) <= allowed, f"seed {seed}: {differing}"
    assert not [line["false"] for line in next(iter(answers), []) if line["false"]]


def _answers_by_kernel(asked: list[str]) -> list[list[dict[str, Any]]]:
    running = [
        subprocess.Popen(
            [sys.executable, "-m", "tests.drawn_degenerate", *asked],
            env={**os.environ, **_ALONE, "OPENBLAS_CORETYPE": kernel},
            stdout=subprocess.PIPE,
            text=True,
        )
        for kernel in KERNELS
    ]
    outputs = [process.communicate()[0] for process in running]
    assert all(process.returncode == 0 for process in running)
    return [[json.loads(line) for line in output.splitlines()] for output in outputs]


def test_real_findings_remain() -> None:
    """A drift, a level, and an outlier of ten deviations of the noise: 2 of 450 are not found."""
    seed = fresh_seed()

    missed = [
        (i, fault) for i in range(4) for fault in missed_findings(np.random.default_rng([seed, i]))
    ]

    assert len(missed) <= 1, f"seed {seed}: {missed}"


def missed_findings(rng: np.random.Generator) -> list[str]:
    """Draw a noisy plant with three faults, and return the faults that `advice` does not name."""
    N, pole, noise = int(rng.integers(400, 1200)), rng.uniform(0.5, 0.95), 0.05
    size = 10.0 ** rng.uniform(-9, 6)
    u = armrig.telegraph(N, 0.1, low=0.5, high=4.5, seed=int(rng.integers(1e6)))
    y = lfilter([0, 1 - pole], [1, -pole], u) + noise * rng.standard_normal(N)
    ramp = 20 * noise * np.linspace(0, 1, N)
    at = int(rng.integers(N // 4, 3 * N // 4))
    spike = 10 * noise * np.eye(1, N, at)[0]
    faults = {"drift": y + ramp, "level": y + 3.0, "outliers": y + spike}
    missed = []
    for name, faulty in faults.items():
        data = armrig.Dataset(u=u, y=size * faulty, Ts=0.01)
        said = {f.about for f in armrig.advice(data).findings if f.level != "good"}
        if name not in said or (name == "outliers" and armrig.hampel(data).valid[at]):
            missed.append(name)
    return missed


def test_what_is_left_of_exact_data_is_explained_by_no_later_input() -> None:
    """Blocks of an exact response are repeated: only u(t) explains the jumps between them."""
    *_, case = drawn_cases(75676, 6)

    assert sims(case.data).p_later == 1.0
