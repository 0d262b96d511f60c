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


def test_every_second_worker_compiles_from_the_end_and_runs_the_same_order(
    pytester: pytest.Pytester,
) -> None:
    module = "print('compiled', __name__)\ndef test_first(): pass\ndef test_second(): pass"
    pytester.makepyfile(**{"test_a": module, "test_b": module})
    pytester.mkpydir("test_folder").joinpath("test_c.py").write_text(module)
    as_collected, compiled = [], []
    for worker, *arguments in (
        ["gw0"],
        ["gw1"],
        ["gw10", "."],
        ["gw11", "."],
        ["gw0", "test_folder", "test_b.py", "test_a.py"],
        ["gw1", "test_folder", "test_b.py", "test_a.py"],
    ):
        pytester.makeconftest(
            f"def pytest_configure(config): config.workerinput = {{'workerid': '{worker}'}}"
        )
        ran = pytester.runpytest_inprocess(
            *("-p", "tests.order", "-p", "no:cacheprovider", "-p", "no:xdist"),
            *("-s", "--collect-only", *arguments),
        )
        as_collected.append([line for line in ran.outlines if "<" in line])
        compiled.append([line[-1] for line in ran.outlines if line.startswith("compiled")])

    assert compiled == [["a", "b", "c"], ["c", "b", "a"]] * 2 + [["c", "b", "a"]] * 2
    assert as_collected[0] == as_collected[1] == as_collected[2] == as_collected[3]
    assert as_collected[4] == as_collected[5] != as_collected[0]


def test_a_failure_shows_what_ran_before_it(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_first(): pass\ndef test_second(): assert False")

    ran = pytester.runpytest_inprocess("-p", "tests.order", "-p", "no:cacheprovider")

    ran.stdout.fnmatch_lines(
        ["the only process, order as collected, 1 tests before*", "*::test_first"]
    )
