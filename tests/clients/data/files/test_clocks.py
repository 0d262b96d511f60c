"""Clocks of tables: several columns of times, several files, sparse rows, order and units."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.data.files.clocks import on_one_clock
from armrig.data.files.table import Column, ReadingError, Table
from armrig.data.files.text import read_text
from armrig.data.step import DOUBT, codes_of
from armrig_core.errors import FileError
from numpy.typing import NDArray

Vector = NDArray[np.float64]
N = 200
T: Vector = 0.01 * np.arange(N, dtype=np.float64)
U = np.repeat(np.random.default_rng(1).integers(1, 6, N // 5), 5).astype(np.float64)
Y = 20 + np.cumsum(np.random.default_rng(2).standard_normal(N)).round(4)


def text(columns: dict[str, Any]) -> str:
    """Return a table; a shorter column has empty cells below its end."""
    rows = max(map(len, columns.values()))
    cells = [[*map(str, x), *[""] * (rows - len(x))] for x in columns.values()]
    return "\n".join([",".join(columns), *map(",".join, zip(*cells, strict=True))])


def held(t: Vector, t_u: Vector) -> Vector:
    """Return the newest u at each time; NaN before the first."""
    k = np.searchsorted(t_u, t + 1e-9, side="right") - 1
    return np.where(k < 0, np.nan, U[np.clip(k, 0, None)])


def seconds(t: Any) -> list[str]:
    return [f"{x:.4f}" for x in t]


def dates(t: Any, form: str = "%Y-%m-%d %H:%M:%S.%f") -> list[str]:
    begin = datetime(2025, 3, 11, 23, 59, 59)
    return [f"{begin + timedelta(seconds=float(x)):{form}}" for x in t]


def load(tmp_path: Path, content: str, **how: Any) -> armrig.Dataset:
    path = tmp_path / "a.csv"
    path.write_text(content)
    return armrig.load_data(path, **how)


def first_is_doubt(data: armrig.Dataset, begin: str) -> None:
    assert data.history[0].startswith(begin)
    assert codes_of(data.history)[0] == DOUBT


def same_data(data: armrig.Dataset, u: Vector, y: Vector = Y, Ts: float = 0.01) -> None:
    known = ~np.isnan(u)
    assert pytest.approx(Ts, rel=1e-6) == data.Ts
    np.testing.assert_array_equal(data.u, u[known])
    np.testing.assert_allclose(data.y, y[known], atol=1e-9)


@pytest.mark.parametrize(
    ("names", "form"),
    [
        (("t_u", "t_y"), seconds),
        (("Time1", "Time2"), seconds),
        (("time (u)", "time (y)"), seconds),
        (("time", "time"), dates),
        (("time", "time.1"), seconds),
        (("u time", "y time"), dates),
        (("Date/Time_u", "Date/Time_y"), dates),
        (("t_u_ms", "t_y"), seconds),
    ],
)
@pytest.mark.parametrize("rate", [0.1, 0.5, 1.0, 10.0])
def test_columns_of_another_clock_are_held_to_the_times_of_the_output(
    names: tuple[str, str], form: Callable[[Vector], list[str]], rate: float, tmp_path: Path
) -> None:
    """The rows pair two clocks; they are never paired by row."""
    t_u = 5 + T / rate
    t_y = 5.035 + min(rate, 1) / rate * T
    last = t_y <= t_u[-1] + 3.01 * 0.01 / rate
    scale = 1000.0 if names[0] == "t_u_ms" else 1.0
    cells = text({f"{names[0]} ": form(scale * t_u), "u": U, f"{names[1]}": form(t_y), "y": Y})

    data = load(tmp_path, cells.replace(f"{names[0]} ,", f"{names[0]},", 1))

    same_data(data, held(t_y, t_u)[last], Y[last], min(rate, 1) / rate * 0.01)
    first_is_doubt(data, f"u has its own times, {names[0]}: held to")


def test_the_given_column_of_times_names_the_clock(tmp_path: Path) -> None:
    cells = text({"t_u": seconds(T), "u": U, "t_y": seconds(T[: N - 5] + 0.05), "y": Y[: N - 5]})

    data = load(tmp_path, cells, time="t_u")

    np.testing.assert_array_equal(data.u, U)
    np.testing.assert_array_equal(data.y[data.valid], Y[: N - 5])
    assert data.valid.tolist() == [k >= 5 for k in range(N)]
    first_is_doubt(data, "y has its own times, t_y: held to the times of u, t_u")
    for time, y in (("3", "4"), ("t_y", "y")):
        at_y = load(tmp_path, cells, time=time, signal=y)
        same_data(at_y, U[5:], Y[: N - 5])


def test_a_given_column_of_times_is_no_reason_to_pair_another_clock(tmp_path: Path) -> None:
    cells = {"t_cmd": seconds(T), "u": U, "t_meas": seconds(T + 0.05), "y": Y}

    data = load(tmp_path, text(cells), time="t_meas")

    assert data.u[0] == U[5]
    first_is_doubt(data, "u has its own times, t_cmd: held to the times of y, t_meas")


def test_several_columns_of_the_same_times_are_asked_for(tmp_path: Path) -> None:
    cells = text({"timestamp": seconds(1.7e9 + T), "datetime": dates(T), "u": U, "y": Y})

    with pytest.raises(ReadingError, match="give --time a name"):
        load(tmp_path, cells)
    for time in ("timestamp", "datetime"):
        same_data(load(tmp_path, cells, time=time), U)


def test_columns_without_names_side_by_side_are_two_clocks(tmp_path: Path) -> None:
    rows = zip(seconds(T), U, seconds(T + 0.05), Y, strict=True)
    cells = "\n".join(",".join(map(str, row)) for row in rows)

    data = load(tmp_path, cells, time="3", input="2", signal="4")

    assert data.u[0] == U[5]
    first_is_doubt(data, "column 2 has its own times, column 1: held to the times of column 4")


@pytest.mark.parametrize(
    "columns",
    [
        {"time_s": seconds(T), "u": U, "timestamp": seconds(1.7e9 + T), "y": Y},
        {"t": seconds(T), "u": U, "time_ms": seconds(1000 * T), "y": Y},
        {"t": seconds(T), "u": U, "y": Y, "device_time": seconds(1.01 * T + 3)},
        {"timestamp": seconds(3 + T), "t": seconds(T), "u": U, "y": Y},
        {"time_index": np.arange(N), "t": seconds(T), "u": U, "y": Y},
        {"t": seconds(T), "u": U, "time": dates(T), "y": Y},
        {"t": seconds(1.7e9 + T), "u": U, "timestamp": [f"{x:.1f}" for x in 1.7e9 + T], "y": Y},
        {"date": dates(T, "%Y-%m-%d"), "time": dates(T, "%H:%M:%S.%f"), "u": U, "y": Y},
        {"time": seconds(T), "u": U, "T_in": seconds(20 + np.sqrt(T)), "y": Y, "T": seconds(T**2)},
        {"time": seconds(T), "Q1": U, "T1": 1 + Y, "u": U, "y": Y, "T2": np.sort(Y)},
        {"time": seconds(T), "u": U, "dead_time": np.zeros(N), "y": Y, "t_max": T + 1},
    ],
    ids=lambda columns: ",".join(columns),
)
def test_one_clock_is_read_without_a_word(columns: dict[str, Any], tmp_path: Path) -> None:
    """A second column of times of the same rows, a counter and a temperature are no clocks."""
    table = read_text(text(columns))
    time = next(name for name in ("time_s", "date", "time", "t") if name in columns)
    time = "time" if time == "date" else time

    assert on_one_clock([("a.csv", table)], output="y", time=time) is table
    data = load(tmp_path, text(columns), time=time)
    same_data(data, U)
    assert DOUBT not in codes_of(data.history)


def test_clocks_without_a_common_beginning_are_refused_at_their_use(tmp_path: Path) -> None:
    cells = text({"t_u": seconds(T), "u": U, "t_y": seconds(1.7e9 + T), "y": Y, "v": U})

    with pytest.raises(FileError, match=r"t_u goes from 0 to 1.99 s and t_y goes from 17.*delete"):
        load(tmp_path, cells)
    same_data(load(tmp_path, cells, input="v"), U)


def test_a_value_without_a_time_is_refused(tmp_path: Path) -> None:
    t_u = [*seconds(T)[:-2], "", ""]
    with pytest.raises(FileError, match=r"line 200: u has a value here, but t_u has no time"):
        load(tmp_path, text({"t_u": t_u, "u": U, "t_y": seconds(T + 0.05), "y": Y}))


def test_the_output_decides_if_it_is_known() -> None:
    cells = {"t_a": seconds(T), "a": U, "t_b": seconds(T + 0.05), "b": Y}
    table = read_text(text(cells))

    with pytest.raises(ReadingError, match="it has several clocks, those of a and b: ") as failure:
        on_one_clock([("a.csv", table)], output=None, time=None)
    assert failure.value.option == "--signal NAME"


def test_arrays_of_two_lengths_are_two_clocks(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t_u=T, t_y=T[:-1:2] + 0.001, u=U, y=Y[:100])

    data = armrig.load_data(tmp_path / "a.npz")

    same_data(data, U[::2], Y[:100], 0.02)
    first_is_doubt(data, "u has its own times, t_u: held to the times of y, t_y; 9")


def test_an_input_is_unknown_in_a_gap_of_its_regular_times(tmp_path: Path) -> None:
    kept = np.delete(np.arange(N), np.arange(60, 100))
    cells = {"t_u": seconds(T[kept]), "u": U[kept], "t_y": seconds(T + 0.001), "y": Y}

    data = load(tmp_path, text(cells))

    assert (data.N, tuple(data.starts)) == (162, (0, 62))
    assert "; not known in 38 rows, over 3 intervals after a value" in data.history[0]


def sparse(shift: float, *, rate: int = 1, sort: bool = True) -> str:
    """Return two topics merged by time: each row has one of two values."""
    rows = [(t, f"{t:.4f},{u:.0f},") for t, u in zip(1.7e9 + T - shift, U, strict=True)]
    rows += [(t, f"{t:.4f},,{y}") for t, y in zip(1.7e9 + T[::rate], Y[::rate], strict=True)]
    return "\n".join(["time,u,y", *(row for _, row in (sorted(rows) if sort else rows))])


@pytest.mark.parametrize("how", [{}, {"hold_input": True, "resample": True}, {"Ts": 0.01}])
@pytest.mark.parametrize("sort", [True, False])
@pytest.mark.parametrize("shift", [0.0, 0.003])
def test_rows_with_one_value_of_two_are_the_times_of_the_output(
    shift: float, sort: bool, how: dict[str, Any], tmp_path: Path
) -> None:
    data = load(tmp_path, sparse(shift, sort=sort), **how)

    np.testing.assert_array_equal(data.u, U)
    np.testing.assert_allclose(data.y, Y, atol=1e-3)
    assert data.Ts == 0.01
    first_is_doubt(data, "u has its values in other rows than y: held to the times of y, time")


def test_values_that_the_output_does_not_meet_are_counted(tmp_path: Path) -> None:
    data = load(tmp_path, sparse(0.003, rate=5))

    same_data(data, U[::5], Y[::5], 0.05)
    assert "; 155 values of u between these times are not used" in data.history[0]


def test_sparse_rows_need_an_output() -> None:
    table = read_text(sparse(0.003).replace("u,y", "a,b"))
    with pytest.raises(ReadingError, match="several clocks, those of a and b: give --signal"):
        on_one_clock([("a.csv", table)], output=None, time=None)


@pytest.mark.parametrize("missing", ["u at changes", "a few of each", "y at every tenth"])
def test_missing_values_are_no_second_clock(missing: str) -> None:
    rng, u, y = np.random.default_rng(3), U.copy(), Y.copy()
    if missing == "u at changes":
        u[1:][np.diff(U) == 0] = y[7] = np.nan
    elif missing == "a few of each":
        u[rng.random(N) < 0.1] = y[rng.random(N) < 0.1] = np.nan
    else:
        y[np.arange(N) % 10 > 0] = np.nan
    table = Table(columns=[Column(name=name) for name in "tuy"], values=[T, u, y])

    assert on_one_clock([("a.npz", table)], output="y", time=None) is table


FALLING: dict[str, Callable[[Vector], list[str]]] = {
    "seconds": seconds,
    "dates": dates,
    "times of day": lambda t: dates(t, "%H:%M:%S.%f"),
    "ten rows in each second": lambda t: [f"{10 * x // 1:.0f}" for x in t],
    "with a zone": lambda t: dates(t, "%Y-%m-%dT%H:%M:%S.%f+01:00"),
}


@pytest.mark.parametrize("Ts", [None, 0.01])
@pytest.mark.parametrize("form", FALLING)
def test_rows_in_falling_order_are_turned_round(
    form: str, Ts: float | None, tmp_path: Path
) -> None:
    cells = {"time": FALLING[form](T)[::-1], "u": U[::-1], "y": Y[::-1]}

    data = load(tmp_path, text(cells), Ts=Ts)

    same_data(data, U, Ts=data.Ts)
    assert "rows in falling order of time: turned round" in data.history
    assert any(codes_of(data.history)) == form.startswith("ten")


def test_a_falling_temperature_named_T_is_no_time(tmp_path: Path) -> None:
    T_K = seconds(300 - np.sqrt(np.arange(N)))
    data = load(tmp_path, text({"T": T_K, "u": U, "y": Y}), Ts=0.01, input="u", time=None)

    np.testing.assert_array_equal(data.u, U)


CLOCKS: dict[str, tuple[str, Sequence[str], float]] = {
    "UTC": ("time", dates(100 * T, "%Y-%m-%d %H:%M:%S.%f UTC"), 1),
    "GMT": ("time", dates(100 * T, "%d.%m.%Y %H:%M:%S GMT"), 1),
    "offset": ("time", dates(100 * T, "%Y-%m-%d %H:%M:%S +0100"), 1),
    "hours": ("time", dates(100 * T, "%Y-%m-%d %H:%M:%S+01"), 1),
    "CET": ("time", dates(100 * T, "%Y-%m-%d %H:%M:%S CET"), 1),
    "zone": ("time", dates(100 * T, "%Y-%m-%dT%H:%M:%S+01:00[Europe/Berlin]"), 1),
    "days": ("time", [f"{k // 86400} days 00:00:{k / 10:09.6f}" for k in range(N)], 0.1),
    "python": ("time", [f'"1 day, 0:00:{k / 10:09.6f}"' for k in range(N)], 0.1),
    "9 digits": ("time", [f"00:00:00.{k:06d}100" for k in range(N)], 1e-6),
    "date of 9 digits": ("t", [f"2025-03-11 09:12:40.{200 * k:09d}" for k in range(N)], 2e-7),
    "created_at": ("created_at", dates(1500 * T, "%Y-%m-%d %H:%M:%S UTC"), 15),
}


@pytest.mark.parametrize("clock", CLOCKS)
def test_dates_and_spans_are_read(clock: str, tmp_path: Path) -> None:
    name, cells, Ts = CLOCKS[clock]

    data = load(tmp_path, text({name: cells, "u": U, "y": Y}))

    same_data(data, U, Ts=Ts)
    assert DOUBT not in codes_of(data.history)


def test_offsets_from_utc_are_subtracted(tmp_path: Path) -> None:
    cells = dates(T, "%Y-%m-%d %H:%M:%S.%f +01:00")
    late = dates(T + 3600, "%Y-%m-%d %H:%M:%S.%f +02:00")

    same_data(load(tmp_path, text({"t": [*cells[:90], *late[90:]], "u": U, "y": Y})), U)


def test_two_unknown_zones_are_refused_with_the_way_out(tmp_path: Path) -> None:
    cells = [*dates(T, "%Y-%m-%d %H:%M:%S CET")[:90], *dates(T, "%Y-%m-%d %H:%M:%S CEST")[90:]]

    with pytest.raises(FileError, match=r"line 92: .*CEST' is in another time zone .*\+01:00"):
        load(tmp_path, text({"t": cells, "u": U, "y": Y}))


NS = np.rint(1e9 * T).astype(np.int64)


@pytest.mark.parametrize(
    ("names", "parts"),
    [
        ("sec,nanosec", (1_700_000_000 + NS // 10**9, NS % 10**9)),
        ("header.stamp.sec,header.stamp.nanosec", (NS // 10**9, NS % 10**9)),
        ("secs,nsecs", (NS // 10**9, NS % 10**9)),
        ("Time,Milliseconds", (dates(NS // 10**9, "%H:%M:%S"), NS % 10**9 // 10**6)),
        (",", (1_700_000_000 + NS // 10**9, NS % 10**9)),
        (",", (NS // 10**9, NS % 10**9 // 1000)),
    ],
)
def test_seconds_and_their_fractions_in_two_columns_are_added(
    names: str, parts: tuple[Sequence[object], Sequence[object]], tmp_path: Path
) -> None:
    has_names = names != ","
    first, second = names.split(",") if has_names else ("a", "b")
    cells = text({first: parts[0], second: parts[1], "u": U, "y": Y})
    how: dict[str, Any] = {} if has_names else {"time": "1", "input": "3", "signal": "4"}

    data = load(tmp_path, cells if has_names else cells.partition("\n")[2], **how)

    same_data(data, U)
    assert "added column" in "".join(data.history)


@pytest.mark.parametrize("second", ["latency_ms", "count", "ms_total"])
def test_a_column_beside_whole_seconds_is_no_fraction(second: str, tmp_path: Path) -> None:
    cells = {"t_s": np.arange(N), second: np.arange(N) % 7, "u": U, "y": Y}

    same_data(load(tmp_path, text(cells), time="t_s"), U, Ts=1)


@pytest.mark.parametrize(
    ("times", "Ts", "unit"),
    [
        (118_374_112 + 10_000 * np.arange(N), 0.01, "us"),
        (400_000_000 + 10 * np.arange(N), 10, ""),
        (40_000_000 + 500 * np.arange(N), 0.5, "ms"),
        (7_000_000_000_000_000 + 10_000_000 * np.arange(N), 0.01, "ns"),
        (10_000 * np.arange(N), 10_000, "s"),
        (600 * np.arange(N), 600, "s"),
    ],
)
def test_long_intervals_without_a_unit_are_doubted_first(
    times: NDArray[np.int64], Ts: float, unit: str, tmp_path: Path
) -> None:
    data = load(tmp_path, text({"timestamp": times, "u": U, "y": Y}))

    same_data(data, U, Ts=Ts)
    words = f"no unit and are {times[1] - times[0]} apart: read as {unit}, so Ts is {Ts:g} s"
    first_is_doubt(data, f"the times in column timestamp have {words if unit else 'no unit: '}")


@pytest.mark.parametrize("Ts", [10_000.0, 10.0, 0.01])
def test_a_given_sampling_time_decides_on_the_unit(Ts: float, tmp_path: Path) -> None:
    cells = text({"t": 10_000 * np.arange(N), "u": U, "y": Y})

    (note,) = (data := load(tmp_path, cells, Ts=Ts)).history

    assert data.Ts == Ts
    assert (
        note == f"the times in column t have no unit: the given Ts = {Ts:g} s is that of their rows"
    )
    first_is_doubt(load(tmp_path, cells, Ts=0.02), "used the given Ts = 0.02 s, although")


def table(**columns: Any) -> Table:
    return Table(columns=[Column(name=name) for name in columns], values=[*columns.values()])


def test_files_with_equal_times_are_paired() -> None:
    files = [("a.csv", table(t=T, u=U)), ("b.csv", table(time_ms=1000 * T, y=Y, u=Y))]

    joined = on_one_clock(files, output=None, time=None)

    assert [column.name for column in joined.columns] == ["time", "a.u", "y", "b.u"]
    np.testing.assert_array_equal([joined.numbers(i) for i in (1, 2)], [U, Y])
    assert joined.notes == ["the rows of a.csv and b.csv have equal times"]
    assert joined.place(3) == "b.csv, row 4"


def test_columns_of_other_files_are_held_to_the_times_of_the_output() -> None:
    files = [
        ("a.csv", table(t=1.7e9 + T, u=U)),
        ("b.csv", table(t=1.7e9 + T[:-1:2] + 0.003, y=Y[:100])),
    ]

    for how in ({"output": "y", "time": None}, {"output": "3", "time": "t"}):
        joined = on_one_clock(files, **how)
        np.testing.assert_array_equal(joined.numbers(1), U[::2])
        np.testing.assert_allclose(joined.numbers(0), T[::2], atol=1e-6)
        assert codes_of(joined.notes)[0] == DOUBT
        assert joined.notes[0].startswith(
            "u has its own times, t of a.csv: held to the times of y, t of b.csv; "
        )
        assert joined.columns[0].name == (how["time"] or "time")
    with pytest.raises(ReadingError, match=r"several clocks, those of u and b: "):
        on_one_clock([files[0], ("b.csv", table(t=T, b=Y))], output=None, time=None)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (table(t=T, y=Y), "t of a.csv goes from 1700000000 to .* s since 1970 and t of b.csv goes"),
        (table(t=1.7e9 + 1.5 + T, y=Y), r"u cannot be held to the times of y. Write both times"),
        (table(y=Y), r"b.csv has no column of times .*give --time"),
    ],
)
def test_files_without_a_common_clock_are_refused(other: Table, said: str) -> None:
    with pytest.raises(FileError, match=said):
        on_one_clock([("a.csv", table(t=1.7e9 + T, u=U)), ("b.csv", other)], output="y", time=None)


@pytest.mark.parametrize("Ts", [None, 0.01])
def test_shuffled_rows_are_sorted_and_doubted(Ts: float | None, tmp_path: Path) -> None:
    order = np.random.default_rng(4).permutation(N)
    cells = {"sec": (NS // 10**9)[order], "nanosec": (NS % 10**9)[order], "u": U[order]}

    data = load(tmp_path, text(cells | {"y": Y[order]}), Ts=Ts)

    same_data(data, U)
    first_is_doubt(data, "rows in no order of time: sorted by time")


def test_a_falling_number_of_rows_shows_the_order(tmp_path: Path) -> None:
    cells = text({"index": np.arange(N)[::-1], "u": U[::-1], "y": Y[::-1]})

    same_data(load(tmp_path, cells, Ts=0.01), U)
    unnamed = load(tmp_path, cells.partition("\n")[2], Ts=0.01, input="2", signal="3")
    same_data(unnamed, U)
    first_is_doubt(unnamed, "rows in falling order of column 1: turned round")


def test_a_clock_that_begins_again_cannot_hold(tmp_path: Path) -> None:
    again = np.append(T[:100], T[:100])
    with pytest.raises(FileError, match=r"line 102: t_u goes back here, so u cannot be held"):
        load(tmp_path, text({"t_u": again, "u": U, "t_y": again + 0.005, "y": Y}))


def test_a_suffix_that_is_a_column_is_doubted_as_a_unit(tmp_path: Path) -> None:
    data = load(tmp_path, text({"t_h": T, "h": U, "y": Y}), input="h")
    first_is_doubt(data, "the times in column t_h are read in h, and not as the times of h")


@pytest.mark.parametrize("times", [1_741_684_360_000 + 500_000 * np.arange(N), dates(20 * T * 100)])
def test_shuffled_times_are_no_timer_that_wraps(times: Sequence[object], tmp_path: Path) -> None:
    order = np.random.default_rng(4).permutation(N)
    cells = {"time": np.array(times)[order], "u": U[order], "y": Y[order]}

    data = load(tmp_path, text(cells))

    same_data(data, U, Ts=data.Ts)
    first_is_doubt(data, "rows in no order of time: sorted by time")


@pytest.mark.parametrize("resample", [False, True])
def test_times_without_an_order_are_not_resampled(resample: bool, tmp_path: Path) -> None:
    t = np.random.default_rng(4).exponential(1.0, N)

    with pytest.raises(FileError, match=r"t go back here, and in \d+ of 199 .* sort the rows"):
        load(tmp_path, text({"t": seconds(t), "u": U, "y": Y}), resample=resample)


@pytest.mark.parametrize("rows", [",1,2", ",1,2\n,1,2\n,2,3"])
def test_a_column_of_times_without_a_value_is_refused(rows: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"t,u,y\n{rows}\n")

    with pytest.raises(FileError, match="the times in column t have no value"):
        armrig.load_data(tmp_path / "a.csv")
