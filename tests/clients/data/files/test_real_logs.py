"""Logs as people have them: their clocks, numbers and faults are read right, or refused."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.data.step import DOUBT, codes_of
from armrig.numerics.polynomial import apply_filter
from armrig_core.errors import FileError
from numpy.typing import NDArray

Vector = NDArray[np.float64]
K = np.arange(200.0)


def plant(N: int) -> tuple[Vector, Vector]:
    """Return u and y of y = 0.2/(q - 0.9) u + 20 + e."""
    rng = np.random.default_rng(1)
    u = armrig.telegraph(N, 0.1, low=1, high=3, seed=rng)
    return u, 20 + apply_filter([0, 0.2], [1, -0.9], u) + 0.02 * rng.standard_normal(N)


def log(
    path: Path,
    times: Sequence[object],
    *,
    header: str = "time,u,y",
    rows: Sequence[int] | NDArray[Any] | None = None,
) -> Path:
    u, y = plant(len(times))
    lines = [f"{t},{u[k]:.0f},{y[k]:.4f}" for k, t in enumerate(times)]
    taken = range(len(lines)) if rows is None else rows
    path.write_text("\n".join([header, *(lines[k] for k in taken)]))
    return path


def saved(folder: Path, u: Vector, y: Vector) -> Path:
    """Write t, u and y every 0.1 s."""
    table = np.column_stack([0.1 * np.arange(u.size), u, y])
    np.savetxt(folder / "a.csv", table, "%.3f", ",", header="t,u,y", comments="")
    return folder / "a.csv"


def good(data: armrig.Dataset, Ts: float, *, starts: Sequence[int] = (0,)) -> None:
    """Fail unless the data have this grid and the rows of the plant, to the digits of the log."""
    u, y = plant(200)
    assert (data.Ts, tuple(data.starts)) == (pytest.approx(Ts, rel=1e-9), tuple(starts))
    np.testing.assert_array_equal(data.u, u)
    np.testing.assert_allclose(data.y, y, atol=6e-4)


@pytest.mark.parametrize(
    ("header", "times"),
    [
        ("time_ms,u,y", 10 * K),
        ("Time(ms),u,y", 10 * K),
        ("t/ms,u,y", 10 * K),
        ("millis,u,y", 10 * K),
        ("millis(),u,y", 10 * K),
        ("micros(),u,y", 10_000 * K),
        ("tout,u,y", [f"{0.01 * k:.2f}" for k in K]),
        ("X_Value,u,y", [f"{0.01 * k:.2f}" for k in K]),
        ("Datum/Zeit,u,y", [f"{0.01 * k:.2f}" for k in K]),
        ("Elapsed Time,u,y", [f"{0.01 * k:.2f}" for k in K]),
        ("t_us,u,y", 10_000 * K),
        ("Elapsed [ms],u,y", 10 * K),
        ("timestamp,u,y", 1_711_846_800_000 + 10 * K),
        ("time,u,y", 1_711_846_800_000_000 + 10_000 * K),
        ("time,u,y", [f"{1_711_846_800 + 0.01 * k:.2f}" for k in K]),
        ("Time in ms,u,y", 10 * K),
        ("time [msec.],u,y", 10 * K),
        ("micros,u,y", (2.0**32 - 500_000 + 10_000 * K) % 2**32),
        ("time,u,y", [f"{737_000 + 0.01 * k / 86_400:.12f}" for k in K]),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_the_unit_of_a_column_follows_from_its_name_or_its_size(
    header: str, times: Sequence[object], tmp_path: Path
) -> None:
    shown = [f"{t:.0f}" if isinstance(t, float) else t for t in times]

    good(armrig.load_data(log(tmp_path / "a.csv", shown, header=header)), 0.01)


def test_the_default_unit_of_seconds_is_reported_if_it_is_ambiguous(tmp_path: Path) -> None:
    slow = armrig.load_data(log(tmp_path / "a.csv", [f"{10 * k:.0f}" for k in K]))
    fast = armrig.load_data(log(tmp_path / "b.csv", [f"{0.1 * k:.1f}" for k in K]))

    assert slow.history == ("the times in column time have no unit: read as s",)
    assert (slow.Ts, fast.Ts, fast.history) == (10, 0.1, ())


def stamps(text: str, step_s: float = 1.0, jump: int = 0) -> list[str]:
    """Return 200 times of day from half a minute before 2 o'clock in local time."""
    at = datetime(2024, 3, 30, 1, 59, 30)
    moved = [timedelta(seconds=step_s * k + (jump if k * step_s >= 30 else 0)) for k in K]
    return [f"{at + m:{text}}" for m in moved]


