"""Inputs that cannot harm the rig."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig.excitation import (
    chirp,
    input_from_file,
    multisine,
    prbs,
    staircase,
    step,
    telegraph,
    white_noise,
)
from armrig.excitation.from_file import has_named_columns
from armrig.excitation.named_signals import (
    NAMES,
    check_step_time,
    clock_of,
    details_of,
    realisations,
    signal_by_name,
    step_at,
    up_and_down,
)
from armrig_core.rig.description import Input
from hypothesis import given
from hypothesis import strategies as st


def test_a_telegraph_signal_switches_with_the_requested_probability() -> None:
    """The probability is a per sample, within four standard deviations."""
    N, a = 20_000, 0.05

    u = telegraph(N, a, low=0.0, high=5.0, seed=3)

    switches = np.count_nonzero(np.diff(u))
    assert set(u) == {0.0, 5.0}
    assert abs(switches - a * (N - 1)) < 4 * np.sqrt(a * (1 - a) * N)


def test_the_first_level_is_drawn_with_equal_chances() -> None:
    """Within four standard deviations of 1000 draws."""
    rng = np.random.default_rng(0)

    high = sum(telegraph(1, 0.05, seed=rng)[0] == 4.5 for _ in range(1000))

    assert abs(high - 500) < 4 * np.sqrt(250)


def test_a_step_is_low_before_and_high_from_its_sample_on() -> None:
    np.testing.assert_array_equal(step(4, low=1.0, high=2.0, at=3), [1, 1, 1, 2])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: telegraph(0, 0.1), "N=0 must be an integer >= 1"),
        (lambda: telegraph(10.5, 0.1), "N=10.5 must be an integer >= 1"),  # type: ignore[arg-type]
        (lambda: telegraph("10", 0.1), "N='10' must be an integer >= 1"),  # type: ignore[arg-type]
        (lambda: telegraph(True, 0.1), "N=True must be an integer >= 1"),
        (lambda: telegraph(9, float("nan")), "a=nan is a probability"),
        (lambda: telegraph(9, "0.1"), "a='0.1' must be a number"),  # type: ignore[arg-type]
        (lambda: telegraph(9, 0.1, "0", 2.0), "low='0' must be a number"),  # type: ignore[arg-type]
        (lambda: telegraph(9, 0.1, 0.5, 4.5, -1), "seed=-1 must be an integer >= 0"),
        (lambda: telegraph(9, 0.1, 0.5, 4.5, "x"), "seed='x' must be an integer >= 0"),  # type: ignore[arg-type]
        (lambda: step(4, at=1.5), "at=1.5 must be"),  # type: ignore[arg-type]
        (lambda: step(4, at=-1), "at=-1 must be"),
        (lambda: step(4, at=5), "at=5 must be"),
        (lambda: prbs(9, 0), "clock=0 must be an integer >= 1"),
        (lambda: prbs(9, register=1), "register=1 must be an integer >= 2"),
        (lambda: prbs(9, register=25), "register=25 is more than 24"),
        (lambda: white_noise(9, distribution="pink"), "distribution='pink'"),  # type: ignore[arg-type]
        (lambda: multisine(2), "needs at least 3 samples"),
        (lambda: multisine(10, periods=3), "not a whole number of periods=3; use N=9"),
        (lambda: multisine(10, []), "lines is empty"),
        (lambda: multisine(400, rms=3.0), r"values outside 0.5 to 4.5 V, first u\["),
        (lambda: multisine(10, [5]), "line 5 is above 4"),
        (lambda: multisine(10, [0]), "line=0 must be an integer >= 1"),
        (lambda: multisine(10, rms=0), "rms=0 V must be > 0"),
        (lambda: chirp(9, 0.01, 1.0, 50.0), "to_hz=50.0 must be > 0 and below 50 Hz"),
        (lambda: chirp(9, 0.0, 1.0, 2.0), "Ts=0.0 must be from"),
        (lambda: chirp(9, 0.01, 1.0, 2.0, sweep="up"), "sweep='up'"),  # type: ignore[arg-type]
        (lambda: staircase(2, 3), "3 levels need at least as many samples"),
        (lambda: staircase(9, 1), "levels=1 must be an integer >= 2"),
    ],
)
def test_an_argument_without_a_signal_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


@given(
    st.integers(3, 300),
    st.floats(0, 4.9),
    st.floats(0.01, 5),
    st.integers(0, 2**32),
)
def test_no_signal_leaves_its_interval(N: int, low: float, width: float, seed: int) -> None:
    high = min(low + width, 5.0)
    signals = {
        "telegraph": telegraph(N, 0.3, low, high, seed),
        "prbs": prbs(N, 2, low, high, seed),
        "uniform": white_noise(N, low, high, seed),
        "normal": white_noise(N, low, high, seed, distribution="normal"),
        "multisine": multisine(N, None, low, high, seed),
        "chirp": chirp(N, 0.01, 0.1, 20.0, low, high),
        "logarithmic chirp": chirp(N, 0.01, 20.0, 0.1, low, high, sweep="logarithmic"),
        "step": step(N, low=low, high=high, at=N // 2),
        "staircase": staircase(N, 3, low, high),
    }

    for name, u in signals.items():
        assert u.shape == (N,), name
        assert u.dtype == np.float64, name
        assert low <= u.min() <= u.max() <= high, name


@pytest.mark.parametrize(
    ("make", "arguments"),
    [
        (telegraph, (9, 0.1)),
        (step, (9,)),
        (prbs, (9,)),
        (white_noise, (9,)),
        (multisine, (9,)),
        (chirp, (9, 0.01, 1.0, 2.0)),
        (staircase, (9,)),
    ],
)
@pytest.mark.parametrize(("low", "high"), [(-1.0, 1.0), (0.0, 5.1), (3.0, 2.0), (np.nan, 1.0)])
def test_an_interval_outside_that_of_the_rig_is_refused(
    make: Any, arguments: tuple[Any, ...], low: float, high: float
) -> None:
    with pytest.raises(ValueError, match=r"outside the rig's 0 to 5 V|must be below"):
        make(*arguments, low=low, high=high)


@pytest.mark.parametrize("register", [2, 3, 5, 8, 11])
def test_a_maximal_length_sequence_is_white_over_its_period(register: int) -> None:
    """Its circular autocorrelation is M at lag 0 and -1 at every other; it repeats after M."""
    M = 2**register - 1

    u = prbs(2 * M, low=0.0, high=2.0, register=register) - 1.0

    spectrum = np.abs(np.fft.fft(u[:M])) ** 2
    np.testing.assert_allclose(np.fft.ifft(spectrum).real, [M, *[-1.0] * (M - 1)], atol=1e-9)
    np.testing.assert_array_equal(u[M:], u[:M])


def test_a_clock_holds_each_value() -> None:
    np.testing.assert_array_equal(prbs(21, 3, register=3)[::3], prbs(7, 1, register=3))
    np.testing.assert_array_equal(prbs(21, 3, register=3)[2::3], prbs(7, 1, register=3))


@pytest.mark.parametrize(
    ("N", "clock", "register"), [(60, 10, 3), (70, 10, 3), (71, 10, 4), (3, 1, 2), (4, 1, 3)]
)
def test_a_prbs_has_the_shortest_register_for_its_length(N: int, clock: int, register: int) -> None:
    """Seven clocks fill the period of three bits."""
    expected = prbs(N, clock, seed=5, register=register)

    np.testing.assert_array_equal(prbs(N, clock, seed=5), expected)
    assert not np.array_equal(expected, prbs(N, clock, seed=5, register=register + 1))


@pytest.mark.parametrize("distribution", ["uniform", "normal"])
def test_noise_is_white_and_has_the_stated_variance(distribution: Any) -> None:
    """Lag correlations within four times 1/sqrt(N); variance within 2 % of the documented value."""
    N = 40_000

    u = white_noise(N, 0.0, 3.0, seed=2, distribution=distribution) - 1.5

    r = np.array([u[k:] @ u[: N - k] for k in range(1, 20)]) / (u @ u)
    assert np.abs(r).max() < 4 / np.sqrt(N)
    # A normal law cut off at three standard deviations has 0.9733 of its variance.
    expected = {"uniform": 9 / 12, "normal": 0.25 * 0.9733}[distribution]
    assert np.var(u) == pytest.approx(expected, rel=0.02)


def test_a_multisine_has_power_at_its_lines_only_and_equally() -> None:
    lines = [1, 3, 5, 40]

    u = multisine(600, lines, seed=4, periods=3)

    amplitude = np.abs(np.fft.rfft(u)) / 300
    np.testing.assert_array_equal(u[:200], u[200:400])
    np.testing.assert_allclose(amplitude[[3 * line for line in lines]], amplitude[3], rtol=1e-9)
    amplitude[[0, *(3 * line for line in lines)]] = 0.0
    assert amplitude.max() < 1e-12
    assert max(u.max() - 2.5, 2.5 - u.min()) == pytest.approx(2.0)


def test_realisations_with_the_same_effective_value_differ_in_their_phases_only() -> None:
    """Otherwise their scatter would not be due to the plant alone."""
    spectra = [np.abs(np.fft.rfft(multisine(400, seed=s, rms=0.4))) for s in (1, 2)]

    np.testing.assert_allclose(spectra[0], spectra[1], rtol=1e-9, atol=1e-9)
    assert np.std(multisine(400, seed=1, rms=0.4)) == pytest.approx(0.4)


@pytest.mark.parametrize(("first", "last"), [(1.0, 10.0), (10.0, 1.0), (5.0, 5.0)])
@pytest.mark.parametrize("sweep", ["linear", "logarithmic"])
def test_a_chirp_moves_from_its_first_frequency_to_its_last(
    sweep: Any, first: float, last: float
) -> None:
    Ts, N = 1e-3, 20_000
    u = chirp(N, Ts, first, last, sweep=sweep) - 2.5

    crossings = Ts * np.flatnonzero((u[:-1] < 0) & (u[1:] >= 0))
    share = (crossings[:-1] + crossings[1:]) / 2 / (N * Ts)
    by_share = {
        "linear": first + (last - first) * share,
        "logarithmic": first * (last / first) ** share,
    }
    expected = by_share[sweep]
    np.testing.assert_allclose(1 / np.diff(crossings), expected, rtol=0.03)


@pytest.mark.parametrize(
    ("to_hz", "sweep", "cycles"), [(3.0, "linear", 0.75), (4.0, "logarithmic", 1 / np.log(4))]
)
def test_a_chirp_reaches_its_last_frequency_after_its_last_sample(
    to_hz: float, sweep: Any, cycles: float
) -> None:
    """At N Ts = 1 s; from 1 Hz the integral of the frequency up to 0.5 s is known."""
    u = chirp(10, 0.1, 1.0, to_hz, 0.5, 4.5, sweep=sweep)

    assert u[5] == pytest.approx(2.5 + 2 * np.sin(2 * np.pi * cycles))


def test_a_staircase_holds_each_level_equally_long() -> None:
    np.testing.assert_array_equal(staircase(7, [1, 3, 2]), [1, 1, 1, 3, 3, 2, 2])
    np.testing.assert_array_equal(staircase(4, 2, low=0, high=5), [0, 0, 5, 5])
    np.testing.assert_array_equal(staircase(3, 3, low=1, high=2), [1, 1.5, 2])


@pytest.mark.parametrize(
    "text",
    [
        "t,u\n0,1\n0.01,2\n0.02,3\n",
        "u;t\n1;0\n2;0.01\n3;0.02\n",
        "# mine\n5.00 1\n5.01 2\n\n5.02 3",
        "\ufeff1\n2\n3\n",
        "t [s];u (V)\n0,00;1,0\n0,01;2,0\n0,02;3,0\n",
        "t\tu\ns\tV\n0,00\t1\n0,01\t2\n0,02\t3\n",
    ],
)
def test_a_file_is_read_in_each_common_notation(tmp_path: Path, text: str) -> None:
    path = tmp_path / "u.csv"
    path.write_text(text, encoding="utf-8")

    np.testing.assert_array_equal(input_from_file(path, 0.01), [1, 2, 3])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,u\n0,1\n0.01,2\n0.03,3\n", r"line 4: t=0.03 s, but Ts=0.01 s gives 0.02 s.*0.015 s"),
        ("0,1\n0.005,2\n0.01,3\n", "line 2: t=0.005 s, but Ts=0.01 s gives 0.01 s"),
        ("0,1\n0.010101,2\n", "line 2: t=0.010101 s"),
        ("0,1\nnan,2\n", "line 2: t=nan s"),
        ("t,u\n0,1\n0.01,-1\n0.02,7\n", r"2 of 3 .* V, first in line 3: u=-1 V"),
        ("1\n2\nnan\n", "line 3: u=nan V"),
        ("0,1\n0.01,two\n", "line 2, column 2: 'two' is not a number"),
        ("0,1\n0.01\n", "line 2 has 1 cell"),
        ("0,1,2\n", "3 columns; give u in V, or t in s and u in V"),
        ("t;u\n0;1,5\n0,01;9,5\n", "first in line 3: u=9.5 V"),
        ("t;u\n0;1,234\n1;2,345\n", "may be .* Write 0.5 for a half"),
        ("t;u [mV]\n0;1\n", "u in mV; give t in s and u in V"),
        ("t\n0\n0.02\n0.04\n", "columns t; name them t and u, or one column u"),
        ("0,5\n1,5\n2,5\n", "a comma separates what may be one number"),
        ("time,voltage\n0,1\n", "columns time, voltage; name them t and u"),
        ("", "no row of numbers"),
        ("# mine\n\nt,u\n0,1\n# a remark\n0.01,2\n0.03,3\n", "line 7: t=0.03 s"),
        ("# mine\n\n1\n# a remark\n9\n", r"1 of 2 .* first in line 5: u=9 V \(sample 1\)"),
        ("t,u\n\n0,1\n0.01,one\n", "line 4, column u: 'one' is not a number"),
    ],
)
def test_a_file_that_must_not_be_played_is_refused_by_its_line(
    tmp_path: Path, text: str, message: str
) -> None:
    """Handout, 3.2: u and t must agree with the chosen step size."""
    path = tmp_path / "u.csv"
    path.write_text(text)

    with pytest.raises(ValueError, match=message):
        input_from_file(path, 0.01)


@pytest.mark.parametrize("name", NAMES)
def test_every_input_by_name_has_the_requested_length_and_range(name: str) -> None:
    figures = {"a": 0.05, "low": 1.0, "high": 2.0, "seed": 5}

    u = signal_by_name(name, 700, 0.01, **figures)  # type: ignore[arg-type]
    details = details_of(name, **figures)  # type: ignore[arg-type]
    again = signal_by_name(details.pop("input"), 700, 0.01, **(figures | details))

    assert u.shape == (700,)
    assert 1 <= u.min() < u.max() <= 2
    assert np.abs(u - 1.5).max() > 0.49
    np.testing.assert_array_equal(u, again)


def test_an_input_by_name_equals_that_of_its_function() -> None:
    """A telegraph of probability 0.1 switches as often as a prbs of five samples."""
    expected = {
        "telegraph": telegraph(90, 0.1, 1.0, 2.0, 3),
        "prbs": prbs(90, 5, 1.0, 2.0, 3),
        "white": white_noise(90, 1.0, 2.0, 3),
        "multisine": multisine(90, None, 1.0, 2.0, 3),
    }

    for name, u in expected.items():
        made = signal_by_name(name, 90, 0.01, a=0.1, low=1.0, high=2.0, seed=3)
        np.testing.assert_array_equal(made, u, err_msg=name)
    assert [clock_of(a) for a in (0.5, 0.3, 0.1, 0.011)] == [1, 2, 5, 45]
    for a in (0.0, 0.51, float("nan")):
        with pytest.raises(ValueError, match="a probability of more than 0, at most"):
            clock_of(a)


def test_a_fifo_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "u.csv")

    with pytest.raises(OSError, match="not a regular file"):
        input_from_file(tmp_path / "u.csv", Ts=1.0)


def test_a_file_of_a_windows_editor_is_read(tmp_path: Path) -> None:
    path = tmp_path / "u.csv"
    path.write_text("t,u\r\n0,1\r\n1,2\r\n", encoding="utf-8-sig")

    np.testing.assert_array_equal(input_from_file(path, Ts=1.0), [1.0, 2.0])
    path.write_text("t,u\n0,1\n1,2\n", encoding="utf-16")
    with pytest.raises(
        ValueError, match=r"u\.csv: it is saved as UTF-16: save it as UTF-8, as a CSV$"
    ):
        input_from_file(path, Ts=1.0)
    path.write_bytes(b"t,u\n0,1 \xb5V\n")
    with pytest.raises(ValueError, match=r"u\.csv: line 2 is not UTF-8: save it as UTF-8"):
        input_from_file(path, Ts=1.0)


@pytest.mark.parametrize(
    ("at", "Ts", "first"),
    [(0.0, 0.01, 0), (0.29, 0.01, 29), (0.3, 0.1, 3), (0.996, 0.01, 99), (0.0007, 0.001, 1)],
)
def test_a_step_at_a_time_is_at_the_nearest_sample_and_never_beyond_the_last(
    at: float, Ts: float, first: int
) -> None:
    """0.29 s / 0.01 s is 28.999999999999996."""
    u = step_at(100, Ts, low=1.0, high=2.0, at=at)

    np.testing.assert_array_equal(u, np.where(np.arange(100) < first, 1.0, 2.0))


@pytest.mark.parametrize(
    ("at", "said"),
    [
        (-0.1, "-0.1 must be a number of seconds, 0 or more"),
        (float("nan"), "nan must be a number of seconds"),
        (2.0, "2 s at the end, 2 s; step earlier"),
        (2.5, "2.5 s after the end, 2 s; step earlier or record longer"),
    ],
)
def test_a_step_outside_the_run_is_refused(at: float, said: str) -> None:
    check_step_time(0.0, 2.0)
    check_step_time(1.99, 2.0)
    with pytest.raises(ValueError, match="at") as found:
        check_step_time(at, 2.0)
    assert said in " ".join(str(found.value).replace(":", " ").replace("=", " ").split())


def test_up_and_down_reaches_the_top_once() -> None:
    assert up_and_down(5, low=1.0, high=3.0, levels=3).tolist() == [1, 2, 3, 2, 1]
    assert up_and_down(6, low=0.0, high=4.0, levels=2).tolist() == [0, 0, 4, 4, 0, 0]


def test_a_logarithmic_chirp_by_name_ends_at_half_of_the_nyquist_frequency() -> None:
    """It covers two decades, whatever the sampling time."""
    for Ts in (0.01, 0.002):
        u = signal_by_name("chirp", 500, Ts, a=0.05, low=1.0, high=2.0, seed=1)

        expected = chirp(500, Ts, 0.0025 / Ts, 0.25 / Ts, 1.0, 2.0, sweep="logarithmic")
        np.testing.assert_allclose(u, expected)


def test_realisations_have_the_seeds_that_follow_each_other() -> None:
    """The power of one multisine alone is the largest that fits."""
    first, second = realisations(400, 2, 1.0, 3.0, 7, periods=2)
    (alone,) = realisations(400, 1, 1.0, 3.0, 8, periods=2)

    lines = range(1, 51)
    np.testing.assert_allclose(alone, multisine(400, lines, 1.0, 3.0, 8, periods=2))
    for u, seed in ((first, 7), (second, 8)):
        ratio = (u - 2) / (multisine(400, lines, 1.0, 3.0, seed, periods=2) - 2)
        np.testing.assert_allclose(ratio, ratio[0])


def test_a_column_with_the_inputs_name_has_its_own_value(tmp_path: Path) -> None:
    power = Input(name="power", unit="%", per_volt=20.0)
    (tmp_path / "own.csv").write_text("t [s],power [%]\n0,0\n0.01,60\n")

    assert input_from_file(tmp_path / "own.csv", 0.01, input=power).tolist() == [0.0, 3.0]
    assert has_named_columns(tmp_path / "own.csv")
    with pytest.raises(ValueError, match=r"columns t, power; name them t and u"):
        input_from_file(tmp_path / "own.csv", 0.01)
    (tmp_path / "own.csv").write_text("t,power [V]\n0,0\n0.01,6\n")
    with pytest.raises(ValueError, match=r"power in V; give t in s and power in %"):
        input_from_file(tmp_path / "own.csv", 0.01, input=power)
