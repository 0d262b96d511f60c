"""The numbers of every public function have not changed.

Other tests prove that numbers are right; this one proves that they are what they were. It compares
each number that the calls of tests/same_numbers_calls.py lead to with the stored file. After a
change of numbers that is meant, `make stored` writes the file again, and its difference belongs in
the same commit.
"""

from __future__ import annotations

import armrig
import pytest

from tests import same_numbers, same_numbers_calls
from tests.sampling import without_slow

BEFORE = same_numbers.read_stored()
SLOW = {"structure_hints", "bj", "oe", "MultivariableFit", "report", "compare", "search", "summary"}


@pytest.mark.parametrize("call", without_slow(same_numbers_calls.CALLS, lambda call: call in SLOW))
def test_the_numbers_equal_the_stored_numbers(call: str) -> None:
    changed = list(same_numbers.changes(call, BEFORE))

    advice = "; if that is meant: make stored"
    assert not changed, f"{len(changed)} numbers changed{advice}\n" + "\n".join(changed[:12])


def test_every_public_name_is_called() -> None:
    calls, others = same_numbers_calls.CALLS.keys(), same_numbers_calls.NOT_CALLED.keys()

    public = {*armrig.__all__, *armrig.control.__all__, *armrig.physics.__all__}
    missing = public - calls - others
    assert not missing, (
        f"add a function that calls {', '.join(sorted(missing))} of armrig to "
        "tests/same_numbers_calls.py, marked with @variants, or the reason to NOT_CALLED"
    )


def test_the_stored_file_contains_only_lines_of_existing_calls() -> None:
    assert {name.split(" ")[0] for name in BEFORE} <= same_numbers_calls.CALLS.keys()
