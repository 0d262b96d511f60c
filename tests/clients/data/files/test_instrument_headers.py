"""Files of instruments and of other programs: what is above the rows, and how a row is written."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from armrig.data.files.kinds import table_of
from armrig.data.files.table import Table
from armrig.data.files.text import read_text
from armrig_core.errors import FileError

K = np.arange(40)
T, U, Y = 0.01 * K, 1.0 + 2 * (K // 7 % 2), 20 + 0.125 * K
ROWS = "".join(f"{t:.2f},{u:.1f},{y:.3f}\n" for t, u, y in zip(T, U, Y, strict=True))


def rows(pattern: str, count: int = 40) -> str:
    """Return a line for each sample, from a pattern of k, t, u and y."""
    values = zip(K, T, U, Y, strict=True)
    return "".join(pattern.format(k=k, t=t, u=u, y=y) + "\n" for k, t, u, y in values)


def titles(table: Table) -> list[str]:
    return [f"{c.name} [{c.unit}]" if c.unit else c.name for c in table.columns]


LABVIEW = (
    "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t,\nX_Columns\tOne\n"
    "***End_of_Header***\t\n\t\nChannels\t2\t\t\t\nY_Unit_Label\tVolts\tDeg C\t\t\n"
    "X_Dimension\tTime\tTime\t\t\nX0\t0,0E+0\t0,0E+0\t\t\nDelta_X\t0,010000\t0,010000\t\t\n"
    "***End_of_Header***\t\t\t\t\nX_Value\tmotor\ttemp\tComment\n"
)
GRAPHTEC = (
    "Vendor,GRAPHTEC Corporation\nSampling interval,10ms\nStart time,2025/03/11,09:12:40\n"
    "AMP settings\nCH,Signal name,Input,Range\nCH1,u,DC,5V,5.0000,V\nData\n"
    "Number,Time,CH1,CH2\nNO.,s,V,degC\n"
)
TOA5 = (
    '"TOA5","CR0","CR0","1","Std","CPU:a.CR1","1","T1"\n"TIMESTAMP","u_Avg","y_Avg"\n'
    '"TS","Volts","degC"\n"","Avg","Avg"\n'
)
SIGLENT = "Record Length,Analog:40\nVertical Scale,CH1:1.00,CH2:2.00\nHorizontal Scale, 0.00100\n"
TEKSCOPE = (
    "Model,MSO0\nFirmware Version,2.4\n\nPoint Format,Y,,\nHorizontal Units,s,\n"
    "Sample Interval,0.01,\nVertical Units,V,V\nLabel,,\nTIME,CH1,CH2\n"
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            LABVIEW + rows("{t:.6f}\t{u:.6f}\t{y:.6f}").replace(".", ","),
            "X_Value|motor [V]|temp [Deg C]",
        ),
        (
            "X,CH1,CH2,Start,Increment,\nSequence,VOLT,VOLT,0.000000e+00,1.000000e-02\n"
            + rows("{k},{u:.2e},{y:.6e},,"),
            "X [s]|CH1 [V]|CH2 [V]",
        ),
        (
            "x-axis,1,2\nsecond,Volt,Volt\n" + rows("{t:+.9E},{u:+.9E},{y:+.9E}"),
            "x-axis [s]|CH1 [V]|CH2 [V]",
        ),
        (GRAPHTEC + rows("{k},{t:.2f},+  {u:.4f},+ {y:.4f}"), "Number|Time [s]|CH1 [V]|CH2 [degC]"),
        (TOA5 + rows('"{t:.2f}",{u},{y}'), "TIMESTAMP|u_Avg [V]|y_Avg [degC]"),
        (
            '"Plot Title: Tank"\n"#",Time,"u, V (LGR S/N: 1)","Temp, °C (LGR S/N: 1, SEN S/N: 2)"\n'
            + rows("{k},{t:.2f},{u},{y}"),
            "#|Time|u [V]|Temp [°C]",
        ),
        (SIGLENT + "Source,CH1,CH2\nSecond,Volt,Volt\n" + ROWS, "Source [s]|CH1 [V]|CH2 [V]"),
        (SIGLENT + "Second,Volt,Volt\n" + ROWS, "Second|Volt|Volt"),
        (TEKSCOPE + ROWS, "TIME|CH1 [V]|CH2 [V]"),
        (
            "Time,Channel A,Channel B\n(s),(V),(mV)\n\n" + ROWS,
            "Time [s]|Channel A [V]|Channel B [mV]",
        ),
        ("Time [s],Channel 0,Channel 1\n" + ROWS, "Time [s]|Channel 0|Channel 1"),
        (rows('{{"t": {t:.2f}, "in": {{"u": {u}}}, "y": {y}}}'), "t|in.u|y"),
        ("[" + rows('{{"t":{t:.2f},"u":{u},"y":{y}}},').rstrip(",\n") + "]", "t|u|y"),
        (rows("t={t:.2f} u={u} y={y}"), "t|u|y"),
        (rows("t = {t:.2f},  u = {u},  y = {y} °C"), "t|u|y [°C]"),
        (rows("t:{t:.2f}\tu:{u}\ty:{y}"), "t|u|y"),
        (rows("09:12:40.{k:02d}0 -> {t:.2f} {u} {y}"), "time|||"),
        (
            "09:12:39.000 -> t,u,y\n" + rows("09:12:40.{k:02d}0 -> {t:.2f},{u},{y}"),
            "received|t|u|y",
        ),
    ],
)
def test_a_file_of_an_instrument_is_read(text: str, expected: str) -> None:
    for end in ("\n", "\r\n"):
        table = table_of(b"\xef\xbb\xbf" + text.replace("\n", end).encode(), ".csv")

        first = table.texts(0)
        at = int(table.columns[0].name in ("Number", "#") or first[0].startswith("09:12"))
        assert "|".join(titles(table)).startswith(expected)
        for i, values in enumerate((T, U, Y), start=at):
            np.testing.assert_allclose(table.numbers(i), values, atol=1e-9)


def test_the_facts_of_an_oscilloscope_beside_its_rows_name_the_column() -> None:
    facts = ["Record Length,4e1", "Source,CH2", "Vertical Units,V", "Horizontal Units,s"]
    lines = [f"{fact},,{row}," for fact, row in zip(facts, ROWS.split(), strict=False)]
    lines += [f",,,{row.rpartition(',')[0]}," for row in ROWS.split()[4:]]
    lines[:4] = [line.rpartition(",")[0].rpartition(",")[0] + "," for line in lines[:4]]

    table = read_text("\n".join(lines))

    assert titles(table) == ["time [s]", "CH2 [V]"]
    np.testing.assert_allclose(table.numbers(0), T)
    np.testing.assert_allclose(table.numbers(1), U)
    with pytest.raises(FileError, match="line 41 has 1 cell, the line of names 2"):
        read_text("\n".join([*lines, "1,2,3"]))


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ("power;temp\n%;°C", ["power [%]", "temp [°C]"]),
        ("power,temp\n%RH,furlong", ["power [%RH]", "temp [furlong]"]),
        ("power temp\n% °C", ["power [%]", "temp [°C]"]),
        ("power temp\n% of a day", ["power", "temp"]),
        ("% power temp\n% W K\nu y", ["u", "y"]),
        ("Logger: ACME\nu y", ["u", "y"]),
        ("ch 1: ok\nt u y", ["t", "u", "y"]),
    ],
)
def test_a_line_above_the_rows_is_units_or_a_remark(lines: str, expected: list[str]) -> None:
    mark = next((x for x in ";," if x in lines), " ")
    rows = "\n".join(mark.join(["1.5"] * len(expected)) for _ in range(3))

    table = read_text(f"{lines}\n{rows}")

    assert titles(table) == expected
    assert len(table.rows) == 3


ABOVE = ["", "A title\n", "Operator{0}Bob\nDate{0}2025-03-11\nInterval{0}0.01\n", "Log{0}{0}\n"]
ABOVE += ["".join(f"Fact {k}{{0}}{k}\n" for k in range(30))]


@pytest.mark.parametrize("above", ABOVE, ids=["none", "title", "facts", "padded", "30 lines"])
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_lines_above_the_names_are_left_out_and_named(above: str, separator: str) -> None:
    for units, has_quotes, comma in product(["", "s,V,°C\n"], [False, True], [False, True]):
        body = f"time,u,y\n{units}{ROWS}"
        if has_quotes:
            body = "\n".join(",".join(f'"{c}"' for c in row.split(",")) for row in body.split())
        body = body.replace(",", separator)
        body = body.replace(".", ",") if comma and separator != "," else body

        table = read_text(above.format(separator) + body)

        assert titles(table) == (["time [s]", "u [V]", "y [°C]"] if units else ["time", "u", "y"])
        for i, values in enumerate((T, U, Y)):
            np.testing.assert_allclose(table.numbers(i), values, atol=1e-9)
        count = above.count("\n")
        which = f"line{'s' * (count > 1)} 1{f' to {count}' * (count > 1)}"
        assert (f"left out {which} above the names" in table.notes) == bool(above)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "Title\na,b,c\nu,v,y\n" + ROWS,
            "line 2 or line 3 may contain the names; delete the other",
        ),
        ("idx,0,1\n" + ROWS, "line 1: 'idx' is above numbers, like a name, but next to a"),
        ("Title\nidx,0,1\n" + ROWS, "line 2: 'idx' is above numbers, like a name"),
        ("t,u,y\n" + ROWS + "t,u\n", "line 42 has 2 cells"),
        ("0.5\n" + ROWS, "line 2 has 3 cells .*, the first row 1 cell"),
        ("t,u,y\n" + ROWS[:192] + "0,1\n" + ROWS, "line 14 has 2 cells .*, the line of names 3"),
        (LABVIEW, "line 7 has 5 cells .*, the first row 2 cells; give every row the same number"),
        ("X,A,Start,Increment\nSequence,V\n1,2\n", "the header of Rigol is damaged"),
        (
            "CH1V,CH2V,t0 = 0.0e+00, tInc = 1.0e-02,\n" + rows("{u:.2e},{y:.6e},,"),
            "line 2 has 3 cells .*, the first row 4 cells; give .* and begin remarks with #",
        ),
        ('{"t": 0}\n{"t": ', "line 2: JSON is damaged here"),
        ('{"t": 0}\n[1]', "line 2: JSON is damaged here, or not an object such as"),
        ('{"a":' * 100_000, "line 1: JSON is damaged here"),
        ("".join(f'{{"k{k}": 1}}\n' for k in range(9000)), "unpacked it has more than 64 MiB"),
        (
            "u=1" + 300_000 * " " + "V\nu=1\nReady\n",
            "line 3: 'Ready' is not of the form name=value",
        ),
        ("u=1 y=2\nu=1 y=3\nReady\n", "line 3: 'Ready' is not of the form name=value"),
        ("09:12:40 -> 1 2 3\nReady now\n", "line 2 has 2 cells .*, the first row 3"),
    ],
)
def test_a_doubtful_or_damaged_head_is_refused(text: str, said: str) -> None:
    with pytest.raises(FileError, match=said):
        read_text(text)


def test_names_with_numbers_are_names_below_a_name_of_times() -> None:
    table = read_text("Title\ntime,1,2\ns,V,V\n" + ROWS)

    assert titles(table) == ["time [s]", "CH1 [V]", "CH2 [V]"]
    assert table.numbers(1).size == K.size


def test_the_names_that_a_later_line_repeats_are_left_out() -> None:
    head, lines = "Log\nt,u,y\ns,V,K\n", ROWS.splitlines(keepends=True)
    table = read_text(head + "".join(lines[:30]) + head + "".join(lines[30:]))

    np.testing.assert_allclose(table.numbers(0), T)
    assert table.notes[-1] == "left out the names that line 35 repeats"
    assert table.place(30) == "line 37"

    other = read_text("t,u,y\n" + "".join(lines[:30]) + "t,y,u\n" + "".join(lines[30:]))
    with pytest.raises(
        FileError, match=r"line 32, column u: 'y' .*like a second line of names: cut"
    ):
        other.numbers(1)


LONG = [("heater", "on"), ("temp", "20.5 °C"), ("heater", "off"), ("temp", "unavailable")]


@pytest.mark.parametrize(
    ("head", "times", "is_long"),
    [
        ("time,sensor,value", [0, 1, 2, 3], True),
        ("x,channel,reading", ["09:12:40", "09:12:40", "09:12:41", "09:12:41"], True),
        ("time,quality,value", [0, 1, 2, 3], False),
    ],
)
def test_a_long_table_gets_a_column_for_each_name(
    head: str, times: list[object], is_long: bool
) -> None:
    """A word such as a quality at each time does not choose the column."""
    rows = [f"{t},{name},{value}" for t, (name, value) in zip(times, LONG, strict=True)]
    table = read_text("\n".join([head, *rows]))

    if not is_long:
        assert ",".join(titles(table)) == head
        return
    assert titles(table) == [head.partition(",")[0], "heater", "temp [°C]"]
    np.testing.assert_array_equal(table.numbers(1), [1, np.nan, 0, np.nan])
    np.testing.assert_array_equal(table.numbers(2), [np.nan, 20.5, np.nan, np.nan])
    assert table.notes[0] == f"long table: a column for each {head.split(',')[1]}"
    assert table.place(3) == "line 5"