@pytest.mark.parametrize(
    ("text", "Ts", "jump", "note"),
    [
        ("%Y-%m-%dT%H:%M:%S", 1, 0, ""),
        ("%d.%m.%Y %H:%M:%S", 1, 0, ""),
        ("%m/%d/%Y %I:%M:%S %p", 1, 0, ""),
        ("%d-%b-%Y %H:%M:%S", 1, 0, ""),
        ("%Y%m%dT%H%M%S", 1, 0, ""),
        ("%Y/%m/%d %H:%M:%S", 1, 0, ""),
        ("%H:%M", 60, 0, "times such as 01:59 are read as hours:minutes"),
        ("%M:%S.%f", 0.1, 0, ""),
        ("%H:%M:%S.%f", 0.1, 0, ""),
        ("%H:%M:%S", 600, 0, ""),
        ("%Y-%m-%d %H:%M:%S", 1, 3600, "the clock goes forward by 1 h"),
        ("%H:%M:%S", 1, -3600, "the clock goes back by 1 h"),
    ],
)
def test_dates_and_times_of_day_are_read(
    text: str, Ts: float, jump: int, note: str, tmp_path: Path
) -> None:
    data = armrig.load_data(log(tmp_path / "a.csv", stamps(text, Ts, jump)))

    good(data, Ts)
    assert note in "".join(data.history)
    assert bool(note) == bool(data.history)


@pytest.mark.parametrize("resample", [False, True])
@pytest.mark.parametrize("text", ["%H:%M", "%d.%m.%Y %H:%M", "%Y-%m-%dT%H:%M"])
def test_several_rows_in_each_minute_are_even(text: str, resample: bool, tmp_path: Path) -> None:
    """Times without seconds have a last digit of one minute; no row is left out."""
    data = armrig.load_data(log(tmp_path / "a.csv", stamps(text, 7)), resample=resample)

    good(data, 7)
    assert "last digit of 60 s; Ts is their mean interval" in "".join(data.history)


def test_rows_that_a_resampling_leaves_out_are_counted(tmp_path: Path) -> None:
    """After a gap, no mean interval fits the stamps of one minute."""
    times = [f"{(60 * (k // 12) + 7200 * (k >= 96)):.0f}" for k in range(192)]
    data = armrig.load_data(log(tmp_path / "a.csv", times, header="t,u,y"), resample=True)

    assert "left out 176 rows with the time of the row before" in data.history
    assert codes_of(data.history)[-1] == DOUBT


def test_a_mean_interval_of_few_minutes_causes_a_warning(tmp_path: Path) -> None:
    short = armrig.load_data(log(tmp_path / "a.csv", stamps("%H:%M", 3)))
    long = armrig.load_data(log(tmp_path / "b.csv", stamps("%H:%M", 12)))

    assert short.Ts == 3
    assert [DOUBT in codes_of(data.history[-1:]) for data in (short, long)] == [True, False]


@pytest.mark.parametrize("step_s", [1, 5, 20, 30, 60, 900])
@pytest.mark.parametrize("text", ["%H%M%S", "%Y%m%d%H%M%S", "%H.%M"])
def test_digits_of_a_clock_are_not_seconds(text: str, step_s: int, tmp_path: Path) -> None:
    if (text == "%H.%M") != (step_s >= 60):
        return
    path = log(tmp_path / "a.csv", stamps(text, step_s))

    with pytest.raises(FileError, match=r"go from .* to .*, as digits of a clock: write them"):
        armrig.load_data(path)


