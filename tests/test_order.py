"""The order of the tests."""

from __future__ import annotations

import pytest

pytest_plugins = ["pytester"]
N = 12
SEED = "2"  # the other module first


def names(pytester: pytest.Pytester, *options: str) -> list[str]:
    """Return the tests of two modules in the order in which they run."""
    test = f"import pytest\n@pytest.mark.parametrize('n', range({N}))\ndef test_it(n): pass"
    pytester.makepyfile(test_a=test, test_b=test)
    ran = pytester.runpytest_inprocess(
        "-p", "tests.order", "-p", "no:cacheprovider", "-v", *options
    )
    return [line.split()[0] for line in ran.outlines if " PASSED" in line]


def test_a_seed_draws_one_order(pytester: pytest.Pytester) -> None:
    as_collected = names(pytester)

    drawn = names(pytester, "--order-seed", SEED)

    assert drawn[N:] != as_collected[:N]
    assert sorted(drawn[N:]) == sorted(as_collected[:N])
    assert sorted(drawn[:N]) == sorted(as_collected[N:])
    assert names(pytester, "--order-seed", SEED) == drawn


def test_a_failure_shows_what_ran_before_it(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_first(): pass\ndef test_second(): assert False")

    ran = pytester.runpytest_inprocess("-p", "tests.order", "-p", "no:cacheprovider")

    ran.stdout.fnmatch_lines(
        ["the only process, order as collected, 1 tests before*", "*::test_first"]
    )
