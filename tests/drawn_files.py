"""Drawn files: one truth in the dialects of loggers, and a judge that knows the truth.

`python -m tests.drawn_files SEED COUNT` prints the verdicts by dialect, and each wrong case. A case
is right if Ts, order, values, names and units are true and each y has the u that was applied. It is
doubted if the history doubts a reading that differs, and refused if an option of the message gives
a right reading; without such an option it is stuck.
"""

from __future__ import annotations

import json
import re
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from armrig import Signals, load_signals
from armrig.data.files.imported_file import write_imported
from armrig.data.files.importing import import_files
from armrig.data.files.placement import Reading
from armrig.data.step import DOUBT, codes_of
from armrig_core.errors import InputError
from numpy.random import Generator
from numpy.typing import NDArray
from pyarrow import parquet
from scipy.io import savemat

Vector = NDArray[np.float64]
Ticks = NDArray[np.int64]
Column = tuple[str, str, list[str]]  # name, unit and cells
Pair = tuple[Any, Any]  # of u and of y
NS = 10**9
BEGIN = datetime(2025, 3, 11, 9, 12, 40, tzinfo=UTC)
EPOCH = int(BEGIN.timestamp())
PERIODS_NS = [n * 10**e for e in range(3, 11) for n in (1, 2, 5)] + [60 * NS, 300 * NS, 600 * NS]
BINARY, LABELLED = ("mat", "npz", "parquet"), ("jsonl", "key=value")
FORMATS = ("csv", "csv", "tsv", "semicolon", "blanks", *LABELLED, *BINARY)
PLAIN = ("none", "s", "s", "ms", "us", "iso", "iso zone", "time of day")
PLAIN += ("epoch s", "epoch ms", "epoch us", "epoch ns", "s+ns")
SEVERAL = ("two clocks", "two files", "sparse", "long")
SMALLEST_NS = dict.fromkeys(("epoch ms", "epoch us", "epoch ns", "ms"), 10**5)
SMALLEST_NS |= dict.fromkeys(("iso", "iso zone", "time of day", "epoch s", "long"), 10**6)
PER_TICK = {"s": NS, "ms": 10**6, "us": 10**3, "ns": 1}
NAMES: dict[str, list[tuple[str, str]]] = {
    "s": [("t", ""), ("time", "s"), ("Time", "sec"), ("time_s", ""), ("elapsed", "s"), ("t", "s")],
    "ms": [("t_ms", ""), ("time", "ms"), ("millis", ""), ("Time", "ms"), ("time", "")],
    "us": [("t_us", ""), ("time", "us"), ("micros", ""), ("timestamp", "")],
    "iso": [("time", ""), ("timestamp", ""), ("created_at", ""), ("Zeit", ""), ("Date/Time", "")],
    "time of day": [("time", ""), ("Uhrzeit", ""), ("clock", "")],
    "epoch": [("time", ""), ("timestamp", ""), ("ts", ""), ("epoch", "")],
}
PREAMBLE = ("Logger: ACME 300", "Serial,12345", "Operator: lab", "Sample rate: 100", "", "ch 1: ok")
ORDERS = (*4 * ["rising"], *2 * ["falling", "gap"], "shuffled", "restart")
MARKS = ("none", "none", "missing", "bool", "units in cells", "thousands", "at changes")
NUMERIC = re.compile(r"-?[\d.]+(e[-+]\d+)?|null|true|false")
OPTIONS = re.compile(r"--(resample|hold-input|Ts|decimal|time|input|signal)\b")


@dataclass(slots=True, kw_only=True)
class Case:
    """Files in a dialect, and the truth: u at the time of each y, the units if they are stated.

    `facts` are options for which a message may ask, `k` is the instant of each y, and `restart` the
    index of the first y after the clock begins again.
    """

    dialect: dict[str, str]
    files: dict[str, bytes]
    options: dict[str, Any]
    facts: dict[str, Any]
    Ts: float
    y: Vector
    u: Vector
    k: Ticks
    restart: int
    names: tuple[str, str]
    units: tuple[str, str]


def draw(rng: Generator, *choices: Any) -> Any:
    """Return one of the choices."""
    return choices[rng.integers(len(choices))]