def test_a_date_in_a_separate_column_is_added_to_the_time(tmp_path: Path) -> None:
    times = [f"2024-03-{1 + k // 24:02.0f},{k % 24:02.0f}:00:00" for k in K]
    path = log(tmp_path / "a.csv", times, header="date,time,u,y")

    good(armrig.load_data(path), 3600)


def shifted(t: Vector, where: Sequence[int], by: float) -> list[str]:
    """Return times of which some rows are late."""
    t = t.copy()
    t[list(where)] += by
    return [f"{x:.4f}" for x in t]


@pytest.mark.parametrize(
    ("times", "Ts", "starts", "note"),
    [
        (shifted(0.1 * K, [17, 90, 91], 0.03), 0.1, (0,), "4 of 199 intervals differ from 0.1 s"),
        (shifted(3.003 * K, range(40, 200), 0.202), 3.003, (0,), "at most by 0.202 s (7 %)"),
        (shifted(0.1 * K, range(40, 200), 60.0), 0.1, (0, 40), "line 42: a gap of 60.1 s"),
        (shifted(0.1 * K, range(40, 200), -4.0), 0.1, (0, 40), "the time goes back by 3.9 s"),
        ([f"{0.1 * k:.0f}" for k in K], 0.1, (0,), "have a last digit of 1 s"),
        ([f"{1.04 * k // 1:.0f}" for k in K], 1.04, (0,), "have a last digit of 1 s"),
        ([f"{0.9 * k // 1:.0f}" for k in K], 0.9, (0,), "have a last digit of 1 s"),
        ([f"{k * 0.01 + k // 7 * 0.001:.3f}" for k in K], 0.010141, (0,), ""),
    ],
    ids=["late", "longer", "gap", "again", "whole seconds", "1.04 s", "0.9 s", "millis"],
)
def test_a_row_lies_on_the_grid_of_all_rows(
    times: list[str], Ts: float, starts: tuple[int, ...], note: str, tmp_path: Path
) -> None:
    data = armrig.load_data(log(tmp_path / "a.csv", times))

    assert note in "; ".join(data.history)
    assert (data.N, data.Ts, data.starts) == (200, pytest.approx(Ts, rel=1e-4), starts)


def test_rows_that_the_file_leaves_out_are_missing(tmp_path: Path) -> None:
    times = [f"{0.1 * k:.1f}" for k in K]
    u, _ = plant(200)
    same = next(k for k in range(50, 190) if u[k - 1] == u[k] == u[k + 1] == u[k + 2])
    other = next(k for k in range(50, 190) if u[k - 1] != u[k + 1])
    for left_out, N, starts, missing in (([same, same + 1], 200, 1, 2), ([other], 199, 2, 0)):
        rows = np.delete(np.arange(200), left_out)
        data = armrig.load_data(log(tmp_path / "a.csv", times, rows=rows))

        assert (data.N, len(data.starts), data.missing) == (N, starts, missing)
        assert "put in" in "".join(data.history)
    held = armrig.load_data(tmp_path / "a.csv", hold_input=True)
    assert (held.N, len(held.starts), held.missing) == (200, 1, 1)


def test_a_given_sampling_time_keeps_gaps_and_is_compared_with_the_times(tmp_path: Path) -> None:
    path = log(tmp_path / "a.csv", shifted(0.1 * K, range(100, 200), 60.0))

    data = armrig.load_data(path, Ts=1.0)

    good(data, 1.0, starts=(0, 100))
    assert "used the given Ts = 1 s, although the times are 0.1 s apart" in data.history[0]


def test_uneven_times_are_resampled_only_if_asked(tmp_path: Path) -> None:
    t = np.cumsum(np.random.default_rng(1).uniform(0.05, 0.15, 200))
    path = log(tmp_path / "a.csv", [f"{x:.4f}" for x in t])

    with pytest.raises(FileError, match=r"of 199 intervals are not .* Give --resample"):
        armrig.load_data(path)
    data = armrig.load_data(path, resample=True, Ts=0.1)

    assert pytest.approx((t[-1] - t[0]) / 0.1, abs=1) == data.N
    assert "resampled 200 rows" in data.history[0]
    assert "each row as one sample although" in armrig.load_data(path, Ts=0.1).history[0]


