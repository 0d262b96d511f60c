"""Random and mutated bytes into the core, under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import re
import subprocess

import pytest

from tests.firmware import library
from tests.tools import needs

pytestmark = needs("cc", "make")


def fuzz(n_bytes: int, seed: int, *constants: str) -> dict[str, int]:
    """Return the result; `boards/pc/fuzz.c` has the requirements."""
    program = library.build("fuzz", *constants)
    done = subprocess.run(
        [program, str(n_bytes), str(seed)], capture_output=True, text=True, check=False, timeout=600
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return {
        name: int(n) for name, n in re.findall(r"([a-z][a-z0-9 ]*?) (\d+)(?:, |\n)", done.stdout)
    }


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "constants",
    [
        (),
        pytest.param(("BOARD_QUEUE=64",), marks=pytest.mark.exhaustive),
        pytest.param(("BOARD_PWM_BITS=16",), marks=pytest.mark.exhaustive),
    ],
)
def test_random_bytes_violate_no_invariant_of_the_core(constants: tuple[str, ...]) -> None:
    found = fuzz(3_000_000, 1, *constants)

    assert found["bytes"] >= 3_000_000
    assert all(found[f"state {n}"] > 100 for n in range(2, 8)), found
    assert all(found[f"fault {n}"] for n in (4, 5, 6, 7, 8, 10)), found
    assert found["latches"] > 10_000
    assert found["cals"] > 10


@pytest.mark.exhaustive
def test_a_different_seed_sends_different_bytes() -> None:
    assert fuzz(100_000, 1) == fuzz(100_000, 1) != fuzz(100_000, 2)