def drawn_case(rng: Generator) -> Case:
    """Return a case of a drawn dialect; each choice keeps to what the others allow."""
    form = draw(rng, *FORMATS)
    binary, labelled = form in BINARY, form in LABELLED
    clock = draw(rng, *(PLAIN if rng.random() < 0.7 else SEVERAL))
    if binary and clock in ("iso zone", "time of day", "s+ns", "two files", "long"):
        clock = "s"
    clock = "epoch ms" if form + clock in ("matiso", "parquetnone", "parquettwo clocks") else clock
    if labelled and clock in ("two clocks", "two files", "long", "time of day"):
        clock = "sparse"
    clock = "long" if (form, clock) == ("blanks", "two clocks") else clock
    header = draw(rng, "names", "names", "units line", "brackets", "preamble", "comments", "none")
    if (header == "none" and clock in ("ms", "us", "s+ns")) or clock in SEVERAL:
        header = draw(rng, "names", "preamble", *("units line", "brackets") * (clock != "long"))
    period = int(draw(rng, *(p for p in PERIODS_NS if p >= SMALLEST_NS.get(clock, 1000))))
    order = draw(rng, *ORDERS)
    if order + clock == "shuffledtime of day" or (order == "restart" and clock not in PER_TICK):
        order = "gap"
    if clock in ("none", *SEVERAL[:2]) or (clock in SEVERAL and order != "falling"):
        order = "rising"
    types = draw(rng, "float", "float", "int", "exponent")
    marks = draw(rng, *MARKS)
    are_few = binary or labelled or form == "blanks" or order in ("falling", "shuffled")
    marks = marks if clock not in SEVERAL and marks in MARKS[: 4 if are_few else None] else "none"
    if marks == "thousands" and (form == "csv" or types == "exponent"):
        marks = "missing"
    end = draw(rng, "newline", "newline", "no newline", "NULs", "CRLF", "BOM")
    d = {"format": form, "clock": clock, "order": order, "marks": marks, "types": types}
    d |= {"header": "own" if binary or labelled else header, "end": "own" if binary else end}
    d["decimal"] = draw(rng, ",", ",", ".") if form == "semicolon" else "."
    return _written(rng, d, period)


def _written(rng: Generator, d: dict[str, str], period: int) -> Case:
    N, restart, clock = int(rng.integers(150, 401)), 0, d["clock"]
    u = _telegraph(rng, N, d)
    y = _response(rng, u, {"int": 0, "float": int(rng.integers(2, 5))}.get(d["types"], 4))
    k = np.arange(N)
    k[60:] += draw(rng, 1, 3, 40) * (d["order"] == "gap")
    t = k * period
    if d["order"] == "restart":
        t = np.append(t[: (restart := 75)], t[: N - restart])
    if d["marks"] == "missing":
        y[1:-1][rng.random(N - 2) < 0.05] = np.nan
    y = y.astype(np.float32) if d["types"] == "float" and d["format"] in BINARY else y
    truth = {"y": y.astype(np.float64), "u": u, "k": k, "restart": restart, "Ts": period / NS}
    t_u = t
    if clock in SEVERAL:
        first, step = int(period * draw(rng, 0, 0.3, 2.4)), int(period * draw(rng, 1, 1, 2, 0.5))
        t_u = np.arange(first, t[-1], step)
        u = _telegraph(rng, t_u.size, d)
        at = np.searchsorted(t_u, t, side="right") - 1
        truth["u"] = np.where(at >= 0, u[at], np.nan)
    if clock in ("sparse", "long"):
        order = np.argsort(both := np.append(t_u, t), kind="stable")
        u = np.append(u, np.full(t.size, np.nan))[order]
        y = np.append(np.full(t_u.size, np.nan), y)[order]
        t = t_u = both[order]
    names = draw(rng, "u", "power", "heater"), draw(rng, "y", "temp", "speed")
    units = draw(rng, "V", "%", "W"), draw(rng, "degC", "rpm", "mm", "°C")
    case = Case(
        dialect=d, files={}, options={"input": names[0], "signal": names[1]}, names=names,
        facts={"Ts": period / NS, "decimal": d["decimal"], "resample": True, "hold_input": True},
        units=units, **truth,
    )  # fmt: skip
    case.options |= {"Ts": case.Ts} if clock == "none" else {}
    if d["order"] in ("falling", "shuffled"):
        at = np.arange(t.size)[::-1] if d["order"] == "falling" else rng.permutation(t.size)
        t, t_u, u, y = t[at], t_u[at], u[at], y[at]
    (_write_arrays if d["format"] in BINARY else _write_text)(case, rng, (t_u, t), (u, y))
    return case