@pytest.mark.parametrize(
    ("cells", "mark", "read"),
    [
        ("298 1,493 1,2", None, [298, 1.493, 1.2]),
        ("298 1,493.5 12", None, [298, 1493.5, 12]),
        ("298 1.493,5 1.493", None, [298, 1493.5, 1493]),
        ("1,234,567 1,493 7", None, [1234567, 1493, 7]),
        ("1.493 1.250 2.000", ".", [1.493, 1.25, 2]),
        ("0 1.125 2", None, [0, 1.125, 2]),
        ("0,125 1,125 2,000", None, [0.125, 1.125, 2]),
        ("298 1'493 12", None, [298, 1493, 12]),
        ("298 1,493 640", None, None),
        ("298 1.493 640", None, None),
        ("1.493 1.250 2.000", None, None),
        ("298 1,493 640", ",", [298, 1.493, 640]),
        ("298 1,493 640", ".", [298, 1493, 640]),
    ],
)
@pytest.mark.parametrize("separator", [";", "\t"])
def test_the_notation_of_a_column_decides_how_a_number_is_read(
    cells: str, mark: Any, read: list[float] | None, separator: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.csv"
    rows = [f"{k}{separator}{k % 2}{separator}{cell}" for k, cell in enumerate(cells.split())]
    path.write_text("\n".join([separator.join("tuy"), *rows]))

    if read is None:
        with pytest.raises(FileError, match=r"'1[,.]493' may be 1.493 or 1493.*--decimal"):
            armrig.load_data(path, decimal=mark)
    else:
        assert armrig.load_data(path, decimal=mark).y.tolist() == read


def test_another_column_decides_on_the_decimal_mark(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    for time, thousand in (("0,{}", 1.493), ("0.{}", 1493)):
        rows = [f"{time.format(k)};1;1,493" for k in range(3)]
        path.write_text("\n".join(["t;u;y", *rows]))
        assert armrig.load_data(path).y[0] == thousand


@pytest.mark.parametrize(
    ("header", "comma"),
    [("sep=;\ntime;u;y", True), ("time\tu\ty", True), ("time u y", True), ("time u y", False)],
)
def test_the_separator_is_the_one_that_splits_the_lines(
    header: str, comma: bool, tmp_path: Path
) -> None:
    path = tmp_path / "a.txt"
    u, y = plant(200)
    mark = header[-2]
    rows = [f"{0.1 * k:.1f}{mark}{u[k]:.1f}{mark}{y[k]:.3f}" for k in range(200)]
    text = "\n".join([header, *rows])
    path.write_text(text.replace(".", ",") if comma else text)

    good(armrig.load_data(path), 0.1)


@pytest.mark.parametrize("modulus", [256.0, 1000.0, 2000.0, 4096.0, 65536.0, 360.0])
def test_a_counter_that_wraps_is_named_and_unwrapped(modulus: float, tmp_path: Path) -> None:
    u, rate = plant(400)
    counts = np.cumsum(rate - 10) * modulus / 150
    np.savez(tmp_path / "a.npz", u=u, y=counts % modulus, Ts=0.1)

    found = armrig.load_data(tmp_path / "a.npz")
    mended = armrig.load_data(tmp_path / "a.npz", unwrap=modulus)

    assert f"y jumps by {modulus:g} at " in found.history[0]
    np.testing.assert_allclose(np.diff(mended.y), np.diff(counts), atol=1e-6 * modulus)


def test_an_unusual_range_is_not_guessed(tmp_path: Path) -> None:
    u, rate = plant(400)
    counts = np.cumsum(rate - 10) * 9

    (note,) = armrig.load_data(saved(tmp_path, u, np.floor(counts % 1337))).history

    assert "y jumps by about 13" in note
    assert note.endswith("give --unwrap with the range of the counter")


@pytest.mark.parametrize(
    ("text", "how", "said"),
    [
        ("t,u,y\n0,1,0.5\n1,1,0.25\n", {"decimal": ","}, "'0.5' has another decimal mark than"),
        ("t,u,y\n0,1,1\n1,1,2\n2,1,3\n", {"resample": True, "Ts": 1e-6}, "give a larger --Ts"),
        ("t,u,y\n0,1,1\n1,1,2\n", {"Ts": -1.0}, "Ts=-1.0 must be finite and > 0, in s"),
        ("t,u,y\n0,1,1\n1,1,9\n2,1,3\n", {"unwrap": 1e-9}, "give the range of the counter"),
        ("t,u,y\n0,1,1\n1,1,9\n2e300,1,3\n", {}, "cover 2e\\+300 s, but 1e-09 to 1e\\+11 s"),
        ("t,u,y\n0,1,1\n1e-300,1,9\n2e-300,1,3\n", {}, "cover 2e-300 s, but 1e-09 to"),
    ],
)
def test_an_option_that_contradicts_the_file_is_refused(
    text: str, how: dict[str, Any], said: str, tmp_path: Path
) -> None:
    (tmp_path / "a.csv").write_text(text)

    with pytest.raises(FileError, match=said):
        armrig.load_data(tmp_path / "a.csv", **how)


@pytest.mark.parametrize(("low", "high"), [(0, 1023), (-5, 5), (20.8, 100)])
def test_samples_at_a_rail_are_named_and_masked(low: float, high: float, tmp_path: Path) -> None:
    u, y = plant(400)
    scaled = np.clip((y - y.mean()) / 2 * (high - low) * 1.2 + (low + high) / 2, low, high)
    rails = np.count_nonzero((scaled == low) | (scaled == high))
    path = saved(tmp_path, u, scaled)

    found, masked = armrig.load_data(path), armrig.load_data(path, mask_rails=True)

    assert f"{rails} of 400 samples of y are exactly " in found.history[0]
    assert (found.missing, masked.missing) == (0, rails)


def test_a_slow_signal_at_a_rail_is_named(tmp_path: Path) -> None:
    u, y = plant(400)
    counts = np.clip(np.rint(20 * (y - y.mean())), None, 5)

    (note,) = armrig.load_data(saved(tmp_path, u, counts)).history

    assert f"{np.count_nonzero(counts == 5)} of 400 samples of y are exactly 5" in note


@pytest.mark.parametrize("rows", [2, 4])
@pytest.mark.parametrize("name", ["u", "y"])
def test_values_that_are_read_less_often_than_written_are_named(
    name: str, rows: int, tmp_path: Path
) -> None:
    table = {"u": np.random.default_rng(1).standard_normal(400), "y": plant(400)[1]}
    table[name] = np.repeat(table[name], rows)[:400]
    np.savez(tmp_path / "a.npz", Ts=1.0, **table)

    (note,) = armrig.load_data(tmp_path / "a.npz").history

    assert note.startswith(f"each value of {name} is in {rows} rows")


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_settled_level_of_y_is_not_a_rail(noise: float, tmp_path: Path) -> None:
    u = np.repeat([1.0, 3.0, 1.0, 3.0], 100)
    x = apply_filter([0, 0.2], [1, -0.9], u)
    x += noise * np.random.default_rng(1).standard_normal(400)

    assert armrig.load_data(saved(tmp_path, u, x)).history == ()


def test_an_input_logged_at_its_changes_is_held_on_request(tmp_path: Path) -> None:
    u, y = plant(200)
    shown = [f"{a:.0f}" if k == 0 or a != u[k - 1] else "" for k, a in enumerate(u)]
    rows = [f"{0.1 * k:.1f},{a},{b:.4f}" for k, (a, b) in enumerate(zip(shown, y, strict=True))]
    (tmp_path / "a.csv").write_text("\n".join(["t,u,y", *rows]))

    with pytest.raises(FileError, match=r"u has a value in \d+ of 200 rows; .* --hold-input"):
        armrig.load_data(tmp_path / "a.csv")
    good(armrig.load_data(tmp_path / "a.csv", hold_input=True), 0.1)
