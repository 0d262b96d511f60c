"""Tables of text, as loggers, spreadsheets and MATLAB write them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig import FileError, load_data
from armrig.data.files import instrument_headers, kinds, loading, text
from armrig.data.step import DOUBT, codes_of
from hypothesis import given
from hypothesis import strategies as st


def counted(function: Callable[..., Any], calls: Counter[str]) -> Callable[..., Any]:
    """Return the function, whose calls are counted."""

    def count(*args: object) -> object:
        calls[function.__name__] += 1
        return function(*args)

    return count


U, Y = [1.0, -2.5, 3.0, 0.125], [0.5, 1e-3, -7.0, 1e6]


def written(folder: Path, text: str, name: str = "data.csv") -> Path:
    """Return a file of text, with unchanged line ends."""
    path = folder / name
    path.write_bytes(text.encode())
    return path


def table(separator: str, *, comma: bool = False, end: str = "\n", names: str = "t u y") -> str:
    """Return four rows of t, u and y, with a line of names unless there are none."""
    rows = [[f"{0.1 * k:.1f}", repr(u), repr(y)] for k, (u, y) in enumerate(zip(U, Y, strict=True))]
    lines = [names.split(), *rows] if names else rows
    text = "".join(separator.join(line) + end for line in lines)
    return text.replace(".", ",") if comma else text


@pytest.mark.parametrize(
    "text",
    [
        table(","),
        table(", "),
        table(";"),
        table(";", comma=True),
        table("\t"),
        table("   "),
        table(",", end="\r\n"),
        table(",", end=",\n"),
        table("\t", end="\t\r\n"),
        "\ufeff" + table(";"),
        "# a remark, with a comma\n% another\n\n" + table(","),
        table(",").replace("t,u,y", '"t","u","y"'),
        table(";").replace("t;u;y", "Time [s];u [V];y (m/s)"),
        table(",", names="t U Y"),
        table(",").replace("\n", "\n\n"),
        table(",").removesuffix("\n"),
    ],
    ids=[
        *("comma", "comma and blank", "semicolon", "decimal comma", "tab", "blanks", "CRLF"),
        *("comma at each end", "tab at each end", "byte order mark", "remarks", "quotes", "units"),
        *("capitals", "empty lines", "no line end"),
    ],
)
def test_each_notation_of_a_table_gives_the_same_numbers(text: str, tmp_path: Path) -> None:
    data = load_data(written(tmp_path, text))

    np.testing.assert_array_equal(data.u, U)
    np.testing.assert_array_equal(data.y, Y)
    assert data.Ts == 0.1


@pytest.mark.parametrize("separator", [",", ";", "\t", "  "])
def test_columns_without_names_are_selected_by_number(separator: str, tmp_path: Path) -> None:
    path = written(tmp_path, table(separator, names=""), "data.dat")

    data = load_data(path, input="2", signal="3", time="1")

    assert data.u.tolist() == U
    assert data.y.tolist() == Y
    assert (data.output, data.Ts, data.N) == ("y", 0.1, 4)


def test_a_column_has_the_length_of_the_table_with_or_without_names(tmp_path: Path) -> None:
    """A separator at the end of each row makes an empty last column."""
    last = written(tmp_path, "u,y\n1,\n2,\n3,\n", "last.csv")
    none = written(tmp_path, "1,5,\n2,6,\n", "none.csv")

    with pytest.raises(FileError, match="the signal, column 2, has no value in any of 3 rows"):
        load_data(last, Ts=1)
    assert load_data(none, input="1", signal="2", Ts=1).y.tolist() == [5, 6]


def test_names_and_units_are_the_headers(tmp_path: Path) -> None:
    path = written(tmp_path, "t [s];Heater (V);Temp [°C]\n0;1;2\n2;2;3\n")

    data = load_data(path, input="Heater", signal="temp [°C]")

    assert (data.output, data.unit, data.input_unit, data.Ts) == ("Temp", "°C", "V", 2.0)


def test_an_empty_cell_is_a_missing_value(tmp_path: Path) -> None:
    rows = ["1,1", "2,", "3,NaN", "4,n/a", "5,5", ",6", "nan,7", "8,8", "9,9"]
    path = written(tmp_path, "u,y\n" + "\n".join(rows))

    data = load_data(path, Ts=1)

    assert data.u.tolist() == [1, 2, 3, 4, 5, 8, 9]
    np.testing.assert_array_equal(data.y, [1, np.nan, np.nan, np.nan, 5, 8, 9])
    assert data.starts == (0, 5)
    assert data.history == (
        "left out 2 samples without an input; a new experiment begins after each gap",
    )


def test_an_unused_column_may_contain_words(tmp_path: Path) -> None:
    rows = ["2024-01-01 10:00:00,1,2,good", "2024-01-01 10:00:01,3,4,bad"]
    named = written(tmp_path, "when,u,y,what\n" + "\n".join(rows), "named.csv")
    bare = written(tmp_path, "\n".join(rows), "bare.csv")

    assert load_data(named, Ts=1).y.tolist() == [2, 4]
    assert load_data(bare, input="2", signal="3", Ts=1).y.tolist() == [2, 4]


def test_a_first_row_without_a_value_is_not_a_header(tmp_path: Path) -> None:
    path = written(tmp_path, "NaN,1\n2,3\n")

    assert load_data(path, input="2", signal="1", Ts=1).N == 2


def test_every_finite_number_of_a_table_is_read_exactly() -> None:
    bits = np.random.default_rng(1).integers(0, 2**64, (2000, 2), dtype=np.uint64)
    values = bits.view(np.float64)
    rows = values[np.isfinite(values).all(axis=1)]

    for separator in (",", ";", "\t", " "):
        read = text.read_text("".join(f"{u!r}{separator}{y!r}\n" for u, y in rows.tolist()))

        np.testing.assert_array_equal(np.column_stack([read.numbers(0), read.numbers(1)]), rows)
    assert len(rows) > 1900


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "there is no row of numbers; a row for each sample is needed"),
        ("# nothing\n\n", "there is no row of numbers; a row"),
        ("t,u,y\n", "there is no row of numbers below its names, t, u, y; a row for each"),
        (
            "1 2\n1 2 3\n",
            r"line 2 has 3 cells \(separated by blanks\), the first row 2 cells; give",
        ),
        (
            "A title\nu;y\n1;2\n1;2\n1;2;3\n",
            r"line 5 has 3 cells \(separated by semicolon\), the line of names 2",
        ),
        ("u,y\nV,an angle in radians\n1,2\n", "line 1 or line 2 may contain the names; delete"),
        ("u;y\n1.23,4,5;2\n", "line 2, column u: '1.23,4,5' is not a number; leave a missing"),
        ("u,y\n1_000,2\n", "line 2, column u: '1_000' is not a number"),
        ("u,y\n1," + 99 * "x" + "\n", "line 2, column y: '" + 39 * "x" + "…' is not a number"),
        ("\x1b[31mu,y\u202e\n1,2\n", r"a number of 1 \\x1b\[31mu, 2 y\\u202e"),
        ("u,y\n1,\x1b[2J\n", r"line 2, column y: '\\x1b\[2J' is not a number"),
        ("u,u,y\n1,2,3\n", "input u: columns 1 and 2 have this name; give the number"),
        (
            ",".join(f"c{i}" for i in range(99)) + "\n" + ",".join("1" * 99) + "\n",
            r"11 c10, 12 c11, … 99$",
        ),
    ],
)
def test_a_wrong_table_is_reported_with_its_line_and_the_remedy(
    text: str, said: str, tmp_path: Path
) -> None:
    path = written(tmp_path, text)

    with pytest.raises(FileError, match=f"^{path}: .*{said}"):
        load_data(path, Ts=1)


@given(st.binary(max_size=300))
def test_random_bytes_of_a_table_raise_no_other_error(data: bytes) -> None:
    for suffix in (".csv", ".mat"):
        said = ""
        try:
            read = kinds.table_of(data, suffix)
            for i in range(len(read.columns)):
                read.numbers(i)
        except FileError as err:
            said = str(err)
        assert len(said) < 300


def test_a_file_that_is_too_long_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    with path.open("wb") as file:
        file.truncate(loading.MOST_BYTES + 1)

    with pytest.raises(FileError, match="has more than 128 MiB; cut it into several files"):
        load_data(path)


@pytest.mark.parametrize(
    ("times", "Ts"),
    [
        ([0, 0.05, 0.1, 0.15], 0.05),
        ([1, 2, 3, 4], 1.0),
        ([1000.1, 1000.2, 1000.3, 1000.4], 0.1),
        ([k / 30 for k in range(400)], 1 / 30),
        ([float(f"{0.05 * k:.6g}") for k in range(4000)], 0.05),
        ([float(np.float32(0.002 * k)) for k in range(3000)], 0.002),
        ([0.0, 0.0101, 0.0199, 0.0301, 0.04], 0.01),
    ],
    ids=["exact", "from 1", "late", "thirtieths", "six digits", "single precision", "unsteady"],
)
def test_the_sampling_time_is_the_roundest_that_the_times_agree_with(
    times: Sequence[float], Ts: float, tmp_path: Path
) -> None:
    text = "t,u,y\n" + "".join(f"{t!r},1,2\n" for t in times)

    assert load_data(written(tmp_path, text)).Ts == pytest.approx(Ts, rel=1e-12)


@pytest.mark.parametrize(
    ("header", "Ts"),
    [("t [ms]", 0.1), ("time (µs)", 1e-4), ("Time [min]", 6000.0), ("T", 100.0), ("t[h]", 3.6e5)],
)
def test_the_times_have_the_unit_of_their_header(header: str, Ts: float, tmp_path: Path) -> None:
    path = written(tmp_path, f"{header},u,y\n0,1,2\n100,1,2\n200,1,2\n")

    assert load_data(path).Ts == pytest.approx(Ts, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t,u,y\n0,1,2\n0,1,2\n0,1,2\n", "line 3: the times in column t do not increase"),
        ("t,u,y\n2,1,2\n2,1,2\n2,1,2\n", "line 3: the times in column t do not increase"),
        ("t,u,y\n0,1,2\n,1,2\n2,1,2\n", "line 3: the times in column t have no value here; add it"),
        (
            "t,u,y\n0,1,2\n",
            "the times in column t: a sampling time needs at least 2 times, got 1; give Ts",
        ),
        (
            "t [weeks],u,y\n0,1,2\n1,1,2\n",
            "the times in column t are in weeks, known units are s, ",
        ),
        ("u,y\n0,1\n1,2\n", r"the sampling time is not known: give it in s \(--Ts\)$"),
    ],
)
def test_times_that_give_no_sampling_time_are_reported(
    text: str, said: str, tmp_path: Path
) -> None:
    path = written(tmp_path, text)

    with pytest.raises(FileError, match=said):
        load_data(path)
    assert load_data(path, Ts=0.5).Ts == 0.5


@pytest.mark.parametrize(("given", "noted"), [(0.1, 0), (0.104, 0), (0.05, 1), (0.2, 1)])
def test_a_sampling_time_that_contradicts_the_file_is_reported(
    given: float, noted: int, tmp_path: Path
) -> None:
    """Up to a twentieth is rounding; the given number is used in any case."""
    path = written(tmp_path, table(","))

    for data in (
        load_data(path, Ts=given),
        armrig.load_signals(path, inputs="u", outputs="y", Ts=given),
    ):
        assert data.Ts == given
        note = f"used the given Ts = {given:g} s, although the times are 0.1 s apart"
        assert data.history == (note,) * noted


@pytest.mark.parametrize("wanted", ["0", "4", "-1", "1.0", "w", "1234567890"])
def test_a_missing_column_is_refused_with_the_existing_columns(wanted: str, tmp_path: Path) -> None:
    path = written(tmp_path, "t,u,y\n0,1,2\n1,3,4\n")

    with pytest.raises(FileError, match=f"input {wanted}: there is no such column; give --input a"):
        load_data(path, input=wanted, Ts=1)
    assert load_data(path, input="1", signal="3", Ts=1).u.tolist() == [0, 1]


def test_names_that_differ_only_in_case_are_distinguished(tmp_path: Path) -> None:
    path = written(tmp_path, "u,Y,y\n5,6,7\n8,9,1\n")

    assert load_data(path, input="U", signal="Y", Ts=1).y.tolist() == [6, 9]
    assert load_data(path, input="u", signal="y", Ts=1).y.tolist() == [7, 1]


def test_data_name_their_file_by_its_hash(tmp_path: Path) -> None:
    import hashlib

    path = written(tmp_path, table(","))

    assert load_data(path).source == f"data:{hashlib.sha256(path.read_bytes()).hexdigest()}"
    assert armrig.merge([load_data(path)] * 2).source == load_data(path).source


@pytest.mark.parametrize("units", ["s;V;°C", "[s];[V];[°C]", "(s);(V);(°C)", ";V;°C", "-;V;°C"])
def test_a_line_of_units_below_the_names_is_recognised(units: str, tmp_path: Path) -> None:
    path = written(tmp_path, f"t;u;y\n{units}\n0;1;2\n0.5;3;4\n1.0;5;x\n")
    good = written(tmp_path, path.read_text().replace("x", "6"), "good.csv")

    data = load_data(good)

    assert (data.input_unit, data.unit, data.Ts) == ("V", "°C", 0.5)
    assert data.y.tolist() == [2.0, 4.0, 6.0]
    assert data.history == ("read line 2 as units",)
    with pytest.raises(FileError, match="line 5, column y: 'x' is not a number"):
        load_data(path)


@pytest.mark.parametrize("row", ["2 s;0 %;21 °C", "2s;0.5V;-3K"])
def test_values_with_units_below_the_names_are_data(row: str, tmp_path: Path) -> None:
    path = written(tmp_path, f"t;u;y\n{row}\n2;3;4\n3;5;6\n")

    with pytest.raises(
        FileError, match=r"line 3, column [tuy]: '\d' has no unit, the values above"
    ):
        load_data(path)


@pytest.mark.parametrize(
    ("cells", "unit"),
    [
        ("20 °C|21 °C", "°C"),
        ("0.5%|.25%", "%"),
        ("9.81 m/s2|-1e-3 m/s2", "m/s2"),
        ('"1,000 V"|"1,5.0"', None),
        ("1 V|2", None),
        ("999 mV|1 V", None),
        ("|3 rpm", "rpm"),
        ("1|2 V", None),
        ("0x10|0x11", None),
        ("+  1.0|- 2", ""),
    ],
)
def test_the_unit_of_every_cell_is_the_unit_of_the_column(cells: str, unit: str | None) -> None:
    """A unit that changes, begins or ends within a column is refused."""
    read = text.read_text("t,u\n" + "".join(f"0,{cell}\n" for cell in cells.split("|")))

    if unit is None:
        with pytest.raises(FileError, match=r"line [23], column u: '.*(unit|not a number)"):
            read.numbers(1)
        return
    plain = cells.replace(unit, "").replace("+  ", "").replace("- ", "-").split("|")
    np.testing.assert_array_equal(read.numbers(1), [float(x or "nan") for x in plain])
    assert read.columns[1].unit == unit


@pytest.mark.parametrize("cell", ["1", "True", "NaN", ""])
@pytest.mark.parametrize("of_u", ["", "-"])
def test_one_column_may_have_no_unit(of_u: str, cell: str) -> None:
    read = text.read_text(f"u,y\n{of_u},rpm\n" + f"{cell},20\n" * 3)

    assert [column.unit for column in read.columns] == ["", "rpm"]
    assert (len(read.rows), read.notes[0]) == (3, "read line 2 as units")


@pytest.mark.parametrize(("end", "codes"), [("\n", [""]), ("", [DOUBT])])
def test_zero_bytes_after_half_a_line_are_a_doubt(end: str, codes: list[str]) -> None:
    data = f"u,y\n1,2\n3,41{end}".encode() + bytes(512)

    assert codes_of(kinds.table_of(data, ".csv").notes) == codes


def test_a_unit_of_cells_that_contradicts_the_header_is_a_doubt() -> None:
    read = text.read_text("t,u [K]\n0,20 °C\n1,21 °C\n")

    assert read.columns[1].unit == "°C"
    assert codes_of(read.notes) == [DOUBT]


@pytest.mark.parametrize(
    ("cells", "numbers"),
    [
        ("True|False|", [1, 0, np.nan]),
        ("off|ON|nan", [0, 1, np.nan]),
        ("on|auto|off", None),
        ("true|3.5|x", None),
    ],
)
def test_the_words_of_a_switch_are_1_and_0(cells: str, numbers: list[float] | None) -> None:
    read = text.read_text("t,u\n" + "".join(f"0,{cell}\n" for cell in cells.split("|")))

    if numbers is None:
        with pytest.raises(FileError, match=r"column u: '(on|true)' is not a number"):
            read.numbers(1)
        return
    np.testing.assert_array_equal(read.numbers(1), numbers)
    assert list(read.notes) == ["read the words of a switch as 1 and 0: u"]


def test_wide_and_doubtful_columns_are_split_and_decided_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The time is proportional to the number of cells, not to its square."""
    names, values = (
        [f"{a}{i % b:03d}" for i in range(4000)] for a, b in (("c", 9999), ("1.", 1000))
    )
    read = text.read_text("\n".join(map(",".join, (names, values, values, values))))
    calls = Counter[str]()
    for name in ("split", "sure_marks"):
        monkeypatch.setattr(text, name, counted(getattr(text, name), calls))

    assert [read.numbers(i)[-1] for i in range(4000)][:2] == [1.0, 1.001]
    assert (calls["split"], calls["sure_marks"]) == (3, 4000)