def _telegraph(rng: Generator, N: int, d: dict[str, str]) -> Vector:
    levels = np.array([0, 2, 5, -3, 8][: rng.integers(2, 6)]) / (1 if d["types"] == "int" else 2)
    levels = np.array([0.0, 1.0]) if d["marks"] == "bool" else levels
    return levels[rng.integers(0, levels.size, N + 1)[np.cumsum(rng.random(N) < 0.12)]]


def _response(rng: Generator, u: Vector, digits: int) -> Vector:
    """Return the output of a plant of order 1 or 2 with noise; all values differ."""
    x, a, order, y = np.zeros(2), rng.uniform(0.6, 0.97, 2), int(rng.integers(1, 3)), 0 * u
    for k, value in enumerate(u):
        y[k] = x[order - 1]
        x = a * x + (1 - a) * np.array([value, x[0]])
    y = rng.choice([20.0, 0.0, 1000.0]) + rng.choice([3.0, -20.0, 400.0]) * y
    y = np.round(y + 0.02 * np.ptp(y) * rng.standard_normal(u.size), digits)
    for k in range(y.size):
        while y[k] in y[:k]:
            y[k] = round(y[k] + 10.0**-digits, digits)
    return y


def _clock_columns(rng: Generator, t: Ticks, clock: str, d: dict[str, str]) -> list[Column]:
    if clock == "none":
        return []
    if clock == "s+ns":
        begin = draw(rng, "", "stamp.")
        seconds, ns = [*map(str, t // NS + EPOCH)], [*map(str, t % NS)]
        return [(f"{begin}sec", "", seconds), (f"{begin}nanosec", "", ns)]
    if clock.startswith("epoch"):
        names, per = [*NAMES["epoch"], (f"time_{clock[6:]}", "")], PER_TICK[clock[6:]]
        t = t + EPOCH * NS
    elif clock in PER_TICK:
        names, per = NAMES[clock], PER_TICK[clock]
        if clock != "s" and np.any(t % per):  # a name without its unit would mislead
            names = names[:-1]
        t = t + draw(rng, 0, 0, 12_000) * per
    else:
        mark = "T" if d["format"] == "blanks" else draw(rng, "T", " ")
        name, unit = draw(rng, *NAMES[clock.removesuffix(" zone")])
        return [(name, unit, [_stamp(tick, clock, mark) for tick in t.tolist()])]
    name, unit = draw(rng, *names)
    if d["header"] not in ("units line", "brackets") and unit not in ("", "s", "sec"):
        name, unit = f"{name}_{unit}", ""
    spec = draw(rng, "f", ".9f") if per == NS else "f"
    cells = [f"{Decimal(tick) / per:{spec}}".replace(".", d["decimal"]) for tick in t.tolist()]
    return [(name, unit, cells)]


def _stamp(tick: int, kind: str, mark: str) -> str:
    moment = BEGIN.replace(tzinfo=None) + timedelta(microseconds=tick // 1000)
    if kind == "time of day":
        return moment.time().isoformat("milliseconds")
    zone = "" if kind == "iso" else "Z" if mark == "T" else "+01:00"
    return moment.isoformat(mark, "milliseconds" if mark == "T" else "auto") + zone


def _write_text(case: Case, rng: Generator, t: Pair, values: Pair) -> None:
    d, form = case.dialect, case.dialect["format"]
    missing = {"blanks": "NaN", "jsonl": "null"}.get(form, draw(rng, "", "NaN", "---"))
    in_cells, in_header = d["marks"] == "units in cells", d["header"] in ("units line", "brackets")
    case.units = ("", "") if not (in_cells or in_header) or d["clock"] == "long" else case.units
    spec = "," * (d["marks"] == "thousands")
    spec += {"int": ".0f", "exponent": ".9e"}.get(d["types"], ".4f")
    marks = str.maketrans(".,", ",." if d["decimal"] == "," else ".,")

    def cell(value: float, unit: str) -> str:
        text = f"{value:{spec}}".translate(marks) if np.isfinite(value) else missing
        return f"{text} {unit}" if in_cells and text != missing else text

    u, y = ([cell(x, unit) for x in z] for z, unit in zip(values, case.units, strict=True))
    if d["marks"] == "bool":
        words = draw(rng, ("False", "True"), ("false", "true"), ("OFF", "ON"))
        u = [words[int(x)] for x in values[0]]
    if d["marks"] == "at changes":
        u = [u[0], *("" if a == b else b for a, b in pairwise(u))]
    of_u, of_y = (case.names[0], case.units[0], u), (case.names[1], case.units[1], y)
    for i, columns in enumerate(_tables(case, rng, t, of_u, of_y)):
        numbers = {name: str(j) for j, (name, *_) in enumerate(columns, 1)}
        if {*case.names} <= numbers.keys():
            case.facts |= {"input": numbers[case.names[0]], "signal": numbers[case.names[1]]}
        suffix = form if form in ("csv", "tsv", "jsonl") else "txt"
        case.files[f"data{i or ''}.{suffix}"] = _content(rng, d, columns)
    if d["header"] == "none" and d["clock"] != "none":
        case.facts["time"] = "1"
    if d["header"] == "none":
        case.options |= {x: case.facts[x] for x in ("input", "signal", "time") if x in case.facts}


def _tables(case: Case, rng: Generator, t: Pair, u: Column, y: Column) -> list[list[Column]]:
    """Return the columns of each file."""
    d, clock, n = case.dialect, case.dialect["clock"], t[0].size
    are_two = clock in ("two clocks", "two files")
    if clock in SEVERAL:
        clock = draw(rng, "s", "s", "iso", "epoch ms") if case.Ts >= 0.01 else "s"
    times = _clock_columns(rng, np.concatenate(t) if are_two else t[1], clock, d)
    case.facts |= {"time": times[0][0]} if times else {}
    if d["clock"] == "long":
        label, value = draw(rng, ("entity_id", "state"), ("channel", "value"), ("name", "value"))
        is_y = [x in ("", "NaN", "---") for x in u[2]]
        cells = [b if w else a for a, b, w in zip(u[2], y[2], is_y, strict=True)]
        columns = [(label, "", [case.names[w] for w in is_y]), (value, "", cells)]
        return [draw(rng, [*times, *columns], [*columns, *times])]
    if not are_two:
        return [[*times, *draw(rng, (u, y), (y, u))]]
    name, unit, cells = times[0]
    if d["clock"] == "two files":
        return [[(name, unit, cells[:n]), u], [(name, unit, cells[n:]), y]]
    of_u, of_y = (f"{name}_{x}" for x in case.names)
    case.facts["time"], length = of_y, max(n, t[1].size)
    columns = [(of_u, unit, cells[:n]), u, (of_y, unit, cells[n:]), y]
    return [[(a, b, [*c, *[""] * (length - len(c))]) for a, b, c in columns]]


def _content(rng: Generator, d: dict[str, str], columns: list[Column]) -> bytes:
    form, header = d["format"], d["header"]
    rows = [*zip(*(cells for *_, cells in columns), strict=True)]
    separator = {"csv": ",", "tsv": "\t", "semicolon": ";"}.get(form, " ")
    names, units = [name for name, *_ in columns], [unit for _, unit, _ in columns]
    head, lines = [separator.join(names)], [separator.join(row) for row in rows]
    if form == "jsonl":
        values = ([x if NUMERIC.fullmatch(x) else json.dumps(x) for x in row] for row in rows)
        pairs = ([f'"{n}": {x}' for n, x in zip(names, row, strict=True)] for row in values)
        lines = [f"{{{', '.join(row)}}}" for row in pairs]
    elif form == "key=value":
        sign, gap = draw(rng, *"=:"), draw(rng, " ", ",", ", ")
        pairs = ([f"{n}{sign}{x}" for n, x in zip(names, row, strict=True) if x] for row in rows)
        lines = [gap.join(row) for row in pairs]
    elif header == "units line":
        none = "-" if form == "blanks" else draw(rng, "-", "")
        head.append(separator.join(unit or none for unit in units))
    elif header == "brackets":
        gap = "" if form == "blanks" else " "
        headings = (f"{n}{gap}[{w}]" if w else n for n, w in zip(names, units, strict=True))
        head = [separator.join(headings)]
    elif header == "preamble":
        head[:0] = [draw(rng, *PREAMBLE) for _ in range(draw(rng, 1, 2, 5, 12, 30))]
    elif header == "comments":
        d["header"], mark = draw(rng, (header, ""), ("hashed names", "# "))
        head = ["# logger 1.2", "# started by hand", mark + head[0]]
    lines[:0] = [] if header == "none" or form in LABELLED else head
    text = ("\r\n" if d["end"] == "CRLF" else "\n").join([*lines, ""])
    content = (text.rstrip("\n") if d["end"] == "no newline" else text).encode()
    return b"\xef\xbb\xbf" * (d["end"] == "BOM") + content + bytes(512) * (d["end"] == "NULs")


def _write_arrays(case: Case, rng: Generator, t: Pair, values: Pair) -> None:
    d, clock, (u_name, y_name) = case.dialect, case.dialect["clock"], case.names
    u, y = values
    u = u.astype(np.bool_) if d["marks"] == "bool" else u
    if clock == "none":
        times = {"Ts": case.options.pop("Ts")}
    elif clock == "two clocks":
        times = {f"t_{u_name}": t[0] / NS, f"t_{y_name}": t[1] / NS}
    elif clock == "iso":
        times = {"time": np.datetime64(EPOCH, "s") + t[1].astype("m8[ns]")}
    else:
        name = {"s": "t", "ms": "t_ms", "us": "t_us", "sparse": "t"}.get(clock, "time")
        ticks, per = t[1] + EPOCH * NS * (name == "time"), PER_TICK.get(clock.split()[-1], NS)
        times = {name: ticks / per if np.any(ticks % per) else ticks // per}
    case.facts["time"], case.units = [*times][-1], ("", "")
    arrays, buffer = times | {u_name: u, y_name: y}, BytesIO()
    if d["format"] == "npz":
        np.savez(buffer, **arrays)
    elif d["format"] == "mat":
        savemat(buffer, _in_matlab(case, rng, arrays))
    else:
        parquet.write_table(pyarrow.table(arrays), buffer)
    case.files[f"data.{d['format']}"] = buffer.getvalue()


def _in_matlab(case: Case, rng: Generator, arrays: dict[str, Any]) -> dict[str, Any]:
    """Return the variables of a MAT-file: vectors, an iddata, or a capture of dSPACE."""
    d, units = case.dialect, ("V", "degC")
    u, y = (np.reshape(arrays[name], (-1, 1)) for name in case.names)
    if d["clock"] not in ("none", "s") or draw(rng, True, False):
        return arrays
    d["header"], case.units = "iddata" if d["clock"] == "none" else "capture", units
    cells = np.array(units, object).reshape(-1, 1)
    if d["clock"] == "s":
        channels = np.empty((1, 2), dtype=[(n, object) for n in ("Name", "Unit", "Data")])
        channels[0] = [(n, w, x.T) for n, w, x in zip(case.names, units, (u, y), strict=True)]
        return {"rec1": {"X": {"Name": "", "Data": arrays["t"][np.newaxis]}, "Y": channels}}
    unit, seconds = draw(rng, ("seconds", 1), ("minutes", 60), ("milliseconds", 1e-3))
    case.names, case.options = ("u", "y"), {"input": "u", "signal": "y"}
    z = {"InputData": u, "OutputData": y, "Ts": case.Ts / seconds, "TimeUnit": unit}
    return {"z": z | {"InputUnit": cells[:1], "OutputUnit": cells[1:], "u": "Same as InputData"}}


def read_case(case: Case, options: dict[str, Any], folder: Path) -> Signals:
    """Import the files of a case and load the recording; raise InputError for a refusal."""
    paths = [folder / name for name in case.files]
    for path in paths:
        path.write_bytes(case.files[path.name])
    how = Reading(**{name: options.get(name) for name in Reading._fields})
    data = import_files(paths, how, inputs=[options["input"]], outputs=[options["signal"]])
    _, content = write_imported(data, name="drawn", started=BEGIN.isoformat(), armrig="0")
    (file := folder / "drawn.mcap").write_bytes(content)
    return load_signals(file, inputs=data.facts.inputs[0], outputs=data.facts.outputs[0])


def differences(case: Case, z: Signals) -> list[str]:
    """Return what differs from the truth."""
    faults = []
    if abs(z.Ts / case.Ts - 1) > 0.01:
        faults.append(f"Ts {z.Ts:g} in place of {case.Ts:g}")
    units = [x * bool(true) for x, true in zip((*z.input_units, *z.units), case.units, strict=True)]
    names = [x.rpartition(".")[2] for x in (*z.inputs, *z.outputs)]
    words = [*(case.names if case.dialect["header"] == "none" else names), *units]
    if words != (true := [*case.names, *case.units]):
        faults.append(f"{words} in place of {true}")
    u, y = z.u[:, 0], z.y[:, 0]
    known, sample = np.flatnonzero(np.isfinite(case.y)), np.flatnonzero(np.isfinite(y))
    order = known[np.argsort(case.y[known])]
    above = np.clip(np.searchsorted(case.y[order], y[sample]), 1, order.size - 1)
    low, high = (np.abs(case.y[order[above - j]] - y[sample]) for j in (1, 0))
    at = order[above - (low < high)]  # index of each sample in the truth
    if np.any(bad := np.minimum(low, high) > 1e-6 * np.abs(case.y[at]) + 1e-9):
        return [*faults, f"y {y[sample][bad][0]:g} was not written ({bad.sum()} such)"]
    if at.size < 0.97 * (due := np.count_nonzero(np.isfinite(case.u[known]))):
        faults.append(f"{at.size} of {due} values of y")
    if np.any(bad := np.isfinite(case.u[at]) & ~np.isclose(case.u[at], u[sample], rtol=1e-6)):
        faults.append(
            f"u {u[sample][bad][0]:g} in place of {case.u[at][bad][0]:g} ({bad.sum()} such)"
        )
    together = np.diff(np.searchsorted(z.starts, sample, side="right")) == 0
    if case.restart and np.any(together & (np.diff(at >= case.restart) != 0)):
        faults.append("no new experiment after the restart")
    steps = np.diff(case.k[at])
    if np.any(bad := (steps <= 0) | (together & (steps != np.diff(sample)))):
        faults.append(f"order or gaps differ ({bad.sum()} places)")
    return faults


def verdict(case: Case, folder: Path, options: dict[str, Any] | None = None) -> tuple[str, str]:
    """Return right, doubted, refused, stuck or wrong, and the reason.

    One of the options that a refusal names must serve, and none may mislead.
    """
    options = options or case.options
    try:
        z = read_case(case, options, folder)
    except InputError as err:
        kind, said = "stuck", str(err)
    except Exception as err:  # a crash
        return "wrong", repr(err)
    else:
        steps = zip(z.history, codes_of(z.history), strict=True)
        doubts = [text for text, code in steps if code == DOUBT]
        faults = differences(case, z)
        kind = ("doubted" if doubts else "wrong") if faults else "right"
        return kind, "; ".join(faults + doubts)
    named = {x.replace("-", "_") for x in OPTIONS.findall(said)} & case.facts.keys()
    named -= {"Ts"} if "time" in named else set()  # the user has times
    for name in sorted(name for name in named if options.get(name) != case.facts[name]):
        outcome, why = verdict(case, folder, options | {name: case.facts[name]})
        if outcome == "wrong":
            return "wrong", f"{said} --> with --{name}: {why}"
        kind = kind if outcome == "stuck" else "refused"
    return kind, said


def run(seed: int, i: int) -> tuple[Case, str, str]:
    """Draw and judge case i of a seed."""
    with tempfile.TemporaryDirectory() as folder:
        return (case := drawn_case(np.random.default_rng([seed, i]))), *verdict(case, Path(folder))


def main(seed: int, count: int) -> None:
    """Print the cases that are wrong or stuck, and the verdicts by dialect."""
    table: dict[str, Counter[str]] = {}
    for i in range(count):
        case, kind, why = run(seed, i)
        for key in ("all", *(f"{axis} {value}" for axis, value in case.dialect.items())):
            table.setdefault(key, Counter())[kind] += 1
        if kind in ("wrong", "stuck"):
            print(f"{kind}: seed {seed}, case {i}: {why}\n  {case.dialect}")
    for key, counts in sorted(table.items()):
        print(f"{key:26}", *(f"{kind} {n:3}" for kind, n in sorted(counts.items())))
    print(f"{time.process_time():.0f} s of processor time")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