@pytest.mark.parametrize("separator", [" ", ",", ";", "\t"])
def test_a_line_of_too_many_words_is_refused_before_they_are_looked_at(
    separator: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A megabyte of words took 15 s."""
    calls = Counter[str]()
    monkeypatch.setattr(instrument_headers, "kind", counted(instrument_headers.kind, calls))

    with pytest.raises(FileError, match="line 1 has more than 65536 cells"):
        text.read_text(separator.join(["word"] * 70_000) + "\n1 2\n")

    assert calls["kind"] == 0


@pytest.mark.parametrize("cell", ["dry", "1,234", "25 °C", ""])
def test_a_column_that_is_not_read_may_contain_anything(tmp_path: Path, cell: str) -> None:
    rows = "".join(f"{k};{k % 2};{k % 5};{cell if k != 5 else 'x'}\n" for k in range(20))

    data = load_data(written(tmp_path, f"t;u;y;note\n{rows}"))

    assert data.N == 20


def test_a_unit_in_the_header_has_precedence_over_one_below(tmp_path: Path) -> None:
    data = load_data(written(tmp_path, "t;u [mV];y\ns;V;K\n0;1;2\n1;3;4\n"))

    assert (data.input_unit, data.unit) == ("mV", "K")


def test_decimal_commas_between_blanks_are_not_cut(tmp_path: Path) -> None:
    rows = "".join(f"{k % 3},5 {100 + k},5\n" for k in range(40))
    (tmp_path / "a.txt").write_text(rows)

    data = load_data(tmp_path / "a.txt", input="1", signal="2", Ts=1)

    assert data.u[:3].tolist() == [0.5, 1.5, 2.5]
    assert data.y[:2].tolist() == [100.5, 101.5]


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_a_remark_above_the_rows_contains_the_names(tmp_path: Path, delimiter: str) -> None:
    """`numpy.savetxt` writes the names so; the unit of the time is milliseconds."""
    rows = np.column_stack([0.2 * np.arange(40), np.arange(40) % 2, np.arange(40.0)])
    names = delimiter.join(["time_ms", "lamp", "temp"])
    np.savetxt(tmp_path / "a.txt", rows, delimiter=delimiter, header=f"logger 1.2\n{names}")

    data = load_data(tmp_path / "a.txt", input="lamp", signal="temp")

    assert (data.input, data.output, data.Ts) == ("lamp", "temp", 0.0002)
    assert data.y.tolist() == [float(k) for k in range(40)]


def test_a_sentence_in_a_remark_is_doubted_as_names(tmp_path: Path) -> None:
    path = written(tmp_path, "# from monday morning\n0 1 2\n1 0 3\n2 1 4\n", "a.txt")

    data = load_data(path, input="2", signal="3", time="1")

    assert DOUBT in codes_of(data.history)
    bare = load_data(
        written(tmp_path, "# 3 rows\n0 1 2\n1 0 3\n2 1 4\n"), input="1", Ts=1, signal="2"
    )
    assert (bare.output, DOUBT in codes_of(bare.history)) == ("y", False)


def test_facts_above_rows_with_missing_values_are_no_rows(tmp_path: Path) -> None:
    rows = "".join(f"{k if k % 9 == 0 else ''},{100 + k}\n" for k in range(40))
    facts = "Serial,12345\nch 1: ok\n" * 3

    data = load_data(written(tmp_path, f"{facts}u,y\n{rows}"), Ts=1, hold_input=True)

    assert (data.y[0], data.y[-1]) == (100.0, 139.0)


@pytest.mark.parametrize("name", ["Minuten", "tmin", "Stunden"])
def test_an_unknown_name_of_times_is_doubted(tmp_path: Path, name: str) -> None:
    rows = "".join(f"{k / 1200:.8f},{k % 3},{k % 5}\n" for k in range(40))

    data = load_data(written(tmp_path, f"{name},u,y\n{rows}"), time=name)

    assert f"the times in column {name} have no unit: read as s; if they are not" in data.history[0]
    assert codes_of(data.history)[0] == DOUBT


def test_a_unit_that_is_the_whole_name_of_times_is_not_doubted(tmp_path: Path) -> None:
    rows = "".join(f"{5 * k},{k % 3},{k % 5}\n" for k in range(40))

    data = load_data(written(tmp_path, f"millis,u,y\n{rows}"))

    assert (data.Ts, DOUBT in codes_of(data.history)) == (0.005, False)
